//! Alignment of the whole maps of two robots (first stage), and checks of accepted alignments.

use super::draw_submaps::{PlacedSubmap, draw_submaps};
use super::edge::{Evidence, RecheckResult};
use super::pair::{RobotPair, robots_of_pair};
use super::robot::Robot;
use super::submaps::SubmapStore;
use crate::align::{Alignment, ComparedSubmaps, align, align_near, evaluate, max_null_f1};
use crate::config::{AlignConfig, MergeConfig};
use msg::{Grid, Pose2};

/// Least number of nodes of a robot whose map is aligned: smaller maps hold too little evidence.
const NODES_MIN: u32 = 8;
/// Factor by which the nodes of a pair must grow before it is aligned again.
const GROWTH_FACTOR: f64 = 1.15;
/// Least number of nodes by which a pair must grow before it is aligned again.
const GROWTH_NODES: u32 = 4;
/// The same for a pair whose candidate waits for its second alignment.
const GROWTH_NODES_OF_CANDIDATE: u32 = 2;
/// The same factor for a pair whose starts are given: alignments only confirm them.
const GROWTH_FACTOR_OF_STARTS: f64 = 2.0;
/// A pair is checked again when its nodes have grown by this factor.
const CHECK_GROWTH_FACTOR: f64 = 1.25;
/// Distance that a robot has driven when its submaps begin to say more of its drift than of its start, metres.
const NEAR_START_M: f64 = 10.0;
/// Distance within which the maps are compared where walls match best and not exactly where the starts put them, metres: closures correct that much.
const NEAR_PLACE_M: f64 = 0.5;
/// Most submaps of a robot that a check compares with the other's map, evenly along its way.
const COMPARED_SUBMAPS_MAX: usize = 32;
/// Submaps in a window of a robot's map, its newest: drift has hardly deformed them. Robots with fewer than twice as many
/// have no window.
const WINDOW_SUBMAPS: usize = 5;

/// Work: find where the map of robot b lies in that of robot a.
#[derive(Debug)]
pub(crate) struct AlignJob {
    pair: usize,
    nodes: [u32; 2],
    maps: [Vec<PlacedSubmap>; 2],
    config: AlignConfig,
}

/// Result of an [`AlignJob`].
#[derive(Debug)]
pub(crate) struct AlignmentResult {
    /// The pair of robots.
    pub pair: usize,
    nodes: [u32; 2],
    found: Option<Evidence>,
    f1_above_chance_min: f64,
}

/// Work: compare the maps of two robots where the fleet's graph has them.
#[derive(Debug)]
pub(crate) struct CheckJob {
    pair: usize,
    nodes: u32,
    maps: [Vec<PlacedSubmap>; 2],
    /// Both maps near their starts, each in its own frame, and the relation of the given starts.
    at_starts: Option<([Vec<PlacedSubmap>; 2], Pose2)>,
    config: MergeConfig,
}

/// Result of a [`CheckJob`].
#[derive(Debug)]
pub(crate) struct CheckResult {
    /// The pair of robots.
    pub pair: usize,
    /// Nodes of both robots together.
    nodes: u32,
    found: Option<(Evidence, ComparedSubmaps)>,
    /// The relation of the given starts, and what the maps say of it.
    at_starts: Option<(Pose2, Evidence)>,
    config: MergeConfig,
}

/// Returns the next alignment. Of the pairs that are not in one graph and have grown, it is a candidate or else the one
/// that was tried least often.
pub(crate) fn next_alignment(
    robots: &[Robot],
    pairs: &mut [RobotPair],
    config: &MergeConfig,
) -> Option<AlignJob> {
    let due = pairs.iter().enumerate().filter(|(index, pair)| is_due(*index, pair, robots));
    let next = due.min_by_key(|(_, pair)| (!pair.edge.is_candidate(), pair.schedule.alignments));
    let index = next?.0;
    let schedule = &mut pairs[index].schedule;
    let [a, b] = robots_of_pair(index).map(|robot| &robots[robot].submaps);
    let nodes = [a.node_count(), b.node_count()];
    // In turns: both whole maps; the whole map of one and the window of the other.
    let [from_a, from_b] = match schedule.alignments % 3 {
        0 => [0, 0],
        1 => [0, window_start(b)],
        _ => [window_start(a), 0],
    };
    let maps = [a.placed(from_a..a.poses().len()), b.placed(from_b..b.poses().len())];
    schedule.alignments += 1;
    schedule.final_alignments = schedule.final_alignments.saturating_sub(1);
    schedule.aligned_at_nodes = nodes[0] + nodes[1];
    Some(AlignJob { pair: index, nodes, maps, config: config.align.clone() })
}

