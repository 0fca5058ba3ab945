//! Covariance of every node's pose in the map, along the best way through the graph from one node of it.
//!
//! One way overestimates what all ways together would give if their errors were independent. They are not: links of one
//! scan share its points, so that the sum over all ways claims too much.

use super::{Edge, EdgeKind, Graph, REGULARISATION};
use msg::Pose2;
use nalgebra::{Matrix3, Rotation2, Vector3};

/// Degrees of freedom from which the links of a graph tell how good they are.
const FREEDOM_MIN: f64 = 100.0;
/// A link's error counts no more than this, in variances: three standard deviations.
const CHI_SQUARED_MAX: f64 = 9.0;
/// Links of one scan share its points, so that they agree better with each other than with the truth: their standard deviation is
/// never taken to be less than half of what they claim, nor more than twice.
const VARIANCE_FACTORS: [f64; 2] = [0.25, 4.0];

/// What is known of the edges' errors beyond their information.
#[derive(Clone, Copy, Debug)]
struct EdgeNoiseModel {
    /// Standard deviation that is added to each edge but odometry's, metres and radians per metre.
    drift: [f64; 2],
    /// Whether links count with all that they claim, and not with [`Edge::measured_information`].
    as_claimed: bool,
    /// Variance of links and closures as a multiple of what their information says.
    variance_factor: f64,
    /// Errors of odometry that repeat, metres and radians per metre: where it alone connects nodes, they grow with the way and not with
    /// its root.
    systematic: [f64; 2],
}

/// A covariance along a way through the graph.
#[derive(Clone, Copy, Debug)]
pub(super) struct PathCovariance {
    covariance: Matrix3<f64>,
    /// Length of the newest part of the way that odometry alone measured, or the part of the motion that scans left open, metres.
    odometry_m: f64,
}

/// Covariance of a pose over (x, y, yaw), seen from a place `moved` away (metres) that turns with it.
pub(crate) fn carry_covariance(covariance: Matrix3<f64>, moved: [f64; 2]) -> Matrix3<f64> {
    let lever = Matrix3::new(1.0, 0.0, -moved[1], 0.0, 1.0, moved[0], 0.0, 0.0, 1.0);
    lever * covariance * lever.transpose()
}

/// The upper triangle of a covariance or an information over (x, y, yaw), row by row.
pub(crate) fn upper_triangle(c: Matrix3<f64>) -> [f64; 6] {
    [c[(0, 0)], c[(0, 1)], c[(0, 2)], c[(1, 1)], c[(1, 2)], c[(2, 2)]]
}

/// A covariance over (x, y, yaw), turned by an angle.
pub(crate) fn turn_covariance(covariance: Matrix3<f64>, yaw_rad: f64) -> Matrix3<f64> {
    let turn = Rotation2::new(yaw_rad).to_homogeneous();
    turn * covariance * turn.transpose()
}

impl Graph {
    /// Covariance of a node's pose in the map over (x, y, yaw), as seen from the covariance reference node.
    pub fn covariance(&self, node: u32) -> Matrix3<f64> {
        self.covariances[node as usize].map_or_else(Matrix3::zeros, |known| known.covariance)
    }

    /// Trace of the covariance of a node's position in the map: the sum of the variances along both axes, m².
    pub fn position_variance_trace_m2(&self, node: u32) -> f64 {
        self.covariances[node as usize].map_or(0.0, |known| known.spread())
    }

    /// The covariance reference node: covariances are as seen from it.
    pub fn covariance_reference_node(&self) -> u32 {
        self.covariance_reference_node
    }

    /// Finds the newest node's covariance from its edges to older nodes. The first node is the covariance reference node.
    pub fn update_newest_covariance(&mut self) {
        let Some(newest) = self.poses.len().checked_sub(1) else { return };
        if newest == 0 {
            self.covariances[0] = Some(PathCovariance::of_reference());
            return;
        }
        let errors = self.learned_errors();
        let older = |edge: &Edge| if edge.a as usize == newest { edge.b } else { edge.a };
        let from_older = |edge: &Edge| {
            let known = self.covariances[older(edge) as usize]?;
            self.covariance_across(edge, older(edge), known, errors)
        };
        let best = self
            .edges_of(newest as u32)
            .filter_map(from_older)
            .min_by(|a, b| a.spread().total_cmp(&b.spread()));
        self.covariances[newest] = best;
    }

