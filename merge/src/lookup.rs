//! One robot's map looked up on the lattice of the merged map, tile by tile.

use msg::grid::UNKNOWN;
use msg::tiles::{TILE, TILE_CELLS};
use msg::{MapTile, Pose2, Rect, TileMap};

/// Added to every place, in cells: an output centre that falls on the border of two input cells
/// always takes the same one, whatever the last bit of a sine says.
const BORDER_BIAS: f64 = 1e-6;
/// Rounding of a hull's corners, in cells.
const HULL_SLACK: f64 = 1e-3;
/// The most samples along one side of an output cell.
const SAMPLES_MAX: usize = 16;
/// Fractional bits of a place on the bench: with 8 bits before them a place fits into 32 bits, and
/// is off by less than a millionth of a cell at the end of a row.
const FRACTION_BITS: u32 = 24;
/// The bench's columns, a power of two: four tiles, of which a turned tile touches three.
const BENCH_WIDTH: usize = 4 * SIDE;
/// The bench's rows, a power of two: a turned tile reaches over 91.
const BENCH_HEIGHT: usize = 128;
const SIDE: usize = TILE as usize;

/// From the lattice of the merged map to the cells of one robot's map.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Lookup {
    /// Place in the robot's cells of the lattice's point (0, 0), and its change per lattice cell.
    start: [f64; 2],
    per_x: [f64; 2],
    per_y: [f64; 2],
    /// Samples along a side of an output cell: more than one where the robot's cells are finer.
    samples: usize,
    /// Steps from a row's first place to each of a tile's columns, as fractions of 2^-24 cells.
    steps: [[u32; SIDE]; 2],
}

/// Where a robot's cells are laid out to be looked up, and what was found. Used again and again.
pub(crate) struct Bench {
    cells: Box<[i8; BENCH_WIDTH * BENCH_HEIGHT]>,
    /// What the last lookup found.
    pub found: Box<[i8; TILE_CELLS]>,
}

impl Default for Bench {
    fn default() -> Self {
        let cells = Box::new([UNKNOWN; BENCH_WIDTH * BENCH_HEIGHT]);
        Self { cells, found: Box::new([UNKNOWN; TILE_CELLS]) }
    }
}

impl Lookup {
    /// `map_from_cells` leads from the robot's lattice to the merged map's frame.
    pub fn new(map_from_cells: Pose2, robot_resolution_m: f64, lattice_resolution_m: f64) -> Self {
        let inverse = map_from_cells.inverse();
        let (sin, cos) = inverse.yaw_rad.sin_cos();
        let step = lattice_resolution_m / robot_resolution_m;
        let snap = |value: f64| if (value - value.round()).abs() < 1e-9 { value.round() } else { value };
        let per_x = [snap(cos * step), snap(sin * step)];
        Self {
            start: [inverse.x_m / robot_resolution_m, inverse.y_m / robot_resolution_m],
            per_x,
            per_y: [snap(-sin * step), snap(cos * step)],
            samples: ((step - 1e-6).ceil() as usize).clamp(1, SAMPLES_MAX),
            steps: per_x.map(|step| core::array::from_fn(|x| fixed(step * x as f64))),
        }
    }

    /// Place in the robot's cells of a point of the lattice.
    fn place(&self, x: f64, y: f64) -> [f64; 2] {
        [0, 1].map(|k| self.start[k] + self.per_x[k] * x + self.per_y[k] * y + BORDER_BIAS)
    }

    /// A box around every lattice cell that is looked up in the robot's `cells`.
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

    /// The robot's cells that a tile of the lattice is looked up in.
    fn cells_under(&self, tile: Rect) -> Rect {
        let [x0, y0, x1, y1] = [tile.x0, tile.y0, tile.x1, tile.y1].map(|v| v as f64);
        let corners = [[x0, y0], [x1, y0], [x0, y1], [x1, y1]].map(|[x, y]| self.place(x, y));
        let [mut low, mut high] = [corners[0]; 2];
        for corner in corners {
            for k in 0..2 {
                (low[k], high[k]) = (low[k].min(corner[k]), high[k].max(corner[k]));
            }
        }
        let (low, high) = (low.map(|v| v.floor() as i64), high.map(|v| v.floor() as i64 + 1));
        Rect { x0: low[0], y0: low[1], x1: high[0], y1: high[1] }
    }

