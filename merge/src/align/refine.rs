//! From a coarse place to the exact one: the walls of both maps drawn to each other's.

use super::field::Field;
use msg::Pose2;
use nalgebra::{Matrix3, Vector3};

/// How far a wall may be off and still pull, metres, one stage after the other: first what the
/// coarse search leaves (a cell of 0.2 m and half a degree), at last a cell of the map.
const STAGES_M: [f64; 3] = [0.25, 0.12, 0.05];
/// Steps in a stage; see [`SETTLED`].
const STEPS_MAX: usize = 8;
/// Walls farther than so many widths of a stage do not pull: their weight is below 0.002.
const WIDTHS_MAX: f64 = 3.5;
/// Of the equations' trace.
const DAMPING: f64 = 1e-4;
/// A stage has settled if a step is this part of its width; a tenth of it in radians.
const SETTLED: f64 = 0.01;

impl Field {
    /// Adds b's walls' pull towards this map's to Gauss-Newton's equations in (x, y, yaw) of
    /// `a_from_b`. Far walls are weighted down (Welsch's function).
    fn pull_of_b(&self, b: &Self, pose: Pose2, keep: usize, width: f64, sums: &mut Normal) {
        let (sin, cos) = pose.yaw_rad.sin_cos();
        for [x, y] in b.evidence.walls_m.iter().step_by(keep) {
            let (x, y) = (f64::from(*x), f64::from(*y));
            let turned = [cos * x - sin * y, sin * x + cos * y];
            let place = self.place([turned[0] + pose.x_m, turned[1] + pose.y_m]);
            if let Some((distance, [gx, gy])) = self.slope(place) {
                let j = Vector3::new(gx, gy, gy * turned[0] - gx * turned[1]);
                sums.add(distance / width, distance * self.cell_m, j);
            }
        }
    }

    /// The same for this map as b: a's walls, seen from b, are pulled towards b's.
    fn pull_of_a(&self, a: &Self, pose: Pose2, keep: usize, width: f64, sums: &mut Normal) {
        let (sin, cos) = pose.yaw_rad.sin_cos();
        for [x, y] in a.evidence.walls_m.iter().step_by(keep) {
            let (x, y) = (f64::from(*x) - pose.x_m, f64::from(*y) - pose.y_m);
            let in_b = [cos * x + sin * y, cos * y - sin * x];
            if let Some((distance, [gx, gy])) = self.slope(self.place(in_b)) {
                let j = Vector3::new(sin * gy - cos * gx, -sin * gx - cos * gy, gx * in_b[1] - gy * in_b[0]);
                sums.add(distance / width, distance * self.cell_m, j);
            }
        }
    }
}

impl Field {
    fn nearness_of(&self, b: &Self, a_from_b: Pose2, keep: usize) -> f64 {
        let (sin, cos) = a_from_b.yaw_rad.sin_cos();
        let reach = (super::field::REACH_M / self.cell_m) as f32;
        let points = b.evidence.walls_m.iter().step_by(keep).map(|[x, y]| {
            let (x, y) = (f64::from(*x), f64::from(*y));
            let [u, v] = self.place([cos * x - sin * y + a_from_b.x_m, sin * x + cos * y + a_from_b.y_m]);
            let inside = u >= 0.0 && v >= 0.0 && u < self.width as f64 && v < self.height as f64;
            if inside { 1.0 - self.distance[v as usize * self.width + u as usize] / reach } else { 0.0 }
        });
        f64::from(points.sum::<f32>())
    }
}

/// Gauss-Newton's equations.
#[derive(Default)]
struct Normal {
    h: Matrix3<f64>,
    g: Vector3<f64>,
}

impl Normal {
    /// A residual in widths of the stage and in metres, and its slope.
    fn add(&mut self, in_widths: f64, metres: f64, j: Vector3<f64>) {
        if in_widths < WIDTHS_MAX {
            let weight = (-0.5 * in_widths * in_widths).exp();
            self.h += weight * j * j.transpose();
            self.g += weight * metres * j;
        }
    }

    fn step(mut self) -> Option<Vector3<f64>> {
        // A little damping: a corridor says nothing about its own direction.
        let damping = DAMPING * self.h.trace().max(1e-9);
        (0..3).for_each(|k| self.h[(k, k)] += damping);
        self.h.cholesky().map(|h| h.solve(&-self.g))
    }
}

/// Draws the walls of both maps to each other's, by Gauss-Newton on their distances; about every
/// `keep`th point of each.
pub(crate) fn refine([a, b]: [&Field; 2], start: Pose2, keep: [usize; 2], stages_m: &[f64]) -> Pose2 {
    let mut pose = start;
    for stage_m in stages_m {
        for _ in 0..STEPS_MAX {
            let mut sums = Normal::default();
            a.pull_of_b(b, pose, keep[1], stage_m / a.cell_m, &mut sums);
            b.pull_of_a(a, pose, keep[0], stage_m / b.cell_m, &mut sums);
            let Some(step) = sums.step() else { return pose };
            pose = Pose2::new(pose.x_m + step[0], pose.y_m + step[1], pose.yaw_rad + step[2]);
            let settled = SETTLED * stage_m;
            if step[0].abs().max(step[1].abs()) < settled && step[2].abs() < settled / 10.0 {
                break;
            }
        }
    }
    Pose2 { yaw_rad: msg::pose::wrap_angle(pose.yaw_rad), ..pose }
}

/// How near the walls of both maps lie to each other's, to choose among many places: the sum over the points of 1 on a
/// wall to 0 at the field's reach.
pub(crate) fn nearness([a, b]: [&Field; 2], a_from_b: Pose2, keep: [usize; 2]) -> f64 {
    a.nearness_of(b, a_from_b, keep[1]) + b.nearness_of(a, a_from_b.inverse(), keep[0])
}

/// The walls' pull on (x, y, yaw) of `a_from_b` at a place, both ways added: Gauss-Newton's matrix
/// for distances in metres, weights as in a stage of this width.
pub(crate) fn pull([a, b]: [&Field; 2], a_from_b: Pose2, keep: [usize; 2], stage_m: f64) -> Matrix3<f64> {
    let mut sums = Normal::default();
    a.pull_of_b(b, a_from_b, keep[1], stage_m / a.cell_m, &mut sums);
    b.pull_of_a(a, a_from_b, keep[0], stage_m / b.cell_m, &mut sums);
    sums.h
}

/// The stages for a candidate of the coarse search.
pub(crate) fn coarse_stages() -> &'static [f64] {
    &STAGES_M
}

/// The stages for the chosen few.
pub(crate) fn fine_stages() -> &'static [f64] {
    &STAGES_M[1..]
}
