//! Disconnected components of the pose graph: after a kidnapping, or after odometry failed while the
//! robot saw nothing known.
//!
//! At a node that contradicts those before it, odometry's edge becomes an odometry break: it keeps the order of
//! the nodes and measures nothing. The component after it is neither drawn nor given out, and the robot
//! reads as lost, until a closure or a search of the whole map connects it. If that closure is taken
//! back, the component is unplaced again.
//!
//! The map is the largest component, so a robot that never returns ends up with a new map.

use super::links::is_sure;
use super::modes::{FOUND_M, FOUND_RAD};
use super::{BREAK_M, BREAK_RAD, BREAK_VARIANCE, BackEnd};
use crate::closure::ClosureCandidate;
use crate::cloud::Agreement;
use crate::front_end::UNMEASURED_MAX_S;
use crate::graph::{EdgeKind, RelativeUncertainty};
use crate::node::Node;
use crate::relocalize::{MapNodes, RelocalizationOutcome, Relocalizer};
use msg::{Pose2, pose::wrap_angle};
use posegraph::information_from_sigmas;

/// A component of more nodes than this is searched for in the whole map; something passing by is over sooner.
const NODES_MIN: u32 = 5;

/// Nodes of the map that a node with an unverified edge is compared with.
const COMPARED_NODES: usize = 8;
/// If more than this share of the compared points is contradicted, and this many points, the edge is broken.
const BREAK_SHARE: f32 = 0.3;
const BREAK_POINTS_MIN: usize = 60;
/// A path shorter than this has not drifted by what counts as a contradiction, metres.
const STRAIGHT_M: f64 = 20.0;

/// A robot is carried this far when it is kidnapped, metres; and by its speed over the time between the scans.
const REACH_M: f64 = 3.0;
/// Standard deviations of the last place before it that count as well.
const REACH_SIGMAS: f64 = 3.0;
/// Drift of the path since it was kidnapped, metres per metre.
const PATH_DRIFT: f64 = 0.1;
/// What the front end drifts while nothing measures the motion, on top of the distance that the robot can have driven, metres and
/// radians.
const UNMEASURED_M: f64 = 1.0;
const UNMEASURED_RAD: f64 = 0.5;

impl BackEnd {
    /// Verifies or breaks the odometry edge before a node that did not fit. When that node, or one after
    /// it, sees what older nodes saw, a link confirms the edge; if they contradict each other, it is
    /// broken.
    pub(super) fn check_unverified_node(&mut self, id: u32, relative: &[Option<RelativeUncertainty>]) {
        let node = &self.nodes[id as usize];
        if !node.is_tracked {
            self.unverified_node = Some(id).filter(|_| !node.odometry_break);
        }
        let Some(unverified_node) = self.unverified_node else { return };
        let across = |e: &crate::graph::Edge| e.kind == EdgeKind::ScanMatch && e.a.min(e.b) < unverified_node;
        if self.graph.edges_of(id).any(across) {
            self.unverified_node = None;
            return;
        }
        // Where the path since the edge, or before it, may have drifted, a contradiction says nothing about the edge.
        let l = &self.config.links;
        let sure = |known: &Option<RelativeUncertainty>| known.is_some_and(|known| is_sure(known, l));
        if !sure(&relative[unverified_node as usize]) {
            return;
        }
        let before = self.graph.uncertainty_from(unverified_node.saturating_sub(1), l.sigma_max_m.powi(2));
        let poses = self.graph.poses();
        let mut path_m = 0.0;
        let not_drifted = (0..unverified_node).rev().take_while(|old| {
            path_m += poses[*old as usize].distance_m(poses[*old as usize + 1]);
            path_m < STRAIGHT_M
        });
        let not_drifted = not_drifted.last().unwrap_or(unverified_node);
        let looks_at = |id: u32| poses[id as usize].apply(self.nodes[id as usize].cloud.centroid_m());
        let [x, y] = looks_at(id);
        let mut near: Vec<(f64, u32)> = (0..unverified_node)
            .filter(|old| *old >= not_drifted || sure(&before[*old as usize]))
            .filter(|old| {
                self.nodes[*old as usize].is_tracked
                    && self.nodes[*old as usize].disconnected_component == node.disconnected_component
            })
            .map(|old| (looks_at(old), old))
            .map(|([u, v], old)| ((u - x).hypot(v - y), old))
            .filter(|(apart, _)| *apart < self.config.links.distance_max_m)
            .collect();
        near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut agreement = Agreement::default();
        for (_, old) in near.into_iter().take(COMPARED_NODES) {
            let old_from_new = poses[old as usize].between(poses[id as usize]);
            agreement += Agreement::both_ways(&self.nodes[old as usize].cloud, &node.cloud, old_from_new);
        }
        if !agreement.is_contradicted(BREAK_SHARE, BREAK_POINTS_MIN) {
            return;
        }
        if self.break_odometry(unverified_node) {
            self.unverified_node = None;
            self.update_components();
        }
    }

