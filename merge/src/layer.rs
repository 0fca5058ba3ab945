//! One robot's map redrawn on the lattice of the merged map.

use crate::rect::{Rect, Tiles};
use msg::grid::UNKNOWN;
use msg::{GridHeader, GridView, Pose2};

/// Fractional bits of a place in the robot's grid: 2^-32 of a cell a step, so that over a lattice
/// of 2^24 cells the sum is off by less than a hundredth of a cell.
const FRACTION_BITS: u32 = 32;
/// Added to every place, in cells: an output centre that falls on the border of two input cells
/// always takes the same one, whatever the last bit of a sine says.
const BORDER_BIAS: f64 = 1e-6;
/// Rounding of a hull's corners, in cells.
const HULL_SLACK: f64 = 1e-3;
/// The most samples along one side of an output cell.
pub(crate) const SAMPLES_MAX: usize = 16;

/// From the lattice of the merged map to the cells of one robot's grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lookup {
    /// Grid place (in cells) of the lattice's point (0, 0), and its change per lattice cell.
    start: [f64; 2],
    per_x: [f64; 2],
    per_y: [f64; 2],
    /// Samples along a side of an output cell: more than one where the robot's cells are finer.
    samples: usize,
}

impl Lookup {
    /// `map_from_grid` leads from the grid's lower left corner to the merged map's frame.
    pub fn new(map_from_grid: Pose2, grid_resolution_m: f64, lattice_resolution_m: f64) -> Self {
        let inverse = map_from_grid.inverse();
        let (sin, cos) = inverse.yaw_rad.sin_cos();
        let step = lattice_resolution_m / grid_resolution_m;
        let snap = |value: f64| if (value - value.round()).abs() < 1e-9 { value.round() } else { value };
        Self {
            start: [inverse.x_m / grid_resolution_m, inverse.y_m / grid_resolution_m],
            per_x: [snap(cos * step), snap(sin * step)],
            per_y: [snap(-sin * step), snap(cos * step)],
            samples: ((step - 1e-6).ceil() as usize).clamp(1, SAMPLES_MAX),
        }
    }

    /// Place in the grid, in cells, of a point of the lattice.
    fn grid_place(&self, x: f64, y: f64) -> [f64; 2] {
        [0, 1].map(|k| self.start[k] + self.per_x[k] * x + self.per_y[k] * y + BORDER_BIAS)
    }

    /// A box around every lattice cell that is looked up in `cells` of the grid.
    pub fn lattice_box(&self, cells: Rect) -> Rect {
        if cells.is_empty() {
            return Rect::default();
        }
        let determinant = self.per_x[0] * self.per_y[1] - self.per_x[1] * self.per_y[0];
        let mut hull = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
        for (u, v) in [(cells.x0, cells.y0), (cells.x1, cells.y0), (cells.x0, cells.y1), (cells.x1, cells.y1)]
        {
            let (du, dv) = (u as f64 - self.start[0], v as f64 - self.start[1]);
            let x = (du * self.per_y[1] - dv * self.per_y[0]) / determinant;
            let y = (dv * self.per_x[0] - du * self.per_x[1]) / determinant;
            hull = [hull[0].min(x), hull[1].min(y), hull[2].max(x), hull[3].max(y)];
        }
        // A cell is reached if its centre is in the hull or, where it is sampled finer, any part of it.
        let inset = if self.samples == 1 { 0.5 } else { 0.0 };
        let first = |least: f64| (least - inset - HULL_SLACK).ceil() as i64 - i64::from(self.samples > 1);
        let end = |most: f64| (most - inset + HULL_SLACK).floor() as i64 + 1;
        Rect { x0: first(hull[0]), y0: first(hull[1]), x1: end(hull[2]), y1: end(hull[3]) }
    }

    /// All of `part` of the lattice is looked up well inside a grid.
    fn is_inside(&self, part: Rect, header: &GridHeader) -> bool {
        let corners = [(part.x0, part.y0), (part.x1, part.y0), (part.x0, part.y1), (part.x1, part.y1)];
        corners.into_iter().all(|(x, y)| {
            let [u, v] = self.grid_place(x as f64, y as f64);
            u >= 1.0 && v >= 1.0 && u <= f64::from(header.width) - 1.0 && v <= f64::from(header.height) - 1.0
        })
    }

    fn is_shift(&self) -> bool {
        self.per_x == [1.0, 0.0] && self.per_y == [0.0, 1.0]
    }
}

/// Evidence on a window of the lattice.
#[derive(Clone, Debug, Default)]
pub(crate) struct Layer {
    pub window: Rect,
    pub cells: Vec<i8>,
}

