//! Resampling of one robot's map on the lattice of the merged map, tile by tile.

use msg::grid::UNKNOWN;
use msg::tiles::{TILE, TILE_CELLS};
use msg::{IndexRect, MapTile, Pose2, TileMap};

/// Added to every input coordinate, in cells: an output centre on the border of two input cells always takes the same
/// one, whatever the last bit of a sine is.
const BORDER_BIAS_CELLS: f64 = 1e-6;
/// Rounding allowed for the corners of a bounding box, in cells.
const BOX_SLACK_CELLS: f64 = 1e-3;
/// Most samples along one side of an output cell: more would take longer than they help.
const SAMPLES_MAX: usize = 16;
/// Direction cosines this near to a whole number are rounded to it, so that quarter turns are exact.
const COSINE_ROUNDING: f64 = 1e-9;
/// Fractional bits of a coordinate in the buffer. With 8 bits before them a coordinate fits into 32 bits, and is off by
/// less than a millionth of a cell at the end of a row.
const FRACTION_BITS: u32 = 24;
/// Columns of the buffer, a power of two: four tiles, of which a rotated tile touches three.
const BUFFER_WIDTH: usize = 4 * SIDE;
/// Rows of the buffer, a power of two: a rotated tile spans 91.
const BUFFER_HEIGHT: usize = 128;
/// Cells along a tile's side.
const SIDE: usize = TILE as usize;

/// Maps the lattice of the merged map to the cells of one robot's map.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Resampler {
    /// Input coordinates, in cells, of the lattice's point (0, 0), and their change per lattice cell.
    start: [f64; 2],
    per_x: [f64; 2],
    per_y: [f64; 2],
    /// Samples along a side of an output cell: more than one where the robot's cells are finer.
    samples: usize,
    /// Steps from a row's first input coordinate to each of a tile's columns, in 2^-24 cells.
    steps: [[u32; SIDE]; 2],
}

/// Working memory of [`Resampler::resample_tile`], reused from tile to tile.
pub(crate) struct ResampleBuffer {
    cells: Box<[i8; BUFFER_WIDTH * BUFFER_HEIGHT]>,
    /// The resampled tile.
    pub tile: Box<[i8; TILE_CELLS]>,
}

impl Default for ResampleBuffer {
    fn default() -> Self {
        let cells = Box::new([UNKNOWN; BUFFER_WIDTH * BUFFER_HEIGHT]);
        Self { cells, tile: Box::new([UNKNOWN; TILE_CELLS]) }
    }
}

impl Resampler {
    /// `map_from_cells`: the merged map's frame from the lattice of the robot's map.
    pub fn new(map_from_cells: Pose2, robot_resolution_m: f64, lattice_resolution_m: f64) -> Self {
        let inverse = map_from_cells.inverse();
        let (sin, cos) = inverse.yaw_rad.sin_cos();
        let step = lattice_resolution_m / robot_resolution_m;
        let snap =
            |value: f64| if (value - value.round()).abs() < COSINE_ROUNDING { value.round() } else { value };
        let per_x = [snap(cos * step), snap(sin * step)];
        Self {
            start: [inverse.x_m / robot_resolution_m, inverse.y_m / robot_resolution_m],
            per_x,
            per_y: [snap(-sin * step), snap(cos * step)],
            samples: ((step - BORDER_BIAS_CELLS).ceil() as usize).clamp(1, SAMPLES_MAX),
            steps: per_x.map(|step| core::array::from_fn(|x| fixed(step * x as f64))),
        }
    }

    /// Input coordinates, in cells, of a point of the lattice.
    fn input_at(&self, x: f64, y: f64) -> [f64; 2] {
        [0, 1].map(|k| self.start[k] + self.per_x[k] * x + self.per_y[k] * y + BORDER_BIAS_CELLS)
    }