    /// Finds all covariances anew; `first` is the node whose pose in the map is certain, `systematic` the errors of odometry that
    /// repeat, metres and radians per metre.
    pub fn update_covariances(&mut self, first: u32, systematic: [f64; 2]) {
        self.systematic_odometry_errors = systematic;
        self.covariance_reference_node = first;
        self.variance_factor = self.variance_of_unit_weight();
        let errors = self.learned_errors();
        self.covariances = self.covariances_from(first, None, errors);
    }

    /// Covariance of a node's pose as seen from another one, in the map's axes, along the best way; `None` if no edges join
    /// them. `drift` is a standard deviation that is added to each edge but odometry's, metres and radians per metre.
    pub fn relative_covariance(&self, from: u32, to: u32, drift: [f64; 2]) -> Option<Matrix3<f64>> {
        let errors = EdgeNoiseModel { drift, as_claimed: true, variance_factor: 1.0, systematic: [0.0; 2] };
        self.covariances_from(from, Some(to), errors)[to as usize].map(|known| known.covariance)
    }

    fn learned_errors(&self) -> EdgeNoiseModel {
        let systematic = self.systematic_odometry_errors;
        EdgeNoiseModel {
            drift: [0.0; 2],
            as_claimed: false,
            variance_factor: self.variance_factor,
            systematic,
        }
    }

    /// How large the links' errors in the solved graph are, in variances that they claim: the variance of unit weight (Mikhail,
    /// "Observations and Least Squares", 1976).
    fn variance_of_unit_weight(&self) -> f64 {
        let links = || self.edges.iter().filter(|edge| edge.is_active && edge.kind == EdgeKind::ScanMatch);
        let squared: f64 = links().map(|edge| self.chi_squared(edge).min(CHI_SQUARED_MAX)).sum();
        // A link measures nothing along a degenerate direction, and has no error there.
        let measured: usize = links().map(|e| if e.degenerate_direction_rad.is_some() { 2 } else { 3 }).sum();
        let freedom = measured as f64 - 3.0 * (self.poses.len() as f64 - 1.0);
        let [least, most] = VARIANCE_FACTORS;
        if freedom < FREEDOM_MIN { 1.0 } else { (squared / freedom).clamp(least, most) }
    }

