//! Whether a configuration can be worked with.

use super::SlamConfig;
use crate::limits::FRAME_UPDATES_MAX;

/// A number of the configuration that cannot be worked with.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("slam.{field} is {found}, expected {expected}")]
pub struct ConfigError {
    /// The field's path below `slam`.
    pub field: &'static str,
    /// What it holds.
    pub found: f64,
    /// What it may hold.
    pub expected: &'static str,
}

impl SlamConfig {
    /// Checks that every number can be worked with.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let between = |field, found: f64, low: f64, high: f64, expected| {
            // A key in single precision may be below a limit by its rounding alone: 0.02 as `f32` is below 0.02.
            let single = found as f32;
            let is_single = f64::from(single) == found;
            let sound = (found >= low || is_single && single >= low as f32)
                && (found <= high || is_single && single <= high as f32);
            if sound { Ok(()) } else { Err(ConfigError { field, found, expected }) }
        };
        for value in self.lidar.base_from_scan {
            between("lidar.base_from_scan", value, -10.0, 10.0, "three numbers within 10 m (rad)")?;
        }
        let (lidar, tracking, map) = (&self.lidar, &self.tracking, &self.map);
        between("lidar.range_use_max_m", lidar.range_use_max_m.into(), 0.1, 200.0, "0.1 to 200 m")?;
        between("lidar.spacing_m", lidar.spacing_m.into(), 0.005, 1.0, "0.005 to 1 m")?;
        between("lidar.points_max", lidar.points_max as f64, 16.0, 4096.0, "16 to 4096")?;
        between("odometry.buffer_len", self.odometry.buffer_len as f64, 2.0, 65536.0, "2 to 65536")?;
        between("odometry.sigma_m", self.odometry.sigma_m, 1e-4, 10.0, "0.0001 to 10 m")?;
        between("odometry.sigma_rad", self.odometry.sigma_rad, 1e-4, 3.0, "0.0001 to 3 rad")?;
        between("tracking.node_distance_m", tracking.node_distance_m, 0.01, 5.0, "0.01 to 5 m")?;
        between("tracking.node_turn_rad", tracking.node_turn_rad, 0.01, 3.2, "0.01 to 3.2 rad")?;
        between("tracking.local_map_nodes", tracking.local_map_nodes as f64, 2.0, 200.0, "2 to 200")?;
        between("tracking.local_map_reach_m", tracking.local_map_reach_m.into(), 2.0, 60.0, "2 to 60 m")?;
        between("tracking.cell_m", tracking.cell_m.into(), 0.02, 0.5, "0.02 to 0.5 m")?;
        between("tracking.blur_m", tracking.blur_m.into(), 0.01, 1.0, "0.01 to 1 m")?;
        between("tracking.window_max_m", tracking.window_max_m, 0.05, 10.0, "0.05 to 10 m")?;
        between("tracking.window_max_rad", tracking.window_max_rad, 0.01, 3.2, "0.01 to 3.2 rad")?;
        let search_points_max = tracking.search_points_max as f64;
        between("tracking.search_points_max", search_points_max, 1.0, 4096.0, "1 to 4096")?;
        between("tracking.references", tracking.references as f64, 1.0, 64.0, "1 to 64")?;
        between("tracking.points_min", tracking.points_min as f64, 1.0, 4096.0, "1 to 4096")?;
        between("links.sequential", self.links.sequential as f64, 1.0, 64.0, "1 to 64")?;
        between("links.near", self.links.near as f64, 0.0, 64.0, "0 to 64")?;
        between("alignment.gate_wide_m", self.alignment.gate_wide_m.into(), 0.01, 0.5, "0.01 to 0.5 m")?;
        between("alignment.gate_narrow_m", self.alignment.gate_narrow_m.into(), 0.01, 0.5, "0.01 to 0.5 m")?;
        between("links.point_landmark_weight", self.links.point_landmark_weight, 0.0, 1.0, "0 to 1")?;
        between("alignment.point_sigma_m", self.alignment.point_sigma_m, 1e-4, 1.0, "0.0001 to 1 m")?;
        between("closures.window_max_m", self.closures.window_max_m, 0.1, 50.0, "0.1 to 50 m")?;
        between("closures.query_nodes", self.closures.query_nodes as f64, 1.0, 100.0, "1 to 100")?;
        between("closures.chain_nodes", self.closures.chain_nodes as f64, 1.0, 200.0, "1 to 200")?;
        between("graph.nodes_max", self.graph.nodes_max as f64, 2.0, 1e6, "2 to 1 000 000")?;
        let trajectory_max = self.graph.trajectory_max as f64;
        between("graph.trajectory_max", trajectory_max, 0.0, 1e7, "0 to 10 000 000")?;
        between("graph.cauchy_sigmas", self.graph.cauchy_sigmas, 0.1, 1e6, "0.1 to 1 000 000")?;
        between("map.resolution_m", map.resolution_m, 0.01, 1.0, "0.01 to 1 m")?;
        between("map.hit_log_odds", map.hit_log_odds, 0.05, 6.0, "0.05 to 6 (natural log-odds)")?;
        between("map.miss_log_odds", map.miss_log_odds, 0.05, 6.0, "0.05 to 6 (natural log-odds)")?;
        between("map.robot_radius_m", map.robot_radius_m, 0.0, 2.0, "0 to 2 m")?;
        let (r, l) = (&self.relocalize, &self.lifelong);
        between("relocalize.places_max", r.places_max as f64, 1.0, 100.0, "1 to 100")?;
        between("relocalize.near_node_m", r.near_node_m, 0.1, 1e3, "0.1 to 1000 m")?;
        between("relocalize.evaluations_max", r.evaluations_max as f64, 1.0, 1e9, "1 to 10^9")?;
        between("lifelong.views", l.views as f64, 1.0, 100.0, "1 to 100")?;
        between("lifelong.batch", l.batch as f64, 1.0, 1000.0, "1 to 1000")?;
        between("lifelong.nodes_max", l.nodes_max as f64, 100.0, 1e6, "100 to 1 000 000")?;
        between("map.range_max_m", map.range_max_m.into(), 0.1, 200.0, "0.1 to 200 m")?;
        self.check_shares()?;
        self.check_amounts()?;
        self.check_counts()
    }

    /// Checks the shares, 0 to 1.
    fn check_shares(&self) -> Result<(), ConfigError> {
        let (links, closures, relocalize) = (&self.links, &self.closures, &self.relocalize);
        let shares = [
            ("tracking.overlap_min", f64::from(self.tracking.overlap_min)),
            ("links.overlap_min", links.overlap_min.into()),
            ("links.agreement_min", links.agreement_min.into()),
            ("closures.response_min", closures.response_min.into()),
            ("closures.ambiguity_ratio_max", closures.ambiguity_ratio_max.into()),
            ("closures.agreement_min", closures.agreement_min.into()),
            ("closures.overlap_min", closures.overlap_min.into()),
            ("graph.new_share", self.graph.new_share),
            ("relocalize.response_min", relocalize.response_min.into()),
            ("relocalize.candidate_ratio_min", relocalize.candidate_ratio_min.into()),
            ("relocalize.overlap_min", relocalize.overlap_min.into()),
            ("relocalize.agreement_min", relocalize.agreement_min.into()),
            ("lifelong.contradicted_share", self.lifelong.contradicted_share.into()),
        ];
        check_all(&shares, |value| (0.0..=1.0).contains(&value), "a share, 0 to 1")
    }

    /// Checks distances, angles and standard deviations that have no upper limit.
    fn check_amounts(&self) -> Result<(), ConfigError> {
        let (odometry, links, closures) = (&self.odometry, &self.links, &self.closures);
        let (relocalize, lifelong) = (&self.relocalize, &self.lifelong);
        let zero_or_more = [
            ("odometry.extrapolation_max_s", odometry.extrapolation_max_s),
            ("odometry.sigma_m_per_m", odometry.sigma_m_per_m),
            ("odometry.sigma_rad_per_rad", odometry.sigma_rad_per_rad),
            ("odometry.sigma_rad_per_m", odometry.sigma_rad_per_m),
            ("links.drift_m_per_m", links.drift_m_per_m),
            ("links.drift_rad_per_m", links.drift_rad_per_m),
            ("graph.bias_rad_per_m", self.graph.bias_rad_per_m),
            ("closures.radius_m", closures.radius_m),
            ("closures.travel_m", closures.travel_m),
            ("map.clear_without_return_m", self.map.clear_without_return_m.into()),
            ("map.redraw_m", self.map.redraw_m),
            ("relocalize.confirmation_distance_m", relocalize.confirmation_distance_m),
            ("relocalize.travel_m", relocalize.travel_m),
            ("lifelong.view_m", lifelong.view_m),
            ("lifelong.view_rad", lifelong.view_rad),
        ];
        let above_zero = [
            ("odometry.speed_max_m_s", odometry.speed_max_m_s),
            ("odometry.turn_max_rad_s", odometry.turn_max_rad_s),
            ("tracking.degenerate_sigma_m", self.tracking.degenerate_sigma_m),
            ("links.distance_max_m", links.distance_max_m),
            ("links.sigma_max_m", links.sigma_max_m),
            ("links.sigma_max_rad", links.sigma_max_rad),
            ("alignment.cauchy_m", self.alignment.cauchy_m),
            ("links.sigma_min_m", links.sigma_min_m),
            ("links.sigma_min_rad", links.sigma_min_rad),
            ("closures.window_max_rad", closures.window_max_rad),
            ("closures.window_sigmas", closures.window_sigmas),
            ("closures.chain_m", closures.chain_m),
            ("closures.query_m", closures.query_m),
            ("closures.agree_m", closures.agree_m),
            ("closures.agree_rad", closures.agree_rad),
            ("graph.step_min", self.graph.step_min),
            ("graph.retract_sigmas", self.graph.retract_sigmas),
            ("relocalize.agree_m", relocalize.agree_m),
            ("relocalize.agree_rad", relocalize.agree_rad),
            ("relocalize.give_up_m", relocalize.give_up_m),
        ];
        check_all(&zero_or_more, |value| value.is_finite() && value >= 0.0, "a number, 0 or more")?;
        check_all(&above_zero, |value| value.is_finite() && value > 0.0, "a number above 0")
    }

    /// Checks counts that have no upper limit.
    fn check_counts(&self) -> Result<(), ConfigError> {
        let counts = [
            ("tracking.lost_scans_max", f64::from(self.tracking.lost_scans_max)),
            ("closures.query_points_max", self.closures.query_points_max as f64),
            ("closures.confirmations_min", self.closures.confirmations_min as f64),
            ("closures.evaluations_max", self.closures.evaluations_max as f64),
            ("graph.iterations_max", self.graph.iterations_max as f64),
            ("relocalize.confirmations_min", self.relocalize.confirmations_min as f64),
            ("relocalize.estimate_nodes_max", self.relocalize.estimate_nodes_max as f64),
            ("lifelong.contradictions", f64::from(self.lifelong.contradictions)),
        ];
        check_all(&counts, |value| value >= 1.0, "1 or more")?;
        // The front end keeps as many frame updates: of more, each would be dropped before it is due.
        let lags = [("graph.frame_update_lag_nodes", f64::from(self.graph.frame_update_lag_nodes))];
        check_all(&lags, |value| (1.0..=FRAME_UPDATES_MAX as f64).contains(&value), "1 to 64")
    }
}

