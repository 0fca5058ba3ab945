//! The pose graph: poses of nodes, relative measurements between them, and the least squares
//! solution with robust weights (Grisetti et al., "A tutorial on graph-based SLAM", IEEE ITS
//! Magazine 2010; graduated robustness after Yang et al., "Graduated non-convexity", RA-L 2020).

use crate::config::GraphConfig;
use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{Pair, SparseColMat, SymbolicSparseColMat};
use faer::{Mat, Side};
use msg::{Pose2, pose::wrap_angle};
use nalgebra::{Matrix3, Vector3};

/// Where a measurement comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EdgeKind {
    /// Wheels, between a node and the next.
    Odometry,
    /// Two scans that see the same surfaces.
    Link,
    /// A place recognised after a long way.
    Closure,
    /// Where a robot was put down, as it was told or found out.
    Placed,
    /// Wheels, where the scans contradict them: no more than the order.
    Torn,
}

/// A measured relative pose.
#[derive(Clone, Copy, Debug)]
pub struct Edge {
    /// The node it is seen from.
    pub a: u32,
    /// The node that is seen.
    pub b: u32,
    /// The measurement.
    pub a_from_b: Pose2,
    /// Its inverse covariance over (x, y, yaw) in `a`.
    pub information: Matrix3<f64>,
    /// Its origin.
    pub kind: EdgeKind,
    /// A retracted edge has no effect.
    pub in_force: bool,
    /// Variances for the propagation of uncertainty: position (worst direction) and heading.
    pub variance: [f64; 2],
    /// Of a closure: how well the scans fitted, 0 to 1.
    pub response: f32,
}

/// How well a node is known as seen from another one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Relative {
    /// Variance of the position, m².
    pub position: f64,
    /// Variance of the heading, rad².
    pub heading: f64,
}

/// See the module.
pub struct Graph {
    config: GraphConfig,
    poses: Vec<Pose2>,
    edges: Vec<Edge>,
    /// Edges of each node.
    around: Vec<Vec<u32>>,
}

impl Graph {
    /// Without nodes.
    pub fn new(config: GraphConfig) -> Self {
        Self { config, poses: Vec::new(), edges: Vec::new(), around: Vec::new() }
    }

    /// With these nodes, and edges between them.
    pub fn from_parts(config: GraphConfig, poses: Vec<Pose2>, edges: Vec<Edge>) -> Self {
        let mut around = vec![Vec::new(); poses.len()];
        for (index, edge) in edges.iter().enumerate() {
            around[edge.a as usize].push(index as u32);
            around[edge.b as usize].push(index as u32);
        }
        Self { config, poses, edges, around }
    }

    /// The map from each node.
    pub fn poses(&self) -> &[Pose2] {
        &self.poses
    }

    /// All edges.
    pub fn edges(&self) -> &[Edge] {
        &self.edges
    }

    /// One edge, to change or retract it.
    pub fn edge_mut(&mut self, index: usize) -> &mut Edge {
        &mut self.edges[index]
    }

    /// Edges in force at a node.
    pub fn edges_of(&self, node: u32) -> impl Iterator<Item = &Edge> {
        self.around[node as usize].iter().map(|&e| &self.edges[e as usize]).filter(|e| e.in_force)
    }

    /// Moves a node: `shift` takes its old pose's frame to the new one's.
    pub fn move_node(&mut self, node: u32, shift: Pose2) {
        let pose = &mut self.poses[node as usize];
        *pose = shift * *pose;
    }

    /// Appends a node.
    pub fn add_node(&mut self, map_from_node: Pose2) {
        self.poses.push(map_from_node);
        self.around.push(Vec::new());
    }

    /// Adds a measurement. `drift` (metres, radians, one standard deviation) is added to its
    /// uncertainty when that is propagated, see [`Graph::relative_to`]; not when the graph is solved.
    pub fn add_edge(
        &mut self,
        [a, b]: [u32; 2],
        a_from_b: Pose2,
        information: Matrix3<f64>,
        kind: EdgeKind,
        drift: [f64; 2],
    ) {
        let known = self.information_between(a, b);
        let covariance =
            (information + known + Matrix3::identity() * 1e-4).try_inverse().unwrap_or(Matrix3::identity());
        let plane = covariance.fixed_view::<2, 2>(0, 0).into_owned();
        let position = plane.symmetric_eigenvalues().max().max(1e-8) + drift[0].powi(2);
        let variance = [position, covariance[(2, 2)].max(1e-10) + drift[1].powi(2)];
        let index = self.edges.len() as u32;
        self.edges.push(Edge { a, b, a_from_b, information, kind, in_force: true, variance, response: 0.0 });
        self.around[a as usize].push(index);
        self.around[b as usize].push(index);
    }

