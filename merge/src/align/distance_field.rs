//! Distance field of one map: distance to the nearest wall, floor, and the side from which each wall was seen.

use super::points::MapPoints;
use super::translation::COARSE_CELL_M;
use crate::config::WallConfig;
use msg::GridView;
use msg::grid::{Occupancy, occupancy};

/// Largest distance in a field, metres: farther walls do not attract.
pub(super) const REACH_M: f64 = 0.8;
/// Most cells of a field; larger maps get coarser ones.
const CELLS_MAX: usize = 2048 * 2048;
/// Least [`WallConfig::match_m`], cells: a wall's place is rounded to a cell.
const MATCH_CELLS_MIN: f32 = 1.5;
/// Least [`WallConfig::conflict_m`], cells, for the same reason.
const CONFLICT_CELLS_MIN: f32 = 2.5;
/// Least [`WallConfig::side_m`], cells: fewer do not tell a side from the other.
const SIDE_CELLS_MIN: usize = 3;
/// Weight of a step to a cell that shares a side, cells (Borgefors 1986).
const SIDE: f32 = 0.955;
/// Weight of a step to a cell that shares a corner, cells.
const DIAGONAL: f32 = 1.3693;

/// Distance to the nearest wall of one map, in the centred frame of its points.
pub(crate) struct DistanceField {
    /// The map's own walls and floor.
    pub points: MapPoints,
    /// [`DistanceField::floor_side`] of each wall point.
    pub wall_sides: Vec<[f32; 2]>,
    /// Distance to the nearest wall in cells, at most [`REACH_M`]; row-major.
    pub distance: Vec<f32>,
    /// Whether a cell is floor; row-major.
    pub floor: Vec<bool>,
    /// Summed-area table of `floor`, one row and one column larger.
    floor_sums: Vec<u32>,
    /// Number of columns, the length of a row in `distance` and `floor`.
    pub width: usize,
    /// Number of rows in `distance` and `floor`.
    pub height: usize,
    /// Side of a cell, metres.
    pub cell_m: f64,
    /// Largest distance of matching walls, cells.
    pub match_cells: f32,
    /// Least distance to the walls of a contradicted wall, cells.
    pub conflict_cells: f32,
    /// Half the side of the square in which a wall's floor is counted, cells.
    side_cells: usize,
    /// Lower left corner in the centred frame.
    corner_m: [f64; 2],
}

impl DistanceField {
    /// Computes the field of a map.
    pub fn of_map(map: GridView<'_>, config: &WallConfig) -> Self {
        Self::new(MapPoints::from_grid(map, COARSE_CELL_M), map, config)
    }

    /// Computes the field of a grid with these points.
    pub fn new(points: MapPoints, grid: GridView<'_>, config: &WallConfig) -> Self {
        let margin_m = REACH_M;
        let span_m = 2.0 * (points.radius_m + margin_m);
        let cell_m = grid.header.resolution_m.max(span_m / (CELLS_MAX as f64).sqrt());
        let hull = bounding_box_m(&points.walls_m);
        // On the grid's own lattice: its cells are the field's, and nothing shifts by part of a cell.
        let corner_m = [hull[0] - margin_m, hull[1] - margin_m].map(|m| (m / cell_m).floor() * cell_m);
        let size = |k: usize| ((hull[k + 2] - corner_m[k] + margin_m) / cell_m).ceil() as usize + 1;
        let (width, height) = (size(0), size(1));
        let reach = (REACH_M / cell_m) as f32;
        let mut field = Self {
            points,
            wall_sides: Vec::new(),
            distance: vec![reach; width * height],
            floor: vec![false; width * height],
            floor_sums: Vec::new(),
            width,
            height,
            cell_m,
            match_cells: ((config.match_m / cell_m) as f32).max(MATCH_CELLS_MIN),
            conflict_cells: ((config.conflict_m / cell_m) as f32).max(CONFLICT_CELLS_MIN),
            side_cells: ((config.side_m / cell_m).round() as usize).max(SIDE_CELLS_MIN),
            corner_m,
        };
        for [x, y] in &field.points.walls_m {
            let [u, v] = field.to_cells([f64::from(*x), f64::from(*y)]);
            field.distance[v as usize * width + u as usize] = 0.0;
        }
        propagate_distances(&mut field.distance, width);
        field.mark_floor(grid);
        field.sum_floor();
        field.wall_sides = field.own_wall_sides();
        field
    }

    /// Converts a point of the centred frame, metres, to cells of the field.
    pub fn to_cells(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [(x - self.corner_m[0]) / self.cell_m, (y - self.corner_m[1]) / self.cell_m]
    }

