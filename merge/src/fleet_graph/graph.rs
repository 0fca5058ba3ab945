//! The fleet's pose graph: submaps of all robots, relative measurements between them, and the least
//! squares solution with robust weights on what robots say of each other (Grisetti et al., "A
//! tutorial on graph-based SLAM", IEEE ITS Magazine 2010; graduated robustness after Yang et al.,
//! "Graduated non-convexity for robust spatial perception", RA-L 2020).
//!
//! It is not `slam`'s graph: that one grows node by node, propagates uncertainty and takes links
//! back; this one is put together anew for each solution, from what is believed at that moment.

use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{Pair, SparseColMat, SymbolicSparseColMat};
use faer::{Mat, Side};
use msg::{Pose2, pose::wrap_angle};
use nalgebra::{Matrix3, Vector3};

/// Gauss-Newton's steps at most.
const STEPS_MAX: usize = 20;
/// Steps smaller than this end it, metres and radians.
const STEP_MIN: f64 = 1e-5;
/// Closures farther off than so many standard deviations pull less and less (Cauchy).
const CAUCHY_SIGMAS: f64 = 2.0;
/// Robustness sets in step by step: it begins so many times wider, and a quarter each step.
const SCALE_START: f64 = 64.0;

/// A measured relative pose.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Constraint {
    pub a: usize,
    pub b: usize,
    pub a_from_b: Pose2,
    /// Inverse covariance over (x, y, yaw) in `a`.
    pub information: Matrix3<f64>,
    /// May be wrong: weighted down when others contradict it.
    pub robust: bool,
}

impl Constraint {
    fn error(&self, poses: &[Pose2]) -> Vector3<f64> {
        let seen = poses[self.a].between(poses[self.b]);
        let yaw = wrap_angle(seen.yaw_rad - self.a_from_b.yaw_rad);
        Vector3::new(seen.x_m - self.a_from_b.x_m, seen.y_m - self.a_from_b.y_m, yaw)
    }

    /// Squared error in standard deviations.
    pub fn chi_squared(&self, poses: &[Pose2]) -> f64 {
        let e = self.error(poses);
        (e.transpose() * self.information * e).x
    }
}

/// Moves all poses but the first to where the constraints want them. False if they cannot be solved:
/// then the poses are as they were.
pub(crate) fn solve(poses: &mut [Pose2], constraints: &[Constraint]) -> bool {
    let before = poses.to_vec();
    let Some(structure) = Structure::new(poses.len(), constraints) else { return poses.len() <= 1 };
    let mut scale = SCALE_START;
    for _ in 0..STEPS_MAX {
        let Some(step) = structure.step(poses, constraints, CAUCHY_SIGMAS * scale) else {
            poses.copy_from_slice(&before);
            return false;
        };
        let mut largest: f64 = 0.0;
        for (pose, d) in poses[1..].iter_mut().zip(step.chunks_exact(3)) {
            *pose = Pose2::new(pose.x_m - d[0], pose.y_m - d[1], wrap_angle(pose.yaw_rad - d[2]));
            largest = d.iter().fold(largest, |most, d| most.max(d.abs()));
        }
        if scale <= 1.0 && largest < STEP_MIN {
            break;
        }
        scale = (scale / 4.0).max(1.0);
    }
    true
}

/// Derivatives of the error by (x, y, yaw) of a and of b (Grisetti et al. 2010, eqs. 30-33).
fn jacobians(a: Pose2, b: Pose2) -> [Matrix3<f64>; 2] {
    let (sin, cos) = a.yaw_rad.sin_cos();
    let (dx, dy) = (b.x_m - a.x_m, b.y_m - a.y_m);
    let by_a =
        Matrix3::new(-cos, -sin, -sin * dx + cos * dy, sin, -cos, -cos * dx - sin * dy, 0.0, 0.0, -1.0);
    let by_b = Matrix3::new(cos, sin, 0.0, -sin, cos, 0.0, 0.0, 0.0, 1.0);
    [by_a, by_b]
}

/// The normal equations' pattern, the same for all steps. The first pose has no unknowns.
struct Structure {
    unknowns: usize,
    pattern: SymbolicSparseColMat<usize>,
    order: faer::sparse::Argsort<usize>,
    symbolic: SymbolicLlt<usize>,
}

impl Structure {
    fn new(poses: usize, constraints: &[Constraint]) -> Option<Self> {
        let unknowns = 3 * poses.checked_sub(1).filter(|n| *n > 0)?;
        let mut pairs = Vec::with_capacity(3 * unknowns + 9 * constraints.len());
        (0..unknowns / 3).for_each(|block| push_block(&mut pairs, block, block));
        for (row, col, _) in constraints.iter().filter_map(below_diagonal) {
            push_block(&mut pairs, row, col);
        }
        let (pattern, order) = SymbolicSparseColMat::try_new_from_indices(unknowns, unknowns, &pairs).ok()?;
        let symbolic = SymbolicLlt::try_new(pattern.as_ref(), Side::Lower).ok()?;
        Some(Self { unknowns, pattern, order, symbolic })
    }