/// Checks numbers of one kind; the first that is out of range is the error.
fn check_all(
    values: &[(&'static str, f64)],
    is_sound: impl Fn(f64) -> bool,
    expected: &'static str,
) -> Result<(), ConfigError> {
    match values.iter().find(|(_, value)| !is_sound(*value)) {
        Some(&(field, found)) => Err(ConfigError { field, found, expected }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    /// Range that a key's explanation states.
    #[derive(Debug)]
    struct StatedRange {
        low: f64,
        /// Whether `low` itself is refused.
        is_open: bool,
        high: Option<f64>,
    }

    /// Reads the range in an explanation: `LOW to HIGH`, `LOW or more`, `above LOW`.
    fn stated_range(text: &str) -> Option<StatedRange> {
        // Digits are grouped by spaces, and clauses end with a punctuation mark.
        let parts = text.split([',', ';', ':']).flat_map(|part| part.split(". "));
        parts.map(|part| part.trim().trim_end_matches('.')).find_map(|part| {
            let number = |text: &str| match text.trim() {
                "10^9" => Some(1e9),
                text => text.replace(' ', "").parse().ok(),
            };
            if let Some(low) = part.strip_prefix("above ").and_then(number) {
                return Some(StatedRange { low, is_open: true, high: None });
            }
            if let Some(low) = part.strip_suffix(" or more").and_then(number) {
                return Some(StatedRange { low, is_open: false, high: None });
            }
            let (low, high) = part.split_once(" to ")?;
            let low = number(low.trim_start_matches("each "))?;
            Some(StatedRange { low, is_open: false, high: Some(number(high)?) })
        })
    }

    /// Explanations of all keys, by struct and field, from the source.
    fn explanations() -> impl Iterator<Item = (&'static str, &'static str, String)> {
        let (mut section, mut text) = ("", String::new());
        include_str!("../config.rs").lines().filter_map(move |line| {
            let line = line.trim();
            if let Some(words) = line.strip_prefix("///") {
                text = format!("{text} {}", words.trim());
                return None;
            }
            let text = std::mem::take(&mut text);
            let name = line.strip_prefix("pub ")?;
            if let Some(name) = name.strip_prefix("struct ") {
                section = name.trim_end_matches(" {");
                return None;
            }
            let (key, _) = name.split_once(": ")?;
            Some((section, key, text))
        })
    }

    /// The default configuration with one value replaced; `None` if its type does not hold the value.
    fn with(section: &str, key: &str, value: Value) -> Option<SlamConfig> {
        let mut config = serde_json::to_value(SlamConfig::default()).unwrap();
        config[section][key] = value;
        serde_json::from_value(config).ok()
    }

    /// Asserts that a value is refused with an error that names its key, if its type holds it.
    fn assert_refused(section: &str, key: &str, value: Value) {
        let Some(config) = with(section, key, value.clone()) else { return };
        let error = config.validate().expect_err(&format!("slam.{section}.{key} = {value} is accepted"));
        assert_eq!(error.field, format!("{section}.{key}"));
        assert!(error.to_string().contains(", expected "), "{error}");
    }

    fn assert_accepted(section: &str, key: &str, value: Value) {
        let config = with(section, key, value.clone()).unwrap();
        assert_eq!(config.validate(), Ok(()), "slam.{section}.{key} = {value}");
    }

    #[test]
    fn every_key_states_a_range_and_is_held_to_it() {
        let default = serde_json::to_value(SlamConfig::default()).unwrap();
        // The types of the sections, from the fields of the whole.
        let source = include_str!("../config.rs");
        let (mut numbers, mut seen) = (0, std::collections::BTreeSet::new());
        for (of, key, text) in explanations() {
            let mut sections = default.as_object().unwrap().iter();
            let Some((section, keys)) =
                sections.find(|(name, _)| source.contains(&format!("pub {name}: {of},")))
            else {
                continue;
            };
            let value = &keys[key];
            let whole = value.is_u64();
            if !(whole || value.is_f64()) {
                continue;
            }
            let range =
                stated_range(&text).unwrap_or_else(|| panic!("slam.{section}.{key} states no range:{text}"));
            let as_value = |number: f64| if whole { json!(number as i64) } else { json!(number) };
            let step = if whole { 1.0 } else { 1e-5 * range.low.abs().max(1e-3) };
            if range.is_open {
                assert_refused(section, key, as_value(range.low));
                assert_accepted(section, key, as_value(range.low + step));
            } else {
                assert_refused(section, key, as_value(range.low - step));
                assert_accepted(section, key, as_value(range.low));
            }
            if let Some(high) = range.high {
                assert_accepted(section, key, as_value(high));
                assert_refused(section, key, as_value(if whole { high + 1.0 } else { high * 1.00001 }));
            }
            seen.insert(format!("{section}.{key}"));
            numbers += 1;
        }
        assert_eq!(numbers, seen.len());
        let of_section = |keys: &Value| {
            keys.as_object().unwrap().values().filter(|value| value.is_f64() || value.is_u64()).count()
        };
        let all: usize = default.as_object().unwrap().values().map(of_section).sum();
        assert_eq!(numbers, all, "a key was not found in the source: {seen:?}");
        assert_refused("lidar", "base_from_scan", json!([0.0, 11.0, 0.0]));
        assert_eq!(SlamConfig::default().validate(), Ok(()));
    }
}
