//! Configuration of map merging: section `[merge]` of a fleet's file.

use crate::limits::RESOLUTION_M;
use serde::{Deserialize, Serialize};

/// How maps are merged.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MergeConfig {
    /// Side of a cell of the merged map, metres, 0.005 to 1. Use that of the robots' maps: nothing is lost then.
    pub resolution_m: f64,
    /// Thresholds that an alignment of two maps must pass.
    pub align: AlignConfig,
}

impl Default for MergeConfig {
    fn default() -> Self {
        Self { resolution_m: 0.05, align: AlignConfig::default() }
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
    /// Least F1 of occupied cells at a tolerance of one cell, 0 to 1.
    pub occupied_f1_min: f64,
    /// Largest share of walls that lie on the other map's floor, 0 to 1.
    ///
    /// Counted are walls on floor and walls on walls. This figure separates the best place in a wrong building from a
    /// right place most clearly.
    pub conflict_max: f64,
    /// Least area known to both maps, square metres.
    pub overlap_min_m2: f64,
    /// Least number of occupied cells that the other map has too, of both maps together.
    pub inliers_min: u32,
    /// Least ratio of the best place's score to that of the best other place.
    pub margin_min: f64,
    /// Least observability of the position, 0 to 0.5: below it a map can slide along itself, as in a corridor.
    pub observability_min: f64,
}

impl Default for AlignConfig {
    fn default() -> Self {
        Self {
            agreement_min: 0.94,
            occupied_f1_min: 0.80,
            conflict_max: 0.11,
            overlap_min_m2: 10.0,
            inliers_min: 200,
            margin_min: 1.5,
            observability_min: 0.03,
        }
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
        if !RESOLUTION_M.contains(&self.resolution_m) {
            let (key, expected) = ("resolution_m", "0.005 to 1 metre a cell");
            return Err(InvalidMergeConfig { key, value: self.resolution_m, expected });
        }
        self.align.validate()
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

impl AlignConfig {
    /// Checks that every value is in its range.
    ///
    /// # Errors
    /// Names the first key whose value is not.
    pub fn validate(&self) -> Result<(), InvalidMergeConfig> {
        let shares = [
            ("align.agreement_min", self.agreement_min),
            ("align.occupied_f1_min", self.occupied_f1_min),
            ("align.conflict_max", self.conflict_max),
            ("align.observability_min", self.observability_min),
        ];
        if let Some((key, value)) = shares.into_iter().find(|(_, value)| !(0.0..=1.0).contains(value)) {
            return Err(InvalidMergeConfig { key, value, expected: "a share, 0 to 1" });
        }
        let amounts = [("align.overlap_min_m2", self.overlap_min_m2), ("align.margin_min", self.margin_min)];
        let amount = amounts.into_iter().find(|(_, value)| !(value.is_finite() && *value >= 0.0));
        match amount {
            Some((key, value)) => Err(InvalidMergeConfig { key, value, expected: "a number from 0" }),
            None => Ok(()),
        }
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
}