    /// Looks a tile of the lattice up in the robot's map: the result is `bench.found`. False if
    /// nothing is known anywhere near it.
    pub fn find(&self, x: i64, y: i64, map: &TileMap, bench: &mut Bench) -> bool {
        let tile = Rect::cells_of_tile(x, y);
        let under = self.cells_under(tile);
        if !under.tiles().points().any(|(x, y)| map.get(x, y).is_some()) {
            return false;
        }
        let fits = under.tiles().width() * SIDE <= BENCH_WIDTH && under.height() <= BENCH_HEIGHT;
        if self.samples == 1 && fits {
            bench.lay_out(map, under);
            self.find_on_bench(tile, under, bench);
        } else {
            self.find_finer(tile, map, bench);
        }
        true
    }

    /// Nearest cell under every output centre: no holes, whatever the rotation.
    fn find_on_bench(&self, tile: Rect, under: Rect, bench: &mut Bench) {
        let corner = [(under.tiles().x0 * TILE) as f64, under.y0 as f64];
        let is_shift = self.per_x == [1.0, 0.0];
        let [steps_u, steps_v] = &self.steps;
        for (row, y) in bench.found.as_chunks_mut::<SIDE>().0.iter_mut().zip(tile.y0..) {
            let place = self.place(tile.x0 as f64 + 0.5, y as f64 + 0.5);
            let [u, v] = [0, 1].map(|k| fixed(place[k] - corner[k]));
            if is_shift {
                let start = on_bench(u, v).min(BENCH_WIDTH * BENCH_HEIGHT - SIDE);
                row.copy_from_slice(&bench.cells[start..start + SIDE]);
                continue;
            }
            // In two passes: the first is done several columns at a time.
            let mut places = [0_u32; SIDE];
            for ((place, du), dv) in places.iter_mut().zip(steps_u).zip(steps_v) {
                *place = on_bench(u.wrapping_add(*du), v.wrapping_add(*dv)) as u32;
            }
            for (cell, place) in row.iter_mut().zip(&places) {
                *cell = bench.cells[*place as usize % (BENCH_WIDTH * BENCH_HEIGHT)];
            }
        }
    }

    /// The robot's cells are finer: the strongest obstacle under an output cell, or else the weakest
    /// free evidence, so that a thin wall does not fall between the samples.
    fn find_finer(&self, tile: Rect, map: &TileMap, bench: &mut Bench) {
        let n = self.samples;
        let mut near: (i64, i64, Option<&MapTile>) = (i64::MIN, i64::MIN, None);
        for ((x, y), cell) in tile.points().zip(bench.found.iter_mut()) {
            *cell = UNKNOWN;
            for sample in 0..n * n {
                let [dx, dy] = [sample % n, sample / n].map(|k| (k as f64 + 0.5) / n as f64);
                let [u, v] = self.place(x as f64 + dx, y as f64 + dy).map(|p| p.floor() as i64);
                let at = [u.div_euclid(TILE), v.div_euclid(TILE)];
                if (near.0, near.1) != (at[0], at[1]) {
                    near = (at[0], at[1], map.get(at[0], at[1]).map(|tile| &**tile));
                }
                let place = (v.rem_euclid(TILE) * TILE + u.rem_euclid(TILE)) as usize;
                let seen = near.2.map_or(UNKNOWN, |tile| tile.cells[place]);
                *cell = (*cell).max(seen); // UNKNOWN is the least of all
            }
        }
    }
}

impl Bench {
    /// Lays out the robot's cells in these rows, and in whole tiles of columns.
    fn lay_out(&mut self, map: &TileMap, cells: Rect) {
        let tiles = cells.tiles();
        for (x, y) in tiles.points() {
            let column = (x - tiles.x0) as usize * SIDE;
            let rows = cells.y0.max(y * TILE)..cells.y1.min((y + 1) * TILE);
            let tile = map.get(x, y);
            for row in rows {
                let start = (row - cells.y0) as usize * BENCH_WIDTH + column;
                let to: &mut [i8] = &mut self.cells[start..start + SIDE];
                match tile {
                    Some(tile) => {
                        let from = ((row - y * TILE) * TILE) as usize;
                        to.copy_from_slice(&tile.cells[from..from + SIDE]);
                    }
                    None => to.fill(UNKNOWN),
                }
            }
        }
    }
}

fn fixed(cells: f64) -> u32 {
    // Negative steps wrap, and wrap back when they are added to a place.
    (cells * f64::from(1_u32 << FRACTION_BITS)).round() as i64 as u32
}

/// Where a place lies on the bench.
fn on_bench(u: u32, v: u32) -> usize {
    const { assert!(BENCH_WIDTH == 1 << (u32::BITS - FRACTION_BITS)) };
    (((v >> FRACTION_BITS) as usize * BENCH_WIDTH) | (u >> FRACTION_BITS) as usize)
        % (BENCH_WIDTH * BENCH_HEIGHT)
}