    /// Breaks the odometry edge before a node, and forgets the searches under way, which relied on it; false if there is none.
    pub(super) fn break_odometry(&mut self, id: u32) -> bool {
        let before = |e: &crate::graph::Edge| e.kind == EdgeKind::Odometry && e.b == id;
        let Some(index) = self.graph.edges().iter().position(before) else { return false };
        let edge = self.graph.edge_mut(index);
        (edge.kind, edge.information) =
            (EdgeKind::OdometryBreak, information_from_sigmas(BREAK_M, BREAK_RAD));
        edge.variance = BREAK_VARIANCE;
        self.nodes[id as usize].odometry_break = true;
        self.forget_searches();
        true
    }

    /// Forgets the searches for places that compare several nodes: the way between these is not known any more.
    pub(super) fn forget_searches(&mut self) {
        self.loop_closures.detector.drop_pending();
        self.location.component_relocalizer = None;
    }

    /// Number of components that are not placed in the map.
    pub fn unplaced_component_count(&self) -> usize {
        // A component is named by its first node.
        self.nodes.iter().filter(|node| node.unplaced_component() == Some(node.id)).count()
    }

    /// Whether the newest node is part of the map.
    pub(super) fn newest_is_placed(&self) -> bool {
        self.nodes.last().is_none_or(Node::is_placed)
    }

    /// Updates which node is in which component, from the active edges.
    pub(super) fn update_components(&mut self) {
        let is_break = |e: &crate::graph::Edge| e.kind == EdgeKind::OdometryBreak;
        if !self.graph.edges().iter().any(is_break) {
            return;
        }
        // Union-find; a component is named by its first node.
        let mut parent: Vec<u32> = (0..self.nodes.len() as u32).collect();
        let first = |parent: &mut [u32], mut id: u32| {
            while parent[id as usize] != id {
                parent[id as usize] = parent[parent[id as usize] as usize];
                id = parent[id as usize];
            }
            id
        };
        for edge in self.graph.edges().iter().filter(|e| e.is_active && !is_break(e)) {
            let (a, b) = (first(&mut parent, edge.a), first(&mut parent, edge.b));
            parent[a.max(b) as usize] = a.min(b);
        }
        let mut sizes = vec![0_usize; parent.len()];
        for id in 0..parent.len() as u32 {
            parent[id as usize] = first(&mut parent, id);
            sizes[parent[id as usize] as usize] += 1;
        }
        let largest = (0..sizes.len()).max_by_key(|&id| (sizes[id], core::cmp::Reverse(id)));
        for (node, component) in self.nodes.iter_mut().zip(parent) {
            node.disconnected_component = Some(component).filter(|first| Some(*first as usize) != largest);
        }
    }

