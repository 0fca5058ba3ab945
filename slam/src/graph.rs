//! The pose graph: poses of nodes, relative measurements between them, and the least squares
//! solution with robust weights (Grisetti et al., "A tutorial on graph-based SLAM", IEEE ITS
//! Magazine 2010; graduated robustness after Yang et al., "Graduated non-convexity", RA-L 2020).

mod pose_covariance;
mod relative_uncertainty;

pub(crate) use pose_covariance::{carry_covariance, turn_covariance, upper_triangle};
pub use relative_uncertainty::{RelativeUncertainty, SystematicError};

use crate::config::GraphConfig;
use msg::Pose2;
use nalgebra::Matrix3;
use posegraph::{Kernel, SolveError, SolverOptions, Summary, information_without_axis};
use serde::{Deserialize, Serialize};

/// Information along a direction that no surface constrains, 1/m² and 1/rad²: a standard deviation of 10 m, more than
/// any search window leaves open.
pub(crate) const UNOBSERVED: f64 = 1e-2;
/// Information added to each coordinate before inversion, 1/m² and 1/rad²: keeps an unobserved direction invertible.
const REGULARISATION: f64 = 1e-4;
/// Least variance of an edge's position, m²: a standard deviation of 0.1 mm keeps rounding from making it negative.
const POSITION_VARIANCE_MIN: f64 = 1e-8;
/// Least variance of an edge's heading, rad²: a standard deviation of 0.01 mrad, for the same reason.
const HEADING_VARIANCE_MIN: f64 = 1e-10;

/// Origin of an edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum EdgeKind {
    /// Odometry between a node and the next.
    Odometry,
    /// Alignment of two scans that see the same surfaces.
    ScanMatch,
    /// A place recognised after a long path.
    Closure,
    /// Pose of the first node after the robot was located in a loaded map, as seen from the nearest node.
    InitialPose,
    /// Odometry that the scans contradict: it keeps the order of the nodes and measures nothing.
    OdometryBreak,
    /// The same as [`EdgeKind::InitialPose`], where a person said it and no scan: what follows is no part of the map until a scan confirms it.
    EstimatedPose,
}

impl EdgeKind {
    /// Whether scans measured such an edge: a link or a closure.
    pub fn is_scan(self) -> bool {
        matches!(self, Self::ScanMatch | Self::Closure)
    }
}

/// Variances of a relative pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseVariances {
    /// Of the position along the axis that is known worst, m².
    pub worst_axis_m2: f64,
    /// Of the heading, rad².
    pub heading_rad2: f64,
}

/// A measured relative pose between two nodes.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Edge {
    /// The node that the measurement is made from.
    pub a: u32,
    /// The node that is measured.
    pub b: u32,
    /// Pose of `b` in the frame of `a`, as measured.
    pub a_from_b: Pose2,
    /// Its inverse covariance over (x, y, yaw) in `a`; of scans, as the alignment claims it.
    #[serde(with = "crate::encoding::matrix")]
    pub information: Matrix3<f64>,
    /// Of scans: direction in `a` that almost no surface constrains, radians. What the information has there is mostly noise of normals.
    pub degenerate_direction_rad: Option<f64>,
    /// Origin of the measurement.
    pub kind: EdgeKind,
    /// Whether the edge has effect; false after it was retracted.
    pub is_active: bool,
    /// Variances for the propagation of uncertainty.
    pub variances: PoseVariances,
    /// Of a closure: how well the scans fitted, 0 to 1.
    pub response: f32,
}

impl Edge {
    /// Whether it is active and scans measured it: a link or a closure.
    pub fn is_active_scan(&self) -> bool {
        self.is_active && self.kind.is_scan()
    }

    /// An active edge whose variance is not known yet.
    fn scan_match(
        [a, b]: [u32; 2],
        a_from_b: Pose2,
        information: Matrix3<f64>,
        degenerate_direction_rad: Option<f64>,
    ) -> Self {
        Self {
            a,
            b,
            a_from_b,
            information,
            degenerate_direction_rad,
            kind: EdgeKind::ScanMatch,
            is_active: true,
            variances: PoseVariances::default(),
            response: 0.0,
        }
    }

    /// The information without that along the degenerate direction.
    ///
    /// The graph is solved with it, and covariances of poses count it. Closures are judged by all of it: a path of less
    /// information admits more of them, wrong ones too.
    pub fn measured_information(&self) -> Matrix3<f64> {
        let unobserved = Matrix3::identity() * UNOBSERVED;
        self.degenerate_direction_rad.map_or(self.information, |direction_rad| {
            information_without_axis(self.information, direction_rad) + unobserved
        })
    }

    /// The measurement alone, as it is.
    fn constraint(&self) -> posegraph::Edge {
        posegraph::Edge {
            a: self.a as usize,
            b: self.b as usize,
            a_from_b: self.a_from_b,
            information: self.measured_information(),
            kernel: Kernel::Quadratic,
        }
    }
}

