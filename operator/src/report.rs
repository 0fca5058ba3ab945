//! What an operator tells at the end: for programs (serde) and for people (Display).

use crate::measures::{LinkReport, Spread, StreamReport};
use bridge::ros::OccupancyGrid;
use nav::driver::DriverFigures;
use serde::Serialize;
use std::fmt;

/// All of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OperatorReport {
    /// The bridge's.
    pub address: String,
    /// From the first attempt to connect to the end.
    pub seconds: f64,
    /// The robots, in the order they came to be known.
    pub robots: Vec<RobotReport>,
    /// Commands written.
    pub commands: u64,
    /// The last merged map seen.
    pub map: Option<MapReport>,
    /// What arrived.
    pub link: LinkReport,
    /// The newest words of the bridge.
    pub notices: Vec<String>,
}

/// One robot's share of the tour.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RobotReport {
    /// 1 for `robot1`.
    pub robot: usize,
    /// Times in the hand; 0 when all were driven at once.
    pub turns: u32,
    /// Time in the hand, seconds.
    pub held_s: f64,
    /// What the operator did with it.
    pub did: DriverFigures,
}

/// A map in numbers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MapReport {
    /// Cells along x.
    pub width: u32,
    /// Cells along y.
    pub height: u32,
    /// Side of a cell, metres.
    pub resolution_m: f64,
    /// Known to be free, square metres.
    pub free_m2: f64,
    /// Known to be occupied, square metres.
    pub occupied_m2: f64,
}

impl MapReport {
    pub(crate) fn of(map: &OccupancyGrid) -> Self {
        let resolution_m = f64::from(map.resolution);
        let area_m2 = |wanted: core::ops::RangeInclusive<i8>| {
            map.data.iter().filter(|cell| wanted.contains(cell)).count() as f64 * resolution_m * resolution_m
        };
        let (free_m2, occupied_m2) = (area_m2(0..=25), area_m2(66..=100));
        Self { width: map.width, height: map.height, resolution_m, free_m2, occupied_m2 }
    }
}

impl fmt::Display for OperatorReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "operator at {}: {:.0} s, {} commands", self.address, self.seconds, self.commands)?;
        writeln!(f, "robot  turns  held s  driven m  frontiers  patrols  freed  scans Hz  lost")?;
        for RobotReport { robot, turns, held_s, did } in &self.robots {
            let scans =
                self.link.scans.iter().find(|s| s.robot == *robot).map(|s| s.scans).unwrap_or_default();
            writeln!(
                f,
                "{robot:>5}  {turns:>5}  {held_s:>6.0}  {:>8.1}  {:>9}  {:>7}  {:>5}  {:>8.2}  {:>4}",
                did.driven_m, did.frontiers, did.patrols, did.recoveries, scans.rate_hz, scans.lost
            )?;
        }
        match &self.map {
            Some(map) => writeln!(
                f,
                "merged map: {} x {} cells of {} m, {:.1} m2 free, {:.1} m2 occupied",
                map.width, map.height, map.resolution_m, map.free_m2, map.occupied_m2
            )?,
            None => writeln!(f, "merged map: none came")?,
        }
        stream(f, "tf of the robots", &self.link.tf)?;
        stream(f, "tf of SLAM and merging", &self.link.slam_tf)?;
        if self.link.connections > 1 {
            writeln!(f, "the link was lost {} times", self.link.connections - 1)?;
        }
        self.notices.iter().try_for_each(|notice| writeln!(f, "the bridge says: {notice}"))
    }
}

fn stream(f: &mut fmt::Formatter<'_>, name: &str, report: &StreamReport) -> fmt::Result {
    let Spread { median, p95, p99, max, .. } = report.jitter_ms;
    writeln!(
        f,
        "{name}: {} links, {} transforms, {} lost, jitter {median:.3} ms, p95 {p95:.3}, p99 {p99:.3}, max {max:.3}",
        report.streams, report.received, report.lost
    )
}
