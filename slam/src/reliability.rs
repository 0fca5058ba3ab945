//! Evidence that a map is wrong: walls that another pass saw through, odometry that the map's motion contradicts, and much of the path
//! without a known place. And where in the path the error is, if one place explains what contradicts.
//!
//! A closure that is wrong by metres fits its own scans, or it would not have been accepted. It shows elsewhere: the scans
//! beside it are drawn over those of another place, or the path to it has become longer or shorter than the wheels say.

use crate::cloud::{Cloud, SEE_THROUGH_M};
use crate::odometry_agreement::OdometryAgreement;
use crate::point_transform::PointTransform;
use msg::Pose2;
use serde::{Deserialize, Serialize};

/// Contradicted points within this distance of each other belong to one object, metres.
const OBJECT_GAP_M: f32 = 0.25;
/// An object of contradicted points at least this long is a wall, metres; a person or a chair is shorter.
const WALL_EXTENT_M: f32 = 0.8;
/// A wall has at least this many contradicted points: at `lidar.spacing_m` of 5 cm, half of its extent.
const WALL_POINTS_MIN: usize = 8;
/// Nodes over which contradictions are summed up: 3 m of path.
const WINDOW_NODES: usize = 10;
/// Fewer contradicted points of walls in a window than this say nothing: 5 m of wall. In acapulco a window has 87.
const WINDOW_POINTS_MIN: u32 = 100;
/// A share of contradicted points from here on is evidence. Right maps of generated logs have at most 0.12.
const CONTRADICTED_SHARE_MAX: f32 = 0.3;
/// Steps over which the map is compared with odometry: 2.4 m of path, short enough that a slip of the wheels shows
/// less than a path that a wrong closure bends.
const RESIDUAL_STEPS: usize = 8;
/// Standard deviation of odometry that does not depend on the number of steps, metres: the scans' own noise.
const RESIDUAL_SIGMA_M: f64 = 0.05;
/// Standard deviation of the length of all steps together, as a wrong wheel radius has it, metres per metre.
const RESIDUAL_SIGMA_M_PER_M: f64 = 0.03;
/// A residual from here on is evidence, standard deviations. Right maps of generated logs, slipping wheels included, have at
/// most 4.1.
const RESIDUAL_SIGMAS_MAX: f64 = 4.5;
/// A share of the nodes from here on that is not placed is evidence: what separates them may be in the map as well.
const UNPLACED_SHARE_MAX: f32 = 0.25;
/// A node contradicts an older one by so many points of walls at least, 1 m of wall, and agrees with it by as many.
const PAIR_POINTS_MIN: u32 = 20;
/// A node agrees with an older one if no larger share is contradicted.
const AGREEING_SHARE_MAX: f32 = 0.1;
/// Nodes that contradict older ones across a place of the path, more than agree with some, show that the motion there is wrong.
const SUSPECTED_BREAK_NODES_MIN: i32 = 5;

/// How well a scan and others from another pass agree about walls.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct WallAgreement {
    /// Points that lie on a surface of the other scan.
    pub agree: u32,
    /// Points of walls that the other scan saw through.
    pub contradict: u32,
}

impl core::ops::AddAssign for WallAgreement {
    fn add_assign(&mut self, other: Self) {
        self.agree += other.agree;
        self.contradict += other.contradict;
    }
}

impl WallAgreement {
    /// Compares two scans, `b` placed at `a_from_b`, each with the other.
    pub fn both_ways(a: &Cloud, b: &Cloud, a_from_b: Pose2) -> Self {
        let mut agreement = compare_walls(a, b, a_from_b);
        agreement += compare_walls(b, a, a_from_b.inverse());
        agreement
    }
}

/// How a node agrees with older ones of other passes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct NodeComparison {
    /// The agreement with all of them.
    pub walls: WallAgreement,
    /// The oldest one that it agrees with.
    pub agrees_with: Option<u32>,
    /// The newest one that it contradicts.
    pub contradicts: Option<u32>,
}