    /// Searches the whole map for the newest node's component.
    pub(super) fn relocalize_component(&mut self, id: u32) {
        let Some(first) = self.nodes[id as usize].disconnected_component else { return };
        if id - first < NODES_MIN {
            return;
        }
        let map = MapNodes { nodes: &self.nodes, poses: self.graph.poses() };
        let relocalizer = self.location.component_relocalizer.get_or_insert_with(|| {
            Relocalizer::new(self.config.clone(), map, None, self.location.relocalization)
        });
        let newest = self.nodes[id as usize].clone();
        let local_from_node = newest.local_from_base;
        let relocalization = relocalizer.add_node(newest, map);
        self.location.relocalization = relocalizer.counts();
        let RelocalizationOutcome::Found { map_from_local } = relocalization else { return };
        self.location.component_relocalizer = None;
        let map_from_node = map_from_local * local_from_node;
        let Some(candidate) = self.nearest_in_map(map_from_node) else { return };
        if self.is_beyond_reach(id, map_from_node) {
            self.doubts.implausible_relocalizations += 1;
            return;
        }
        self.add_closures(&[ClosureCandidate {
            newer: id,
            older: candidate,
            older_from_newer: self.graph.poses()[candidate as usize].between(map_from_node),
            information: information_from_sigmas(FOUND_M, FOUND_RAD),
            response: self.config.relocalize.response_min,
        }]);
    }

    /// Whether the robot, last in the map before node `id`, cannot have gone to where that node was found. Carried, it has no
    /// heading that is known; where only the motion was not measured, it is not far from where the front end has it.
    fn is_beyond_reach(&self, id: u32, map_from_node: Pose2) -> bool {
        let Some(last) = self.nodes[..id as usize].iter().rfind(|node| node.is_placed()) else {
            return false;
        };
        let since = &self.nodes[last.id as usize + 1..=id as usize];
        let node = &self.nodes[id as usize];
        let map_from_last = self.graph.poses()[last.id as usize];
        let speed_max_m_s = self.config.odometry.speed_max_m_s;
        let is_kidnapped = |node: &Node| node.odometry_break && !self.is_unmeasured_break(node.id);
        if since.iter().any(is_kidnapped) {
            return self.is_beyond_reach_of_kidnapped(id, map_from_node, is_kidnapped);
        }
        let expected = map_from_last * last.local_from_base.between(node.local_from_base);
        let unmeasured_s: f64 = since.iter().map(|node| f64::from(node.unmeasured_s)).sum();
        let turned_rad = wrap_angle(expected.yaw_rad - map_from_node.yaw_rad).abs();
        expected.distance_m(map_from_node) > UNMEASURED_M + speed_max_m_s * unmeasured_s
            || turned_rad > UNMEASURED_RAD
    }

    /// Whether a kidnapped robot cannot have gone to where node `id` was found. The path since it was kidnapped is known, its
    /// heading in the map is not; of the paths between earlier losses only the length is known.
    fn is_beyond_reach_of_kidnapped(
        &self,
        id: u32,
        map_from_node: Pose2,
        is_kidnapped: impl Fn(&Node) -> bool,
    ) -> bool {
        let nodes = &self.nodes[..=id as usize];
        let is_connected = |node: &&Node| node.disconnected_component.is_none();
        let Some(last) = nodes[..id as usize].iter().rfind(is_connected) else { return false };
        let (node, since) = (&nodes[id as usize], &nodes[last.id as usize + 1..]);
        let first = since.iter().rfind(|node| node.odometry_break).unwrap_or(node);
        let map_from_first = map_from_node * node.local_from_base.between(first.local_from_base);
        let path_m = |nodes: &[Node]| -> f64 {
            nodes.windows(2).map(|pair| pair[0].local_from_base.distance_m(pair[1].local_from_base)).sum()
        };
        let (before, after) = (&nodes[last.id as usize..=first.id as usize], &nodes[first.id as usize..]);
        let speed_max_m_s = self.config.odometry.speed_max_m_s;
        let carries = since.iter().filter(|node| node.id <= first.id && is_kidnapped(node));
        let carried_m = carries.map(|node| {
            REACH_M + speed_max_m_s * (node.header.stamp - nodes[node.id as usize - 1].header.stamp)
        });
        let unmeasured_s: f64 = since.iter().map(|node| f64::from(node.unmeasured_s)).sum();
        let sigma_m = self.graph.position_variance_m2(last.id).sqrt();
        let reach_m = carried_m.sum::<f64>()
            + REACH_SIGMAS * sigma_m
            + path_m(before)
            + speed_max_m_s * unmeasured_s
            + PATH_DRIFT * path_m(after);
        self.graph.poses()[last.id as usize].distance_m(map_from_first) > reach_m
    }

