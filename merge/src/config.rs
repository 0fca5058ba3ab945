//! Configuration of map merging: section `[merge]` of a fleet's file.

use crate::limits::RESOLUTION_M;
use core::ops::RangeInclusive;
use serde::{Deserialize, Serialize};

/// How maps are merged.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MergeConfig {
    /// Side of a cell of the merged map, metres, 0.005 to 1. Use that of the robots' maps: nothing is lost then.
    pub resolution_m: f64,
    /// Thresholds that an alignment of two maps must pass.
    pub align: AlignConfig,
    /// Thresholds of closures between submaps of two robots.
    pub closures: ClosureConfig,
    /// When the maps contradict an accepted edge.
    pub check: CheckConfig,
}

impl Default for MergeConfig {
    fn default() -> Self {
        Self {
            resolution_m: 0.05,
            align: AlignConfig::default(),
            closures: ClosureConfig::default(),
            check: CheckConfig::default(),
        }
    }
}

/// Thresholds that an alignment of two whole maps must pass to be accepted.
///
/// The defaults accept none of the wrong places of the bench's pairs of maps (`cargo bench --bench merge`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AlignConfig {
    /// Least share of the cells known to both maps on which they agree, 0 to 1.
    pub agreement_min: f64,
    /// Least F1 of occupied cells, 0 to 1, at a tolerance of `walls.tolerance_m`.
    pub occupied_f1_min: f64,
    /// Least lead of that F1 over the best of 20 wrong transforms, 0 to 1: what chance cannot reach.
    pub f1_above_chance_min: f64,
    /// Largest share of walls that lie on the other map's floor, 0 to 1.
    ///
    /// Counted are walls on floor and walls on walls. This figure separates the best place in a wrong building from a
    /// right place most clearly.
    pub conflict_max: f64,
    /// The same where long walls that match do not count, 0 to 1.
    ///
    /// Rooms of one size share their outline; furniture, niches and doors tell them apart. Right places of the bench's pairs
    /// have 0.22 at most, those of generated seeds mostly 0.12; wrong ones of generated seeds from 0.28 on.
    pub short_wall_conflict_max: f64,
    /// Least length of short walls that match, of both maps together, metres, 0 to 10000. Right places of the bench's pairs have
    /// 9 and more; empty rooms and corridors have less, and are like others.
    pub short_walls_min_m: f64,
    /// Least area known to both maps, square metres, 0 to 10000.
    pub overlap_min_m2: f64,
    /// Least length of walls that the other map has too, of both maps together, metres, 0 to 10000. 10 m are a room.
    pub walls_min_m: f64,
    /// Least ratio of the best place's score to that of the best other place, 0 to 100.
    pub margin_min: f64,
    /// Least ratio of the length of its short walls that match to that of the best other place that nothing contradicts, 0 to 100.
    ///
    /// Where objects repeat, as pillars do, another place matches as many. Right places of the bench's pairs have 1.69 and more,
    /// wrong ones in halls of equal bays 1.34 at most.
    pub short_walls_margin_min: f64,
    /// Least observability of the position, 0 to 0.5: below it a map can slide along itself, as in a corridor.
    pub observability_min: f64,
    /// When walls of two maps are the same, or contradict each other; for submaps, too.
    pub walls: WallConfig,
}

impl Default for AlignConfig {
    fn default() -> Self {
        Self {
            agreement_min: 0.94,
            occupied_f1_min: 0.80,
            f1_above_chance_min: 0.3,
            conflict_max: 0.11,
            short_wall_conflict_max: 0.25,
            short_walls_min_m: 6.0,
            overlap_min_m2: 10.0,
            walls_min_m: 10.0,
            margin_min: 1.7,
            short_walls_margin_min: 1.5,
            observability_min: 0.03,
            walls: WallConfig::default(),
        }
    }
}

