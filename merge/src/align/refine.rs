//! From a coarse place to the exact one: b's walls drawn to a's nearest walls.

use super::evidence::Evidence;
use msg::grid::{Occupancy, occupancy};
use msg::{GridView, Pose2};
use nalgebra::{Matrix3, Vector3};

/// Distances are known up to this, metres.
const REACH_M: f64 = 0.8;
/// The most cells of a distance field; larger maps get coarser ones.
const CELLS_MAX: usize = 2048 * 2048;
/// How far a wall may be off and still pull, metres, one stage after the other: first what the
/// coarse search leaves (a cell of 0.2 m and half a degree), at last a cell of the map.
const STAGES_M: [f64; 4] = [0.4, 0.2, 0.1, 0.05];
/// Steps in a stage; a stage ends before if a step is shorter than [`STEP_MIN`].
const STEPS_MAX: usize = 8;
/// Metres and radians.
const STEP_MIN: f64 = 2e-4;
/// Two walls that are this near are the same, cells of the field.
const SAME_CELLS: f32 = 1.5;
/// A wall is missed only where the other map saw floor and no wall within this, cells of the field.
const MISSED_CELLS: f32 = 2.5;

/// Distance to a's nearest wall, about a's middle.
pub(crate) struct Field {
    /// Cells of `cell_m`, row-major; distance in cells, at most the reach.
    distance: Vec<f32>,
    free: Vec<bool>,
    width: usize,
    height: usize,
    cell_m: f64,
    /// Of the lower left corner, about the middle.
    corner_m: [f64; 2],
}

/// How b's walls lie on a.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Fit {
    pub a_from_b: Pose2,
    /// Wall points of b on a wall of a.
    pub found: f64,
    /// Wall points of b on a's floor, far from its walls.
    pub missed: f64,
    /// Mean distance of the found ones, metres.
    pub residual_m: f64,
    /// The least of the eigenvalues of the found walls' pull on the position over their sum, 0 to
    /// 0.5: near 0 the map can slide along itself, as in a corridor.
    pub firmness: f64,
}

impl Fit {
    /// What speaks for it: walls found less walls missed.
    pub fn evidence(&self) -> f64 {
        self.found - self.missed
    }
}

impl Field {
    pub fn of(evidence: &Evidence, grid: GridView<'_>) -> Self {
        let margin_m = REACH_M;
        let span_m = 2.0 * (evidence.radius_m + margin_m);
        let cell_m = grid.header.resolution_m.max(span_m / (CELLS_MAX as f64).sqrt());
        let hull = hull_m(&evidence.walls_m);
        let corner_m = [hull[0] - margin_m, hull[1] - margin_m];
        let size = |k: usize| ((hull[k + 2] - hull[k] + 2.0 * margin_m) / cell_m).ceil() as usize + 1;
        let (width, height) = (size(0), size(1));
        let reach = (REACH_M / cell_m) as f32;
        let mut field = Self {
            distance: vec![reach; width * height],
            free: vec![false; width * height],
            width,
            height,
            cell_m,
            corner_m,
        };
        for [x, y] in &evidence.walls_m {
            let [u, v] = field.place([f64::from(*x), f64::from(*y)]);
            field.distance[v as usize * width + u as usize] = 0.0;
        }
        field.spread();
        field.mark_floor(evidence, grid);
        field
    }

    /// Where a point about the middle lies, in cells.
    fn place(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [(x - self.corner_m[0]) / self.cell_m, (y - self.corner_m[1]) / self.cell_m]
    }

    /// Two sweeps with the steps of a chamfer (Borgefors 1986): within 4 % of Euclid's distance.
    fn spread(&mut self) {
        const SIDE: f32 = 0.955;
        const DIAGONAL: f32 = 1.3693;
        let (width, height) = (self.width, self.height);
        let d = &mut self.distance;
        for y in 0..height {
            for x in 0..width {
                let i = y * width + x;
                let mut least = d[i];
                if x > 0 {
                    least = least.min(d[i - 1] + SIDE);
                }
                if y > 0 {
                    least = least.min(d[i - width] + SIDE);
                    if x > 0 {
                        least = least.min(d[i - width - 1] + DIAGONAL);
                    }
                    if x + 1 < width {
                        least = least.min(d[i - width + 1] + DIAGONAL);
                    }
                }
                d[i] = least;
            }
        }
        for y in (0..height).rev() {
            for x in (0..width).rev() {
                let i = y * width + x;
                let mut least = d[i];
                if x + 1 < width {
                    least = least.min(d[i + 1] + SIDE);
                }
                if y + 1 < height {
                    least = least.min(d[i + width] + SIDE);
                    if x > 0 {
                        least = least.min(d[i + width - 1] + DIAGONAL);
                    }
                    if x + 1 < width {
                        least = least.min(d[i + width + 1] + DIAGONAL);
                    }
                }
                d[i] = least;
            }
        }
    }

    fn mark_floor(&mut self, evidence: &Evidence, grid: GridView<'_>) {
        let width = (grid.header.width as usize).max(1);
        let r = grid.header.resolution_m;
        let middle_from_grid = evidence.grid_from_middle().inverse() * grid.header.origin;
        for (y, row) in grid.cells.chunks_exact(width).enumerate() {
            for (x, cell) in row.iter().enumerate() {
                if occupancy(*cell) == Occupancy::Free {
                    let point = middle_from_grid.apply([(x as f64 + 0.5) * r, (y as f64 + 0.5) * r]);
                    let [u, v] = self.place(point);
                    if u >= 0.0 && v >= 0.0 && (u as usize) < self.width && (v as usize) < self.height {
                        self.free[v as usize * self.width + u as usize] = true;
                    }
                }
            }
        }
    }