    /// What the edges in force from `a` to `b` already say together.
    fn information_between(&self, a: u32, b: u32) -> Matrix3<f64> {
        let same = self.edges_of(b).filter(|e| e.a == a && e.b == b);
        same.fold(Matrix3::zeros(), |sum, e| sum + e.information)
    }

    /// Squared error of an edge in standard deviations.
    pub fn chi_squared(&self, edge: &Edge) -> f64 {
        let e = error(edge, self.poses[edge.a as usize], self.poses[edge.b as usize]);
        (e.transpose() * edge.information * e).x
    }

    /// How well the nodes around `from` are known as seen from it: the best single way through the
    /// graph to each, which overestimates what all ways together would give. Nodes beyond
    /// `position_max` (m²) are `None`.
    pub fn relative_to(&self, from: u32, position_max: f64) -> Vec<Option<Relative>> {
        let mut known: Vec<Option<Relative>> = vec![None; self.poses.len()];
        let mut open = std::collections::BinaryHeap::new();
        known[from as usize] = Some(Relative { position: 0.0, heading: 0.0 });
        open.push((core::cmp::Reverse(0_u64), from));
        while let Some((core::cmp::Reverse(bits), node)) = open.pop() {
            let Some(here) = known[node as usize] else { continue };
            if here.position.to_bits() != bits {
                continue;
            }
            for edge in self.edges_of(node) {
                let next = if edge.a == node { edge.b } else { edge.a };
                let lever_squared = edge.a_from_b.x_m.powi(2) + edge.a_from_b.y_m.powi(2);
                let there = Relative {
                    position: here.position + here.heading * lever_squared + edge.variance[0],
                    heading: here.heading + edge.variance[1],
                };
                let better = known[next as usize].is_none_or(|k| there.position < k.position);
                if better && there.position <= position_max {
                    known[next as usize] = Some(there);
                    open.push((core::cmp::Reverse(there.position.to_bits()), next));
                }
            }
        }
        known
    }

    /// Moves all nodes but the first to where the edges in force want them. `shock`: a closure came
    /// in that may pull far; robustness then sets in step by step. Returns the largest movement, metres.
    pub fn solve(&mut self, shock: bool) -> f64 {
        let before = self.poses.clone();
        let Some(structure) = Structure::new(self) else { return 0.0 };
        let mut scale = if shock { 64.0 } else { 1.0 };
        for _ in 0..self.config.iterations_max {
            let Some(step) = structure.step(self, self.config.cauchy_sigmas * scale) else { break };
            let mut largest: f64 = 0.0;
            for (pose, d) in self.poses[1..].iter_mut().zip(step.chunks_exact(3)) {
                *pose = Pose2::new(pose.x_m - d[0], pose.y_m - d[1], wrap_angle(pose.yaw_rad - d[2]));
                largest = largest.max(d[0].abs()).max(d[1].abs()).max(d[2].abs());
            }
            if scale <= 1.0 && largest < self.config.step_min {
                break;
            }
            scale = (scale / 4.0).max(1.0);
        }
        let moved = before.iter().zip(&self.poses).map(|(a, b)| a.distance_m(*b));
        moved.fold(0.0, f64::max)
    }
}

fn error(edge: &Edge, a: Pose2, b: Pose2) -> Vector3<f64> {
    let seen = a.between(b);
    let yaw = wrap_angle(seen.yaw_rad - edge.a_from_b.yaw_rad);
    Vector3::new(seen.x_m - edge.a_from_b.x_m, seen.y_m - edge.a_from_b.y_m, yaw)
}

/// Derivatives of [`error`] by (x, y, yaw) of a and of b (Grisetti et al. 2010, eqs. 30-33).
fn jacobians(a: Pose2, b: Pose2) -> (Matrix3<f64>, Matrix3<f64>) {
    let (sin, cos) = a.yaw_rad.sin_cos();
    let (dx, dy) = (b.x_m - a.x_m, b.y_m - a.y_m);
    let by_a =
        Matrix3::new(-cos, -sin, -sin * dx + cos * dy, sin, -cos, -cos * dx - sin * dy, 0.0, 0.0, -1.0);
    let by_b = Matrix3::new(cos, sin, 0.0, -sin, cos, 0.0, 0.0, 0.0, 1.0);
    (by_a, by_b)
}

