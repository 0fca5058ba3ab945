//! Lifelong mapping: which nodes a map that lasts removes, and when:
//!
//! - Of scans of the same view (`lifelong.view_m`, `view_rad`) the newest `lifelong.views` are kept.
//! - A scan that `lifelong.contradictions` later ones contradict (they see through
//!   `contradicted_share` of it) goes as soon as a later scan has much the same view.
//!
//! So what stood in the room is gone from the map when a robot has looked at its place a few times
//! more, people and opened doors too, and the number of nodes is bounded by the area, not by time.
//! A node that goes leaves its knowledge in the graph: what it was linked to is linked to one of
//! its neighbours instead, as the graph has them now (after Kretzschmar and Stachniss,
//! "Information-theoretic compression of pose graphs for laser-based SLAM", IJRR 2012: marginalising
//! onto a tree keeps the graph sparse).

use super::BackEnd;
use crate::graph::{Edge, EdgeKind, PoseVariances};
use msg::{Pose2, pose::wrap_angle};
use nalgebra::Matrix3;

/// A later scan that sees this far behind a point contradicts it, metres: less than elsewhere, as both scans are
/// linked and hardly drift against each other, and what leaves the room may be thin.
const SEE_THROUGH_M: f32 = 0.3;
/// A contradicted scan goes if a later one has much the same view: within this many times the limits of the same view.
const COVERING_VIEW_SCALE: f64 = 1.5;
/// Links of a removed node that its neighbours take over: the best known ones.
const INHERITED_MAX: usize = 16;
/// Share of its information that an inherited link keeps where the sum of both covariances cannot be inverted: two like errors.
const INHERITED_SHARE: f64 = 0.5;

/// What a map that lasts remembers of its nodes.
#[derive(Default)]
pub(super) struct Lifelong {
    /// How often each node was contradicted by later ones.
    pub contradicted: Vec<u8>,
    /// Nodes to be removed with the next batch.
    pub marked: Vec<u32>,
    /// Nodes removed so far.
    pub removed_nodes: u64,
}

impl BackEnd {
    /// Nodes removed so far; the others then have new numbers.
    pub fn removed_nodes(&self) -> u64 {
        self.lifelong.removed_nodes
    }

    /// Removes what later nodes contradict or repeat; called after each node in lifelong mode.
    pub(super) fn remove_outdated_nodes(&mut self) {
        let Some(newest) = self.nodes.len().checked_sub(1).filter(|_| self.newest_is_placed()) else {
            return;
        };
        self.count_contradictions(newest);
        self.mark_repeated_views(newest);
        let full = self.nodes.len() >= self.config.lifelong.nodes_max.min(self.config.graph.nodes_max);
        if full && self.lifelong.marked.is_empty() {
            self.mark_for_removal(0);
        }
        if self.lifelong.marked.len() >= self.config.lifelong.batch || full {
            self.remove_marked();
        }
    }

    fn mark_for_removal(&mut self, id: u32) {
        if !self.lifelong.marked.contains(&id) {
            self.lifelong.marked.push(id);
        }
    }

    /// Whether a node is old enough to be touched.
    fn is_old(&self, id: usize) -> bool {
        id + self.config.lifelong.newest < self.nodes.len() && !self.lifelong.marked.contains(&(id as u32))
    }

    fn same_view(&self, a: usize, b: usize, scale: f64) -> bool {
        let l = &self.config.lifelong;
        let (p, q) = (self.graph.poses()[a], self.graph.poses()[b]);
        let together = self.nodes[a].disconnected_component == self.nodes[b].disconnected_component;
        together
            && p.distance_m(q) < scale * l.view_m
            && wrap_angle(p.yaw_rad - q.yaw_rad).abs() < scale * l.view_rad
    }

    /// Old nodes linked to the newest one, that it sees through.
    fn count_contradictions(&mut self, newest: usize) {
        let linked: Vec<u32> = self
            .graph
            .edges_of(newest as u32)
            .filter(|e| e.kind == EdgeKind::ScanMatch)
            .map(|e| if e.a as usize == newest { e.b } else { e.a })
            .collect();
        for old in linked.into_iter().map(|id| id as usize) {
            if !self.is_old(old) {
                continue;
            }
            let new_from_old = self.graph.poses()[newest].between(self.graph.poses()[old]);
            let (newest, old_cloud) = (&self.nodes[newest].cloud, &self.nodes[old].cloud);
            let agreement = newest.compare(old_cloud, new_from_old, SEE_THROUGH_M);
            let l = &self.config.lifelong;
            if !agreement.is_contradicted(l.contradicted_share, 0) {
                continue;
            }
            self.lifelong.contradicted[old] = self.lifelong.contradicted[old].saturating_add(1);
            let covered =
                (old + 1..self.nodes.len()).any(|later| self.same_view(old, later, COVERING_VIEW_SCALE));
            if self.lifelong.contradicted[old] >= l.contradictions && covered {
                self.mark_for_removal(old as u32);
            }
        }
    }

