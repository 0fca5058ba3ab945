//! Occupancy grids whose cells hold log-odds.
//!
//! A cell collects the evidence about a square of the floor. Evidence of several scans, or of several
//! robots, is added (Elfes 1989; Thrun, Burgard, Fox, "Probabilistic Robotics", 2005, eq. 9.7). ROS's
//! occupancy values are derived from it by [`trinary_table`], or graded by [`percent_table`].
//!
//! [`occupancy`] alone says which cells are free, occupied and unknown: published maps, map files, statistics and
//! comparisons use it. Its thresholds are those of map_server's map_saver. SLAM Toolbox counts beams instead: it
//! publishes a cell once more than 2 beams reached it (`min_pass_through`), as occupied if more than 10 % of them
//! ended there (`occupancy_threshold`; Karto's `OccupancyGrid::UpdateCell`). With SLAM's default evidence a cell is
//! free here after 3 beams too, but more than a third of many beams must end in an occupied one.

use crate::{Header, Monotonic, Pose2};
use bytemuck::{Pod, Zeroable};

/// Value of a cell that no robot has seen.
pub const UNKNOWN: i8 = i8::MIN;
/// Value of the most certain occupied cell.
pub const LOG_ODDS_MAX: i8 = 127;
/// Value of the cell that beams show free most certainly: one step short of [`SWEPT_FREE`].
pub const LOG_ODDS_MIN: i8 = -126;
/// Value of a cell that the robot's own body has covered. Nothing else stood there at that time, even if
/// another robot saw an obstacle, which was this robot. It stays until the robot itself sees an obstacle there.
pub const SWEPT_FREE: i8 = -127;
/// Natural log-odds per step of a cell's value: 127 steps are 6.35, a probability of 0.998.
pub const LOG_ODDS_PER_STEP: f64 = 0.05;
/// Largest number of cells of a robot's map: 4096 x 4096, 205 m x 205 m at 0.05 m.
pub const CELLS_MAX: usize = 4096 * 4096;
/// Largest number of cells of any map, such as the fleet's. As a message it still fits into a frame of
/// 64 MiB, the limit of the bridge's clients.
pub const MAP_CELLS_MAX: usize = 15 << 22;

/// Smallest value of an occupied cell: map_saver's `occupied_thresh`, probability 0.65, ln(0.65/0.35) = 0.619.
pub const OCCUPIED_MIN: i8 = 13;
/// Largest value of a free cell: map_saver's `free_thresh`, probability 0.25, ln(0.25/0.75) = -1.099.
pub const FREE_MAX: i8 = -22;

/// Trinary state of a cell, as map_server defines it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Occupancy {
    /// The cell was not seen, or its evidence lies between the two thresholds.
    Unknown,
    /// The evidence says that the floor is free.
    Free,
    /// The evidence says that an obstacle stands there.
    Occupied,
}

/// Classifies a cell's value by map_server's thresholds.
pub fn occupancy(cell: i8) -> Occupancy {
    match cell {
        UNKNOWN => Occupancy::Unknown,
        OCCUPIED_MIN.. => Occupancy::Occupied,
        -127..=FREE_MAX => Occupancy::Free,
        _ => Occupancy::Unknown,
    }
}

/// Returns how many cells are not [`UNKNOWN`].
pub fn known_count(cells: &[i8]) -> usize {
    // A byte holds the count of 255 cells, and many bytes are added in one instruction.
    let count = |part: &[i8]| part.iter().map(|cell| u8::from(*cell != UNKNOWN)).sum::<u8>();
    cells.chunks(usize::from(u8::MAX)).map(|part| usize::from(count(part))).sum()
}

/// Returns nav_msgs/OccupancyGrid's trinary value for each cell value, indexed by the cell's bits (`cell as u8`).
///
/// A value is 0 for free, 100 for occupied and -1 for unknown, as SLAM Toolbox and map_server publish maps.
pub fn trinary_table() -> [i8; 256] {
    core::array::from_fn(|bits| match occupancy(bits as u8 as i8) {
        Occupancy::Unknown => -1,
        Occupancy::Free => 0,
        Occupancy::Occupied => 100,
    })
}

/// Returns nav_msgs/OccupancyGrid's graded value for each cell value, indexed by the cell's bits (`cell as u8`).
///
/// A value is the probability of occupation in percent, or -1 for a cell that no robot has seen.
pub fn percent_table() -> [i8; 256] {
    core::array::from_fn(|bits| match bits as u8 as i8 {
        UNKNOWN => -1,
        cell => (100.0 / (1.0 + (-f64::from(cell) * LOG_ODDS_PER_STEP).exp())).round() as i8,
    })
}

/// Size, resolution and pose of a grid. Cells are row-major; row 0 has the lowest y.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct GridHeader {
    /// Header whose `stamp` is that of the newest scan in the map.
    pub header: Header,
    /// Time at which that scan left its simulator. Scan-to-map latency is counted from it.
    pub scan_sent: Monotonic,
    /// Pose of the lower left corner of cell (0, 0) in the grid's frame.
    pub origin: Pose2,
    /// Length of a cell's side, metres.
    pub resolution_m: f64,
    /// Number of cells along the grid's x axis.
    pub width: u32,
    /// Number of cells along the grid's y axis.
    pub height: u32,
}

