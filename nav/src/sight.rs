//! What the operator sees: the map, the robots in it, the newest scans. Borrowed, so that it can be
//! laid over ROS messages and over `msg` types alike.

use msg::grid::{self, CELLS_MAX, Occupancy};
use msg::{GridView, Pose2, RobotId, Stamp};

/// Pose of the Burger's LiDAR on its base (ROBOTIS's URDF: 32 mm behind the wheels' axis).
pub const BURGER_BASE_FROM_SCAN: Pose2 = Pose2::new(-0.032, 0.0, 0.0);

/// How a cell of a map is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CellCode {
    /// Evidence, as in [`msg::grid`].
    LogOdds,
    /// nav_msgs/OccupancyGrid: -1 unknown, 0 to 100 percent occupied; map_server's thresholds.
    Percent,
}

/// A map to plan on, in the frame `map` (or a robot's own map, while that is not merged).
#[derive(Clone, Copy, Debug)]
pub struct MapView<'a> {
    /// Pose of the lower left corner of cell (0, 0).
    pub map_from_grid: Pose2,
    /// Side of a cell, metres.
    pub resolution_m: f64,
    /// Cells along the grid's x axis.
    pub width: u32,
    /// Cells along the grid's y axis.
    pub height: u32,
    /// Row-major, row 0 is the lowest y.
    pub cells: &'a [i8],
    /// What a cell's number means.
    pub code: CellCode,
}

impl<'a> MapView<'a> {
    /// `None` if the size is not the cells' or is over [`CELLS_MAX`], or the resolution (0.001 m to 10 m) or the
    /// pose is not a usable number.
    pub fn percent(
        map_from_grid: Pose2,
        resolution_m: f64,
        (width, height): (u32, u32),
        cells: &'a [i8],
    ) -> Option<Self> {
        let size = (width as usize).checked_mul(height as usize)?;
        let sound = size == cells.len()
            && size <= CELLS_MAX
            && (0.001..=10.0).contains(&resolution_m)
            && map_from_grid.is_finite();
        sound.then_some(Self { map_from_grid, resolution_m, width, height, cells, code: CellCode::Percent })
    }

    /// A grid of this project. `None` as for [`MapView::percent`].
    pub fn log_odds(view: GridView<'a>) -> Option<Self> {
        let GridView { header, cells } = view;
        let size = (header.width, header.height);
        let map = Self::percent(header.origin, header.resolution_m, size, cells)?;
        Some(Self { code: CellCode::LogOdds, ..map })
    }

    /// What is known about the cell in column `x`, row `y`; unknown outside.
    pub fn occupancy(&self, x: i64, y: i64) -> Occupancy {
        if !(0..i64::from(self.width)).contains(&x) || !(0..i64::from(self.height)).contains(&y) {
            return Occupancy::Unknown;
        }
        let cell = self.cells[y as usize * self.width as usize + x as usize];
        match self.code {
            CellCode::LogOdds => grid::occupancy(cell),
            CellCode::Percent => match cell {
                0..=25 => Occupancy::Free,
                66..=100 => Occupancy::Occupied,
                _ => Occupancy::Unknown,
            },
        }
    }
}

/// A scan (sensor_msgs/LaserScan's meaning; ranges follow REP-117).
#[derive(Clone, Copy, Debug)]
pub struct ScanView<'a> {
    /// When it came, on the clock of [`Sight::stamp`].
    pub seen: Stamp,
    /// Where the sensor sits.
    pub base_from_scan: Pose2,
    /// Direction of beam 0, radians.
    pub angle_min_rad: f64,
    /// Between beams, radians.
    pub angle_increment_rad: f64,
    /// Metres; smaller ranges mean nothing.
    pub range_min_m: f64,
    /// Metres; larger ranges mean no return.
    pub range_max_m: f64,
    /// Metres.
    pub ranges_m: &'a [f32],
}

/// What one beam says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beam {
    /// In the sensor's frame, radians.
    pub angle_rad: f64,
    /// Nothing stands nearer, metres.
    pub range_m: f64,
    /// Something stands there.
    pub hit: bool,
}

impl<'a> ScanView<'a> {
    /// A scan of this project by a Burger's LiDAR, seen when it was measured.
    pub fn of_burger(scan: &'a msg::Scan) -> Self {
        Self {
            seen: scan.header.stamp,
            base_from_scan: BURGER_BASE_FROM_SCAN,
            angle_min_rad: f64::from(scan.angle_min_rad),
            angle_increment_rad: f64::from(scan.angle_increment_rad),
            range_min_m: f64::from(scan.range_min_m),
            range_max_m: f64::from(scan.range_max_m),
            ranges_m: scan.ranges_m(),
        }
    }