/// Returns the next check of two maps that have grown, and that an active edge or given starts relate.
pub(crate) fn next_check(
    robots: &[Robot],
    pairs: &mut [RobotPair],
    config: &MergeConfig,
) -> Option<CheckJob> {
    for (index, pair) in pairs.iter_mut().enumerate() {
        let [a, b] = robots_of_pair(index).map(|robot| &robots[robot]);
        if !pair.edge.is_active() && a_from_b_of_starts(a, b).is_none() {
            continue;
        }
        let nodes = a.submaps.node_count() + b.submaps.node_count();
        let checked_at = pair.schedule.checked_at_nodes;
        let has_grown = f64::from(nodes) >= CHECK_GROWTH_FACTOR * f64::from(checked_at)
            || (pair.starts.are_unverified() && nodes >= checked_at + GROWTH_NODES_OF_CANDIDATE);
        if a.estimate.map_from_robot_map().is_none()
            || b.estimate.map_from_robot_map().is_none()
            || !has_grown
        {
            continue;
        }
        pair.schedule.checked_at_nodes = nodes.max(1);
        let maps = [a, b].map(|robot| robot.placed_in(Pose2::IDENTITY));
        if maps.iter().all(|map| !map.is_empty()) {
            let starts = a_from_b_of_starts(a, b).filter(|_| !pair.edge.is_active());
            let at_starts = starts.map(|a_from_b| ([a, b].map(|robot| near_start(&robot.submaps)), a_from_b));
            return Some(CheckJob { pair: index, nodes, maps, at_starts, config: config.clone() });
        }
    }
    None
}

/// Returns the second robot's map in the first's by their given starts, if both are given.
fn a_from_b_of_starts(a: &Robot, b: &Robot) -> Option<Pose2> {
    Some(a.estimate.configured_map_from_robot_map()?.between(b.estimate.configured_map_from_robot_map()?))
}

/// Returns the submaps that the robot drew before it had driven [`NEAR_START_M`]: drift has hardly moved them.
fn near_start(submaps: &SubmapStore) -> Vec<PlacedSubmap> {
    let count = (0..submaps.poses().len()).take_while(|id| submaps.distance_driven_m(*id, 0) <= NEAR_START_M);
    submaps.placed(0..count.count())
}

fn is_due(index: usize, pair: &RobotPair, robots: &[Robot]) -> bool {
    let [a, b] = robots_of_pair(index).map(|robot| &robots[robot]);
    let in_one_graph = a.estimate.map_from_robot_map().is_some() && b.estimate.map_from_robot_map().is_some();
    // Given starts are checked until the maps have confirmed them.
    let by_starts = a_from_b_of_starts(a, b).is_some() && !pair.starts.are_confirmed();
    let nodes = [a, b].map(|robot| robot.submaps.node_count());
    let schedule = &pair.schedule;
    let growth = if pair.edge.is_candidate() {
        GROWTH_NODES_OF_CANDIDATE
    } else {
        let factor = if by_starts { GROWTH_FACTOR_OF_STARTS } else { GROWTH_FACTOR };
        GROWTH_NODES.max(((factor - 1.0) * f64::from(schedule.aligned_at_nodes)) as u32)
    };
    let has_grown = schedule.aligned_at_nodes == 0
        || nodes[0] + nodes[1] >= schedule.aligned_at_nodes + growth
        || schedule.final_alignments > 0;
    (!in_one_graph || by_starts)
        && !pair.edge.is_active()
        && has_grown
        && nodes.iter().all(|nodes| *nodes >= NODES_MIN)
        && a.submaps.all_have_poses()
        && b.submaps.all_have_poses()
}

/// Returns the first submap of a robot's window; 0 if it has none.
fn window_start(submaps: &SubmapStore) -> usize {
    let count = submaps.poses().len();
    if count >= 2 * WINDOW_SUBMAPS { count - WINDOW_SUBMAPS } else { 0 }
}

fn draw_both([a, b]: &[Vec<PlacedSubmap>; 2]) -> Option<[Grid; 2]> {
    Some([draw_submaps(a)?, draw_submaps(b)?])
}

