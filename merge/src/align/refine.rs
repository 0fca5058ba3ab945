//! Refinement of a coarse transform: each map's walls are drawn to the other's by Gauss-Newton on their distances.

use super::distance_field::{DistanceField, REACH_M};
use msg::{Pose2, pose::wrap_angle};
use nalgebra::{Matrix3, Vector3};

/// Widths of the robust kernel, metres, one stage after the other: first what the coarse search leaves (a cell of 0.2 m
/// and half a degree), at last a cell of the map.
const KERNEL_WIDTHS_M: [f64; 3] = [0.25, 0.12, 0.05];
/// Kernel widths for a candidate of the coarse search.
pub(crate) const COARSE_KERNELS_M: &[f64] = &KERNEL_WIDTHS_M;
/// Kernel widths for a transform that has been refined with few points.
pub(crate) const FINE_KERNELS_M: &[f64] = KERNEL_WIDTHS_M.split_at(1).1;
/// Most iterations of a stage: [`CONVERGED`] ends nearly all before.
const ITERATIONS_MAX: usize = 8;
/// Walls farther away than so many kernel widths are left out: their weight is below 0.002.
const KERNEL_WIDTHS_MAX: f64 = 3.5;
/// Damping, as a share of the trace of the normal matrix: a corridor says nothing about its own direction.
const DAMPING: f64 = 1e-4;
/// Least trace that the damping counts with: without any walls the matrix stays invertible.
const TRACE_MIN: f64 = 1e-9;
/// A stage has converged when a step moves less than this share of the kernel's width,
const CONVERGED: f64 = 0.01;
/// and turns less than this many radians for each metre of that: at 10 m the two are alike.
const CONVERGED_RAD_PER_M: f64 = 0.1;

/// Normal equations in (x, y, yaw) of `a_from_b`.
#[derive(Default)]
struct NormalEquations {
    matrix: Matrix3<f64>,
    gradient: Vector3<f64>,
}

impl NormalEquations {
    /// Adds a residual, in kernel widths and in metres, with its Jacobian. Welsch's function weights far walls down.
    fn add(&mut self, in_widths: f64, metres: f64, jacobian: Vector3<f64>) {
        if in_widths < KERNEL_WIDTHS_MAX {
            let weight = (-0.5 * in_widths * in_widths).exp();
            self.matrix += weight * jacobian * jacobian.transpose();
            self.gradient += weight * metres * jacobian;
        }
    }

    fn solve(mut self) -> Option<Vector3<f64>> {
        let damping = DAMPING * self.matrix.trace().max(TRACE_MIN);
        (0..3).for_each(|k| self.matrix[(k, k)] += damping);
        self.matrix.cholesky().map(|matrix| matrix.solve(&-self.gradient))
    }
}

impl DistanceField {
    /// Adds the residuals of b's walls in this map. `width` is the kernel's, in cells.
    fn add_walls_of_b(
        &self,
        b: &Self,
        a_from_b: Pose2,
        stride: usize,
        width: f64,
        sums: &mut NormalEquations,
    ) {
        let (sin, cos) = a_from_b.yaw_rad.sin_cos();
        for [x, y] in b.points.walls_m.iter().step_by(stride) {
            let (x, y) = (f64::from(*x), f64::from(*y));
            let rotated = [cos * x - sin * y, sin * x + cos * y];
            let cell = self.to_cells([rotated[0] + a_from_b.x_m, rotated[1] + a_from_b.y_m]);
            if let Some((distance, [gx, gy])) = self.distance_and_gradient(cell) {
                let jacobian = Vector3::new(gx, gy, gy * rotated[0] - gx * rotated[1]);
                sums.add(distance / width, distance * self.cell_m, jacobian);
            }
        }
    }