    /// Whether the odometry edge before a node is broken because the motion was not measured.
    fn is_unmeasured_break(&self, id: u32) -> bool {
        let before = self.nodes[..id as usize].iter().rev().take_while(|node| !node.odometry_break);
        let unmeasured_s: f32 = before.map(|node| node.unmeasured_s).sum();
        unmeasured_s + self.nodes[id as usize].unmeasured_s > UNMEASURED_MAX_S
    }

    /// The node of the map nearest to a place.
    pub(super) fn nearest_in_map(&self, at: Pose2) -> Option<u32> {
        let poses = self.graph.poses();
        let away = |id: u32| poses[id as usize].distance_m(at);
        let in_map = self.nodes.iter().filter(|node| node.in_map()).map(|node| node.id);
        in_map.min_by(|a, b| away(*a).total_cmp(&away(*b)))
    }

    /// Moves one of two components to where a closure has it, before the closure connects them: a solver
    /// finds small movements, not half a turn.
    pub(super) fn align_components(&mut self, closure: &ClosureCandidate) {
        let [old, new] =
            [closure.older, closure.newer].map(|id| self.nodes[id as usize].disconnected_component);
        if old == new {
            return;
        }
        let poses = self.graph.poses();
        let (a, b) = (poses[closure.older as usize], poses[closure.newer as usize]);
        let (moves, shift) = match new {
            Some(_) => (new, a * closure.older_from_newer * b.inverse()),
            None => (old, b * closure.older_from_newer.inverse() * a.inverse()),
        };
        for node in self.nodes.iter().filter(|node| node.disconnected_component == moves) {
            self.graph.move_node(node.id, shift);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::straight_path;
    use super::*;

    /// A path of 30 nodes along x, each metre, at one moment; before node 20 the robot was kidnapped.
    fn kidnapped_robot() -> BackEnd {
        let mut back = straight_path(30, 1.0);
        for node in &mut back.nodes[20..] {
            node.disconnected_component = Some(20);
        }
        back.nodes[20].odometry_break = true;
        back
    }

    #[test]
    fn a_kidnapped_robot_is_found_where_it_can_have_been_carried_to_whatever_its_heading() {
        let back = kidnapped_robot();
        // Since it was kidnapped it has driven 9 m.
        let newest_if_carried_to = |first: Pose2| first * Pose2::new(9.0, 0.0, 0.0);
        let is_beyond = |first: Pose2| back.is_beyond_reach(29, newest_if_carried_to(first));
        for yaw_rad in [0.0, 1.5, core::f64::consts::PI] {
            assert!(!is_beyond(Pose2::new(21.0, 2.0, yaw_rad)), "2.8 m from where it was seen last");
            assert!(is_beyond(Pose2::new(30.0, 2.0, yaw_rad)), "11 m from there");
        }
        // The same place of the newest node, but driven to from the other side.
        let place = newest_if_carried_to(Pose2::new(21.0, 2.0, 0.0));
        assert!(!back.is_beyond_reach(29, place));
        let turned = place * Pose2::new(0.0, 0.0, core::f64::consts::PI);
        assert!(back.is_beyond_reach(29, turned), "it would have been carried by 18 m");
    }
}