    /// Of the views like the newest one's, the oldest beyond the allowed number.
    fn mark_repeated_views(&mut self, newest: usize) {
        let same: Vec<usize> = (0..=newest).filter(|&id| self.same_view(id, newest, 1.0)).collect();
        let beyond = same.len().saturating_sub(self.config.lifelong.views);
        for id in same.into_iter().take(beyond) {
            if self.is_old(id) {
                self.mark_for_removal(id as u32);
            }
        }
    }

    /// Removes the marked nodes, and renumbers the others.
    fn remove_marked(&mut self) {
        let mut gone = core::mem::take(&mut self.lifelong.marked);
        gone.sort_unstable();
        let mut edges = self.graph.edges().to_vec();
        for &id in &gone {
            marginalise(&mut edges, self.graph.poses(), id);
        }
        let numbers = RenumberedNodes::without(&gone, self.nodes.len());
        let keep = |id: usize| numbers.of(id as u32).is_some();
        self.renumber_searches(&numbers);
        let kept_poses = self.graph.poses().iter().enumerate().filter(|(id, _)| keep(*id)).map(|(_, p)| *p);
        let kept_edges = edges.into_iter().filter_map(|e| {
            // Retracted links are dropped; retracted closures stay listed.
            let is_kept = e.is_active || e.kind == EdgeKind::Closure;
            is_kept.then_some(Edge { a: numbers.of(e.a)?, b: numbers.of(e.b)?, ..e })
        });
        self.graph.replace_parts(kept_poses.collect(), kept_edges.collect());
        self.forget_odometry_after(&gone);
        let mut id = 0;
        self.nodes.retain(|_| (keep(id), id += 1).0);
        for (id, node) in self.nodes.iter_mut().enumerate() {
            node.id = id as u32;
        }
        self.node_ids.earlier_nodes = (0..self.node_ids.earlier_nodes).filter(|id| keep(*id)).count();
        let mut id = 0;
        self.node_ids.front_ids.retain(|_| (keep(id), id += 1).0);
        let mut id = 0;
        self.lifelong.contradicted.retain(|_| (keep(id), id += 1).0);
        self.reliability.retain_nodes(keep);
        self.loop_closures.renumber(&|id| numbers.of(id));
        self.lifelong.removed_nodes += gone.len() as u64;
        self.update_after_edge_change();
        self.node_ids.earlier.clear();
        // The map is another one now: drawn anew, all at once, so that nobody sees half of it.
        self.mapper.restore(&self.nodes, self.graph.poses());
    }

    /// Gives the nodes that searches and checks under way speak of their new numbers; before the nodes are removed.
    fn renumber_searches(&mut self, numbers: &RenumberedNodes) {
        // Before the first node there is no edge.
        self.unverified_node =
            self.unverified_node.and_then(|id| numbers.at_or_after(id)).filter(|id| *id > 0);
        self.odometry_noise.renumber(|id| numbers.at_or_after(id).unwrap_or(numbers.kept));
        if let Some(unconfirmed) = &mut self.location.unconfirmed {
            unconfirmed.first_node = numbers.at_or_after(unconfirmed.first_node).unwrap_or(numbers.kept);
        }
        let nodes = &self.nodes;
        self.location.component_searches.renumber(|component| {
            // A component is named by its first node.
            let of_component = nodes.iter().filter(|node| node.disconnected_component == Some(component));
            of_component.filter_map(|node| numbers.of(node.id)).next()
        });
    }

    /// Forgets odometry's motion to each node whose predecessor goes: it is one from that predecessor, and says nothing of the node that
    /// will be before it.
    fn forget_odometry_after(&mut self, gone: &[u32]) {
        for id in gone {
            if let Some(node) = self.nodes.get_mut(*id as usize + 1) {
                node.previous_from_this = None;
            }
        }
    }
}

/// The numbers that nodes have after some were removed.
struct RenumberedNodes {
    /// New number of each node; `None` if it was removed.
    new: Vec<Option<u32>>,
    /// Nodes that are left.
    kept: u32,
}

impl RenumberedNodes {
    /// The numbers after the nodes `gone`, which are sorted, were removed from `nodes` nodes.
    fn without(gone: &[u32], nodes: usize) -> Self {
        let mut kept = 0;
        let number = |id: u32| {
            let stays = gone.binary_search(&id).is_err();
            stays.then(|| (kept, kept += 1).0)
        };
        let new = (0..nodes as u32).map(number).collect();
        Self { new, kept }
    }

    /// The new number of a node; `None` if it was removed.
    fn of(&self, id: u32) -> Option<u32> {
        self.new.get(id as usize).copied().flatten()
    }

    /// The new number of a node, or of the first one after it that is left: a removed node hands the edge before it on to that one.
    fn at_or_after(&self, id: u32) -> Option<u32> {
        self.new.get(id as usize..)?.iter().copied().flatten().next()
    }
}

