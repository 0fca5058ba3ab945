//! Alignment of the whole maps of two robots (first stage), and checks of accepted alignments.

use super::compose::{PlacedSubmap, compose};
use super::edge::{CheckResult, Evidence};
use super::pair::{RobotPair, robots_of_pair};
use super::robot::Robot;
use super::submaps::SubmapStore;
use crate::align::{align, evaluate, max_null_f1};
use crate::config::{AlignConfig, CheckConfig, MergeConfig};
use msg::{Grid, Pose2};

/// Least number of nodes of a robot whose map is aligned: smaller maps hold too little evidence.
const NODES_MIN: u32 = 8;
/// Factor by which the nodes of a pair must grow before it is aligned again.
const GROWTH_FACTOR: f64 = 1.15;
/// Least number of nodes by which a pair must grow before it is aligned again.
const GROWTH_NODES: u32 = 4;
/// The same for a pair whose candidate waits for its second alignment.
const GROWTH_NODES_OF_CANDIDATE: u32 = 2;
/// An active edge is checked again when its nodes have grown by this factor.
const CHECK_GROWTH_FACTOR: f64 = 1.25;
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
pub(crate) struct MapsAligned {
    pair: usize,
    nodes: [u32; 2],
    found: Option<Evidence>,
    chance_lead_min: f64,
}

/// Work: compare the maps of two robots where the fleet's graph has them.
#[derive(Debug)]
pub(crate) struct CheckJob {
    pair: usize,
    maps: [Vec<PlacedSubmap>; 2],
    config: MergeConfig,
}

/// Result of a [`CheckJob`].
#[derive(Debug)]
pub(crate) struct MapsChecked {
    pair: usize,
    found: Option<Evidence>,
    config: CheckConfig,
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

/// Returns the next check of an active edge whose maps have grown.
pub(crate) fn next_check(
    robots: &[Robot],
    pairs: &mut [RobotPair],
    config: &MergeConfig,
) -> Option<CheckJob> {
    for (index, pair) in pairs.iter_mut().enumerate().filter(|(_, pair)| pair.edge.is_active()) {
        let [a, b] = robots_of_pair(index).map(|robot| &robots[robot]);
        let nodes = a.submaps.node_count() + b.submaps.node_count();
        let has_grown = f64::from(nodes) >= CHECK_GROWTH_FACTOR * f64::from(pair.schedule.checked_at_nodes);
        if a.estimate.transform().is_none() || b.estimate.transform().is_none() || !has_grown {
            continue;
        }
        pair.schedule.checked_at_nodes = nodes.max(1);
        let maps = [a, b].map(|robot| robot.placed_in(Pose2::IDENTITY));
        if maps.iter().all(|map| !map.is_empty()) {
            return Some(CheckJob { pair: index, maps, config: config.clone() });
        }
    }
    None
}

fn is_due(index: usize, pair: &RobotPair, robots: &[Robot]) -> bool {
    let [a, b] = robots_of_pair(index).map(|robot| &robots[robot]);
    let in_one_graph = a.estimate.transform().is_some() && b.estimate.transform().is_some();
    let nodes = [a, b].map(|robot| robot.submaps.node_count());
    let schedule = &pair.schedule;
    let growth = if pair.edge.is_candidate() {
        GROWTH_NODES_OF_CANDIDATE
    } else {
        GROWTH_NODES.max(((GROWTH_FACTOR - 1.0) * f64::from(schedule.aligned_at_nodes)) as u32)
    };
    let has_grown = schedule.aligned_at_nodes == 0
        || nodes[0] + nodes[1] >= schedule.aligned_at_nodes + growth
        || schedule.final_alignments > 0;
    !in_one_graph
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

fn compose_both([a, b]: &[Vec<PlacedSubmap>; 2]) -> Option<[Grid; 2]> {
    Some([compose(a)?, compose(b)?])
}

impl AlignJob {
    /// Aligns the maps.
    pub fn run(self) -> MapsAligned {
        let found = compose_both(&self.maps).and_then(|[a, b]| {
            let alignment = align(a.view(), b.view(), &self.config)?;
            // Only an accepted alignment is compared with chance.
            let null_f1_max = if alignment.accepted {
                max_null_f1(a.view(), b.view(), alignment.a_from_b, &self.config.walls)
            } else {
                0.0
            };
            Some(Evidence { alignment, null_f1_max })
        });
        let chance_lead_min = self.config.chance_lead_min;
        MapsAligned { pair: self.pair, nodes: self.nodes, found, chance_lead_min }
    }
}

impl CheckJob {
    /// Compares the maps.
    pub fn run(self) -> MapsChecked {
        let found = compose_both(&self.maps).and_then(|[a, b]| {
            let config = &self.config.align;
            let alignment = evaluate(a.view(), b.view(), Pose2::IDENTITY, config)?;
            let null_f1_max = max_null_f1(a.view(), b.view(), Pose2::IDENTITY, &config.walls);
            Some(Evidence { alignment, null_f1_max })
        });
        MapsChecked { pair: self.pair, found, config: self.config.check }
    }
}

impl MapsAligned {
    /// Records the alignment; returns whether the pair's edge became accepted.
    pub fn apply(self, pairs: &mut [RobotPair], maps_are_complete: bool) -> bool {
        let edge = &mut pairs[self.pair].edge;
        self.found.is_some_and(|found| {
            edge.record_alignment(self.nodes, found, self.chance_lead_min, maps_are_complete)
        })
    }
}

impl MapsChecked {
    /// Records the check; returns whether the pair's edge was dropped.
    pub fn apply(self, pairs: &mut [RobotPair]) -> bool {
        let pair = &mut pairs[self.pair];
        let Some(found) = self.found.filter(|_| pair.edge.is_active()) else { return false };
        match pair.edge.record_check(found, &self.config) {
            CheckResult::Confirmed => return false,
            CheckResult::Contradicted => pair.schedule.checked_at_nodes = 0,
            CheckResult::Refuted => {
                let nodes = core::mem::take(&mut pair.schedule.checked_at_nodes);
                pair.drop_edge(nodes);
                return true;
            }
        }
        false
    }
}