    /// Covariances of all nodes as seen from `first`, or of those that are known no worse than node `last`.
    fn covariances_from(
        &self,
        first: u32,
        last: Option<u32>,
        errors: EdgeNoiseModel,
    ) -> Vec<Option<PathCovariance>> {
        let mut covariances = vec![None; self.poses.len()];
        if first as usize >= self.poses.len() {
            return covariances;
        }
        let mut open = std::collections::BinaryHeap::new();
        covariances[first as usize] = Some(PathCovariance::of_reference());
        open.push((core::cmp::Reverse(0_u64), first));
        while let Some((core::cmp::Reverse(bits), node)) = open.pop() {
            let Some(known) = covariances[node as usize] else { continue };
            if known.spread().to_bits() != bits {
                continue;
            }
            if last == Some(node) {
                break;
            }
            for edge in self.edges_of(node) {
                let next = if edge.a == node { edge.b } else { edge.a };
                let Some(there) = self.covariance_across(edge, node, known, errors) else { continue };
                if covariances[next as usize].is_none_or(|known| there.spread() < known.spread()) {
                    covariances[next as usize] = Some(there);
                    open.push((core::cmp::Reverse(there.spread().to_bits()), next));
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
        known: PathCovariance,
        errors: EdgeNoiseModel,
    ) -> Option<PathCovariance> {
        let [a, b] = [edge.a, edge.b].map(|id| self.poses[id as usize]);
        let information_of =
            |e: &Edge| if errors.as_claimed { e.information } else { e.measured_information() };
        let scaled = |e: &Edge| {
            if e.kind.is_scan() { information_of(e) / errors.variance_factor } else { information_of(e) }
        };
        let same = self.edges_between(edge.a, edge.b);
        let information = same.fold(Matrix3::identity() * REGULARISATION, |sum, e| sum + scaled(e));
        let length_m = edge.a_from_b.x_m.hypot(edge.a_from_b.y_m);
        let drifts_over_m = if edge.kind == EdgeKind::Odometry { 0.0 } else { length_m };
        let drift = errors.drift.map(|per_m| (per_m * drifts_over_m).powi(2));
        let drift = Matrix3::from_diagonal(&Vector3::new(drift[0], drift[0], drift[1]));
        let left = self.left_to_odometry(edge);
        let odometry_m = if left == OdometryPart::Nothing { 0.0 } else { known.odometry_m + length_m };
        let over_m2 = (odometry_m.powi(2) - known.odometry_m.powi(2)).max(0.0);
        let repeated = left.covariance(errors.systematic.map(|per_m| per_m.powi(2) * over_m2));
        let measured = turn_covariance(information.try_inverse()? + drift + repeated, a.yaw_rad);
        let moved = |from: Pose2, to: Pose2| [to.x_m - from.x_m, to.y_m - from.y_m];
        let covariance = if from == edge.a {
            carry_covariance(known.covariance, moved(a, b)) + measured
        } else {
            carry_covariance(known.covariance + measured, moved(b, a))
        };
        Some(PathCovariance { covariance, odometry_m })
    }
}

impl Graph {
    /// What odometry alone measures of the motion between the nodes of an edge.
    fn left_to_odometry(&self, edge: &Edge) -> OdometryPart {
        let (mut has_odometry, mut left) = (false, OdometryPart::Everything);
        for e in self.edges_between(edge.a, edge.b) {
            has_odometry |= e.kind == EdgeKind::Odometry;
            if e.kind.is_scan() {
                let Some(direction_rad) = e.degenerate_direction_rad else { return OdometryPart::Nothing };
                if left == OdometryPart::Everything {
                    left = OdometryPart::Along(direction_rad);
                }
            }
        }
        if has_odometry { left } else { OdometryPart::Nothing }
    }
}

/// A part of the motion between two nodes.
#[derive(Clone, Copy, Debug, PartialEq)]
enum OdometryPart {
    Nothing,
    Everything,
    /// The part along a direction that scans leave open, radians in the axes of the first node.
    Along(f64),
}

impl OdometryPart {
    /// Covariance of these variances of the position and the heading in the axes of the first node, m² and rad².
    fn covariance(self, [m2, rad2]: [f64; 2]) -> Matrix3<f64> {
        match self {
            Self::Nothing => Matrix3::zeros(),
            Self::Everything => Matrix3::from_diagonal(&Vector3::new(m2, m2, rad2)),
            Self::Along(direction_rad) => {
                let axis = Vector3::new(direction_rad.cos(), direction_rad.sin(), 0.0);
                axis * axis.transpose() * m2
            }
        }
    }
}

impl PathCovariance {
    /// The covariance of the covariance reference node.
    fn of_reference() -> Self {
        Self { covariance: Matrix3::zeros(), odometry_m: 0.0 }
    }

    /// What the best way makes small: the variance of the position, m².
    fn spread(&self) -> f64 {
        self.covariance[(0, 0)] + self.covariance[(1, 1)]
    }
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
        graph.update_covariances(0, [0.0; 2]);
        let end = graph.covariance(10);
        // Along: ten times 0.1 m. Sideways: each of the headings before moves all that follows.
        let sideways = 10.0 * 0.01 + (1..10).map(|k| f64::from(k * k)).sum::<f64>() * 4e-4;
        assert!((end[(0, 0)] - 0.1).abs() < 1e-3, "{end}");
        assert!((end[(1, 1)] - sideways).abs() < 1e-3, "{end}");
        assert!((end[(2, 2)] - 10.0 * 4e-4).abs() < 1e-4, "{end}");
        assert_eq!(graph.covariance(0), Matrix3::zeros());
    }

    #[test]
    fn errors_of_odometry_that_repeat_grow_with_the_way_along_what_scans_leave_open() {
        const PER_M: f64 = 0.05;
        let end = |degenerate_direction_rad: Option<Option<f64>>| {
            let mut graph = straight_path(11);
            for id in 1..11 {
                let Some(direction_rad) = degenerate_direction_rad else { continue };
                let moved = Pose2::new(1.0, 0.0, 0.0);
                let information = information_from_sigmas(0.01, 0.003);
                graph.add_link([id - 1, id], moved, information, direction_rad, [0.0; 2]);
            }
            graph.update_covariances(0, [0.0; 2]);
            let without = graph.covariance(10);
            graph.update_covariances(0, [PER_M, 0.0]);
            graph.covariance(10) - without
        };
        let grown = (PER_M * 10.0).powi(2);
        // A corridor along x: scans measure nothing along it, and all across it.
        let along_x = end(Some(Some(0.0)));
        assert!((along_x[(0, 0)] - grown).abs() < 1e-9 && along_x[(1, 1)].abs() < 1e-9, "{along_x}");
        let along_y = end(Some(Some(core::f64::consts::FRAC_PI_2)));
        assert!(along_y[(0, 0)].abs() < 1e-9 && (along_y[(1, 1)] - grown).abs() < 1e-9, "{along_y}");
        // Without scans in all directions; with scans that leave nothing open in none.
        let alone = end(None);
        assert!((alone[(0, 0)] - grown).abs() < 1e-9 && (alone[(1, 1)] - grown).abs() < 1e-9, "{alone}");
        assert_eq!(end(Some(None)), Matrix3::zeros());
    }

    #[test]
    fn a_closure_tells_the_end_of_a_path_from_either_side() {
        for ends in [[0, 10], [10, 0]] {
            let mut graph = straight_path(11);
            let [a, b] = ends.map(|id| graph.poses()[id as usize]);
            let information = information_from_sigmas(0.05, 0.01);
            graph.add_edge(ends, a.between(b), information, EdgeKind::Closure, [0.0; 2]);
            graph.update_covariances(0, [0.0; 2]);
            let end = graph.covariance(10);
            assert!((end[(0, 0)] - 0.0025).abs() < 1e-4, "{end}");
            // Measured from the end, the heading's error moves the end sideways.
            let lever = if ends[0] == 0 { 0.0 } else { 10.0 };
            assert!((end[(1, 1)] - 0.0025 - (0.01_f64 * lever).powi(2)).abs() < 1e-3, "{end}");
        }
    }

    #[test]
    fn the_covariance_grows_from_the_first_node_on_before_the_graph_was_ever_solved() {
        let path = straight_path(11);
        let mut graph = Graph::new(SlamConfig::default().graph);
        for (id, pose) in (0..11).zip(path.poses()) {
            graph.add_node(*pose);
            let before = path.edges().iter().filter(|edge| edge.b == id);
            before.for_each(|e| graph.add_edge([e.a, e.b], e.a_from_b, e.information, e.kind, [0.0; 2]));
            graph.update_newest_covariance();
        }
        let at_once: Vec<_> = (0..11).map(|id| graph.covariance(id)).collect();
        graph.update_covariances(0, [0.0; 2]);
        assert!(at_once[10][(0, 0)] > 0.0);
        for (id, covariance) in (0..11).zip(at_once) {
            assert!((covariance - graph.covariance(id)).norm() < 1e-12, "node {id}");
        }
    }

    #[test]
    fn the_newest_node_is_known_as_if_all_were_found_anew() {
        let mut graph = straight_path(5);
        graph.update_covariances(0, [0.0; 2]);
        graph.add_node(Pose2::new(5.0, 0.0, 0.0));
        for older in [3, 4] {
            let moved = Pose2::new(f64::from(5 - older), 0.0, 0.0);
            let information = information_from_sigmas(0.02, 0.003);
            graph.add_edge([older as u32, 5], moved, information, EdgeKind::ScanMatch, [0.0; 2]);
        }
        graph.update_newest_covariance();
        let at_once = graph.covariance(5);
        graph.update_covariances(0, [0.0; 2]);
        assert_eq!(at_once, graph.covariance(5));
        assert!(
            at_once[(0, 0)] < graph.covariance(4)[(0, 0)],
            "two edges, one of them from node 3, are better"
        );
    }
}
