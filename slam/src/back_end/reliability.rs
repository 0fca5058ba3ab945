//! Keeps the evidence that the map is wrong up to date, a few nodes at a time. Scans are compared with a bounded number of
//! others; the search for these looks at the pose of each node of the map.

use super::BackEnd;
use crate::node::Node;
use crate::odometry_agreement::{MotionPair, OdometryAgreement};
use crate::reliability::{
    NodeComparison, OdometryStep, ReliabilityEvidence, SuspectedBreak, WallAgreement, contradicted_share,
    odometry_residual_sigmas, suspected_break,
};
use crate::stages::Stage;
use msg::Pose2;
use serde::{Deserialize, Serialize};

/// Older nodes that a node is compared with.
const COMPARED_NODES: usize = 4;
/// Two compared nodes are at least this far apart in order.
const COMPARED_NODE_GAP_MIN: u32 = 3;
/// Nodes nearer to each other in order than this are of one pass and say the same.
const SAME_PASS_NODES: u32 = 12;
/// Scans from afar see other sides of things: a metre between viewpoints counts so much as a metre between what is looked at.
const VIEWPOINT: f64 = 0.5;
/// Nodes compared anew with each new one, as solutions move them.
const RENEWED_NODES: usize = 1;
/// Nodes after which what is known of the nodes is summed up.
const SUMMARY_NODES: usize = 8;

/// Evidence that the map is wrong, and what it is computed from; part of a session.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ReliabilityMonitor {
    /// How the nodes agree with older ones of other passes, by id; `None` where there are none.
    pub node_comparisons: Vec<Option<NodeComparison>>,
    /// The newest node that was compared anew.
    pub cursor: usize,
    /// Places that were refused because they are farther away than the robot can have gone.
    pub implausible_relocalizations: u32,
    /// Time in which nothing measured the motion, since its place was known last, seconds.
    pub unmeasured_s: f32,
    /// Where the path is wrong, by what its nodes contradict.
    pub suspected_break: Option<SuspectedBreak>,
    /// The evidence when it was summed up last.
    pub current: ReliabilityEvidence,
}

impl ReliabilityMonitor {
    /// Forgets what is known of nodes that are no more; the others get their new numbers.
    pub fn retain_nodes(&mut self, is_kept: impl Fn(usize) -> bool) {
        let mut kept = 0;
        let new_ids: Vec<Option<u32>> =
            (0..self.node_comparisons.len()).map(|id| is_kept(id).then(|| (kept, kept += 1).0)).collect();
        let renumbered = |old: Option<u32>| new_ids.get(old? as usize).copied().flatten();
        let mut id = 0;
        self.node_comparisons.retain(|_| (is_kept(id), id += 1).0);
        for comparison in self.node_comparisons.iter_mut().flatten() {
            comparison.agrees_with = renumbered(comparison.agrees_with);
            comparison.contradicts = renumbered(comparison.contradicts);
        }
        self.cursor = (0..self.cursor).filter(|id| is_kept(*id)).count();
        self.suspected_break = suspected_break(&self.node_comparisons);
    }
}

impl BackEnd {
    /// Evidence that the map is wrong.
    pub fn reliability_evidence(&self) -> ReliabilityEvidence {
        self.reliability.current
    }

    /// Compares the newest node, and some older ones anew, with the other passes over the same places.
    pub(super) fn update_reliability(&mut self) {
        let Some(newest) = self.nodes.len().checked_sub(1) else { return };
        self.stages.stage_started(Stage::Link);
        let is_new = self.reliability.node_comparisons.len() <= newest;
        self.reliability.node_comparisons.resize(newest + 1, None);
        if is_new {
            self.reliability.node_comparisons[newest] = self.compare_with_older(newest as u32);
        }
        for _ in 0..RENEWED_NODES {
            self.reliability.cursor = (self.reliability.cursor + 1) % (newest + 1);
            self.reliability.node_comparisons[self.reliability.cursor] =
                self.compare_with_older(self.reliability.cursor as u32);
        }
        if newest.is_multiple_of(SUMMARY_NODES) {
            self.summarize_evidence();
        }
    }

    /// Compares all nodes anew, and sums up the evidence.
    pub(super) fn recompute_reliability(&mut self) {
        self.reliability.node_comparisons =
            (0..self.nodes.len() as u32).map(|id| self.compare_with_older(id)).collect();
        self.summarize_evidence();
    }

    fn summarize_evidence(&mut self) {
        let found = suspected_break(&self.reliability.node_comparisons);
        if found != self.reliability.suspected_break {
            self.reliability.suspected_break = found;
            self.update_covariances();
        }
        let unplaced = self.nodes.iter().filter(|node| !node.is_placed()).count();
        self.reliability.current = ReliabilityEvidence {
            contradicted_share: contradicted_share(&self.walls_in_map()),
            odometry_residual_sigmas: odometry_residual_sigmas(&self.odometry_steps()),
            unmeasured_motion_s: self.reliability.unmeasured_s,
            implausible_relocalizations: self.reliability.implausible_relocalizations,
            position_sigma_m: self.largest_position_sigma_m(),
            unplaced_share: unplaced as f32 / self.nodes.len().max(1) as f32,
            conflicting_closures: self.count_conflicting_closures(),
            odometry_agreement: OdometryAgreement::new(&self.motions()),
        };
    }

