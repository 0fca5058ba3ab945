//! Observations for planners, with the map, the robots in it and their newest scans.
//!
//! All views borrow, so that they can be laid over ROS messages and over `msg` types alike.

use msg::grid::{self, CELLS_MAX, Occupancy};
use msg::{GridView, Pose2, RobotId, Stamp, pose::wrap_angle};

/// Angle from which a sensor sees all around, so that no heading matters, radians: 354 degrees.
pub(crate) const ALL_AROUND_RAD: f64 = core::f64::consts::TAU - 0.1;

/// Pose of the LiDAR on a TurtleBot3 Burger (ROBOTIS's URDF: 32 mm behind the axis of the wheels).
pub const BURGER_BASE_FROM_SCAN: Pose2 = Pose2::new(-0.032, 0.0, 0.0);
/// Cells of a nav_msgs/OccupancyGrid up to this percentage are free (map_server: `free_thresh` 0.25).
pub const FREE_PERCENT_MAX: i8 = 25;
/// Cells of a nav_msgs/OccupancyGrid from this percentage on are occupied (map_server: `occupied_thresh` 0.65).
pub const OCCUPIED_PERCENT_MIN: i8 = 66;
/// Resolutions accepted, metres: finer or coarser ones come from a broken message.
const RESOLUTION_M: core::ops::RangeInclusive<f64> = 0.001..=10.0;

/// Meaning of the numbers in a map's cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CellEncoding {
    /// Log-odds of being occupied, as in [`msg::grid`].
    LogOdds,
    /// nav_msgs/OccupancyGrid: -1 is unknown, 0 to 100 is the percentage of being occupied.
    Percent,
}

/// Occupancy grid to plan on, in the frame `map` (or the robot's own map while that is not merged).
#[derive(Clone, Copy, Debug)]
pub struct MapView<'a> {
    /// Pose of the lower left corner of cell (0, 0) in the frame of the map.
    pub map_from_grid: Pose2,
    /// Side of a cell, metres.
    pub resolution_m: f64,
    /// Number of cells along the grid's x axis.
    pub width: u32,
    /// Number of cells along the grid's y axis.
    pub height: u32,
    /// Cells in row-major order; row 0 has the lowest y.
    pub cells: &'a [i8],
    /// Meaning of the cells' numbers.
    pub encoding: CellEncoding,
}

impl<'a> MapView<'a> {
    /// Views the cells of a nav_msgs/OccupancyGrid.
    ///
    /// `None` if width times height is not the number of cells or exceeds [`CELLS_MAX`], if the resolution is not in
    /// 0.001 m to 10 m, or if the pose is not finite.
    pub fn from_percent(
        map_from_grid: Pose2,
        resolution_m: f64,
        (width, height): (u32, u32),
        cells: &'a [i8],
    ) -> Option<Self> {
        let size = (width as usize).checked_mul(height as usize)?;
        let is_valid = size == cells.len()
            && size <= CELLS_MAX
            && RESOLUTION_M.contains(&resolution_m)
            && map_from_grid.is_finite();
        let encoding = CellEncoding::Percent;
        is_valid.then_some(Self { map_from_grid, resolution_m, width, height, cells, encoding })
    }

    /// Views a log-odds grid of this project. `None` as for [`MapView::from_percent`].
    pub fn from_log_odds(view: GridView<'a>) -> Option<Self> {
        let GridView { header, cells } = view;
        let size = (header.width, header.height);
        let map = Self::from_percent(header.origin, header.resolution_m, size, cells)?;
        Some(Self { encoding: CellEncoding::LogOdds, ..map })
    }

    /// Area of the cells that are known to be free or occupied, square metres.
    pub fn known_m2(&self) -> f64 {
        let is_known = |cell: &&i8| self.occupancy_of(**cell) != Occupancy::Unknown;
        self.cells.iter().filter(is_known).count() as f64 * self.resolution_m.powi(2)
    }

    /// Occupancy of the cell in column `x` and row `y`; unknown outside the map.
    pub fn occupancy(&self, x: i64, y: i64) -> Occupancy {
        if !(0..i64::from(self.width)).contains(&x) || !(0..i64::from(self.height)).contains(&y) {
            return Occupancy::Unknown;
        }
        self.occupancy_of(self.cells[y as usize * self.width as usize + x as usize])
    }

