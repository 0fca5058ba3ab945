//! Given starts, which the maps confirm or contradict.
//!
//! A start that somebody measured or typed can be wrong, and a robot at a wrong place makes a wrong map. So the two maps of each
//! pair of robots are compared where their starts put them, and aligned as those of unknown starts are. A start that is contradicted
//! is not used any more: the place of its robot is unknown until an edge gives it.

use super::FleetPoseGraph;
use super::alignment::{AlignmentResult, CheckResult};
use super::edge::{Evidence, SAME_ALIGNMENT_M, SAME_ALIGNMENT_RAD};
use super::pair::{RobotPair, robots_of_pair};
use crate::config::{ClosureConfig, MergeConfig};
use msg::{Pose2, RobotId, pose::wrap_angle};

/// Score of walls up to which the maps contradict their starts, metres: contradicted walls count 2.7 times, matching ones once, so that
/// it takes 7.5 m of walls. Less is drawn wrong by a robot that has just begun.
const CONTRADICTED_SCORE_M: f64 = -20.0;

/// What the maps of two robots say of the relation of their given starts.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct StartsOfPair {
    agreement: StartsAgreement,
    /// Contradictions in a row.
    contradictions: u32,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum StartsAgreement {
    /// The maps overlap too little.
    #[default]
    Unknown,
    Confirmed,
    Contradicted,
}

/// How far drift can have moved the meeting place of two robots away from where their starts put it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DriftAllowance {
    within_m: f64,
    within_rad: f64,
}

impl DriftAllowance {
    /// The drift of robots that drove so far since their starts, both together, as closures are allowed it.
    fn new(driven_m: f64, config: &ClosureConfig) -> Self {
        let drift_rad = (config.error_rad_per_m * driven_m).min(config.error_max_rad);
        // The heading drifts evenly along the way.
        let drift_m = config.error_m_per_m * driven_m + 0.5 * drift_rad * driven_m;
        Self { within_m: SAME_ALIGNMENT_M + drift_m, within_rad: SAME_ALIGNMENT_RAD + drift_rad }
    }

    fn explains(self, one: Pose2, other: Pose2) -> bool {
        let rotation_rad = wrap_angle(one.yaw_rad - other.yaw_rad).abs();
        one.distance_m(other) < self.within_m && rotation_rad < self.within_rad
    }
}

impl StartsOfPair {
    /// Returns whether the two maps agree where the starts put them.
    pub fn are_confirmed(self) -> bool {
        self.agreement == StartsAgreement::Confirmed
    }

    /// Returns whether the maps contradicted the starts once, and a second comparison is awaited.
    pub fn are_unverified(self) -> bool {
        self.contradictions > 0
    }

    /// Records a comparison of the two maps where the starts put them. Returns whether the starts are contradicted.
    pub fn record_check(&mut self, found: &Evidence, config: &MergeConfig) -> bool {
        let alignment = &found.alignment;
        if alignment.overlap_m2 < config.check.overlap_min_m2 {
            return false;
        }
        if alignment.occupied_f1 < config.check.f1_min && alignment.score_m <= CONTRADICTED_SCORE_M {
            self.contradictions += 1;
            let is_contradicted = self.contradictions >= config.check.contradictions_max;
            if is_contradicted {
                self.contradict();
            }
            return is_contradicted;
        }
        self.contradictions = 0;
        if alignment.occupied_f1 >= found.null_f1_max + config.align.f1_above_chance_min {
            self.agreement = StartsAgreement::Confirmed;
        }
        false
    }

    /// Records that the maps were aligned at a place, where the starts put them at another. Returns whether the starts are
    /// contradicted: not if the maps agree there, too.
    pub fn record_alignment(&mut self, aligned: Pose2, by_starts: Pose2, drift: DriftAllowance) -> bool {
        if self.are_confirmed() || drift.explains(aligned, by_starts) {
            return false;
        }
        self.contradict();
        true
    }

    fn contradict(&mut self) {
        *self = Self { agreement: StartsAgreement::Contradicted, contradictions: 0 };
    }
}

impl FleetPoseGraph {
    /// Returns whether the maps contradicted the robot's given start. It is not used any more then.
    pub fn is_start_contradicted(&self, robot: RobotId) -> bool {
        self.robots.get(robot.index()).is_some_and(|robot| robot.is_start_contradicted)
    }

    /// Applies an alignment of two whole maps.
    pub(crate) fn apply_alignment(&mut self, maps: AlignmentResult) {
        let pair = maps.pair;
        if !maps.apply(&mut self.pairs, self.maps_are_complete) {
            return;
        }
        let aligned = self.pairs[pair].edge.a_from_b();
        if self.starts_contradict(pair, aligned) {
            self.withdraw_worse_start(pair);
        }
        self.graph_changed();
    }

    /// Applies a comparison of two whole maps where the graph has them.
    pub(crate) fn apply_check(&mut self, maps: CheckResult) {
        let pair = maps.pair;
        let checked = maps.apply(&mut self.pairs);
        if checked.starts_are_contradicted {
            self.withdraw_worse_start(pair);
        }
        if checked.edge_was_dropped || checked.starts_are_contradicted {
            self.graph_changed();
        }
    }

    /// Returns whether the given starts of a pair put the two maps elsewhere than this, and not only because of their drift.
    fn starts_contradict(&mut self, pair: usize, aligned: Pose2) -> bool {
        let [a, b] = robots_of_pair(pair).map(|robot| &self.robots[robot]);
        let Some((start_of_a, start_of_b)) =
            a.estimate.configured_map_from_robot_map().zip(b.estimate.configured_map_from_robot_map())
        else {
            return false;
        };
        let driven_m: f64 = [a, b].map(|robot| robot.submaps.distance_driven_m(0, usize::MAX)).iter().sum();
        let drift = DriftAllowance::new(driven_m, &self.config.closures);
        self.pairs[pair].starts.record_alignment(aligned, start_of_a.between(start_of_b), drift)
    }

    fn withdraw_worse_start(&mut self, pair: usize) {
        let robot = worse_start(pair, &self.pairs);
        self.robots[robot].withdraw_start();
        // Closures were searched where the start put the robot.
        for (index, pair) in self.pairs.iter_mut().enumerate() {
            if robots_of_pair(index).contains(&robot) {
                pair.clear_evidence();
            }
        }
    }
}

/// Returns which robot of a pair whose starts contradict each other has the worse start: the one with more contradicted pairs and
/// fewer confirmed ones. Of equal ones it is the second, so that the first robot's frame stays.
pub(crate) fn worse_start(pair: usize, pairs: &[RobotPair]) -> usize {
    let [a, b] = robots_of_pair(pair);
    let contradictions = |robot: usize| -> i32 {
        let of_robot = pairs.iter().enumerate().filter(|(index, _)| robots_of_pair(*index).contains(&robot));
        let each = of_robot.map(|(_, pair)| match pair.starts.agreement {
            StartsAgreement::Unknown => 0,
            StartsAgreement::Confirmed => -1,
            StartsAgreement::Contradicted => 1,
        });
        each.sum()
    };
    if contradictions(a) > contradictions(b) { a } else { b }
}
