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
const STAGES_M: [f64; 3] = [0.25, 0.12, 0.05];
/// Steps in a stage; see [`SETTLED`].
const STEPS_MAX: usize = 8;
/// Walls farther than so many widths of a stage do not pull: their weight is below 0.002.
const WIDTHS_MAX: f64 = 3.5;
/// Of the equations' trace.
const DAMPING: f64 = 1e-4;
/// A stage has settled if a step is this part of its width; a tenth of it in radians.
const SETTLED: f64 = 0.01;
/// A wall's floor is looked for this far to each side, cells.
const SIDE_CELLS: usize = 3;
/// Two walls seen from opposite sides, both clearly, are the two faces of a wall at best: below
/// this product of [`Field::seen_from`].
const BACK_TO_BACK: f64 = -0.15;
/// A wall missed weighs as much as so many found. In the right place nine walls in ten are found
/// again, in the best of many wrong ones about half: the log-likelihood ratios of found and missed
/// are ln(0.9 / 0.5) and ln(0.1 / 0.5).
pub(crate) const MISSED_WEIGHT: f64 = 2.7;
/// Two walls that are this near are the same, cells of the field.
const SAME_CELLS: f32 = 1.5;
/// A wall is missed only where the other map saw floor and no wall within this, cells of the field.
const MISSED_CELLS: f32 = 2.5;

/// Distance to a's nearest wall, about a's middle.
pub(crate) struct Field {
    /// [`Field::seen_from`] of the map's own wall points.
    sides: Vec<[f32; 2]>,
    /// Cells of `cell_m`, row-major; distance in cells, at most the reach.
    distance: Vec<f32>,
    free: Vec<bool>,
    /// How many cells of floor lie in each rectangle from the corner; one row and column more.
    floor_below: Vec<u32>,
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
    /// Wall points of either map on a wall of the other.
    pub found: f64,
    /// Wall points of either map on the other's floor, far from its walls.
    pub missed: f64,
    /// Mean distance of the found ones, metres.
    pub residual_m: f64,
    /// The least of the eigenvalues of the found walls' pull on the position over their sum, 0 to
    /// 0.5: near 0 the map can slide along itself, as in a corridor.
    pub firmness: f64,
}

impl Fit {
    /// What speaks for it: walls found less [`MISSED_WEIGHT`] times the walls missed.
    pub fn evidence(&self) -> f64 {
        self.found - MISSED_WEIGHT * self.missed
    }

    /// Both directions together.
    pub fn plus(self, other: Self) -> Self {
        let found = self.found + other.found;
        let mean = |x: f64, y: f64| (x * self.found + y * other.found) / found.max(1.0);
        Self {
            a_from_b: self.a_from_b,
            found,
            missed: self.missed + other.missed,
            residual_m: mean(self.residual_m, other.residual_m),
            firmness: mean(self.firmness, other.firmness),
        }
    }
}