/// The pose graph of one robot; see the module.
pub struct Graph {
    config: GraphConfig,
    poses: Vec<Pose2>,
    /// Covariance of each pose in the map; `None` where no edge says.
    covariances: Vec<Option<pose_covariance::PathCovariance>>,
    /// The node that they are as seen from.
    covariance_reference_node: u32,
    edges: Vec<Edge>,
    /// Variance of links and closures as a multiple of what their information says, by the last solution.
    variance_factor: f64,
    /// Errors of odometry that repeat, metres and radians per metre.
    systematic_odometry_errors: [f64; 2],
    /// Edges of each node.
    edges_of_node: Vec<Vec<u32>>,
    /// Solutions that ended with an error.
    failed_solutions: u64,
}

impl Graph {
    /// A graph without nodes.
    pub fn new(config: GraphConfig) -> Self {
        Self {
            config,
            poses: Vec::new(),
            covariances: Vec::new(),
            covariance_reference_node: 0,
            edges: Vec::new(),
            variance_factor: 1.0,
            systematic_odometry_errors: [0.0; 2],
            edges_of_node: Vec::new(),
            failed_solutions: 0,
        }
    }

    /// A graph of these nodes and edges.
    pub fn from_parts(config: GraphConfig, poses: Vec<Pose2>, edges: Vec<Edge>) -> Self {
        let mut graph = Self::new(config);
        graph.replace_parts(poses, edges);
        graph
    }

    /// Replaces all nodes and edges; the count of failed solutions stays.
    pub fn replace_parts(&mut self, poses: Vec<Pose2>, edges: Vec<Edge>) {
        self.edges_of_node = vec![Vec::new(); poses.len()];
        for (index, edge) in edges.iter().enumerate() {
            self.edges_of_node[edge.a as usize].push(index as u32);
            self.edges_of_node[edge.b as usize].push(index as u32);
        }
        self.covariances = vec![None; poses.len()];
        (self.poses, self.edges) = (poses, edges);
    }

    /// Solutions that failed since the graph was made.
    pub fn failed_solutions(&self) -> u64 {
        self.failed_solutions
    }

    /// Pose of each node in the map, by id.
    pub fn poses(&self) -> &[Pose2] {
        &self.poses
    }

    /// All edges, active or not.
    pub fn edges(&self) -> &[Edge] {
        &self.edges
    }

    /// One edge, to change or retract it.
    pub fn edge_mut(&mut self, index: usize) -> &mut Edge {
        &mut self.edges[index]
    }

    /// Active edges at a node.
    pub fn edges_of(&self, node: u32) -> impl Iterator<Item = &Edge> {
        self.edges_of_node[node as usize].iter().map(|&e| &self.edges[e as usize]).filter(|e| e.is_active)
    }

    /// Moves a node: `shift` takes its old pose's frame to the new one's.
    pub fn move_node(&mut self, node: u32, shift: Pose2) {
        let pose = &mut self.poses[node as usize];
        *pose = shift * *pose;
    }

    /// Appends a node.
    pub fn add_node(&mut self, map_from_node: Pose2) {
        self.poses.push(map_from_node);
        self.covariances.push(None);
        self.edges_of_node.push(Vec::new());
    }

    /// Adds a measurement without a degenerate direction. `drift` (metres, radians, one standard deviation) is added to its
    /// uncertainty when that is propagated, see [`Graph::uncertainty_from`]; not when the graph is solved.
    pub fn add_edge(
        &mut self,
        nodes: [u32; 2],
        a_from_b: Pose2,
        information: Matrix3<f64>,
        kind: EdgeKind,
        drift: [f64; 2],
    ) {
        self.push_edge(Edge { kind, ..Edge::scan_match(nodes, a_from_b, information, None) }, drift);
    }

    /// Adds the alignment of the scans of two nodes, which may have a degenerate direction; see [`Graph::add_edge`].
    pub fn add_link(
        &mut self,
        nodes: [u32; 2],
        a_from_b: Pose2,
        information: Matrix3<f64>,
        degenerate_direction_rad: Option<f64>,
        drift: [f64; 2],
    ) {
        self.push_edge(Edge::scan_match(nodes, a_from_b, information, degenerate_direction_rad), drift);
    }