/// A borrowed occupancy grid.
#[derive(Clone, Copy, Debug)]
pub struct GridView<'a> {
    /// Size, resolution and pose of the grid.
    pub header: &'a GridHeader,
    /// Row-major cells, `width * height` of them.
    pub cells: &'a [i8],
}

impl<'a> GridView<'a> {
    /// Borrows a grid and checks it. `None` if the header's size is not that of `cells` or exceeds
    /// [`MAP_CELLS_MAX`], or if the resolution or the origin is not a usable number.
    pub fn new(header: &'a GridHeader, cells: &'a [i8]) -> Option<Self> {
        let size = (header.width as usize).checked_mul(header.height as usize)?;
        let valid = size == cells.len()
            && size <= MAP_CELLS_MAX
            && header.resolution_m.is_finite()
            && header.resolution_m > 0.0
            && header.origin.is_finite();
        valid.then_some(Self { header, cells })
    }

    /// Returns the cell in column `x`, row `y`; [`UNKNOWN`] outside of the grid.
    pub fn cell(&self, x: i64, y: i64) -> i8 {
        let inside =
            (0..i64::from(self.header.width)).contains(&x) && (0..i64::from(self.header.height)).contains(&y);
        if inside { self.cells[y as usize * self.header.width as usize + x as usize] } else { UNKNOWN }
    }

    /// Returns the cell (column, row) under a point of the grid's frame. It may lie outside of the grid.
    pub fn cell_of(&self, point_m: [f64; 2]) -> (i64, i64) {
        let [x, y] = self.header.origin.inverse().apply(point_m);
        ((x / self.header.resolution_m).floor() as i64, (y / self.header.resolution_m).floor() as i64)
    }

    /// Returns the centre of the cell in column `x`, row `y`, in the grid's frame, metres.
    pub fn centre_m(&self, x: i64, y: i64) -> [f64; 2] {
        let r = self.header.resolution_m;
        self.header.origin.apply([(x as f64 + 0.5) * r, (y as f64 + 0.5) * r])
    }

    /// Copies the grid and its cells.
    pub fn to_owned(&self) -> Grid {
        Grid { header: *self.header, cells: self.cells.to_vec() }
    }
}

/// An owned occupancy grid.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Grid {
    /// Size, resolution and pose of the grid.
    pub header: GridHeader,
    /// Row-major cells, `width * height` of them.
    pub cells: Vec<i8>,
}

impl Grid {
    /// Borrows the grid without a check. The cells must fit the header; an empty grid is valid.
    pub fn view(&self) -> GridView<'_> {
        GridView { header: &self.header, cells: &self.cells }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn occupancy_uses_the_thresholds_of_map_server() {
        let percent = percent_table();
        for cell in -127..=127_i8 {
            let p = f64::from(percent[cell as u8 as usize]);
            match occupancy(cell) {
                Occupancy::Occupied => assert!(p >= 65.0, "{cell}: {p}"),
                Occupancy::Free => assert!(p <= 25.0, "{cell}: {p}"),
                Occupancy::Unknown => assert!((25.0..=65.0).contains(&p), "{cell}: {p}"),
            }
        }
        assert_eq!(percent[UNKNOWN as u8 as usize], -1);
        assert_eq!(percent[0], 50);
        assert_eq!(percent[LOG_ODDS_MAX as u8 as usize], 100);
    }

    #[test]
    fn trinary_values_are_those_of_the_occupancy() {
        let trinary = trinary_table();
        let of = |cell: i8| trinary[cell as u8 as usize];
        assert_eq!([UNKNOWN, SWEPT_FREE, LOG_ODDS_MIN, FREE_MAX].map(of), [-1, 0, 0, 0]);
        assert_eq!([FREE_MAX + 1, 0, OCCUPIED_MIN - 1].map(of), [-1; 3], "evidence that decides nothing");
        assert_eq!([OCCUPIED_MIN, LOG_ODDS_MAX].map(of), [100; 2]);
    }

    #[test]
    fn swept_cells_are_free_and_more_certain_than_beams_make_them() {
        assert_eq!(occupancy(SWEPT_FREE), Occupancy::Free);
        const { assert!(UNKNOWN < SWEPT_FREE && SWEPT_FREE < LOG_ODDS_MIN) };
        assert_eq!(percent_table()[SWEPT_FREE as u8 as usize], 0);
    }

    #[test]
    fn a_view_refuses_cells_that_do_not_fit_the_header() {
        let header = GridHeader { resolution_m: 0.05, width: 3, height: 2, ..Default::default() };
        assert!(GridView::new(&header, &[0; 6]).is_some());
        assert!(GridView::new(&header, &[0; 5]).is_none());
        let huge = GridHeader { width: u32::MAX, height: u32::MAX, ..header };
        assert!(GridView::new(&huge, &[0; 6]).is_none());
        assert!(GridView::new(&GridHeader { resolution_m: f64::NAN, ..header }, &[0; 6]).is_none());
    }
}