impl Field {
    pub fn of(evidence: &Evidence, grid: GridView<'_>) -> Self {
        let margin_m = REACH_M;
        let span_m = 2.0 * (evidence.radius_m + margin_m);
        let cell_m = grid.header.resolution_m.max(span_m / (CELLS_MAX as f64).sqrt());
        let hull = hull_m(&evidence.walls_m);
        // On the grid's own lattice, so that its cells are the field's and nothing shifts by part of one.
        let corner_m = [hull[0] - margin_m, hull[1] - margin_m].map(|m| (m / cell_m).floor() * cell_m);
        let size = |k: usize| ((hull[k + 2] - corner_m[k] + margin_m) / cell_m).ceil() as usize + 1;
        let (width, height) = (size(0), size(1));
        let reach = (REACH_M / cell_m) as f32;
        let mut field = Self {
            sides: Vec::new(),
            distance: vec![reach; width * height],
            free: vec![false; width * height],
            floor_below: Vec::new(),
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
        field.sum_floor();
        field.sides = field.sides(evidence);
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
        let r = grid.header.resolution_m;
        // The points' axes are the grid's: only shifted.
        let from_corner = evidence.frame_from_middle.inverse() * grid.header.origin;
        let start = self.place([from_corner.x_m + 0.5 * r, from_corner.y_m + 0.5 * r]);
        let step = r / self.cell_m;
        let column = |x: u32| {
            let u = start[0] + step * f64::from(x);
            if u < 0.0 { usize::MAX } else { u as usize }
        };
        let columns: Vec<usize> = (0..grid.header.width).map(column).collect();
        for (y, row) in grid.cells.chunks_exact(columns.len().max(1)).enumerate() {
            let v = start[1] + step * y as f64;
            if v < 0.0 || v as usize >= self.height {
                continue;
            }
            let free = &mut self.free[v as usize * self.width..][..self.width];
            for (u, cell) in columns.iter().zip(row) {
                if let Some(free) = free.get_mut(*u) {
                    *free |= occupancy(*cell) == Occupancy::Free;
                }
            }
        }
    }

    fn sum_floor(&mut self) {
        let stride = self.width + 1;
        self.floor_below = vec![0; stride * (self.height + 1)];
        for y in 0..self.height {
            let mut row = 0;
            for x in 0..self.width {
                row += u32::from(self.free[y * self.width + x]);
                self.floor_below[(y + 1) * stride + x + 1] = self.floor_below[y * stride + x + 1] + row;
            }
        }
    }

    /// The side on which a wall at a place was seen: towards its floor, -1 to 1 along x and y; near
    /// zero if it was seen from both.
    fn seen_from(&self, x: usize, y: usize) -> [f64; 2] {
        let (x0, x1) = (x.saturating_sub(SIDE_CELLS), (x + SIDE_CELLS + 1).min(self.width));
        let (y0, y1) = (y.saturating_sub(SIDE_CELLS), (y + SIDE_CELLS + 1).min(self.height));
        let stride = self.width + 1;
        let at = |x: usize, y: usize| i64::from(self.floor_below[y * stride + x]);
        let floor =
            |x0: usize, y0: usize, x1: usize, y1: usize| at(x1, y1) + at(x0, y0) - at(x0, y1) - at(x1, y0);
        let half = (SIDE_CELLS * (2 * SIDE_CELLS + 1)) as f64;
        let across = floor(x + 1, y0, x1, y1) - floor(x0, y0, x, y1);
        let along = floor(x0, y + 1, x1, y1) - floor(x0, y0, x1, y);
        [across as f64 / half, along as f64 / half]
    }

    /// [`Field::seen_from`] of this map's own wall points.
    fn sides(&self, evidence: &Evidence) -> Vec<[f32; 2]> {
        let side = |[x, y]: &[f32; 2]| {
            let [u, v] = self.place([f64::from(*x), f64::from(*y)]);
            self.seen_from(u as usize, v as usize).map(|s| s as f32)
        };
        evidence.walls_m.iter().map(side).collect()
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

    /// Adds b's walls' pull towards this map's to Gauss-Newton's equations in (x, y, yaw) of
    /// `a_from_b`. Far walls are weighted down (Welsch's function).
    fn pull_of_b(&self, b: &Evidence, pose: Pose2, keep: usize, width: f64, sums: &mut Normal) {
        let (sin, cos) = pose.yaw_rad.sin_cos();
        for [x, y] in b.walls_m.iter().step_by(keep) {
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
    fn pull_of_a(&self, a: &Evidence, pose: Pose2, keep: usize, width: f64, sums: &mut Normal) {
        let (sin, cos) = pose.yaw_rad.sin_cos();
        for [x, y] in a.walls_m.iter().step_by(keep) {
            let (x, y) = (f64::from(*x) - pose.x_m, f64::from(*y) - pose.y_m);
            let in_b = [cos * x + sin * y, cos * y - sin * x];
            if let Some((distance, [gx, gy])) = self.slope(self.place(in_b)) {
                let j = Vector3::new(sin * gy - cos * gx, -sin * gx - cos * gy, gx * in_b[1] - gy * in_b[0]);
                sums.add(distance / width, distance * self.cell_m, j);
            }
        }
    }

    /// How b's walls lie, every `keep`th point.
    pub fn fit(&self, b: &Evidence, of_b: &Self, a_from_b: Pose2, keep: usize) -> Fit {
        let (sin, cos) = a_from_b.yaw_rad.sin_cos();
        let mut fit = Fit { a_from_b, ..Default::default() };
        let (mut sum, mut pull) = (0.0, [0.0; 3]);
        for ([x, y], side) in b.walls_m.iter().zip(&of_b.sides).step_by(keep) {
            let (x, y) = (f64::from(*x), f64::from(*y));
            let [u, v] = self.place([cos * x - sin * y + a_from_b.x_m, sin * x + cos * y + a_from_b.y_m]);
            if !(u >= 0.0 && v >= 0.0 && u < self.width as f64 && v < self.height as f64) {
                continue;
            }
            let index = v as usize * self.width + u as usize;
            let distance = self.distance[index];
            if distance <= SAME_CELLS {
                let [sx, sy] = side.map(f64::from);
                let [tx, ty] = self.seen_from(u as usize, v as usize);
                if tx * (cos * sx - sin * sy) + ty * (sin * sx + cos * sy) < BACK_TO_BACK {
                    continue;
                }
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
pub(crate) fn refine(
    [of_a, of_b]: [&Field; 2],
    [a, b]: [&Evidence; 2],
    start: Pose2,
    keep: [usize; 2],
    stages_m: &[f64],
) -> Pose2 {
    let mut pose = start;
    for stage_m in stages_m {
        for _ in 0..STEPS_MAX {
            let mut sums = Normal::default();
            of_a.pull_of_b(b, pose, keep[1], stage_m / of_a.cell_m, &mut sums);
            of_b.pull_of_a(a, pose, keep[0], stage_m / of_b.cell_m, &mut sums);
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

/// The stages for a candidate of the coarse search.
pub(crate) fn coarse_stages() -> &'static [f64] {
    &STAGES_M
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
