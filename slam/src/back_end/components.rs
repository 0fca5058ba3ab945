//! Disconnected components of the pose graph: after a kidnapping, or after odometry failed while the
//! robot saw nothing known.
//!
//! At a node that contradicts those before it, odometry's edge becomes an odometry break: it keeps the order of
//! the nodes and measures nothing. The component after it is neither drawn nor given out, and the robot
//! reads as lost, until a closure or a search of the whole map connects it. If that closure is
//! undone or retracted, the component is unplaced again.
//!
//! The map is the first component until another one is clearly larger, and so on: a robot that never returns ends up with a new map,
//! and a lost robot that stands does not lose its map by one scan more.

use super::links::is_well_constrained;
use super::{BREAK_SIGMAS, BREAK_VARIANCES, BackEnd};
use crate::closure::ClosureCandidate;
use crate::cloud::Agreement;
use crate::graph::{EdgeKind, RelativeUncertainty};
use crate::node::Node;

/// Nodes of the map that a node with an unverified edge is compared with.
const COMPARED_NODES: usize = 8;
/// If more than this share of the compared points is contradicted, and this many points, the edge becomes an odometry break.
const BREAK_SHARE: f32 = 0.3;
const BREAK_POINTS_MIN: usize = 60;
/// Another component becomes the map when it has so many nodes more than the map, or twice as many.
const LEAD_NODES_MAX: usize = 10;
/// A path shorter than this has not drifted by what counts as a contradiction, metres.
const STRAIGHT_M: f64 = 20.0;

impl BackEnd {
    /// Verifies the odometry edge before a node that did not fit, or replaces it by an odometry break. When that node, or one after
    /// it, sees what older nodes saw, a link confirms the edge; if they contradict each other, it becomes a break.
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
        let sure =
            |known: &Option<RelativeUncertainty>| known.is_some_and(|known| is_well_constrained(known, l));
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

    /// Turns the odometry edge before a node into an odometry break, and forgets the searches under way, which relied on it. False if there is
    /// no such edge.
    pub(super) fn break_odometry(&mut self, id: u32) -> bool {
        let before = |e: &crate::graph::Edge| e.kind == EdgeKind::Odometry && e.b == id;
        let Some(index) = self.graph.edges().iter().position(before) else { return false };
        let edge = self.graph.edge_mut(index);
        (edge.kind, edge.information) = (EdgeKind::OdometryBreak, BREAK_SIGMAS.information());
        edge.variances = BREAK_VARIANCES;
        self.nodes[id as usize].odometry_break = true;
        self.forget_searches();
        true
    }

    /// Forgets the searches for places that compare several nodes: the way between these is not known any more.
    pub(super) fn forget_searches(&mut self) {
        self.loop_closures.detector.drop_pending();
        self.location.component_searches.clear();
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
        for id in 0..parent.len() as u32 {
            parent[id as usize] = first(&mut parent, id);
        }
        let map = map_component(&parent);
        let first_of_map = self.nodes.iter().position(|node| node.disconnected_component.is_none());
        for (node, component) in self.nodes.iter_mut().zip(parent) {
            node.disconnected_component = Some(component).filter(|first| *first != map);
        }
        if first_of_map.is_some_and(|first| self.nodes[first].disconnected_component.is_some()) {
            self.map_frame_changes += 1;
        }
    }

    /// Returns how often the map became one of another frame, in this process: its first node, the robot's start at the beginning, is
    /// not part of it any more. Nothing is known then of where the map lies by that start.
    pub fn map_frame_changes(&self) -> u32 {
        self.map_frame_changes
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

/// Returns the first node of the component that is the map. `components`: the first node of each node's component, oldest node first.
///
/// The sizes are followed as they grew, so that the map does not depend on whether the process was started again meanwhile.
fn map_component(components: &[u32]) -> u32 {
    let mut sizes = vec![0_usize; components.len()];
    let mut map = 0;
    for &component in components {
        sizes[component as usize] += 1;
        let map_size = sizes[map as usize];
        if sizes[component as usize] > map_size + map_size.min(LEAD_NODES_MAX) {
            map = component;
        }
    }
    map
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Returns nodes in groups, each of a component and a number of nodes, as [`map_component`] takes them.
    fn nodes(groups: &[(usize, usize)]) -> Vec<u32> {
        let mut first: Vec<Option<u32>> =
            vec![None; 1 + groups.iter().map(|group| group.0).max().unwrap_or(0)];
        let mut nodes = Vec::new();
        for &(component, count) in groups {
            let id = *first[component].get_or_insert(nodes.len() as u32);
            nodes.resize(nodes.len() + count, id);
        }
        nodes
    }

    #[test]
    fn a_component_stays_the_map_until_another_is_clearly_larger() {
        let map = |groups: &[(usize, usize)]| map_component(&nodes(groups));
        assert_eq!(map(&[(0, 4), (1, 5)]), 0, "a lost robot stands");
        assert_eq!(map(&[(0, 4), (1, 8)]), 0);
        assert_eq!(map(&[(0, 4), (1, 9)]), 4, "a robot that never returns has a new map");
        assert_eq!(map(&[(0, 4), (1, 9), (0, 1)]), 4, "it was found in the old one, and keeps the new one");
        assert_eq!(map(&[(0, 4), (1, 9), (0, 15)]), 0);
        assert_eq!([19, 20, 21, 29].map(|count| map(&[(0, 19), (1, count)])), [0; 4]);
        assert_eq!(map(&[(0, 19), (1, 30)]), 19);
    }

    proptest! {
        #[test]
        fn the_map_changes_only_by_a_clear_lead_and_is_never_left_clearly_behind(
            groups in proptest::collection::vec((0..4_usize, 1..30_usize), 1..20)
        ) {
            let nodes = nodes(&groups);
            let mut before = 0;
            for count in 1..=nodes.len() {
                let size = |component: u32| nodes[..count].iter().filter(|of| **of == component).count();
                let needed = |component: u32| size(component) + size(component).min(LEAD_NODES_MAX);
                let map = map_component(&nodes[..count]);
                prop_assert!(map == before || size(map) > needed(before));
                prop_assert!(nodes[..count].iter().all(|other| size(*other) <= needed(map)));
                before = map;
            }
        }
    }
}