/// When walls of two maps are the same, and when they contradict each other.
///
/// A map's cells round its walls: where cells are larger than 0.05 m, the distances grow with them (1.5, 2.5, 3 and 1 of
/// them at least).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WallConfig {
    /// Largest distance of matching walls, metres, 0.01 to 0.5: a cell and a half of the usual 0.05 m.
    pub match_m: f64,
    /// Least distance to the other map's walls of a wall that its floor contradicts, metres, 0.01 to 0.5. More than
    /// `match_m`: between the two a wall says nothing.
    pub conflict_m: f64,
    /// Half the side of the square around a wall in which its floor is looked for, metres, 0.01 to 0.5: a wall was seen
    /// from there.
    pub side_m: f64,
    /// Tolerance of the F1 of occupied cells, metres, 0.01 to 0.5: a cell of the usual 0.05 m.
    pub tolerance_m: f64,
}

impl Default for WallConfig {
    fn default() -> Self {
        Self { match_m: 0.075, conflict_m: 0.125, side_m: 0.15, tolerance_m: 0.05 }
    }
}

/// Thresholds of closures between submaps of two robots, and of sets of closures that can be right together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ClosureConfig {
    /// Least length of walls that the other submap has too, of both together, metres, 0 to 10000. Less than between
    /// whole maps: the place is known already.
    pub walls_min_m: f64,
    /// Largest share of walls that lie on the other submap's floor, 0 to 1.
    pub conflict_max: f64,
    /// Least ratio of the best place's score to that of the best other place in the search window, 0 to 100.
    pub margin_min: f64,
    /// Least observability of the position, 0 to 0.5.
    pub observability_min: f64,
    /// Largest distance between a closure and its prediction by a consistent one, metres, 0.001 to 10.
    pub error_m: f64,
    /// The same of the rotation, radians, 0.001 to 3.
    pub error_rad: f64,
    /// Increase of `error_m` for each metre that the robots drove between the two, metres, 0 to 1: the drift of their
    /// SLAM.
    pub error_m_per_m: f64,
    /// The same of the rotation, radians, 0 to 1. It moves the far end, too.
    pub error_rad_per_m: f64,
    /// Upper limit of the whole distance, metres, 0.001 to 100: the drift of SLAM along a path without closures.
    pub error_max_m: f64,
    /// The same of the rotation, radians, 0.001 to 3.
    pub error_max_rad: f64,
    /// Error of a closure in the joint solution beyond which it is left out, standard deviations, 0.1 to 100.
    pub outlier_sigmas: f64,
}

impl Default for ClosureConfig {
    fn default() -> Self {
        Self {
            walls_min_m: 7.5,
            conflict_max: 0.11,
            margin_min: 1.3,
            observability_min: 0.04,
            error_m: 0.12,
            error_rad: 0.03,
            error_m_per_m: 0.01,
            error_rad_per_m: 0.004,
            error_max_m: 4.0,
            error_max_rad: 0.4,
            outlier_sigmas: 6.0,
        }
    }
}

/// When the maps contradict an accepted edge, which is then dropped.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CheckConfig {
    /// F1 of occupied cells below which the maps contradict the edge, 0 to 1: right places have 0.8 and more, wrong ones
    /// 0.2 and less.
    pub f1_min: f64,
    /// Least overlap in which such an F1 counts, square metres, 0 to 10000.
    pub overlap_min_m2: f64,
    /// Contradictions in a row after which the edge is dropped, 1 to 100. One may be a map that is being corrected.
    pub contradictions_max: u32,
}

impl Default for CheckConfig {
    fn default() -> Self {
        Self { f1_min: 0.4, overlap_min_m2: 10.0, contradictions_max: 2 }
    }
}

/// A configuration value outside its range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("merge.{key} is {value}; expected {expected}")]
pub struct InvalidMergeConfig {
    /// The key below `merge`, as in the file.
    pub key: &'static str,
    /// The value found.
    pub value: f64,
    /// What was expected, for people.
    pub expected: &'static str,
}

impl MergeConfig {
    /// Checks that every value is in its range.
    ///
    /// # Errors
    /// Names the first key whose value is not.
    pub fn validate(&self) -> Result<(), InvalidMergeConfig> {
        check("resolution_m", self.resolution_m, RESOLUTION_M, "0.005 to 1 metre a cell")?;
        self.align.validate()?;
        self.closures.validate()?;
        self.check.validate()
    }