    /// One step (to be subtracted), x, y, yaw of the second pose, of the third, ...
    fn step(&self, poses: &[Pose2], constraints: &[Constraint], cauchy_sigmas: f64) -> Option<Vec<f64>> {
        let mut diagonal = vec![Matrix3::<f64>::identity() * 1e-6; self.unknowns / 3];
        let mut beside = Vec::with_capacity(9 * constraints.len());
        let mut right = Mat::<f64>::zeros(self.unknowns, 1);
        for constraint in constraints {
            let e = constraint.error(poses);
            let mut weighted = constraint.information;
            if constraint.robust {
                let chi_squared = (e.transpose() * weighted * e).x;
                weighted /= 1.0 + chi_squared / (cauchy_sigmas * cauchy_sigmas);
            }
            let by = jacobians(poses[constraint.a], poses[constraint.b]);
            for (pose, jacobian) in [constraint.a, constraint.b].into_iter().zip(&by) {
                if let Some(block) = pose.checked_sub(1) {
                    diagonal[block] += jacobian.transpose() * weighted * jacobian;
                    let gradient = jacobian.transpose() * (weighted * e);
                    (0..3).for_each(|k| right[(3 * block + k, 0)] += gradient[k]);
                }
            }
            if let Some((_, _, a_is_row)) = below_diagonal(constraint) {
                let (row, col) = if a_is_row { (&by[0], &by[1]) } else { (&by[1], &by[0]) };
                beside.extend_from_slice((row.transpose() * weighted * col).as_slice());
            }
        }
        let mut values = Vec::with_capacity(3 * self.unknowns + beside.len());
        diagonal.iter().for_each(|block| values.extend_from_slice(block.as_slice()));
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

/// The block below the diagonal that a constraint fills: (row, column, whether a is the row).
fn below_diagonal(constraint: &Constraint) -> Option<(usize, usize, bool)> {
    let (a, b) = (constraint.a.checked_sub(1)?, constraint.b.checked_sub(1)?);
    if b > a { Some((b, a, false)) } else { Some((a, b, true)) }
}

/// What is known of `a_from_b`, as said of `i_from_a * a_from_b * b_from_j`.
pub(crate) fn transported(
    information: Matrix3<f64>,
    i_from_a: Pose2,
    a_from_b: Pose2,
    b_from_j: Pose2,
) -> Matrix3<f64> {
    let (sin, cos) = i_from_a.yaw_rad.sin_cos();
    let [arm_x, arm_y] = Pose2::new(0.0, 0.0, a_from_b.yaw_rad).apply([b_from_j.x_m, b_from_j.y_m]);
    let back = Matrix3::new(cos, sin, arm_y, -sin, cos, -arm_x, 0.0, 0.0, 1.0);
    back.transpose() * information * back
}

/// Information that claims no more than a standard deviation of `m` metres and `rad` radians.
pub(crate) fn floored(information: Matrix3<f64>, m: f64, rad: f64) -> Matrix3<f64> {
    let floor = Matrix3::from_diagonal(&Vector3::new(m * m, m * m, rad * rad));
    let covariance = (information + Matrix3::identity() * 1e-3).try_inverse().map(|c| c + floor);
    let inverse = covariance.and_then(|c| c.try_inverse()).unwrap_or(Matrix3::zeros());
    (inverse + inverse.transpose()) * 0.5
}

/// Independent standard deviations.
pub(crate) fn certain_to(m: f64, rad: f64) -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::new(1.0 / (m * m), 1.0 / (m * m), 1.0 / (rad * rad)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn constraint(a: usize, b: usize, a_from_b: Pose2, robust: bool) -> Constraint {
        Constraint { a, b, a_from_b, information: certain_to(0.1, 0.02), robust }
    }

    #[test]
    fn a_wrong_closure_is_outvoted() {
        // A square driven round, its corners 4 m apart, closed three times, once wrongly.
        let side = Pose2::new(4.0, 0.0, core::f64::consts::FRAC_PI_2);
        let mut constraints: Vec<_> =
            (0..8).map(|k| constraint(k, k + 1, side * Pose2::new(0.1, 0.05, 0.02), false)).collect();
        for (a, b) in [(0, 4), (1, 5), (2, 6), (3, 7), (4, 8)] {
            constraints.push(constraint(a, b, Pose2::IDENTITY, true));
        }
        constraints.push(constraint(0, 2, Pose2::new(-3.0, 1.0, 1.0), true));
        let mut poses = vec![Pose2::IDENTITY];
        for k in 0..8 {
            poses.push(poses[k] * constraints[k].a_from_b);
        }
        let apart = poses[0].distance_m(poses[4]);
        assert!(solve(&mut poses, &constraints));
        assert!(poses[0].distance_m(poses[4]) < 0.1 * apart, "{:?} of {apart}", poses[4]);
        assert!(constraints.last().unwrap().chi_squared(&poses) > 100.0);
        assert!((poses[2].distance_m(Pose2::new(4.0, 4.0, 0.0))) < 0.4, "{:?}", poses[2]);
    }

    #[test]
    fn what_cannot_be_solved_is_left_as_it_was() {
        let mut poses = vec![Pose2::IDENTITY, Pose2::new(1.0, 2.0, 3.0)];
        let broken =
            Constraint { information: Matrix3::from_element(f64::NAN), ..constraint(0, 1, poses[1], false) };
        assert!(!solve(&mut poses, &[broken]));
        assert_eq!(poses[1], Pose2::new(1.0, 2.0, 3.0));
    }
}