    fn mark_floor(&mut self, grid: GridView<'_>) {
        let r = grid.header.resolution_m;
        // The centred frame has the grid's axes: only a shift lies between them.
        let from_corner = self.points.frame_from_centred.inverse() * grid.header.origin;
        let start = self.to_cells([from_corner.x_m + 0.5 * r, from_corner.y_m + 0.5 * r]);
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
            let floor = &mut self.floor[v as usize * self.width..][..self.width];
            for (u, cell) in columns.iter().zip(row) {
                if let Some(floor) = floor.get_mut(*u) {
                    *floor |= occupancy(*cell) == Occupancy::Free;
                }
            }
        }
    }

    fn sum_floor(&mut self) {
        let stride = self.width + 1;
        self.floor_sums = vec![0; stride * (self.height + 1)];
        for y in 0..self.height {
            let mut row = 0;
            for x in 0..self.width {
                row += u32::from(self.floor[y * self.width + x]);
                self.floor_sums[(y + 1) * stride + x + 1] = self.floor_sums[y * stride + x + 1] + row;
            }
        }
    }

    /// Direction from a cell towards the floor around it, -1 to 1 along x and y.
    ///
    /// A wall was seen from there. It is near zero for a wall that was seen from both sides.
    pub fn floor_side(&self, x: usize, y: usize) -> [f64; 2] {
        let side = self.side_cells;
        let (x0, x1) = (x.saturating_sub(side), (x + side + 1).min(self.width));
        let (y0, y1) = (y.saturating_sub(side), (y + side + 1).min(self.height));
        let stride = self.width + 1;
        let at = |x: usize, y: usize| i64::from(self.floor_sums[y * stride + x]);
        let floor =
            |x0: usize, y0: usize, x1: usize, y1: usize| at(x1, y1) + at(x0, y0) - at(x0, y1) - at(x1, y0);
        let half = (side * (2 * side + 1)) as f64;
        let across = floor(x + 1, y0, x1, y1) - floor(x0, y0, x, y1);
        let along = floor(x0, y + 1, x1, y1) - floor(x0, y0, x1, y);
        [across as f64 / half, along as f64 / half]
    }

    fn own_wall_sides(&self) -> Vec<[f32; 2]> {
        let side = |[x, y]: &[f32; 2]| {
            let [u, v] = self.to_cells([f64::from(*x), f64::from(*y)]);
            self.floor_side(u as usize, v as usize).map(|s| s as f32)
        };
        self.points.walls_m.iter().map(side).collect()
    }

    /// Distance (cells) and its gradient at a place in cells, interpolated between cell centres; `None` outside.
    pub fn distance_and_gradient(&self, [u, v]: [f64; 2]) -> Option<(f64, [f64; 2])> {
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

/// Propagates distances in two sweeps of a chamfer (Borgefors, "Distance transformations in digital images", 1986):
/// within 4 % of the Euclidean distance. `width`: cells of a row, at least one.
fn propagate_distances(distances: &mut [f32], width: usize) {
    let mut before: Option<&mut [f32]> = None;
    for row in distances.chunks_exact_mut(width) {
        before.into_iter().for_each(|before| propagate_from_row(row, before));
        propagate_along(row.iter_mut());
        before = Some(row);
    }
    let mut before: Option<&mut [f32]> = None;
    for row in distances.chunks_exact_mut(width).rev() {
        before.into_iter().for_each(|before| propagate_from_row(row, before));
        propagate_along(row.iter_mut().rev());
        before = Some(row);
    }
}

/// Distances of a row from those of the row before it.
fn propagate_from_row(row: &mut [f32], before: &[f32]) {
    let nearer = |distance: &mut f32, other: f32| {
        if other < *distance {
            *distance = other;
        }
    };
    // One neighbour at a time, so that the compiler vectorises it.
    row.iter_mut().zip(before).for_each(|(distance, below)| nearer(distance, below + SIDE));
    row.iter_mut().skip(1).zip(before).for_each(|(distance, left)| nearer(distance, left + DIAGONAL));
    row.iter_mut().zip(&before[1..]).for_each(|(distance, right)| nearer(distance, right + DIAGONAL));
}

/// Distances of a row along itself.
fn propagate_along<'a>(row: impl Iterator<Item = &'a mut f32>) {
    let mut before = f32::INFINITY;
    for distance in row {
        *distance = if before + SIDE < *distance { before + SIDE } else { *distance };
        before = *distance;
    }
}

/// Least x and y, greatest x and y.
fn bounding_box_m(points: &[[f32; 2]]) -> [f64; 4] {
    let start = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    let hull = points.iter().fold(start, |hull, [x, y]| {
        let (x, y) = (f64::from(*x), f64::from(*y));
        [hull[0].min(x), hull[1].min(y), hull[2].max(x), hull[3].max(y)]
    });
    if hull[0] <= hull[2] { hull } else { [0.0; 4] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The least way to any wall, step by step until no distance changes.
    fn least_ways(walls: &[bool], width: usize, reach: f32) -> Vec<f32> {
        let height = walls.len() / width;
        let mut ways: Vec<f32> = walls.iter().map(|wall| if *wall { 0.0 } else { reach }).collect();
        loop {
            let before = ways.clone();
            for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
                let rows = y.saturating_sub(1)..(y + 2).min(height);
                for (v, u) in
                    rows.flat_map(|v| (x.saturating_sub(1)..(x + 2).min(width)).map(move |u| (v, u)))
                {
                    let step = if u != x && v != y { DIAGONAL } else { SIDE };
                    ways[y * width + x] = ways[y * width + x].min(before[v * width + u] + step);
                }
            }
            if ways == before {
                return ways;
            }
        }
    }

    proptest! {
        #[test]
        fn two_sweeps_find_the_least_ways(
            width in 1_usize..12,
            rows in 1_usize..10,
            seeds in prop::collection::vec(0_u8..6, 120),
        ) {
            let walls: Vec<bool> = seeds[..width * rows].iter().map(|seed| *seed == 0).collect();
            let mut distances: Vec<f32> = walls.iter().map(|wall| if *wall { 0.0 } else { 16.0 }).collect();
            propagate_distances(&mut distances, width);
            for (found, least) in distances.iter().zip(least_ways(&walls, width, 16.0)) {
                // Sums of the same steps in another order.
                prop_assert!((found - least).abs() < 1e-4, "{distances:?}");
            }
        }
    }
}