impl NodeComparison {
    /// Adds the agreement with an older node.
    pub fn add(&mut self, older: u32, agreement: WallAgreement) {
        self.walls += agreement;
        let WallAgreement { agree, contradict } = agreement;
        let share = contradict as f32 / (agree + contradict).max(1) as f32;
        if contradict >= PAIR_POINTS_MIN && share > CONTRADICTED_SHARE_MAX {
            self.contradicts = self.contradicts.max(Some(older));
        } else if agree >= PAIR_POINTS_MIN && share < AGREEING_SHARE_MAX {
            self.agrees_with = Some(self.agrees_with.map_or(older, |oldest| oldest.min(older)));
        }
    }
}

/// A place in the path whose motion is wrong: what lies on one side of it contradicts what lies on the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SuspectedBreak {
    /// The last node that is surely before it.
    pub before: u32,
    /// The first node that is surely after it.
    pub after: u32,
}

/// Finds the place in the path that divides the most nodes from older ones that they contradict, and the fewest from those that they
/// agree with; the comparisons are those of the nodes, by id.
pub fn suspected_break(nodes: &[Option<NodeComparison>]) -> Option<SuspectedBreak> {
    // Changes of the sum over pairs whose older node is before a place, and whose newer one is not: place `k` is before node `k`.
    let mut changes = vec![0_i32; nodes.len() + 1];
    for (id, comparison) in nodes.iter().enumerate().filter_map(|(id, node)| Some((id, (*node)?))) {
        for (older, weight) in [(comparison.contradicts, 1), (comparison.agrees_with, -1)] {
            if let Some(older) = older.filter(|older| (*older as usize) < id) {
                changes[older as usize + 1] += weight;
                changes[id + 1] -= weight;
            }
        }
    }
    let mut sum = 0;
    let sums: Vec<i32> = changes.iter().map(|change| (sum += change, sum).1).collect();
    let most = sums.iter().copied().max().filter(|most| *most >= SUSPECTED_BREAK_NODES_MIN)?;
    let first = sums.iter().position(|sum| *sum == most)?;
    let places = sums[first..].iter().take_while(|sum| **sum == most).count();
    Some(SuspectedBreak { before: first as u32 - 1, after: (first + places - 1) as u32 })
}

/// Compares the points of `b`, placed at `a_from_b`, with what `a` saw.
fn compare_walls(a: &Cloud, b: &Cloud, a_from_b: Pose2) -> WallAgreement {
    let transform = PointTransform::new(a_from_b);
    let mut agreement = WallAgreement::default();
    let mut seen_through = Vec::new();
    for point in b.points() {
        let at = transform.point(point.at);
        if a.has_surface(at, transform.direction(point.normal)) {
            agreement.agree += 1;
        } else if a.sees_through(at, SEE_THROUGH_M) {
            seen_through.push(at);
        }
    }
    agreement.contradict = points_of_walls(&seen_through) as u32;
    agreement
}

/// Number of points that belong to objects as long as a wall: single-linkage clusters.
fn points_of_walls(points: &[[f32; 2]]) -> usize {
    let distance = |a: usize, b: usize| (points[a][0] - points[b][0]).hypot(points[a][1] - points[b][1]);
    let mut left: Vec<usize> = (0..points.len()).collect();
    let mut of_walls = 0;
    while let Some(first) = left.pop() {
        let mut object = vec![first];
        let mut next = 0;
        while next < object.len() {
            let here = object[next];
            left.retain(|&other| {
                let is_near = distance(here, other) < OBJECT_GAP_M;
                if is_near {
                    object.push(other);
                }
                !is_near
            });
            next += 1;
        }
        let is_long = || object.iter().any(|&a| object.iter().any(|&b| distance(a, b) >= WALL_EXTENT_M));
        if object.len() >= WALL_POINTS_MIN && is_long() {
            of_walls += object.len();
        }
    }
    of_walls
}

/// Largest share of contradicted points over consecutive nodes, 0 to 1; `None` is a node that was compared with nothing.
pub fn contradicted_share(nodes: &[Option<WallAgreement>]) -> f32 {
    let compared: Vec<WallAgreement> = nodes.iter().flatten().copied().collect();
    let share = |window: &[WallAgreement]| {
        let mut sum = WallAgreement::default();
        window.iter().for_each(|agreement| sum += *agreement);
        let is_enough = sum.contradict >= WINDOW_POINTS_MIN;
        if is_enough { sum.contradict as f32 / (sum.agree + sum.contradict) as f32 } else { 0.0 }
    };
    let window = WINDOW_NODES.min(compared.len()).max(1);
    compared.windows(window).map(share).fold(0.0, f32::max)
}