    /// How the nodes of the map agree with others of the map.
    fn walls_in_map(&self) -> Vec<Option<WallAgreement>> {
        let is_placed = |id: u32| self.nodes.get(id as usize).is_some_and(Node::is_placed);
        let in_map = |(id, comparison): (usize, &Option<NodeComparison>)| {
            let comparison =
                comparison.filter(|it| is_placed(id as u32) && it.contradicts.is_none_or(is_placed))?;
            Some(comparison.walls)
        };
        self.reliability.node_comparisons.iter().enumerate().map(in_map).collect()
    }

    /// Standard deviation of the map's position that is known worst, as seen from one node of the map, metres.
    fn largest_position_sigma_m(&self) -> f64 {
        let in_map = self.nodes.iter().filter(|node| node.is_placed());
        in_map.map(|node| self.graph.position_variance_trace_m2(node.id)).fold(0.0, f64::max).sqrt()
    }

    /// Compares a node with older ones of other passes that look at the same place.
    fn compare_with_older(&self, id: u32) -> Option<NodeComparison> {
        let node = &self.nodes[id as usize];
        let is_comparable = |node: &Node| node.is_tracked && node.disconnected_component.is_none();
        if !is_comparable(node) {
            return None;
        }
        let poses = self.graph.poses();
        let here = poses[id as usize];
        let looks_at = |node: &Node| poses[node.id as usize].apply(node.cloud.centroid_m());
        let [x, y] = looks_at(node);
        let others = &self.nodes[..id.saturating_sub(SAME_PASS_NODES) as usize];
        let mut near: Vec<(f64, u32)> = others
            .iter()
            .filter(|other| is_comparable(other))
            .filter_map(|other| {
                let [u, v] = looks_at(other);
                let apart_m = (u - x).hypot(v - y);
                let away_m = here.distance_m(poses[other.id as usize]);
                (apart_m < self.config.links.distance_max_m)
                    .then_some((apart_m + VIEWPOINT * away_m, other.id))
            })
            .collect();
        near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut compared: Vec<u32> = Vec::with_capacity(COMPARED_NODES);
        for (_, other) in near {
            if compared.iter().all(|earlier| earlier.abs_diff(other) >= COMPARED_NODE_GAP_MIN) {
                compared.push(other);
            }
            if compared.len() == COMPARED_NODES {
                break;
            }
        }
        let mut comparison: Option<NodeComparison> = None;
        for other in compared {
            let other_from_node = poses[other as usize].between(here);
            let cloud = &self.nodes[other as usize].cloud;
            let agreement = WallAgreement::both_ways(cloud, &node.cloud, other_from_node);
            comparison.get_or_insert_default().add(other, agreement);
        }
        comparison
    }

    /// Every motion between consecutive nodes of the map, by odometry and as the graph has it.
    fn odometry_steps(&self) -> Vec<Option<OdometryStep>> {
        let poses = self.graph.poses();
        let step = |pair: &[Node]| {
            let is_in_map = pair.iter().all(Node::is_placed) && !pair[1].odometry_break;
            let MotionPair { by_odometry, .. } = self.motion(pair).filter(|_| is_in_map)?;
            let [a, b] = [pair[0].id, pair[1].id].map(|id| poses[id as usize]);
            let there = a * by_odometry;
            let length_m = by_odometry.x_m.hypot(by_odometry.y_m);
            let [sigma_m, _] = self.configured_odometry_sigmas(by_odometry);
            Some(OdometryStep { error_m: [there.x_m - b.x_m, there.y_m - b.y_m], length_m, sigma_m })
        };
        self.nodes.windows(2).map(step).collect()
    }

    /// All motions between consecutive nodes of the map that odometry measured and that scans matched, with what odometry measured too
    /// much; those too after which the robot was found elsewhere.
    fn motions(&self) -> Vec<MotionPair> {
        let is_matched = |pair: &&[Node]| {
            let is_found = |node: &Node| node.is_tracked || node.odometry_break;
            pair.iter().all(is_found) && pair.iter().all(Node::is_placed)
        };
        let motion = |pair: &[Node]| {
            let MotionPair { by_odometry, in_map } = self.motion(pair)?;
            let [x_m, y_m, yaw_rad] = pair[1].slip;
            Some(MotionPair { by_odometry: by_odometry * Pose2::new(x_m, y_m, yaw_rad), in_map })
        };
        self.nodes.windows(2).filter(is_matched).filter_map(motion).collect()
    }

    /// The motion between two consecutive nodes; `None` if odometry did not measure it.
    fn motion(&self, pair: &[Node]) -> Option<MotionPair> {
        let [before, node] = pair else { return None };
        let by_odometry = node.previous_from_this?;
        let [a, b] = [before.id, node.id].map(|id| self.graph.poses()[id as usize]);
        Some(MotionPair { by_odometry, in_map: a.between(b) })
    }
}
