//! Passes over a place: consecutive nodes of the path, and the comparison of two passes' scans.

use super::{COMPARED_SCANS, ClosureDetector};
use crate::cloud::Agreement;
use crate::graph::Graph;
use crate::node::Node;
use msg::{Pose2, pose::wrap_angle};

/// Scans of the older pass that the query is aligned and compared with. In six of 90° and 3.5 m less than half of the query's surfaces
/// are found, and right closures are refused: on the generated seeds 0..144 (as drawn before 2026-11-28), with all
/// else the same, 931 right ones are part of the graph with 12, and 752 with six.
const ALIGNED_SCANS: usize = 12;

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

/// Chooses the [`ALIGNED_SCANS`] of a chain that were taken nearest to scans of the query, of any of them: where the view is narrow,
/// those around the newest one alone do not see what the whole query saw.
pub(super) fn nearest_scans<'a, 'b>(
    chain: &'b [PosedNode<'a>],
    query: &[PosedNode<'_>],
    chain_from_query: Pose2,
) -> Vec<&'b PosedNode<'a>> {
    let seen_from: Vec<Pose2> =
        query.iter().map(|(_, query_from_node)| chain_from_query * *query_from_node).collect();
    let distance = |pose: Pose2| {
        let to = |other: &Pose2| pose.distance_m(*other) + wrap_angle(pose.yaw_rad - other.yaw_rad).abs();
        seen_from.iter().map(to).fold(f64::INFINITY, f64::min)
    };
    let mut near: Vec<(f64, &PosedNode<'_>)> = chain.iter().map(|posed| (distance(posed.1), posed)).collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.0.id.cmp(&b.1.0.id)));
    near.into_iter().take(ALIGNED_SCANS).map(|(_, posed)| posed).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::common::{NARROW, Noise, cast, rectangle};
    use crate::config::SlamConfig;
    use crate::testing::standing_node;
    use msg::Stamp;

    #[test]
    fn a_query_is_aligned_with_scans_around_each_of_its_own_and_not_around_its_newest_alone() {
        // A path along a room, twice: the query is its middle the second time, in the frame of its newest scan.
        let pose = |k: usize| Pose2::new(0.4 * k as f64, 0.0, 0.0);
        let scan = cast(&rectangle(-1.0, -1.0, 12.0, 1.0), &NARROW, pose(0), Stamp(0), &mut Noise::new(1));
        let node = |k: usize| standing_node(k as u32, &scan, pose(k), &SlamConfig::default().lidar);
        let nodes: Vec<Node> = (0..24).map(node).collect();
        let seen_from =
            |from: usize| nodes.iter().enumerate().map(move |(k, node)| (node, pose(from).between(pose(k))));
        let chain: Vec<PosedNode<'_>> = seen_from(0).collect();
        let query: Vec<PosedNode<'_>> = seen_from(17).skip(6).take(12).collect();
        let mut chosen: Vec<u32> =
            nearest_scans(&chain, &query, pose(17)).iter().map(|(node, _)| node.id).collect();
        chosen.sort_unstable();
        assert_eq!(chosen, (6..18).collect::<Vec<u32>>());
    }
}
