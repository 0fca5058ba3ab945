//! A grid's walls and floor as points, for matching.

use msg::grid::{Occupancy, occupancy};
use msg::{GridView, Pose2};

/// Most wall points of a map: more occupied cells are thinned evenly.
const WALL_POINTS_MAX: usize = 60_000;
/// Most floor points of a map: with more the squares are larger.
const FLOOR_POINTS_MAX: usize = 1 << 20;

/// A grid's walls and floor as points, metres, along the grid's own axes.
///
/// Their frame is centred: its origin is the corner of a cell in the middle of what is known.
pub(crate) struct MapPoints {
    /// The grid's frame from the centred frame.
    pub frame_from_centred: Pose2,
    /// Centres of occupied cells.
    pub walls_m: Vec<[f32; 2]>,
    /// Length of wall that a point stands for, metres.
    pub wall_point_m: f64,
    /// Centres of squares that hold mostly floor and no wall.
    pub floor_m: Vec<[f32; 2]>,
    /// Least and greatest x and y of the points, metres.
    pub bounds_m: [[f64; 2]; 2],
    /// Distance of the farthest point from the origin, metres.
    pub radius_m: f64,
}

impl MapPoints {
    /// Extracts the points of a grid; floor in squares of about `floor_square_m`.
    pub fn from_grid(grid: GridView<'_>, floor_square_m: f64) -> Self {
        let resolution = grid.header.resolution_m;
        let least = (grid.cells.len() as f64 / FLOOR_POINTS_MAX as f64).sqrt().ceil() as usize;
        let block = ((floor_square_m / resolution).round() as usize).max(least).max(1);
        let total = grid.cells.iter().filter(|cell| occupancy(**cell) == Occupancy::Occupied).count();
        let keep = total.div_ceil(WALL_POINTS_MAX).max(1);
        let mut seen = 0;
        let (width, height) = (grid.header.width as usize, grid.header.height as usize);
        let mut walls = Vec::new();
        let mut floor = Vec::new();
        let mut free = vec![0_u32; width.div_ceil(block)];
        let mut blocked = vec![false; free.len()];
        for (y, row) in grid.cells.chunks_exact(width.max(1)).enumerate() {
            for (x, cell) in row.iter().enumerate() {
                match occupancy(*cell) {
                    Occupancy::Free => free[x / block] += 1,
                    Occupancy::Occupied => {
                        blocked[x / block] = true;
                        if seen % keep == 0 {
                            walls.push([x as f64 + 0.5, y as f64 + 0.5]);
                        }
                        seen += 1;
                    }
                    Occupancy::Unknown => {}
                }
            }
            if (y + 1) % block == 0 || y + 1 == height {
                let middle = (y / block * block) as f64 + block as f64 / 2.0;
                let enough = (block * block).div_ceil(2) as u32;
                let squares = free.iter().zip(&blocked).enumerate();
                let empty = squares.filter(|(_, (free, blocked))| **free >= enough && !**blocked);
                floor.extend(empty.map(|(x, _)| [(x * block) as f64 + block as f64 / 2.0, middle]));
                free.fill(0);
                blocked.fill(false);
            }
        }
        Self { wall_point_m: keep as f64 * resolution, ..Self::centred(&walls, &floor, grid) }
    }

    /// Converts points in cells of the grid.
    fn centred(walls: &[[f64; 2]], floor: &[[f64; 2]], grid: GridView<'_>) -> Self {
        let mut hull = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
        for [x, y] in walls.iter().chain(floor) {
            hull = [hull[0].min(*x), hull[1].min(*y), hull[2].max(*x), hull[3].max(*y)];
        }
        let known = hull[0] <= hull[2];
        // A corner of a cell: points lie half cells from it.
        let centre = if known { [0, 1].map(|k| ((hull[k] + hull[k + 2]) / 2.0).round()) } else { [0.0; 2] };
        let resolution = grid.header.resolution_m;
        let centred = |[x, y]: &[f64; 2]| {
            [(x - centre[0]) * resolution, (y - centre[1]) * resolution].map(|m| m as f32)
        };
        let walls_m: Vec<_> = walls.iter().map(centred).collect();
        let floor_m: Vec<_> = floor.iter().map(centred).collect();
        let radius = |points: &[[f32; 2]]| points.iter().fold(0.0_f32, |r, [x, y]| r.max(x.hypot(*y)));
        let radius_m = radius(&walls_m).max(radius(&floor_m)).into();
        let to_centre = Pose2::new(centre[0] * resolution, centre[1] * resolution, 0.0);
        let bounds_m = [0, 1].map(|end| {
            [0, 1].map(|k| if known { (hull[2 * end + k] - centre[k]) * resolution } else { 0.0 })
        });
        let frame_from_centred = grid.header.origin * to_centre;
        Self { frame_from_centred, bounds_m, walls_m, wall_point_m: resolution, floor_m, radius_m }
    }
}