    fn occupancy_of(&self, cell: i8) -> Occupancy {
        match self.encoding {
            CellEncoding::LogOdds => grid::occupancy(cell),
            CellEncoding::Percent => match cell {
                0..=FREE_PERCENT_MAX => Occupancy::Free,
                OCCUPIED_PERCENT_MIN..=100 => Occupancy::Occupied,
                _ => Occupancy::Unknown,
            },
        }
    }
}

/// Planar scan (sensor_msgs/LaserScan; special ranges as in REP-117).
#[derive(Clone, Copy, Debug)]
pub struct ScanView<'a> {
    /// Time of arrival, on the clock of [`FleetObservation::stamp`].
    pub received: Stamp,
    /// Pose of the sensor on the robot.
    pub base_from_scan: Pose2,
    /// Direction of beam 0 in the sensor's frame, radians.
    pub angle_min_rad: f64,
    /// Angle from one beam to the next, radians.
    pub angle_increment_rad: f64,
    /// Shortest range that is a measurement, metres.
    pub range_min_m: f64,
    /// Longest range that is a measurement, metres; a longer one means no return.
    pub range_max_m: f64,
    /// Measured range of each beam, metres.
    pub ranges_m: &'a [f32],
}

/// One valid beam of a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beam {
    /// Direction in the sensor's frame, radians.
    pub angle_rad: f64,
    /// Free distance along the beam, metres.
    pub range_m: f64,
    /// Whether an obstacle stands at the end of the range.
    pub is_hit: bool,
}

impl<'a> ScanView<'a> {
    /// Views a scan of a TurtleBot3 Burger's LiDAR that arrives at its own stamp.
    pub fn from_burger_scan(scan: &'a msg::Scan) -> Self {
        Self {
            received: scan.header.stamp,
            base_from_scan: BURGER_BASE_FROM_SCAN,
            angle_min_rad: f64::from(scan.angle_min_rad),
            angle_increment_rad: f64::from(scan.angle_increment_rad),
            range_min_m: f64::from(scan.range_min_m),
            range_max_m: f64::from(scan.range_max_m),
            ranges_m: scan.ranges_m(),
        }
    }

    /// Valid beams, at most [`msg::BEAMS_MAX`]. A scan whose angles or limits are not usable has none.
    pub fn beams(&self) -> impl Iterator<Item = Beam> + '_ {
        let is_valid = self.angle_min_rad.is_finite()
            && self.angle_increment_rad.is_finite()
            && self.range_min_m >= 0.0
            && self.range_max_m.is_finite()
            && self.range_min_m < self.range_max_m
            && self.base_from_scan.is_finite();
        let count = if is_valid { self.ranges_m.len().min(msg::BEAMS_MAX) } else { 0 };
        self.ranges_m[..count].iter().enumerate().filter_map(|(i, range)| {
            let angle_rad = self.angle_min_rad + i as f64 * self.angle_increment_rad;
            let range_m = f64::from(*range);
            let (range_m, is_hit) = match range_m {
                r if r.is_nan() => return None,
                // Minus infinity means an obstacle too close to measure (REP-117).
                f64::NEG_INFINITY => (self.range_min_m, true),
                r if r >= self.range_max_m => (self.range_max_m, false),
                r if r < self.range_min_m => return None,
                r => (r, true),
            };
            Some(Beam { angle_rad, range_m, is_hit })
        })
    }

    /// Range that the beam nearest to an angle in the sensor's frame measured, metres; `None` if the sensor does not look there.
    pub(crate) fn beam_towards(&self, angle_rad: f64) -> Option<f32> {
        let beam = ((angle_rad - self.angle_min_rad) / self.angle_increment_rad).round();
        if beam >= 0.0 { self.ranges_m.get(beam as usize).copied() } else { None }
    }

    /// Whether nothing around the scanner is out of its view.
    pub fn sees_all_around(&self) -> bool {
        self.angle_increment_rad.abs() * self.ranges_m.len() as f64 >= ALL_AROUND_RAD
    }

    /// Whether at least half of the beams within an angle of straight ahead are valid. A covered LiDAR has none, and an obstacle nearer
    /// than its shortest range shows as invalid beams.
    pub fn sees_ahead(&self, within_rad: f64) -> bool {
        let yaw_rad = self.base_from_scan.yaw_rad;
        let is_ahead = |angle_rad: f64| wrap_angle(angle_rad + yaw_rad).abs() <= within_rad;
        let valid = self.beams().filter(|beam| is_ahead(beam.angle_rad)).count();
        let count = self.ranges_m.len().min(msg::BEAMS_MAX);
        let angles = (0..count).map(|i| self.angle_min_rad + i as f64 * self.angle_increment_rad);
        valid > 0 && 2 * valid >= angles.filter(|angle_rad| is_ahead(*angle_rad)).count()
    }

    /// Positions of the obstacles hit, in `base_footprint`, metres.
    pub fn hits_in_base_m(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        let base_from_scan = self.base_from_scan;
        self.beams().filter(|beam| beam.is_hit).map(move |beam| {
            let (sin, cos) = beam.angle_rad.sin_cos();
            base_from_scan.apply([cos * beam.range_m, sin * beam.range_m])
        })
    }
}

