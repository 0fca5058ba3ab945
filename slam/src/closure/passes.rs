//! Passes over a place: consecutive nodes of the path, and the comparison of two passes' scans.

use super::{COMPARED_SCANS, ClosureDetector};
use crate::cloud::Agreement;
use crate::graph::Graph;
use crate::node::Node;
use msg::Pose2;

/// A node and its pose in another node's frame.
pub(crate) type PosedNode<'a> = (&'a Node, Pose2);

/// The pose graph and the nodes' scans, as a closure search reads them.
pub struct GraphView<'a> {
    /// All nodes with their scans, by id.
    pub nodes: &'a [Node],
    /// Pose graph of these nodes.
    pub graph: &'a Graph,
}

impl<'a> GraphView<'a> {
    /// A node and its pose in the frame of node `from`.
    pub(super) fn posed_node(&self, from: u32, id: u32) -> PosedNode<'a> {
        let poses = self.graph.poses();
        (&self.nodes[id as usize], poses[from as usize].between(poses[id as usize]))
    }

    /// First and last node of the pass around `middle`: nodes of its component, each side up to `half_m` metres of
    /// path and `half_nodes`.
    pub(super) fn pass(&self, middle: u32, half_m: f64, half_nodes: u32) -> (u32, u32) {
        let poses = self.graph.poses();
        let reach = |step: i64| {
            let (mut id, mut path_m) = (i64::from(middle), 0.0);
            while (id - i64::from(middle)).unsigned_abs() < u64::from(half_nodes) {
                let Some(next) = poses.get((id + step) as usize) else { break };
                if self.nodes[(id + step) as usize].disconnected_component
                    != self.nodes[middle as usize].disconnected_component
                {
                    break;
                }
                path_m += poses[id as usize].distance_m(*next);
                if path_m > half_m {
                    break;
                }
                id += step;
            }
            id as u32
        };
        (reach(-1), reach(1))
    }
}

impl ClosureDetector {
    /// Whether a node's own scan can be recognised. Where it sees next to nothing, the scans of its pass would be, and what odometry
    /// drifted in between would count as known.
    pub(super) fn sees_enough(&self, node: &Node) -> bool {
        node.cloud.points().len() >= self.config.tracking.points_min
    }

    /// Whether the pass around one node covers the other one.
    pub(super) fn same_pass(&self, graph: &Graph, a: u32, b: u32) -> bool {
        let c = &self.config.closures;
        let poses = &graph.poses()[a.min(b) as usize..=a.max(b) as usize];
        let path_m: f64 = poses.windows(2).map(|p| p[0].distance_m(p[1])).sum();
        path_m < c.chain_m && poses.len() <= c.chain_nodes
    }
}

/// Compares the scans of two passes over the same place: the newest [`COMPARED_SCANS`] of the query with each of the
/// chain.
pub(crate) fn compare_passes<'a>(
    chain: impl Iterator<Item = &'a PosedNode<'a>>,
    query: &[PosedNode<'_>],
    chain_from_query: Pose2,
) -> Agreement {
    let mut agreement = Agreement::default();
    for (older, chain_from_older) in chain {
        for (newer, query_from_newer) in query.iter().rev().take(COMPARED_SCANS) {
            let older_from_newer = chain_from_older.inverse() * chain_from_query * *query_from_newer;
            agreement += Agreement::both_ways(&older.cloud, &newer.cloud, older_from_newer);
        }
    }
    agreement
}