    fn push_edge(&mut self, edge: Edge, drift: [f64; 2]) {
        let known = self.information_between(edge.a, edge.b);
        let covariance = (edge.information + known + Matrix3::identity() * REGULARISATION)
            .try_inverse()
            .unwrap_or(Matrix3::identity());
        let plane = covariance.fixed_view::<2, 2>(0, 0).into_owned();
        let worst_axis = plane.symmetric_eigenvalues().max().max(POSITION_VARIANCE_MIN);
        let variances = PoseVariances {
            worst_axis_m2: worst_axis + drift[0].powi(2),
            heading_rad2: covariance[(2, 2)].max(HEADING_VARIANCE_MIN) + drift[1].powi(2),
        };
        let index = self.edges.len() as u32;
        self.edges_of_node[edge.a as usize].push(index);
        self.edges_of_node[edge.b as usize].push(index);
        self.edges.push(Edge { variances, ..edge });
    }

    /// The active edges from `a` to `b`.
    fn edges_between(&self, a: u32, b: u32) -> impl Iterator<Item = &Edge> {
        self.edges_of(b).filter(move |e| e.a == a && e.b == b)
    }

    /// Sum of the information of the active edges from `a` to `b`.
    fn information_between(&self, a: u32, b: u32) -> Matrix3<f64> {
        self.edges_between(a, b).fold(Matrix3::zeros(), |sum, e| sum + e.information)
    }

    /// Node `b` as seen from node `a` if an edge is right, and the poses of the nodes near its ends relative to these are.
    pub fn implied_by(&self, edge: &Edge, [a, b]: [u32; 2]) -> Pose2 {
        let to = self.poses[a as usize].between(self.poses[edge.a as usize]);
        let back = self.poses[edge.b as usize].between(self.poses[b as usize]);
        to * edge.a_from_b * back
    }

    /// Squared error of an edge in standard deviations.
    pub fn chi_squared(&self, edge: &Edge) -> f64 {
        edge.constraint().chi_squared(self.poses[edge.a as usize], self.poses[edge.b as usize])
    }

    /// Moves all nodes but the first to a minimum of the edges' robust errors. `graduated`: new edges
    /// may be far off, as after a closure; the robust kernels then begin wide.
    ///
    /// # Errors
    /// [`SolveError`] if the graph cannot be solved; all poses are then what they were, and the failure is counted.
    pub fn solve(&mut self, graduated: bool) -> Result<Summary, SolveError> {
        let kernel = Kernel::Cauchy { sigmas: self.config.cauchy_sigmas };
        let constraint = |edge: &Edge| posegraph::Edge { kernel, ..edge.constraint() };
        let constraints: Vec<_> = self.edges.iter().filter(|edge| edge.is_active).map(constraint).collect();
        let options = SolverOptions {
            iterations_max: self.config.iterations_max,
            step_min: self.config.step_min,
            graduated,
            ..SolverOptions::default()
        };
        let result = posegraph::solve(&mut self.poses, &constraints, &options);
        self.failed_solutions += u64::from(result.is_err());
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::SlamConfig;
    use posegraph::information_from_sigmas;

    #[test]
    fn along_a_degenerate_direction_odometry_decides_and_across_it_the_link() {
        let mut graph = Graph::new(SlamConfig::default().graph);
        let map_from_a = Pose2::new(3.0, -2.0, 1.1);
        // A corridor at 0.7 rad in the frame of `a`; `b` looks elsewhere.
        let a_from_corridor = Pose2::new(0.0, 0.0, 0.7);
        let in_corridor = |x_m: f64, y_m: f64, yaw_rad: f64| a_from_corridor * Pose2::new(x_m, y_m, yaw_rad);
        let odometry = in_corridor(1.0, 0.0, 0.5);
        graph.add_node(map_from_a);
        graph.add_node(map_from_a * odometry);
        graph.add_edge([0, 1], odometry, information_from_sigmas(0.1, 0.1), EdgeKind::Odometry, [0.0; 2]);
        // By the scans 0.1 m short along the corridor, which is noise, and 0.05 m to the side, which is not.
        let (link, information) = (in_corridor(0.9, 0.05, 0.52), information_from_sigmas(0.01, 0.01));
        graph.add_link([0, 1], link, information, Some(0.7), [0.0; 2]);
        graph.solve(false).unwrap();
        let moved = (map_from_a * a_from_corridor).between(graph.poses()[1]);
        assert!((moved.x_m - 1.0).abs() < 1e-3, "{moved:?}");
        assert!((moved.y_m - 0.05).abs() < 1e-3 && (moved.yaw_rad - 0.52).abs() < 2e-3, "{moved:?}");
        // The map's covariance, turned into the corridor.
        graph.update_covariances(0, [0.0; 2]);
        let along_and_across = |covariance| turn_covariance(covariance, -1.8);
        let known = along_and_across(graph.covariance(1));
        assert!((known[(0, 0)].sqrt() - 0.1).abs() < 0.002 && known[(1, 1)].sqrt() < 0.011, "{known}");
        // A closure is judged by what the link claims.
        let claimed = along_and_across(graph.relative_covariance(0, 1, [0.0; 2]).unwrap());
        assert!(claimed[(0, 0)].sqrt() < 0.011, "{claimed}");
    }
}