/// Replaces a node's edges by edges between its neighbours and the one that knows the node best.
fn marginalise(edges: &mut Vec<Edge>, poses: &[Pose2], id: u32) {
    let mine: Vec<usize> =
        (0..edges.len()).filter(|&i| edges[i].is_active && (edges[i].a == id || edges[i].b == id)).collect();
    let other = |e: &Edge| if e.a == id { e.b } else { e.a };
    // Several edges to one neighbour count as one.
    let mut neighbours: Vec<(u32, Matrix3<f64>, PoseVariances, EdgeKind)> = Vec::new();
    for e in mine.iter().map(|&i| &edges[i]) {
        match neighbours.iter_mut().find(|n| n.0 == other(e)) {
            Some(n) => {
                n.1 += e.information;
                n.3 = if n.3 == EdgeKind::OdometryBreak { e.kind } else { n.3 };
            }
            None => neighbours.push((other(e), e.information, e.variances, e.kind)),
        }
    }
    neighbours.sort_by(|a, b| b.1.trace().total_cmp(&a.1.trace()).then(a.0.cmp(&b.0)));
    for &i in &mine {
        edges[i].is_active = false;
    }
    let Some(&(inheritor, known, heir_variances, _)) = neighbours.first() else { return };
    for &(to, information, variances, kind) in neighbours.iter().skip(1).take(INHERITED_MAX) {
        let linked =
            |e: &Edge| e.is_active && ((e.a == inheritor && e.b == to) || (e.a == to && e.b == inheritor));
        // The order along the way is held by odometry's edges: they are always handed on.
        let along = matches!(kind, EdgeKind::Odometry | EdgeKind::OdometryBreak);
        if !along && edges.iter().any(linked) {
            continue;
        }
        let (a, b) = (inheritor.min(to), inheritor.max(to));
        let sum = known.try_inverse().zip(information.try_inverse()).and_then(|(p, q)| (p + q).try_inverse());
        let information = sum.unwrap_or(information * INHERITED_SHARE);
        edges.push(Edge {
            a,
            b,
            a_from_b: poses[a as usize].between(poses[b as usize]),
            information: (information + information.transpose()) * 0.5,
            degenerate_direction_rad: None,
            kind: if along { kind } else { EdgeKind::ScanMatch },
            is_active: true,
            variances: PoseVariances {
                worst_axis_m2: variances.worst_axis_m2 + heir_variances.worst_axis_m2,
                heading_rad2: variances.heading_rad2 + heir_variances.heading_rad2,
            },
            response: 0.0,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::back_end::testing::straight_path;
    use crate::common::{FULL, Noise, cast};
    use crate::node::Node;
    use crate::session::SessionIdentity;
    use crate::testing::standing_node;
    use msg::Stamp;

    /// A back end with eight nodes, of which a session can be made.
    fn eight_nodes() -> BackEnd {
        let mut back = straight_path(8, 0.3);
        back.lifelong.contradicted = vec![0; 8];
        back.node_ids.front_ids = (0..8).collect();
        for [a, b] in (1..8).map(|b| [b - 1, b]) {
            let (moved, information) = (Pose2::new(0.3, 0.0, 0.0), Matrix3::identity());
            back.graph.add_edge([a, b], moved, information, EdgeKind::Odometry, [0.0; 2]);
        }
        back
    }

    #[test]
    fn a_node_whose_edge_is_unverified_keeps_it_when_others_are_removed() {
        // The node before which nothing is verified, the nodes removed, and its number among those that are left.
        let cases: [(u32, &[u32], Option<u32>); 5] = [
            (7, &[2, 3, 6], Some(4)),
            (3, &[5, 6], Some(3)),
            (4, &[1, 4], Some(3)),
            (7, &[7], None),
            (6, &[0, 1, 2, 3, 4, 5], None),
        ];
        for (unverified, removed, after) in cases {
            let mut back = eight_nodes();
            back.unverified_node = Some(unverified);
            back.lifelong.marked = removed.to_vec();
            back.remove_marked();
            assert_eq!(back.unverified_node, after, "{unverified} without {removed:?}");
            let identity = SessionIdentity::new(1, 7, &back.config);
            assert_eq!(back.session(identity, None, &[]).validate(), Ok(()));
            // The next node is tracked, and sees too little to be linked.
            let at = Pose2::new(2.4, 0.0, 0.0);
            let scan = cast(&[], &FULL, at, Stamp(9), &mut Noise::new(1));
            back.add_node(Node { is_tracked: true, ..standing_node(8, &scan, at, &back.config.lidar) });
            assert_eq!(back.unverified_node, after, "{unverified} without {removed:?}");
        }
    }

    #[test]
    fn odometry_says_nothing_of_two_nodes_between_which_one_was_removed() {
        let mut back = eight_nodes();
        back.nodes.iter_mut().skip(1).for_each(|node| {
            node.previous_from_this = Some(Pose2::new(0.3, 0.0, 0.0));
        });
        back.lifelong.marked = vec![2, 3, 6];
        back.remove_marked();
        let measured: Vec<bool> = back.nodes.iter().map(|node| node.previous_from_this.is_some()).collect();
        // Of the nodes 0, 1, 4, 5 and 7.
        assert_eq!(measured, [false, true, false, true, false]);
    }
}