    /// Bounding box of all lattice cells that read the robot's `cells`.
    pub fn lattice_cells(&self, cells: IndexRect) -> IndexRect {
        if cells.is_empty() {
            return IndexRect::default();
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
        // A cell reads the robot's cells if its centre is in the hull or, where it has several samples, any part of it.
        let inset = if self.samples == 1 { 0.5 } else { 0.0 };
        let first =
            |least: f64| (least - inset - BOX_SLACK_CELLS).ceil() as i64 - i64::from(self.samples > 1);
        let end = |most: f64| (most - inset + BOX_SLACK_CELLS).floor() as i64 + 1;
        IndexRect { x0: first(hull[0]), y0: first(hull[1]), x1: end(hull[2]), y1: end(hull[3]) }
    }

    /// Bounding box of the robot's cells that a tile of the lattice reads.
    fn cells_under(&self, tile: IndexRect) -> IndexRect {
        let [x0, y0, x1, y1] = [tile.x0, tile.y0, tile.x1, tile.y1].map(|v| v as f64);
        let corners = [[x0, y0], [x1, y0], [x0, y1], [x1, y1]].map(|[x, y]| self.input_at(x, y));
        let [mut low, mut high] = [corners[0]; 2];
        for corner in corners {
            for k in 0..2 {
                (low[k], high[k]) = (low[k].min(corner[k]), high[k].max(corner[k]));
            }
        }
        let (low, high) = (low.map(|v| v.floor() as i64), high.map(|v| v.floor() as i64 + 1));
        IndexRect { x0: low[0], y0: low[1], x1: high[0], y1: high[1] }
    }

    /// Resamples one tile of the lattice into `buffer.tile`. False if nothing is known anywhere near it.
    pub fn resample_tile(&self, x: i64, y: i64, map: &TileMap, buffer: &mut ResampleBuffer) -> bool {
        let tile = IndexRect::cells_of_tile(x, y);
        let under = self.cells_under(tile);
        if !under.tiles().points().any(|(x, y)| map.get(x, y).is_some()) {
            return false;
        }
        let fits = under.tiles().width() * SIDE <= BUFFER_WIDTH && under.height() <= BUFFER_HEIGHT;
        if self.samples == 1 && fits {
            buffer.load(map, under);
            self.resample_nearest(tile, under, buffer);
        } else {
            self.resample_finer(tile, map, buffer);
        }
        true
    }

    /// Takes the nearest input cell at every output centre: no rotation leaves holes.
    fn resample_nearest(&self, tile: IndexRect, under: IndexRect, buffer: &mut ResampleBuffer) {
        let corner = [(under.tiles().x0 * TILE) as f64, under.y0 as f64];
        let is_translation = self.per_x == [1.0, 0.0];
        let [steps_u, steps_v] = &self.steps;
        for (row, y) in buffer.tile.as_chunks_mut::<SIDE>().0.iter_mut().zip(tile.y0..) {
            let input = self.input_at(tile.x0 as f64 + 0.5, y as f64 + 0.5);
            let [u, v] = [0, 1].map(|k| fixed(input[k] - corner[k]));
            if is_translation {
                let start = buffer_index(u, v).min(BUFFER_WIDTH * BUFFER_HEIGHT - SIDE);
                row.copy_from_slice(&buffer.cells[start..start + SIDE]);
                continue;
            }
            // Two passes, because the compiler vectorises the first.
            let mut indices = [0_u32; SIDE];
            for ((index, du), dv) in indices.iter_mut().zip(steps_u).zip(steps_v) {
                *index = buffer_index(u.wrapping_add(*du), v.wrapping_add(*dv)) as u32;
            }
            for (cell, index) in row.iter_mut().zip(&indices) {
                *cell = buffer.cells[*index as usize % (BUFFER_WIDTH * BUFFER_HEIGHT)];
            }
        }
    }

    /// Takes the largest of several samples of finer input cells: the surest obstacle, or else the least sure free
    /// space. A thin wall does not fall between the samples.
    fn resample_finer(&self, tile: IndexRect, map: &TileMap, buffer: &mut ResampleBuffer) {
        let n = self.samples;
        let mut newest: (i64, i64, Option<&MapTile>) = (i64::MIN, i64::MIN, None);
        for ((x, y), cell) in tile.points().zip(buffer.tile.iter_mut()) {
            *cell = UNKNOWN;
            for sample in 0..n * n {
                let [dx, dy] = [sample % n, sample / n].map(|k| (k as f64 + 0.5) / n as f64);
                let [u, v] = self.input_at(x as f64 + dx, y as f64 + dy).map(|p| p.floor() as i64);
                let at = [u.div_euclid(TILE), v.div_euclid(TILE)];
                if (newest.0, newest.1) != (at[0], at[1]) {
                    newest = (at[0], at[1], map.get(at[0], at[1]).map(|tile| &**tile));
                }
                let index = (v.rem_euclid(TILE) * TILE + u.rem_euclid(TILE)) as usize;
                let seen = newest.2.map_or(UNKNOWN, |tile| tile.cells[index]);
                *cell = (*cell).max(seen); // UNKNOWN is the least value of all
            }
        }
    }
}

impl ResampleBuffer {
    /// Copies the robot's cells of these rows, and of whole tiles of columns, into the buffer.
    fn load(&mut self, map: &TileMap, cells: IndexRect) {
        let tiles = cells.tiles();
        for (x, y) in tiles.points() {
            let column = (x - tiles.x0) as usize * SIDE;
            let rows = cells.y0.max(y * TILE)..cells.y1.min((y + 1) * TILE);
            let tile = map.get(x, y);
            for row in rows {
                let start = (row - cells.y0) as usize * BUFFER_WIDTH + column;
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

/// A coordinate in fixed point.
fn fixed(cells: f64) -> u32 {
    // Negative steps wrap, and wrap back when they are added to a coordinate.
    (cells * f64::from(1_u32 << FRACTION_BITS)).round() as i64 as u32
}

/// Index of the buffer's cell at fixed-point coordinates.
fn buffer_index(u: u32, v: u32) -> usize {
    const { assert!(BUFFER_WIDTH == 1 << (u32::BITS - FRACTION_BITS)) };
    (((v >> FRACTION_BITS) as usize * BUFFER_WIDTH) | (u >> FRACTION_BITS) as usize)
        % (BUFFER_WIDTH * BUFFER_HEIGHT)
}