/// One robot with its map, pose and newest scan.
#[derive(Clone, Copy, Debug)]
pub struct RobotObservation<'a> {
    /// The robot observed.
    pub robot: RobotId,
    /// Map that the robot's pose refers to: the merged one, or its own while it is not merged.
    pub map: Option<MapView<'a>>,
    /// Whether `map` is the merged map, which all merged robots share.
    pub in_merged_map: bool,
    /// Pose of the robot in `map`; `None` if it is unknown.
    pub map_from_base: Option<Pose2>,
    /// Newest scan of the robot.
    pub scan: Option<ScanView<'a>>,
}

impl RobotObservation<'_> {
    /// An observation of a robot of which nothing is known.
    pub fn unknown(robot: RobotId) -> Self {
        Self { robot, map: None, in_merged_map: false, map_from_base: None, scan: None }
    }
}

/// All robots at one moment.
#[derive(Clone, Copy, Debug)]
pub struct FleetObservation<'a> {
    /// Time of the observation; it never goes back.
    pub stamp: Stamp,
    /// The robots in any order; those that a tour does not drive are obstacles to it.
    pub robots: &'a [RobotObservation<'a>],
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_encodings_give_the_same_occupancy() {
        let percent = grid::percent_table();
        let log_odds: Vec<i8> = (i8::MIN..=i8::MAX).collect();
        let percents: Vec<i8> = log_odds.iter().map(|cell| percent[*cell as u8 as usize]).collect();
        let header = msg::GridHeader { resolution_m: 0.05, width: 16, height: 16, ..Default::default() };
        let ours = MapView::from_log_odds(GridView::new(&header, &log_odds).unwrap()).unwrap();
        let ros = MapView::from_percent(Pose2::IDENTITY, 0.05, (16, 16), &percents).unwrap();
        for (x, y) in (-1..17).flat_map(|y| (-1..17).map(move |x| (x, y))) {
            assert_eq!(ours.occupancy(x, y), ros.occupancy(x, y), "cell {x}, {y}");
        }
        assert!(MapView::from_percent(Pose2::IDENTITY, f64::NAN, (16, 16), &percents).is_none());
        assert!(MapView::from_percent(Pose2::IDENTITY, 0.05, (16, 15), &percents).is_none());
        assert!(MapView::from_percent(Pose2::IDENTITY, 0.05, (u32::MAX, u32::MAX), &percents).is_none());
    }

    #[test]
    fn special_ranges_are_read_as_rep_117_says() {
        let ranges = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.01, 1.0, 9.0];
        let scan = ScanView {
            received: Stamp(0),
            base_from_scan: Pose2::IDENTITY,
            angle_min_rad: 0.0,
            angle_increment_rad: 0.1,
            range_min_m: 0.12,
            range_max_m: 3.5,
            ranges_m: &ranges,
        };
        let beams: Vec<(f64, bool)> = scan.beams().map(|beam| (beam.range_m, beam.is_hit)).collect();
        assert_eq!(beams, [(3.5, false), (0.12, true), (1.0, true), (3.5, false)]);
        assert_eq!(ScanView { angle_increment_rad: f64::NAN, ..scan }.beams().count(), 0);
        assert!(scan.sees_ahead(0.25), "two of the first three beams");
        assert!(!scan.sees_ahead(0.05), "the first alone");
        let behind = Pose2::new(0.0, 0.0, core::f64::consts::PI);
        assert!(!ScanView { base_from_scan: behind, ..scan }.sees_ahead(0.5), "the sensor looks back");
    }
}