    /// Distance and its slope (both in cells) at a place, between cell centres; `None` outside.
    fn slope(&self, [u, v]: [f64; 2]) -> Option<(f64, [f64; 2])> {
        let (u, v) = (u - 0.5, v - 0.5);
        if !(u >= 0.0 && v >= 0.0 && u < (self.width - 1) as f64 && v < (self.height - 1) as f64) {
            return None;
        }
        let (x, y) = (u as usize, v as usize);
        let (s, t) = (u - x as f64, v - y as f64);
        let at = |i: usize| f64::from(self.distance[i]);
        let i = y * self.width + x;
        let (p00, p10, p01, p11) = (at(i), at(i + 1), at(i + self.width), at(i + self.width + 1));
        let (low, high) = (p00 + s * (p10 - p00), p01 + s * (p11 - p01));
        let across = (1.0 - t) * (p10 - p00) + t * (p11 - p01);
        Some((low + t * (high - low), [across, high - low]))
    }

    /// Gauss-Newton on the distances of b's walls, far ones weighted down (Welsch's function),
    /// every `keep`th point.
    pub fn refine(&self, b: &Evidence, start: Pose2, keep: usize, stages: &[f64]) -> Pose2 {
        let mut pose = start;
        for stage_m in stages {
            let width = stage_m / self.cell_m;
            for _ in 0..STEPS_MAX {
                let Some(step) = self.step(b, pose, keep, width) else { return pose };
                pose = Pose2::new(pose.x_m + step[0], pose.y_m + step[1], pose.yaw_rad + step[2]);
                if step[0].abs().max(step[1].abs()) < STEP_MIN && step[2].abs() < STEP_MIN / 10.0 {
                    break;
                }
            }
        }
        Pose2 { yaw_rad: msg::pose::wrap_angle(pose.yaw_rad), ..pose }
    }

    fn step(&self, b: &Evidence, pose: Pose2, keep: usize, width: f64) -> Option<Vector3<f64>> {
        let (sin, cos) = pose.yaw_rad.sin_cos();
        let (mut h, mut g) = (Matrix3::zeros(), Vector3::zeros());
        for [x, y] in b.walls_m.iter().step_by(keep) {
            let (x, y) = (f64::from(*x), f64::from(*y));
            let turned = [cos * x - sin * y, sin * x + cos * y];
            let place = self.place([turned[0] + pose.x_m, turned[1] + pose.y_m]);
            let Some((distance, [gx, gy])) = self.slope(place) else { continue };
            let weight = (-0.5 * (distance / width).powi(2)).exp();
            if weight < 1e-3 {
                continue;
            }
            // Distances in metres, slopes without unit.
            let j = Vector3::new(gx, gy, gy * turned[0] - gx * turned[1]);
            h += weight * j * j.transpose();
            g += weight * distance * self.cell_m * j;
        }
        // A little damping: a corridor says nothing about its own direction.
        let scale = h.trace().max(1e-9);
        h += Matrix3::from_diagonal(&Vector3::new(1e-4, 1e-4, 1e-4)) * scale;
        h.cholesky().map(|h| h.solve(&-g))
    }

    /// How b's walls lie, every `keep`th point.
    pub fn fit(&self, b: &Evidence, a_from_b: Pose2, keep: usize) -> Fit {
        let (sin, cos) = a_from_b.yaw_rad.sin_cos();
        let mut fit = Fit { a_from_b, ..Default::default() };
        let (mut sum, mut pull) = (0.0, [0.0; 3]);
        for [x, y] in b.walls_m.iter().step_by(keep) {
            let (x, y) = (f64::from(*x), f64::from(*y));
            let [u, v] = self.place([cos * x - sin * y + a_from_b.x_m, sin * x + cos * y + a_from_b.y_m]);
            if !(u >= 0.0 && v >= 0.0 && u < self.width as f64 && v < self.height as f64) {
                continue;
            }
            let index = v as usize * self.width + u as usize;
            let distance = self.distance[index];
            if distance <= SAME_CELLS {
                fit.found += 1.0;
                sum += f64::from(distance);
                if let Some((_, [gx, gy])) = self.slope([u, v]) {
                    pull = [pull[0] + gx * gx, pull[1] + gx * gy, pull[2] + gy * gy];
                }
            } else if distance > MISSED_CELLS && self.free[index] {
                fit.missed += 1.0;
            }
        }
        let (trace, apart) = (pull[0] + pull[2], (pull[0] - pull[2]).hypot(2.0 * pull[1]));
        fit.residual_m = if fit.found > 0.0 { sum / fit.found * self.cell_m } else { 0.0 };
        fit.firmness = if trace > 0.0 { (trace - apart) / (2.0 * trace) } else { 0.0 };
        fit.found *= keep as f64;
        fit.missed *= keep as f64;
        fit
    }
}

/// The stages for a candidate of the coarse search.
pub(crate) fn coarse_stages() -> &'static [f64] {
    &STAGES_M[..3]
}

/// The stages for the chosen few.
pub(crate) fn fine_stages() -> &'static [f64] {
    &STAGES_M[2..]
}

fn hull_m(points: &[[f32; 2]]) -> [f64; 4] {
    let start = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    let hull = points.iter().fold(start, |hull, [x, y]| {
        let (x, y) = (f64::from(*x), f64::from(*y));
        [hull[0].min(x), hull[1].min(y), hull[2].max(x), hull[3].max(y)]
    });
    if hull[0] <= hull[2] { hull } else { [0.0; 4] }
}