/// A motion between two nodes, by odometry and as the map has it.
#[derive(Clone, Copy, Debug)]
pub struct OdometryStep {
    /// Odometry's motion minus that in the map, in the map's axes, metres.
    pub error_m: [f64; 2],
    /// Length of the motion by odometry, metres.
    pub length_m: f64,
    /// Standard deviation of odometry over it, metres.
    pub sigma_m: f64,
}

/// Largest difference between map and odometry over consecutive steps, in standard deviations of odometry; `None` is a step
/// that odometry did not measure.
pub fn odometry_residual_sigmas(steps: &[Option<OdometryStep>]) -> f64 {
    let residual = |window: &[Option<OdometryStep>]| {
        let (mut error, mut length_m, mut variance) = ([0.0; 2], 0.0, RESIDUAL_SIGMA_M * RESIDUAL_SIGMA_M);
        for step in window {
            let step = (*step)?;
            error = [error[0] + step.error_m[0], error[1] + step.error_m[1]];
            length_m += step.length_m;
            variance += step.sigma_m * step.sigma_m;
        }
        variance += (RESIDUAL_SIGMA_M_PER_M * length_m).powi(2);
        Some(error[0].hypot(error[1]) / variance.sqrt())
    };
    steps.windows(RESIDUAL_STEPS).filter_map(residual).fold(0.0, f64::max)
}

/// Evidence that a map is wrong.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ReliabilityEvidence {
    /// Largest share of compared points, over some metres of path, that belong to walls which another pass saw through, 0 to 1.
    pub contradicted_share: f32,
    /// Largest difference of the map from odometry over some metres of path, standard deviations of odometry.
    pub odometry_residual_sigmas: f64,
    /// Time in which neither odometry nor scans measured the robot's motion, since its place was known last, seconds.
    pub unmeasured_motion_s: f32,
    /// Places that were refused because they are farther away than the robot can have gone.
    pub implausible_relocalizations: u32,
    /// Standard deviation of the position in the map that is known worst, metres.
    pub position_sigma_m: f64,
    /// Share of the nodes that are not placed in the map: nothing connects them with it, their position is uncertain, or they
    /// contradict it; 0 to 1.
    pub unplaced_share: f32,
    /// Closures that agree with another one and put nodes of the map more than a metre away from where they are: the map contradicts them.
    pub conflicting_closures: u32,
    /// How the motion in the map compares with odometry's over the whole path.
    pub odometry_agreement: OdometryAgreement,
}

impl ReliabilityEvidence {
    /// Whether the evidence is strong enough to call the map unreliable.
    pub fn is_unreliable(&self) -> bool {
        self.reasons().next().is_some()
    }

    /// The evidence in words: what is strong enough.
    pub fn reasons(&self) -> impl Iterator<Item = &'static str> + use<> {
        let reasons = [
            (self.contradicted_share > CONTRADICTED_SHARE_MAX, "scans see through walls of the map"),
            (
                self.odometry_residual_sigmas > RESIDUAL_SIGMAS_MAX,
                "the path is longer or shorter than odometry says",
            ),
            (
                self.unplaced_share > UNPLACED_SHARE_MAX,
                "a large part of the path has no known place in the map",
            ),
            (self.conflicting_closures > 0, "places that were recognised lie elsewhere in the map"),
        ];
        let of_map = reasons.into_iter().filter(|(is_strong, _)| *is_strong).map(|(_, reason)| reason);
        of_map.chain(self.odometry_agreement.reasons())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::common::{FULL, Noise, Wall, cast, rectangle};
    use crate::config::SlamConfig;
    use crate::testing::standing_node;
    use msg::Stamp;

    /// A scan in the middle of a room.
    fn scan_of(walls: &[Wall], at: Pose2) -> std::sync::Arc<Cloud> {
        let scan = cast(walls, &FULL, at, Stamp(0), &mut Noise::new(5));
        standing_node(0, &scan, at, &SlamConfig::default().lidar).cloud
    }