/// Adds what chance reaches to an alignment of two maps.
fn with_chance([a, b]: [&Grid; 2], alignment: Alignment, config: &AlignConfig) -> Evidence {
    let null_f1_max = max_null_f1(a.view(), b.view(), alignment.a_from_b, &config.walls);
    Evidence { alignment, null_f1_max }
}

impl AlignJob {
    /// Aligns the maps.
    pub fn run(self) -> AlignmentResult {
        let found = draw_both(&self.maps).and_then(|[a, b]| {
            let alignment = align(a.view(), b.view(), &self.config)?;
            // Only an accepted alignment is compared with chance.
            Some(if alignment.accepted {
                with_chance([&a, &b], alignment, &self.config)
            } else {
                Evidence { alignment, null_f1_max: 0.0 }
            })
        });
        let f1_above_chance_min = self.config.f1_above_chance_min;
        AlignmentResult { pair: self.pair, nodes: self.nodes, found, f1_above_chance_min }
    }
}

impl CheckJob {
    /// Compares the maps.
    pub fn run(self) -> CheckResult {
        let found = draw_both(&self.maps).and_then(|[a, b]| {
            let config = &self.config.align;
            let alignment = evaluate(a.view(), b.view(), Pose2::IDENTITY, config)?;
            let submaps = |map: &[PlacedSubmap], other: &Grid| {
                let each = map.len().div_ceil(COMPARED_SUBMAPS_MAX).max(1);
                let parts =
                    map.iter().step_by(each).map(|submap| (submap.grid.view(), submap.frame_from_submap));
                ComparedSubmaps::of(other.view(), parts, &config.walls)
            };
            let [of_a, of_b] = &self.maps;
            let compared = submaps(of_a, &b).plus(submaps(of_b, &a));
            Some((with_chance([&a, &b], alignment, config), compared))
        });
        let at_starts = self.at_starts.and_then(|(maps, a_from_b)| {
            let [a, b] = draw_both(&maps)?;
            let config = &self.config.align;
            // Errors of SLAM are no errors of the start: the maps are compared at the nearest place where walls match.
            let near = align_near(a.view(), b.view(), a_from_b, config)
                .filter(|near| near.a_from_b.distance_m(a_from_b) <= NEAR_PLACE_M);
            let alignment = near.or_else(|| evaluate(a.view(), b.view(), a_from_b, config))?;
            Some((a_from_b, with_chance([&a, &b], alignment, config)))
        });
        CheckResult { pair: self.pair, nodes: self.nodes, found, at_starts, config: self.config }
    }
}

impl AlignmentResult {
    /// Records the alignment; returns whether the pair's edge became accepted.
    pub fn apply(self, pairs: &mut [RobotPair], maps_are_complete: bool) -> bool {
        let edge = &mut pairs[self.pair].edge;
        let Some(found) = self.found else {
            edge.record_nothing_found();
            return false;
        };
        edge.record_alignment(self.nodes, found, self.f1_above_chance_min, maps_are_complete)
    }
}

impl CheckResult {
    /// Records the check.
    pub fn apply(self, pairs: &mut [RobotPair]) -> CheckedPair {
        let pair = &mut pairs[self.pair];
        let mut checked = CheckedPair::default();
        if let Some((found, submaps)) = self.found {
            pair.compared_submaps = submaps;
            if pair.edge.is_active() {
                match pair.edge.record_check(found, &self.config.check) {
                    RecheckResult::Confirmed => {}
                    // The operator's word stands whatever the maps say: it is looked at again when they have grown, as any other.
                    RecheckResult::Contradicted if pair.edge.is_pinned() => {}
                    RecheckResult::Contradicted => pair.schedule.checked_at_nodes = 0,
                    RecheckResult::Refuted => {
                        pair.schedule.checked_at_nodes = 0;
                        pair.drop_edge(self.nodes);
                        checked.edge_was_dropped = true;
                    }
                }
            }
        }
        if let Some((a_from_b, found)) = self.at_starts.filter(|_| !pair.edge.is_active())
            && pair.starts.record_check(&found, &self.config)
        {
            pair.edge.retract_at(a_from_b, found, self.nodes);
            checked.starts_are_contradicted = true;
        }
        checked
    }
}

/// What a check changed.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct CheckedPair {
    /// The maps contradicted the pair's edge often enough to drop it.
    pub edge_was_dropped: bool,
    /// The maps contradict the given starts of the two robots.
    pub starts_are_contradicted: bool,
}
