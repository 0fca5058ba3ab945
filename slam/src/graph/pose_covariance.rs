//! Covariance of every node's pose in the map, along the best way through the graph from the map's first node.
//!
//! One way overestimates what all ways together would give if their errors were independent. They are not: links of one
//! scan share its points, so that the sum over all ways claims too much.

use super::{Edge, EdgeKind, Graph, REGULARISATION};
use msg::Pose2;
use nalgebra::{Matrix3, Rotation2, Vector3};

/// No standard deviation beyond what the edges claim.
const NO_DRIFT: [f64; 2] = [0.0; 2];

/// Covariance of a pose over (x, y, yaw), seen from a place `moved` away (metres) that turns with it.
pub(crate) fn carry_covariance(covariance: Matrix3<f64>, moved: [f64; 2]) -> Matrix3<f64> {
    let lever = Matrix3::new(1.0, 0.0, -moved[1], 0.0, 1.0, moved[0], 0.0, 0.0, 1.0);
    lever * covariance * lever.transpose()
}

/// A covariance over (x, y, yaw), turned by an angle.
pub(crate) fn turn_covariance(covariance: Matrix3<f64>, yaw_rad: f64) -> Matrix3<f64> {
    let turn = Rotation2::new(yaw_rad).to_homogeneous();
    turn * covariance * turn.transpose()
}

impl Graph {
    /// Covariance of a node's pose in the map over (x, y, yaw), relative to the map's first node.
    pub fn covariance(&self, node: u32) -> Matrix3<f64> {
        self.covariances[node as usize].unwrap_or_else(Matrix3::zeros)
    }

    /// Finds the newest node's covariance from its edges to older nodes.
    pub fn update_newest_covariance(&mut self) {
        let Some(newest) = self.poses.len().checked_sub(1) else { return };
        let older = |edge: &Edge| if edge.a as usize == newest { edge.b } else { edge.a };
        let from_older = |edge: &Edge| {
            let known = self.covariances[older(edge) as usize]?;
            self.covariance_across(edge, older(edge), known, NO_DRIFT)
        };
        let best = self
            .edges_of(newest as u32)
            .filter_map(from_older)
            .min_by(|a, b| spread(a).total_cmp(&spread(b)));
        self.covariances[newest] = best;
    }

    /// Finds all covariances anew; `first` is the node whose pose in the map is certain.
    pub fn update_covariances(&mut self, first: u32) {
        self.covariances = self.covariances_from(first, None, NO_DRIFT);
    }

    /// Covariance of a node's pose as seen from another one, in the map's axes, along the best way; `None` if no edges join
    /// them. `drift` is a standard deviation that is added to each edge but odometry's, metres and radians per metre.
    pub fn relative_covariance(&self, from: u32, to: u32, drift: [f64; 2]) -> Option<Matrix3<f64>> {
        self.covariances_from(from, Some(to), drift)[to as usize]
    }

    /// Covariances of all nodes as seen from `first`, or of those that are known no worse than node `last`.
    fn covariances_from(&self, first: u32, last: Option<u32>, drift: [f64; 2]) -> Vec<Option<Matrix3<f64>>> {
        let mut covariances = vec![None; self.poses.len()];
        if first as usize >= self.poses.len() {
            return covariances;
        }
        let mut open = std::collections::BinaryHeap::new();
        covariances[first as usize] = Some(Matrix3::zeros());
        open.push((core::cmp::Reverse(0_u64), first));
        while let Some((core::cmp::Reverse(bits), node)) = open.pop() {
            let Some(known) = covariances[node as usize] else { continue };
            if spread(&known).to_bits() != bits {
                continue;
            }
            if last == Some(node) {
                break;
            }
            for edge in self.edges_of(node) {
                let next = if edge.a == node { edge.b } else { edge.a };
                let Some(there) = self.covariance_across(edge, node, known, drift) else { continue };
                if covariances[next as usize].is_none_or(|known| spread(&there) < spread(&known)) {
                    covariances[next as usize] = Some(there);
                    open.push((core::cmp::Reverse(spread(&there).to_bits()), next));
                }
            }
        }
        covariances
    }

