//! Occupancy grids. A cell is the evidence collected about a square of the floor, as log-odds:
//! evidence of several scans, or of several robots, is added (Elfes 1989; Thrun, Burgard, Fox,
//! "Probabilistic Robotics", 2005, eq. 9.7). What ROS calls occupancy is derived from it.

use crate::{Header, Monotonic, Pose2};
use bytemuck::{Pod, Zeroable};

/// A cell nobody has seen.
pub const UNKNOWN: i8 = i8::MIN;
/// The most certain occupied cell.
pub const LOG_ODDS_MAX: i8 = 127;
/// The most that beams can say for a cell being free: one step short of [`SWEPT_FREE`].
pub const LOG_ODDS_MIN: i8 = -126;
/// A cell that the robot's own body has covered. Nothing else stood there then, whatever others took the
/// robot itself for: it holds until the robot sees something there.
pub const SWEPT_FREE: i8 = -127;
/// Natural log-odds in one step of a cell: 127 steps are 6.35, a probability of 0.998.
pub const LOG_ODDS_PER_STEP: f64 = 0.05;
/// The most cells a robot's map may span: 4096 x 4096, 205 m x 205 m at 0.05 m.
pub const CELLS_MAX: usize = 4096 * 4096;
/// The most cells any map may span, such as that of a fleet: as a message it still fits into the 64 MiB
/// that clients of the bridge may expect of a frame.
pub const MAP_CELLS_MAX: usize = 15 << 22;

/// map_server's thresholds on the probability of occupation: above 0.65 occupied, below 0.25 free.
/// As log-odds: ln(0.65/0.35) = 0.619, ln(0.25/0.75) = -1.099.
pub const OCCUPIED_MIN: i8 = 13;
/// See [`OCCUPIED_MIN`].
pub const FREE_MAX: i8 = -22;

/// What a cell means to one who must decide.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Occupancy {
    /// Nobody has seen it, or the evidence does not decide.
    Unknown,
    /// Nothing stands there.
    Free,
    /// Something stands there.
    Occupied,
}

/// Trinary reading of a cell.
pub fn occupancy(cell: i8) -> Occupancy {
    match cell {
        UNKNOWN => Occupancy::Unknown,
        OCCUPIED_MIN.. => Occupancy::Occupied,
        -127..=FREE_MAX => Occupancy::Free,
        _ => Occupancy::Unknown,
    }
}

/// nav_msgs/OccupancyGrid's value of each cell, indexed by the cell's bits (`cell as u8`):
/// the probability of occupation in percent, -1 if unknown.
pub fn percent_table() -> [i8; 256] {
    core::array::from_fn(|bits| match bits as u8 as i8 {
        UNKNOWN => -1,
        cell => (100.0 / (1.0 + (-f64::from(cell) * LOG_ODDS_PER_STEP).exp())).round() as i8,
    })
}

/// Whose grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum GridFrame {
    /// One robot's loop-closed map, frame `robotK/map`.
    RobotMap = 1,
    /// The fleet's merged map, frame `map`.
    Map = 2,
}

/// Travels with the cells of a grid. Cells are row-major; row 0 is the lowest y.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct GridHeader {
    /// `stamp` is that of the newest scan drawn in.
    pub header: Header,
    /// When that scan left its simulator: what scan-to-map latency is counted from.
    pub scan_sent: Monotonic,
    /// Pose of the lower left corner of cell (0, 0) in the grid's frame.
    pub origin: Pose2,
    /// Side of a cell, metres.
    pub resolution_m: f64,
    /// Cells along the grid's x axis.
    pub width: u32,
    /// Cells along the grid's y axis.
    pub height: u32,
}

/// A borrowed grid.
#[derive(Clone, Copy, Debug)]
pub struct GridView<'a> {
    /// Its shape and place.
    pub header: &'a GridHeader,
    /// Row-major evidence, `width * height` cells.
    pub cells: &'a [i8],
}

impl<'a> GridView<'a> {
    /// `None` if the header's size is not the cells' or is over [`MAP_CELLS_MAX`], or the
    /// resolution or the origin is not a usable number.
    pub fn new(header: &'a GridHeader, cells: &'a [i8]) -> Option<Self> {
        let size = (header.width as usize).checked_mul(header.height as usize)?;
        let sound = size == cells.len()
            && size <= MAP_CELLS_MAX
            && header.resolution_m.is_finite()
            && header.resolution_m > 0.0
            && header.origin.is_finite();
        sound.then_some(Self { header, cells })
    }

    /// The cell in column `x`, row `y`; unknown outside.
    pub fn cell(&self, x: i64, y: i64) -> i8 {
        let inside =
            (0..i64::from(self.header.width)).contains(&x) && (0..i64::from(self.header.height)).contains(&y);
        if inside { self.cells[y as usize * self.header.width as usize + x as usize] } else { UNKNOWN }
    }

    /// The cell (column, row) under a point of the grid's frame, perhaps outside the grid.
    pub fn cell_of(&self, point_m: [f64; 2]) -> (i64, i64) {
        let [x, y] = self.header.origin.inverse().apply(point_m);
        ((x / self.header.resolution_m).floor() as i64, (y / self.header.resolution_m).floor() as i64)
    }

    /// The centre of the cell in column `x`, row `y`, in the grid's frame.
    pub fn centre_m(&self, x: i64, y: i64) -> [f64; 2] {
        let r = self.header.resolution_m;
        self.header.origin.apply([(x as f64 + 0.5) * r, (y as f64 + 0.5) * r])
    }

    /// An owned copy.
    pub fn to_owned(&self) -> Grid {
        Grid { header: *self.header, cells: self.cells.to_vec() }
    }
}

/// An owned grid.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Grid {
    /// Its shape and place.
    pub header: GridHeader,
    /// Row-major evidence, `width * height` cells.
    pub cells: Vec<i8>,
}

impl Grid {
    /// A borrowed grid. An empty one is sound.
    pub fn view(&self) -> GridView<'_> {
        GridView { header: &self.header, cells: &self.cells }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thresholds_are_map_servers() {
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
    fn where_a_robot_has_driven_is_free_and_beyond_what_beams_say() {
        assert_eq!(occupancy(SWEPT_FREE), Occupancy::Free);
        const { assert!(UNKNOWN < SWEPT_FREE && SWEPT_FREE < LOG_ODDS_MIN) };
        assert_eq!(percent_table()[SWEPT_FREE as u8 as usize], 0);
    }

    #[test]
    fn refuses_what_does_not_fit() {
        let header = GridHeader { resolution_m: 0.05, width: 3, height: 2, ..Default::default() };
        assert!(GridView::new(&header, &[0; 6]).is_some());
        assert!(GridView::new(&header, &[0; 5]).is_none());
        let huge = GridHeader { width: u32::MAX, height: u32::MAX, ..header };
        assert!(GridView::new(&huge, &[0; 6]).is_none());
        assert!(GridView::new(&GridHeader { resolution_m: f64::NAN, ..header }, &[0; 6]).is_none());
    }
}
