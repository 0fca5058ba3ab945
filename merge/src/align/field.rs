//! One map made ready to be matched: how far is the nearest wall, where is floor, and from which side
//! was a wall seen?

use super::evidence::Evidence;
use msg::GridView;
use msg::grid::{Occupancy, occupancy};

/// Distances are known up to this, metres.
pub(super) const REACH_M: f64 = 0.8;
/// The most cells of a distance field; larger maps get coarser ones.
const CELLS_MAX: usize = 2048 * 2048;
/// A wall's floor is looked for this far to each side, cells.
const SIDE_CELLS: usize = 3;

/// Distance to the map's nearest wall, about its middle.
pub(crate) struct Field {
    /// The map's own walls and floor.
    pub evidence: Evidence,
    /// [`Field::seen_from`] of the map's own wall points.
    pub sides: Vec<[f32; 2]>,
    /// Cells of `cell_m`, row-major; distance in cells, at most the reach.
    pub distance: Vec<f32>,
    pub free: Vec<bool>,
    /// How many cells of floor lie in each rectangle from the corner; one row and column more.
    floor_below: Vec<u32>,
    pub width: usize,
    pub height: usize,
    pub cell_m: f64,
    /// Lower left corner, about the middle.
    corner_m: [f64; 2],
}

impl Field {
    pub fn of(evidence: Evidence, grid: GridView<'_>) -> Self {
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
            evidence,
            sides: Vec::new(),
            distance: vec![reach; width * height],
            free: vec![false; width * height],
            floor_below: Vec::new(),
            width,
            height,
            cell_m,
            corner_m,
        };
        for [x, y] in &field.evidence.walls_m {
            let [u, v] = field.place([f64::from(*x), f64::from(*y)]);
            field.distance[v as usize * width + u as usize] = 0.0;
        }
        field.spread();
        field.mark_floor(grid);
        field.sum_floor();
        field.sides = field.own_sides();
        field
    }

    /// Where a point about the middle lies, in cells.
    pub fn place(&self, [x, y]: [f64; 2]) -> [f64; 2] {
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

    fn mark_floor(&mut self, grid: GridView<'_>) {
        let r = grid.header.resolution_m;
        // The points' axes are the grid's: only shifted.
        let from_corner = self.evidence.frame_from_middle.inverse() * grid.header.origin;
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
    pub fn seen_from(&self, x: usize, y: usize) -> [f64; 2] {
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
    fn own_sides(&self) -> Vec<[f32; 2]> {
        let side = |[x, y]: &[f32; 2]| {
            let [u, v] = self.place([f64::from(*x), f64::from(*y)]);
            self.seen_from(u as usize, v as usize).map(|s| s as f32)
        };
        self.evidence.walls_m.iter().map(side).collect()
    }

    /// Distance and its slope (both in cells) at a place, between cell centres; `None` outside.
    pub fn slope(&self, [u, v]: [f64; 2]) -> Option<(f64, [f64; 2])> {
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
}

fn hull_m(points: &[[f32; 2]]) -> [f64; 4] {
    let start = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    let hull = points.iter().fold(start, |hull, [x, y]| {
        let (x, y) = (f64::from(*x), f64::from(*y));
        [hull[0].min(x), hull[1].min(y), hull[2].max(x), hull[3].max(y)]
    });
    if hull[0] <= hull[2] { hull } else { [0.0; 4] }
}