    /// The resolution, or the nearest plausible one.
    pub(crate) fn plausible_resolution_m(&self) -> f64 {
        let [least, most] = [*RESOLUTION_M.start(), *RESOLUTION_M.end()];
        if RESOLUTION_M.contains(&self.resolution_m) {
            self.resolution_m
        } else {
            least.max(self.resolution_m.min(most))
        }
    }
}

/// Range of shares.
const SHARE: RangeInclusive<f64> = 0.0..=1.0;
/// Range of the smaller eigenvalue's share in the sum of two.
const OBSERVABILITY: RangeInclusive<f64> = 0.0..=0.5;
/// Range of lengths (metres) and areas (square metres).
const EXTENT: RangeInclusive<f64> = 0.0..=10_000.0;
/// Range of ratios of two scores.
const RATIO: RangeInclusive<f64> = 0.0..=100.0;
/// Range of distances between walls, metres.
const WALL_M: RangeInclusive<f64> = 0.01..=0.5;

/// Checks one value.
fn check(
    key: &'static str,
    value: f64,
    range: RangeInclusive<f64>,
    expected: &'static str,
) -> Result<(), InvalidMergeConfig> {
    if range.contains(&value) { Ok(()) } else { Err(InvalidMergeConfig { key, value, expected }) }
}

impl AlignConfig {
    /// Checks that every value is in its range.
    ///
    /// # Errors
    /// Names the first key whose value is not.
    pub fn validate(&self) -> Result<(), InvalidMergeConfig> {
        check("align.agreement_min", self.agreement_min, SHARE, "a share, 0 to 1")?;
        check("align.occupied_f1_min", self.occupied_f1_min, SHARE, "a share, 0 to 1")?;
        check("align.f1_above_chance_min", self.f1_above_chance_min, SHARE, "a share, 0 to 1")?;
        check("align.conflict_max", self.conflict_max, SHARE, "a share, 0 to 1")?;
        check("align.short_wall_conflict_max", self.short_wall_conflict_max, SHARE, "a share, 0 to 1")?;
        check("align.short_walls_min_m", self.short_walls_min_m, EXTENT, "0 to 10000 m")?;
        check("align.overlap_min_m2", self.overlap_min_m2, EXTENT, "0 to 10000 m²")?;
        check("align.walls_min_m", self.walls_min_m, EXTENT, "0 to 10000 m")?;
        check("align.margin_min", self.margin_min, RATIO, "a ratio, 0 to 100")?;
        check("align.short_walls_margin_min", self.short_walls_margin_min, RATIO, "a ratio, 0 to 100")?;
        check("align.observability_min", self.observability_min, OBSERVABILITY, "0 to 0.5")?;
        let walls = &self.walls;
        check("align.walls.match_m", walls.match_m, WALL_M, "0.01 to 0.5 m")?;
        check("align.walls.conflict_m", walls.conflict_m, WALL_M, "0.01 to 0.5 m")?;
        check("align.walls.side_m", walls.side_m, WALL_M, "0.01 to 0.5 m")?;
        check("align.walls.tolerance_m", walls.tolerance_m, WALL_M, "0.01 to 0.5 m")
    }
}

impl ClosureConfig {
    fn validate(&self) -> Result<(), InvalidMergeConfig> {
        check("closures.walls_min_m", self.walls_min_m, EXTENT, "0 to 10000 m")?;
        check("closures.conflict_max", self.conflict_max, SHARE, "a share, 0 to 1")?;
        check("closures.margin_min", self.margin_min, RATIO, "a ratio, 0 to 100")?;
        check("closures.observability_min", self.observability_min, OBSERVABILITY, "0 to 0.5")?;
        check("closures.error_m", self.error_m, 1e-3..=10.0, "0.001 to 10 m")?;
        check("closures.error_rad", self.error_rad, 1e-3..=3.0, "0.001 to 3 rad")?;
        check("closures.error_m_per_m", self.error_m_per_m, 0.0..=1.0, "0 to 1 m for each metre")?;
        check("closures.error_rad_per_m", self.error_rad_per_m, 0.0..=1.0, "0 to 1 rad for each metre")?;
        check("closures.error_max_m", self.error_max_m, 1e-3..=100.0, "0.001 to 100 m")?;
        check("closures.error_max_rad", self.error_max_rad, 1e-3..=3.0, "0.001 to 3 rad")?;
        check("closures.outlier_sigmas", self.outlier_sigmas, 0.1..=100.0, "0.1 to 100 standard deviations")
    }
}