    /// Adds the residuals of a's walls in this map, which is b. `width` is the kernel's, in cells.
    fn add_walls_of_a(
        &self,
        a: &Self,
        a_from_b: Pose2,
        stride: usize,
        width: f64,
        sums: &mut NormalEquations,
    ) {
        let (sin, cos) = a_from_b.yaw_rad.sin_cos();
        for [x, y] in a.points.walls_m.iter().step_by(stride) {
            let (x, y) = (f64::from(*x) - a_from_b.x_m, f64::from(*y) - a_from_b.y_m);
            let in_b = [cos * x + sin * y, cos * y - sin * x];
            if let Some((distance, [gx, gy])) = self.distance_and_gradient(self.to_cells(in_b)) {
                let jacobian =
                    Vector3::new(sin * gy - cos * gx, -sin * gx - cos * gy, gx * in_b[1] - gy * in_b[0]);
                sums.add(distance / width, distance * self.cell_m, jacobian);
            }
        }
    }

    /// Sum over b's walls of 1 on a wall of this map, down to 0 at the field's reach.
    fn proximity_of(&self, b: &Self, a_from_b: Pose2, stride: usize) -> f64 {
        let (sin, cos) = a_from_b.yaw_rad.sin_cos();
        let reach = (REACH_M / self.cell_m) as f32;
        let points = b.points.walls_m.iter().step_by(stride).map(|[x, y]| {
            let (x, y) = (f64::from(*x), f64::from(*y));
            let [u, v] = self.to_cells([cos * x - sin * y + a_from_b.x_m, sin * x + cos * y + a_from_b.y_m]);
            let inside = u >= 0.0 && v >= 0.0 && u < self.width as f64 && v < self.height as f64;
            if inside { 1.0 - self.distance[v as usize * self.width + u as usize] / reach } else { 0.0 }
        });
        f64::from(points.sum::<f32>())
    }
}

/// Refines the transform between two maps' centred frames, in stages of these kernel widths, by every `strides`th wall
/// point of each.
pub(crate) fn refine(
    [a, b]: [&DistanceField; 2],
    start: Pose2,
    strides: [usize; 2],
    kernels_m: &[f64],
) -> Pose2 {
    let mut pose = start;
    for kernel_m in kernels_m {
        for _ in 0..ITERATIONS_MAX {
            let sums = normal_equations([a, b], pose, strides, *kernel_m);
            let Some(step) = sums.solve() else { return pose };
            pose = Pose2::new(pose.x_m + step[0], pose.y_m + step[1], pose.yaw_rad + step[2]);
            let converged = CONVERGED * kernel_m;
            if step[0].abs().max(step[1].abs()) < converged && step[2].abs() < converged * CONVERGED_RAD_PER_M
            {
                break;
            }
        }
    }
    Pose2 { yaw_rad: wrap_angle(pose.yaw_rad), ..pose }
}

/// Proximity of both maps' walls, for ranking many transforms quickly: the sum over the wall points of 1 on a wall of
/// the other map, down to 0 at the field's reach.
pub(crate) fn wall_proximity([a, b]: [&DistanceField; 2], a_from_b: Pose2, strides: [usize; 2]) -> f64 {
    a.proximity_of(b, a_from_b, strides[1]) + b.proximity_of(a, a_from_b.inverse(), strides[0])
}

/// Information of both maps' walls on (x, y, yaw) of `a_from_b`, for points of unit variance (metres): the normal matrix
/// with a kernel of this width.
pub(crate) fn wall_information(
    fields: [&DistanceField; 2],
    a_from_b: Pose2,
    strides: [usize; 2],
    kernel_m: f64,
) -> Matrix3<f64> {
    normal_equations(fields, a_from_b, strides, kernel_m).matrix
}

fn normal_equations(
    [a, b]: [&DistanceField; 2],
    a_from_b: Pose2,
    strides: [usize; 2],
    kernel_m: f64,
) -> NormalEquations {
    let mut sums = NormalEquations::default();
    a.add_walls_of_b(b, a_from_b, strides[1], kernel_m / a.cell_m, &mut sums);
    b.add_walls_of_a(a, a_from_b, strides[0], kernel_m / b.cell_m, &mut sums);
    sums
}
