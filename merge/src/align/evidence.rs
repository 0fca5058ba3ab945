//! What of a grid is worth matching: its walls and its floor, as points.

use msg::grid::{Occupancy, occupancy};
use msg::{GridView, Pose2};

/// The most occupied cells that are matched: more are thinned evenly.
pub(crate) const WALL_POINTS_MAX: usize = 60_000;

/// A grid's content relative to a point in its middle, metres, in the axes of its frame.
pub(crate) struct Evidence {
    /// Where the points are counted from, in the grid's frame.
    pub middle_m: [f64; 2],
    /// Centres of occupied cells.
    pub walls_m: Vec<[f32; 2]>,
    /// Centres of squares of [`Evidence::floor_square_m`] with nothing but floor.
    pub floor_m: Vec<[f32; 2]>,
    /// Distance of the farthest point from the middle, metres.
    pub radius_m: f64,
}

impl Evidence {
    /// Reads a grid; floor in squares of about `floor_square_m`.
    pub fn of(grid: GridView<'_>, floor_square_m: f64) -> Self {
        let resolution = grid.header.resolution_m;
        let block = ((floor_square_m / resolution).round() as usize).max(1);
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
                        walls.push([x as f64 + 0.5, y as f64 + 0.5]);
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
        Self::about_middle(walls, floor, |cells| grid.header.origin.apply(cells.map(|c| c * resolution)))
    }

    fn about_middle(
        walls: Vec<[f64; 2]>,
        floor: Vec<[f64; 2]>,
        place: impl Fn([f64; 2]) -> [f64; 2],
    ) -> Self {
        let keep = walls.len().div_ceil(WALL_POINTS_MAX).max(1);
        let walls: Vec<_> = walls.into_iter().step_by(keep).map(&place).collect();
        let floor: Vec<_> = floor.into_iter().map(&place).collect();
        let mut hull = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
        for [x, y] in walls.iter().chain(&floor) {
            hull = [hull[0].min(*x), hull[1].min(*y), hull[2].max(*x), hull[3].max(*y)];
        }
        let middle_m = if hull[0] <= hull[2] {
            [(hull[0] + hull[2]) / 2.0, (hull[1] + hull[3]) / 2.0]
        } else {
            [0.0; 2]
        };
        let about = |[x, y]: &[f64; 2]| [(x - middle_m[0]) as f32, (y - middle_m[1]) as f32];
        let (walls_m, floor_m) =
            (walls.iter().map(about).collect::<Vec<_>>(), floor.iter().map(about).collect::<Vec<_>>());
        let radius = |points: &[[f32; 2]]| points.iter().fold(0.0_f32, |r, [x, y]| r.max(x.hypot(*y)));
        let radius_m = radius(&walls_m).max(radius(&floor_m)).into();
        Self { middle_m, walls_m, floor_m, radius_m }
    }

    /// From the points' frame to the grid's.
    pub fn grid_from_middle(&self) -> Pose2 {
        Pose2::new(self.middle_m[0], self.middle_m[1], 0.0)
    }
}