    /// Every beam that says something; at most [`msg::BEAMS_MAX`].
    pub fn beams(&self) -> impl Iterator<Item = Beam> + '_ {
        let sound = self.angle_min_rad.is_finite()
            && self.angle_increment_rad.is_finite()
            && self.range_min_m >= 0.0
            && self.range_max_m.is_finite()
            && self.range_min_m < self.range_max_m
            && self.base_from_scan.is_finite();
        let count = if sound { self.ranges_m.len().min(msg::BEAMS_MAX) } else { 0 };
        self.ranges_m[..count].iter().enumerate().filter_map(|(i, range)| {
            let angle_rad = self.angle_min_rad + i as f64 * self.angle_increment_rad;
            let range_m = f64::from(*range);
            let (range_m, hit) = match range_m {
                r if r.is_nan() => return None,
                // Too close to measure (REP-117).
                f64::NEG_INFINITY => (self.range_min_m, true),
                r if r >= self.range_max_m => (self.range_max_m, false),
                r if r < self.range_min_m => return None,
                r => (r, true),
            };
            Some(Beam { angle_rad, range_m, hit })
        })
    }

    /// Where something stands, in `base_footprint`, metres.
    pub fn hits_in_base_m(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        let base_from_scan = self.base_from_scan;
        self.beams().filter(|beam| beam.hit).map(move |beam| {
            let (sin, cos) = beam.angle_rad.sin_cos();
            base_from_scan.apply([cos * beam.range_m, sin * beam.range_m])
        })
    }
}

/// One robot as the operator sees it.
#[derive(Clone, Copy, Debug)]
pub struct RobotSight<'a> {
    /// Which.
    pub robot: RobotId,
    /// The map this robot is shown in: the merged one, or its own while it is not merged.
    pub map: Option<MapView<'a>>,
    /// Whether `map` is the merged map, which the merged robots share.
    pub merged: bool,
    /// Where it is in `map`; `None` if nobody knows.
    pub map_from_base: Option<Pose2>,
    /// The newest scan.
    pub scan: Option<ScanView<'a>>,
}

/// All the operator sees at one moment.
#[derive(Clone, Copy, Debug)]
pub struct Sight<'a> {
    /// Now, on the operator's clock. It never goes back.
    pub stamp: Stamp,
    /// The fleet, in any order; robots the tour does not know are obstacles.
    pub robots: &'a [RobotSight<'a>],
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_codes_mean_the_same() {
        let percent = grid::percent_table();
        let log_odds: Vec<i8> = (i8::MIN..=i8::MAX).collect();
        let percents: Vec<i8> = log_odds.iter().map(|cell| percent[*cell as u8 as usize]).collect();
        let header = msg::GridHeader { resolution_m: 0.05, width: 16, height: 16, ..Default::default() };
        let ours = MapView::log_odds(GridView::new(&header, &log_odds).unwrap()).unwrap();
        let ros = MapView::percent(Pose2::IDENTITY, 0.05, (16, 16), &percents).unwrap();
        for (x, y) in (-1..17).flat_map(|y| (-1..17).map(move |x| (x, y))) {
            assert_eq!(ours.occupancy(x, y), ros.occupancy(x, y), "cell {x}, {y}");
        }
        assert!(MapView::percent(Pose2::IDENTITY, f64::NAN, (16, 16), &percents).is_none());
        assert!(MapView::percent(Pose2::IDENTITY, 0.05, (16, 15), &percents).is_none());
        assert!(MapView::percent(Pose2::IDENTITY, 0.05, (u32::MAX, u32::MAX), &percents).is_none());
    }

    #[test]
    fn beams_follow_rep_117() {
        let ranges = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.01, 1.0, 9.0];
        let scan = ScanView {
            seen: Stamp(0),
            base_from_scan: Pose2::IDENTITY,
            angle_min_rad: 0.0,
            angle_increment_rad: 0.1,
            range_min_m: 0.12,
            range_max_m: 3.5,
            ranges_m: &ranges,
        };
        let said: Vec<(f64, bool)> = scan.beams().map(|beam| (beam.range_m, beam.hit)).collect();
        assert_eq!(said, [(3.5, false), (0.12, true), (1.0, true), (3.5, false)]);
        assert_eq!(ScanView { angle_increment_rad: f64::NAN, ..scan }.beams().count(), 0);
    }
}