/// The normal equations' pattern, the same for all iterations of a solution. The first node is
/// fixed and has no unknowns.
struct Structure {
    edges: Vec<usize>,
    unknowns: usize,
    pattern: SymbolicSparseColMat<usize>,
    order: faer::sparse::Argsort<usize>,
    symbolic: SymbolicLlt<usize>,
}

impl Structure {
    fn new(graph: &Graph) -> Option<Self> {
        let unknowns = 3 * graph.poses.len().checked_sub(1).filter(|n| *n > 0)?;
        let edges: Vec<usize> = (0..graph.edges.len()).filter(|&i| graph.edges[i].in_force).collect();
        let mut pairs = Vec::with_capacity(2 * unknowns + 9 * edges.len());
        for block in 0..unknowns / 3 {
            push_block(&mut pairs, block, block);
        }
        for edge in edges.iter().map(|&i| &graph.edges[i]) {
            if let Some((row, col, _)) = off_diagonal(edge) {
                push_block(&mut pairs, row, col);
            }
        }
        let (pattern, order) = SymbolicSparseColMat::try_new_from_indices(unknowns, unknowns, &pairs).ok()?;
        let symbolic = SymbolicLlt::try_new(pattern.as_ref(), Side::Lower).ok()?;
        Some(Self { edges, unknowns, pattern, order, symbolic })
    }

    /// One Gauss-Newton step (to be subtracted), x, y, yaw of node 1, of node 2, ...
    fn step(&self, graph: &Graph, cauchy_sigmas: f64) -> Option<Vec<f64>> {
        let mut diagonal = vec![Matrix3::<f64>::identity() * 1e-6; self.unknowns / 3];
        let mut beside = Vec::with_capacity(9 * self.edges.len());
        let mut right = Mat::<f64>::zeros(self.unknowns, 1);
        for edge in self.edges.iter().map(|&i| &graph.edges[i]) {
            let (a, b) = (graph.poses[edge.a as usize], graph.poses[edge.b as usize]);
            let e = error(edge, a, b);
            let chi_squared = (e.transpose() * edge.information * e).x;
            let weighted = edge.information / (1.0 + chi_squared / (cauchy_sigmas * cauchy_sigmas));
            let (by_a, by_b) = jacobians(a, b);
            for (node, jacobian) in [(edge.a, &by_a), (edge.b, &by_b)] {
                if let Some(block) = (node as usize).checked_sub(1) {
                    diagonal[block] += jacobian.transpose() * weighted * jacobian;
                    let gradient = jacobian.transpose() * (weighted * e);
                    for k in 0..3 {
                        right[(3 * block + k, 0)] += gradient[k];
                    }
                }
            }
            if let Some((_, _, flipped)) = off_diagonal(edge) {
                let (row, col) = if flipped { (&by_a, &by_b) } else { (&by_b, &by_a) };
                beside.extend_from_slice((row.transpose() * weighted * col).as_slice());
            }
        }
        let mut values = Vec::with_capacity(3 * self.unknowns + beside.len());
        for block in &diagonal {
            values.extend_from_slice(block.as_slice());
        }
        values.extend_from_slice(&beside);
        let matrix = SparseColMat::new_from_argsort(self.pattern.clone(), &self.order, &values).ok()?;
        let llt = Llt::try_new_with_symbolic(self.symbolic.clone(), matrix.as_ref(), Side::Lower).ok()?;
        llt.solve_in_place(&mut right);
        let step: Vec<f64> = (0..self.unknowns).map(|i| right[(i, 0)]).collect();
        step.iter().all(|v| v.is_finite()).then_some(step)
    }
}

/// Column by column, as nalgebra stores.
fn push_block(pairs: &mut Vec<Pair<usize, usize>>, row: usize, col: usize) {
    for c in 0..3 {
        for r in 0..3 {
            pairs.push(Pair { row: 3 * row + r, col: 3 * col + c });
        }
    }
}

/// The block below the diagonal that an edge fills: (row, column, whether a is the row).
fn off_diagonal(edge: &Edge) -> Option<(usize, usize, bool)> {
    let (a, b) = ((edge.a as usize).checked_sub(1)?, (edge.b as usize).checked_sub(1)?);
    if b > a { Some((b, a, false)) } else { Some((a, b, true)) }
}