impl Layer {
    /// Makes the window `window`; what lies in both is kept, the rest is unknown.
    pub fn reframe(&mut self, window: Rect) {
        if window == self.window {
            return;
        }
        let mut cells = vec![UNKNOWN; window.width() * window.height()];
        let both = window.intersect(self.window);
        for y in both.y0..both.y1 {
            if both.is_empty() {
                break;
            }
            let from = self.window.index(both.x0, y);
            let to = window.index(both.x0, y);
            cells[to..to + both.width()].copy_from_slice(&self.cells[from..from + both.width()]);
        }
        *self = Self { window, cells };
    }

    /// The part of row `y` that lies in columns `x0..x1`, which are in the window.
    pub fn row(&self, x0: i64, x1: i64, y: i64) -> &[i8] {
        &self.cells[self.window.index(x0, y)..][..(x1 - x0) as usize]
    }

    /// The same, to be written.
    pub fn row_mut(&mut self, x0: i64, x1: i64, y: i64) -> &mut [i8] {
        let start = self.window.index(x0, y);
        &mut self.cells[start..start + (x1 - x0) as usize]
    }

    /// Redraws tiles from the robot's grid.
    pub fn redraw(&mut self, tiles: &Tiles, lookup: &Lookup, grid: GridView<'_>) {
        for tile in tiles.marked() {
            let part = tile.intersect(self.window);
            let inside = lookup.is_inside(part, grid.header);
            for y in part.y0..part.y1 {
                let row = self.row_mut(part.x0, part.x1, y);
                let place = || lookup.grid_place(part.x0 as f64 + 0.5, y as f64 + 0.5);
                match lookup.samples {
                    1 if lookup.is_shift() => shift_row(row, place(), grid),
                    1 if inside => sample_row_inside(row, place(), lookup, grid),
                    1 => sample_row(row, place(), lookup, grid),
                    _ => supersample_row(row, part.x0, y, lookup, grid),
                }
            }
        }
    }
}

/// The grid has the lattice's orientation and cells: rows are copied.
fn shift_row(row: &mut [i8], place: [f64; 2], grid: GridView<'_>) {
    let [from_x, from_y] = place.map(|p| p.floor() as i64);
    let (width, height) = (i64::from(grid.header.width), i64::from(grid.header.height));
    row.fill(UNKNOWN);
    let (first, last) = ((-from_x).max(0), (width - from_x).min(row.len() as i64));
    if (0..height).contains(&from_y) && first < last {
        let start = (from_y * width + from_x + first) as usize;
        let length = (last - first) as usize;
        row[first as usize..last as usize].copy_from_slice(&grid.cells[start..start + length]);
    }
}

/// Nearest cell under every output centre: no holes, whatever the rotation.
fn sample_row(row: &mut [i8], place: [f64; 2], lookup: &Lookup, grid: GridView<'_>) {
    let ([mut u, mut v], [du, dv]) = (place.map(fixed), lookup.per_x.map(fixed));
    let (width, height) = (grid.header.width, grid.header.height);
    for cell in row {
        // Left of or below the grid wraps to far beyond its size.
        let (x, y) = ((u >> FRACTION_BITS) as u32, (v >> FRACTION_BITS) as u32);
        let inside = x < width && y < height;
        *cell = if inside { grid.cells[y as usize * width as usize + x as usize] } else { UNKNOWN };
        u += du;
        v += dv;
    }
}

/// The same where the whole row is known to lie inside the grid: most of a large map.
fn sample_row_inside(row: &mut [i8], place: [f64; 2], lookup: &Lookup, grid: GridView<'_>) {
    let ([mut u, mut v], [du, dv]) = (place.map(fixed), lookup.per_x.map(fixed));
    let width = grid.header.width as usize;
    for cell in row {
        *cell = grid.cells[(v >> FRACTION_BITS) as usize * width + (u >> FRACTION_BITS) as usize];
        u += du;
        v += dv;
    }
}

fn fixed(cells: f64) -> i64 {
    (cells * (1_u64 << FRACTION_BITS) as f64) as i64
}

/// The robot's cells are finer: the strongest obstacle under an output cell, or else the weakest
/// free evidence, so that a thin wall does not fall between the samples.
fn supersample_row(row: &mut [i8], x0: i64, y: i64, lookup: &Lookup, grid: GridView<'_>) {
    let n = lookup.samples;
    row.fill(UNKNOWN);
    let mut part = [UNKNOWN; crate::rect::TILE as usize];
    for sample in 0..n * n {
        let [dx, dy] = [sample % n, sample / n].map(|k| (k as f64 + 0.5) / n as f64);
        let part = &mut part[..row.len()];
        sample_row(part, lookup.grid_place(x0 as f64 + dx, y as f64 + dy), lookup, grid);
        for (cell, seen) in row.iter_mut().zip(part) {
            *cell = (*cell).max(*seen); // UNKNOWN is the least of all
        }
    }
}
