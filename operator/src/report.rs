//! Report of a run, serialised for programs and displayed for people.

use crate::OperatorError;
use crate::link_statistics::{LinkReport, Percentiles, StreamReport};
use bridge::ros::OccupancyGrid;
use nav::ExplorationStats;
use nav::observation::{FREE_PERCENT_MAX, OCCUPIED_PERCENT_MIN};
use serde::Serialize;
use std::fmt;

/// What the operator did, and what arrived.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OperatorReport {
    /// Address of the bridge.
    pub address: String,
    /// Time from the first attempt to connect to the end, seconds.
    pub seconds: f64,
    /// The robots, in the order of the tour.
    pub robots: Vec<RobotReport>,
    /// Number of velocities published.
    pub commands: u64,
    /// Newest merged map.
    pub map: Option<MapReport>,
    /// Statistics of what arrived.
    pub link: LinkReport,
    /// Text of the bridge that the operator may not drive, if that was so at the end.
    pub not_permitted: Option<String>,
    /// Newest texts of the bridge.
    pub notices: Vec<String>,
}

/// What the operator did with one robot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RobotReport {
    /// Number of the robot: 1 for `robot1`.
    pub robot: usize,
    /// Number of turns; 0 if all robots were driven at once.
    pub turns: u32,
    /// Length of all turns, seconds.
    pub held_s: f64,
    /// Exploration of the robot.
    pub did: ExplorationReport,
}

/// What one robot's explorer did. The names of the fields are keys of the JSON report.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ExplorationReport {
    /// Distance driven by the poses in the map, metres.
    pub driven_m: f64,
    /// Number of spins to look around.
    pub looks_around: u32,
    /// Number of frontiers looked past.
    pub frontiers: u32,
    /// Number of places visited again.
    pub patrols: u32,
    /// Number of times that the robot was stuck and left its goal.
    pub recoveries: u32,
    /// Number of plans made.
    pub plans: u32,
}

impl From<ExplorationStats> for ExplorationReport {
    fn from(stats: ExplorationStats) -> Self {
        let ExplorationStats { driven_m, spins, frontiers, patrols, recoveries, plans } = stats;
        Self { driven_m, looks_around: spins, frontiers, patrols, recoveries, plans }
    }
}

/// Size and known area of a map.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MapReport {
    /// Number of cells along x.
    pub width: u32,
    /// Number of cells along y.
    pub height: u32,
    /// Side of a cell, metres.
    pub resolution_m: f64,
    /// Area known to be free, square metres.
    pub free_m2: f64,
    /// Area known to be occupied, square metres.
    pub occupied_m2: f64,
}

impl MapReport {
    pub(crate) fn of(map: &OccupancyGrid) -> Self {
        let resolution_m = f64::from(map.resolution);
        let area_m2 = |percent: core::ops::RangeInclusive<i8>| {
            map.data.iter().filter(|cell| percent.contains(cell)).count() as f64 * resolution_m * resolution_m
        };
        Self {
            width: map.width,
            height: map.height,
            resolution_m,
            free_m2: area_m2(0..=FREE_PERCENT_MAX),
            occupied_m2: area_m2(OCCUPIED_PERCENT_MIN..=100),
        }
    }
}

impl OperatorReport {
    /// Checks that the operator did its work.
    ///
    /// # Errors
    /// No scan came, or the operator may not drive.
    pub fn check(&self) -> Result<(), OperatorError> {
        if let Some(why) = &self.not_permitted {
            return Err(OperatorError::NotPermitted(why.clone()));
        }
        if self.link.scans.iter().all(|robot| robot.scans.received == 0) {
            return Err(OperatorError::NoScans { address: self.address.clone(), seconds: self.seconds });
        }
        Ok(())
    }
}

impl fmt::Display for OperatorReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "operator at {}: {:.0} s, {} commands", self.address, self.seconds, self.commands)?;
        writeln!(f, "robot  turns  turns s  driven m  frontiers  patrols  stuck  scans Hz  scans lost")?;
        for RobotReport { robot, turns, held_s, did } in &self.robots {
            let scans =
                self.link.scans.iter().find(|s| s.robot == *robot).map(|s| s.scans).unwrap_or_default();
            writeln!(
                f,
                "{robot:>5}  {turns:>5}  {held_s:>7.0}  {:>8.1}  {:>9}  {:>7}  {:>5}  {:>8.2}  {:>10}",
                did.driven_m, did.frontiers, did.patrols, did.recoveries, scans.rate_hz, scans.lost
            )?;
        }
        match &self.map {
            Some(map) => writeln!(
                f,
                "merged map: {} x {} cells of {:.3} m, {:.1} m2 free, {:.1} m2 occupied",
                map.width, map.height, map.resolution_m, map.free_m2, map.occupied_m2
            )?,
            None => writeln!(f, "merged map: none received")?,
        }
        write_stream(f, "transforms of the robots", &self.link.tf)?;
        write_stream(f, "transforms of SLAM and merging", &self.link.slam_tf)?;
        if self.link.connections > 1 {
            writeln!(f, "the connection was lost {} times", self.link.connections - 1)?;
        }
        self.notices.iter().try_for_each(|text| writeln!(f, "message of the bridge: {text}"))
    }
}

fn write_stream(f: &mut fmt::Formatter<'_>, name: &str, report: &StreamReport) -> fmt::Result {
    let Percentiles { median, p95, p99, max, .. } = report.jitter_ms;
    write!(f, "{name}: {} frames, {} received, {} lost, ", report.streams, report.received, report.lost)?;
    match (median, p95, p99, max) {
        (Some(median), Some(p95), Some(p99), Some(max)) => {
            writeln!(f, "jitter {median:.3} ms, p95 {p95:.3}, p99 {p99:.3}, max {max:.3}")
        }
        _ => writeln!(f, "jitter unknown"),
    }
}