    #[test]
    fn a_wall_that_another_scan_saw_through_contradicts_but_a_person_does_not() {
        let room = rectangle(-3.0, -2.5, 3.0, 2.5);
        let empty = scan_of(&room, Pose2::IDENTITY);
        let person = [room.clone(), rectangle(1.2, 0.2, 1.6, 0.6)].concat();
        let divided = [room, rectangle(1.5, -2.5, 1.6, 2.5)].concat();
        let compared = |walls: &[Wall]| {
            WallAgreement::both_ways(&empty, &scan_of(walls, Pose2::IDENTITY), Pose2::IDENTITY)
        };
        assert_eq!(compared(&person).contradict, 0, "{:?}", compared(&person));
        let wall = compared(&divided);
        assert!(wall.contradict > 20 && wall.agree > 100, "{wall:?}");
        let nodes = vec![Some(WallAgreement { agree: 300, contradict: 0 }); 30];
        assert_eq!(contradicted_share(&nodes), 0.0);
        let bent =
            [nodes, vec![None; 3], vec![Some(WallAgreement { agree: 30, contradict: 70 }); 12]].concat();
        assert!((contradicted_share(&bent) - 0.7).abs() < 1e-6);
    }

    #[test]
    fn a_torn_path_stretches_odometry_and_noise_over_all_of_it_does_not() {
        let step = |error_m: [f64; 2]| Some(OdometryStep { error_m, length_m: 0.3, sigma_m: 0.05 });
        let alternating = |k: usize| step([if k.is_multiple_of(2) { 0.05 } else { -0.05 }, 0.03]);
        let mut steps: Vec<_> = (0..100).map(alternating).collect();
        assert!(odometry_residual_sigmas(&steps) < 2.0, "{}", odometry_residual_sigmas(&steps));
        steps[50] = step([0.0, 2.0]);
        assert!(
            odometry_residual_sigmas(&steps) > 2.0 * RESIDUAL_SIGMAS_MAX,
            "{}",
            odometry_residual_sigmas(&steps)
        );
        // Where odometry measured nothing it says nothing.
        steps[50] = None;
        assert!(odometry_residual_sigmas(&steps) < 2.0);
    }

    #[test]
    fn every_kind_of_evidence_makes_a_map_unreliable_and_has_its_words() {
        assert!(!ReliabilityEvidence::default().is_unreliable());
        let evidence = [
            ReliabilityEvidence { contradicted_share: 0.5, ..ReliabilityEvidence::default() },
            ReliabilityEvidence { odometry_residual_sigmas: 8.0, ..ReliabilityEvidence::default() },
            ReliabilityEvidence { unplaced_share: 0.4, ..ReliabilityEvidence::default() },
            ReliabilityEvidence { conflicting_closures: 2, ..ReliabilityEvidence::default() },
        ];
        let words: Vec<_> = evidence.iter().flat_map(ReliabilityEvidence::reasons).collect();
        assert_eq!(words.len(), 4);
        assert!((0..4).all(|a| (0..a).all(|b| words[a] != words[b])), "{words:?}");
    }

    /// Comparisons of 40 nodes: the last ones with the first ones, which they agree with or contradict.
    fn second_pass(contradicts_from: u32) -> Vec<Option<NodeComparison>> {
        let compared = |id: u32| {
            let mut comparison = NodeComparison::default();
            let walls = match id < contradicts_from {
                true => WallAgreement { agree: 100, contradict: 0 },
                false => WallAgreement { agree: 40, contradict: 60 },
            };
            comparison.add(id - 20, walls);
            comparison
        };
        (0..40).map(|id| (id >= 20).then(|| compared(id))).collect()
    }

    #[test]
    fn a_path_is_cut_where_its_end_contradicts_its_beginning_and_not_for_a_door() {
        // Kidnapped at an unknown place between nodes 19 and 20.
        assert_eq!(suspected_break(&second_pass(20)), Some(SuspectedBreak { before: 19, after: 20 }));
        // Kidnapped on the second round: until then it agrees.
        assert_eq!(suspected_break(&second_pass(27)), Some(SuspectedBreak { before: 26, after: 27 }));
        assert_eq!(suspected_break(&second_pass(40)), None);
        // Two nodes see a door that was open.
        let mut door = second_pass(40);
        for id in [30, 31] {
            let mut comparison = NodeComparison::default();
            comparison.add(10, WallAgreement { agree: 40, contradict: 60 });
            door[id] = Some(comparison);
        }
        assert_eq!(suspected_break(&door), None);
        assert_eq!(suspected_break(&[]), None);
    }
}
