//! The normal equations of a pose graph: assembled block by block, factored by sparse Cholesky.

use crate::edge::Edge;
use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{Argsort, Pair, SparseColMat, SymbolicSparseColMat};
use faer::{Mat, Side};
use msg::Pose2;
use nalgebra::Matrix3;

/// Entries of a 3 x 3 block.
const BLOCK: usize = 9;

/// The sparsity pattern and the elimination order: the same for all iterations of a solution.
///
/// Pose 0 is fixed and has no unknowns; pose `k` has the unknowns `3 (k - 1)` to `3 (k - 1) + 2`.
pub(crate) struct Structure {
    unknowns: usize,
    pattern: SymbolicSparseColMat<usize>,
    order: Argsort<usize>,
    symbolic: SymbolicLlt<usize>,
}

/// The normal equations at some poses: `hessian * step = gradient`, the step to be subtracted.
pub(crate) struct NormalEquations {
    /// Diagonal blocks by pose, then the blocks below the diagonal by edge; column by column.
    hessian: Vec<f64>,
    gradient: Mat<f64>,
    /// The cost at these poses, with kernels of this linearisation's scale.
    pub cost: f64,
}

impl Structure {
    /// `None` if the pattern cannot be built (more entries than memory can index).
    pub fn new(poses: usize, edges: &[Edge]) -> Option<Self> {
        let unknowns = 3 * poses.checked_sub(1)?;
        let mut pairs = Vec::with_capacity(3 * unknowns + BLOCK * edges.len());
        (0..unknowns / 3).for_each(|block| push_block(&mut pairs, block, block));
        for (row, column, _) in edges.iter().filter_map(below_diagonal) {
            push_block(&mut pairs, row, column);
        }
        let (pattern, order) = SymbolicSparseColMat::try_new_from_indices(unknowns, unknowns, &pairs).ok()?;
        let symbolic = SymbolicLlt::try_new(pattern.as_ref(), Side::Lower).ok()?;
        Some(Self { unknowns, pattern, order, symbolic })
    }

    /// Linearises all edges at these poses, with kernels `scale` times as wide. Every unknown has
    /// `prior` added on the diagonal.
    pub fn linearise(&self, poses: &[Pose2], edges: &[Edge], scale: f64, prior: f64) -> NormalEquations {
        let mut diagonal = vec![Matrix3::<f64>::identity() * prior; self.unknowns / 3];
        let mut off_diagonal = Vec::with_capacity(BLOCK * edges.len());
        let mut gradient = Mat::<f64>::zeros(self.unknowns, 1);
        let mut cost = 0.0;
        for edge in edges {
            let (a, b) = (poses[edge.a], poses[edge.b]);
            let error = edge.error(a, b);
            let chi_squared = (error.transpose() * edge.information * error).x;
            cost += edge.kernel.cost(chi_squared, scale);
            let weighted = edge.information / edge.kernel.inverse_weight(chi_squared, scale);
            let jacobians = Edge::jacobians(a, b);
            for (pose, jacobian) in [edge.a, edge.b].into_iter().zip(&jacobians) {
                if let Some(block) = pose.checked_sub(1) {
                    diagonal[block] += jacobian.transpose() * weighted * jacobian;
                    let part = jacobian.transpose() * (weighted * error);
                    (0..3).for_each(|k| gradient[(3 * block + k, 0)] += part[k]);
                }
            }
            if let Some((_, _, a_is_row)) = below_diagonal(edge) {
                let [by_a, by_b] = &jacobians;
                let (row, column) = if a_is_row { (by_a, by_b) } else { (by_b, by_a) };
                off_diagonal.extend_from_slice((row.transpose() * weighted * column).as_slice());
            }
        }
        let mut hessian = Vec::with_capacity(3 * self.unknowns + off_diagonal.len());
        diagonal.iter().for_each(|block| hessian.extend_from_slice(block.as_slice()));
        hessian.extend_from_slice(&off_diagonal);
        NormalEquations { hessian, gradient, cost }
    }

    /// The step to subtract, (x, y, yaw) of pose 1, of pose 2, and so on. `damping` adds this share of the
    /// diagonal to itself (Marquardt). `None` if the matrix is not positive definite or the step not finite.
    pub fn step(&self, equations: &NormalEquations, damping: f64) -> Option<Vec<f64>> {
        let mut damped = Vec::new();
        let values = if damping > 0.0 {
            damped.extend_from_slice(&equations.hessian);
            for block in damped.chunks_exact_mut(BLOCK).take(self.unknowns / 3) {
                (0..3).for_each(|k| block[4 * k] *= 1.0 + damping);
            }
            &damped
        } else {
            &equations.hessian
        };
        let matrix = SparseColMat::new_from_argsort(self.pattern.clone(), &self.order, values).ok()?;
        let llt = Llt::try_new_with_symbolic(self.symbolic.clone(), matrix.as_ref(), Side::Lower).ok()?;
        let mut solution = equations.gradient.clone();
        llt.solve_in_place(&mut solution);
        let step: Vec<f64> = (0..self.unknowns).map(|i| solution[(i, 0)]).collect();
        step.iter().all(|v| v.is_finite()).then_some(step)
    }
}

/// Indices of a 3 x 3 block, column by column, as nalgebra stores it.
fn push_block(pairs: &mut Vec<Pair<usize, usize>>, row: usize, column: usize) {
    for c in 0..3 {
        for r in 0..3 {
            pairs.push(Pair { row: 3 * row + r, col: 3 * column + c });
        }
    }
}

/// The block below the diagonal that an edge fills: row, column, and whether `a` is the row.
/// `None` if one of its poses is the fixed one.
fn below_diagonal(edge: &Edge) -> Option<(usize, usize, bool)> {
    let (a, b) = (edge.a.checked_sub(1)?, edge.b.checked_sub(1)?);
    if b > a { Some((b, a, false)) } else { Some((a, b, true)) }
}