    /// Covariance of the node at the other end of an edge, from that of `from`.
    fn covariance_across(
        &self,
        edge: &Edge,
        from: u32,
        known: Matrix3<f64>,
        drift: [f64; 2],
    ) -> Option<Matrix3<f64>> {
        let [a, b] = [edge.a, edge.b].map(|id| self.poses[id as usize]);
        let information = self.information_between(edge.a, edge.b) + Matrix3::identity() * REGULARISATION;
        let drifts = edge.kind != EdgeKind::Odometry;
        let length_m = if drifts { edge.a_from_b.x_m.hypot(edge.a_from_b.y_m) } else { 0.0 };
        let [drift_m2, drift_rad2] = drift.map(|per_m| (per_m * length_m).powi(2));
        let drifted = Matrix3::from_diagonal(&Vector3::new(drift_m2, drift_m2, drift_rad2));
        let measured = turn_covariance(information.try_inverse()?, a.yaw_rad) + drifted;
        let moved = |from: Pose2, to: Pose2| [to.x_m - from.x_m, to.y_m - from.y_m];
        Some(if from == edge.a {
            carry_covariance(known, moved(a, b)) + measured
        } else {
            carry_covariance(known + measured, moved(b, a))
        })
    }
}

/// What the best way makes small: the variance of the position, m².
fn spread(covariance: &Matrix3<f64>) -> f64 {
    covariance[(0, 0)] + covariance[(1, 1)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::SlamConfig;
    use crate::graph::EdgeKind;
    use posegraph::information_from_sigmas;

    /// Nodes each metre along x, with edges of 0.1 m and 0.02 rad between them.
    fn straight_path(nodes: u32) -> Graph {
        let mut graph = Graph::new(SlamConfig::default().graph);
        for id in 0..nodes {
            graph.add_node(Pose2::new(f64::from(id), 0.0, 0.0));
            if id > 0 {
                let information = information_from_sigmas(0.1, 0.02);
                let moved = Pose2::new(1.0, 0.0, 0.0);
                graph.add_edge([id - 1, id], moved, information, EdgeKind::Odometry, [0.0; 2]);
            }
        }
        graph
    }

    #[test]
    fn the_covariance_grows_along_a_path_and_sideways_with_the_heading() {
        let mut graph = straight_path(11);
        graph.update_covariances(0);
        let end = graph.covariance(10);
        // Along: ten times 0.1 m. Sideways: each of the headings before moves all that follows.
        let sideways = 10.0 * 0.01 + (1..10).map(|k| f64::from(k * k)).sum::<f64>() * 4e-4;
        assert!((end[(0, 0)] - 0.1).abs() < 1e-3, "{end}");
        assert!((end[(1, 1)] - sideways).abs() < 1e-3, "{end}");
        assert!((end[(2, 2)] - 10.0 * 4e-4).abs() < 1e-4, "{end}");
        assert_eq!(graph.covariance(0), Matrix3::zeros());
    }

    #[test]
    fn a_closure_tells_the_end_of_a_path_from_either_side() {
        for ends in [[0, 10], [10, 0]] {
            let mut graph = straight_path(11);
            let [a, b] = ends.map(|id| graph.poses()[id as usize]);
            let information = information_from_sigmas(0.05, 0.01);
            graph.add_edge(ends, a.between(b), information, EdgeKind::Closure, [0.0; 2]);
            graph.update_covariances(0);
            let end = graph.covariance(10);
            assert!((end[(0, 0)] - 0.0025).abs() < 1e-4, "{end}");
            // Measured from the end, the heading's error moves the end sideways.
            let lever = if ends[0] == 0 { 0.0 } else { 10.0 };
            assert!((end[(1, 1)] - 0.0025 - (0.01_f64 * lever).powi(2)).abs() < 1e-3, "{end}");
        }
    }

    #[test]
    fn the_newest_node_is_known_as_if_all_were_found_anew() {
        let mut graph = straight_path(5);
        graph.update_covariances(0);
        graph.add_node(Pose2::new(5.0, 0.0, 0.0));
        for older in [3, 4] {
            let moved = Pose2::new(f64::from(5 - older), 0.0, 0.0);
            let information = information_from_sigmas(0.02, 0.003);
            graph.add_edge([older as u32, 5], moved, information, EdgeKind::Link, [0.0; 2]);
        }
        graph.update_newest_covariance();
        let at_once = graph.covariance(5);
        graph.update_covariances(0);
        assert_eq!(at_once, graph.covariance(5));
        assert!(
            at_once[(0, 0)] < graph.covariance(4)[(0, 0)],
            "two edges, one of them from node 3, are better"
        );
    }
}
