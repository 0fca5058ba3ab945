//! The normal equations of a pose graph: assembled block by block, factored by sparse Cholesky.

use crate::block_cholesky::{BlockIndex, SymbolicFactor};
use crate::edge::Edge;
use msg::Pose2;
use nalgebra::{Matrix3, Vector3};

/// The sparsity pattern and the elimination order: the same for all iterations of a solution.
///
/// Pose 0 is fixed and has no unknowns; pose `k` has row `k - 1` of 3 x 3 blocks: x, y, yaw.
pub(crate) struct Structure {
    symbolic: SymbolicFactor,
}

/// The normal equations at some poses: `hessian * step = gradient`, the step to be subtracted.
pub(crate) struct NormalEquations {
    /// Diagonal blocks by pose, then the blocks below the diagonal by edge.
    hessian: Vec<Matrix3<f64>>,
    gradient: Vec<Vector3<f64>>,
    /// The cost at these poses, with kernels of this linearisation's scale.
    pub cost: f64,
}

impl Structure {
    /// `None` if no elimination order is found.
    pub fn new(poses: usize, edges: &[Edge]) -> Option<Self> {
        let rows = poses.checked_sub(1)?;
        let diagonal = (0..rows).map(|row| BlockIndex { row, column: row });
        let blocks: Vec<BlockIndex> =
            diagonal.chain(edges.iter().filter_map(below_diagonal).map(|(index, _)| index)).collect();
        Some(Self { symbolic: SymbolicFactor::new(rows, &blocks)? })
    }

    /// Linearises all edges at these poses, with kernels `scale` times as wide. Every unknown has
    /// `prior` added on the diagonal.
    pub fn linearise(&self, poses: &[Pose2], edges: &[Edge], scale: f64, prior: f64) -> NormalEquations {
        let rows = self.symbolic.rows();
        let mut hessian = Vec::with_capacity(rows + edges.len());
        hessian.resize(rows, Matrix3::identity() * prior);
        let mut gradient = vec![Vector3::zeros(); rows];
        let mut cost = 0.0;
        for edge in edges {
            let (a, b) = (poses[edge.a], poses[edge.b]);
            let error = edge.error(a, b);
            let chi_squared = (error.transpose() * edge.information * error).x;
            cost += edge.kernel.cost(chi_squared, scale);
            let weighted = edge.information / edge.kernel.inverse_weight(chi_squared, scale);
            let jacobians = Edge::jacobians(a, b);
            for (pose, jacobian) in [edge.a, edge.b].into_iter().zip(&jacobians) {
                if let Some(row) = pose.checked_sub(1) {
                    hessian[row] += jacobian.transpose() * weighted * jacobian;
                    gradient[row] += jacobian.transpose() * (weighted * error);
                }
            }
            if let Some((_, a_is_row)) = below_diagonal(edge) {
                let [by_a, by_b] = &jacobians;
                let (row, column) = if a_is_row { (by_a, by_b) } else { (by_b, by_a) };
                hessian.push(row.transpose() * weighted * column);
            }
        }
        NormalEquations { hessian, gradient, cost }
    }

    /// The step to subtract, (x, y, yaw) of pose 1, of pose 2, and so on. `damping` adds this share of the
    /// diagonal to itself (Marquardt). `None` if the matrix is not positive definite or the step not finite.
    pub fn step(&self, equations: &NormalEquations, damping: f64) -> Option<Vec<Vector3<f64>>> {
        let mut damped = Vec::new();
        let hessian = if damping > 0.0 {
            damped.extend_from_slice(&equations.hessian);
            for block in &mut damped[..self.symbolic.rows()] {
                (0..3).for_each(|k| block[(k, k)] *= 1.0 + damping);
            }
            &damped
        } else {
            &equations.hessian
        };
        let step = self.symbolic.factor(hessian)?.solve(&equations.gradient);
        step.iter().flatten().all(|v| v.is_finite()).then_some(step)
    }
}

/// The block below the diagonal that an edge fills, and whether pose `a` is its row.
/// `None` if one of its poses is the fixed one.
fn below_diagonal(edge: &Edge) -> Option<(BlockIndex, bool)> {
    let (a, b) = (edge.a.checked_sub(1)?, edge.b.checked_sub(1)?);
    Some((BlockIndex { row: a.max(b), column: a.min(b) }, a >= b))
}