impl CheckConfig {
    fn validate(&self) -> Result<(), InvalidMergeConfig> {
        check("check.f1_min", self.f1_min, SHARE, "a share, 0 to 1")?;
        check("check.overlap_min_m2", self.overlap_min_m2, EXTENT, "0 to 10000 m²")?;
        check("check.contradictions_max", self.contradictions_max.into(), 1.0..=100.0, "1 to 100")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_out_of_range_is_named_with_what_was_expected() {
        assert_eq!(MergeConfig::default().validate(), Ok(()));
        let coarse = MergeConfig { resolution_m: 2.0, ..MergeConfig::default() };
        let text = coarse.validate().unwrap_err().to_string();
        assert_eq!(text, "merge.resolution_m is 2; expected 0.005 to 1 metre a cell");
        assert_eq!(coarse.plausible_resolution_m(), 1.0);
        let align = AlignConfig { conflict_max: -0.1, ..AlignConfig::default() };
        assert!(align.validate().unwrap_err().to_string().starts_with("merge.align.conflict_max is -0.1"));
        let align = AlignConfig { margin_min: f64::NAN, ..AlignConfig::default() };
        assert!(align.validate().unwrap_err().to_string().starts_with("merge.align.margin_min is NaN"));
    }

    /// Keys and ranges (LOW to HIGH) that the explanations state.
    fn stated_ranges() -> impl Iterator<Item = (&'static str, &'static str, [f64; 2])> {
        let (mut section, mut text) = ("", String::new());
        include_str!("config.rs").lines().filter_map(move |line| {
            let line = line.trim();
            if let Some(words) = line.strip_prefix("///") {
                text = format!("{text} {words}");
                return None;
            }
            let text = std::mem::take(&mut text);
            let name = line.strip_prefix("pub ")?;
            if let Some(name) = name.strip_prefix("struct ") {
                section = name.trim_end_matches(" {");
                return None;
            }
            let (key, kind) = name.split_once(": ")?;
            if !matches!(kind, "f64," | "u32,") || section == "InvalidMergeConfig" {
                return None;
            }
            let parts = text.split([',', ':']).flat_map(|part| part.split(". "));
            let range = parts.map(|part| part.trim().trim_end_matches('.')).find_map(|part| {
                let (low, high) = part.split_once(" to ")?;
                Some([low.parse().ok()?, high.parse().ok()?])
            });
            Some((section, key, range.unwrap_or_else(|| panic!("{section}.{key} states no range:{text}"))))
        })
    }

    #[test]
    fn every_key_states_a_range_and_is_held_to_it() {
        let pointer = |section: &str, key: &str| match section {
            "MergeConfig" => format!("/{key}"),
            "AlignConfig" => format!("/align/{key}"),
            "WallConfig" => format!("/align/walls/{key}"),
            "ClosureConfig" => format!("/closures/{key}"),
            "CheckConfig" => format!("/check/{key}"),
            other => panic!("{other} is no section"),
        };
        let with = |pointer: &str, value: f64| -> Result<(), String> {
            let mut config = serde_json::to_value(MergeConfig::default()).unwrap();
            let found = config.pointer_mut(pointer).unwrap();
            *found = if found.is_u64() { serde_json::json!(value as i64) } else { serde_json::json!(value) };
            let config: MergeConfig = serde_json::from_value(config).map_err(|why| why.to_string())?;
            config.validate().map_err(|why| why.to_string())
        };
        let mut count = 0;
        for (section, key, [low, high]) in stated_ranges() {
            let pointer = pointer(section, key);
            for accepted in [low, high] {
                assert_eq!(with(&pointer, accepted), Ok(()), "{pointer}");
            }
            let step = if key == "contradictions_max" { 1.0 } else { 1e-4 };
            for refused in [low - step, high + step] {
                let why = with(&pointer, refused).expect_err(&pointer);
                assert!(why.contains(&pointer[1..].replace('/', ".")), "{pointer}: {why}");
            }
            count += 1;
        }
        assert_eq!(count, 30);
    }
}
