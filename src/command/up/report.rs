//! Report of a run, `report.json` for programs and a summary for people.

use super::events::Events;
use crate::run::{Run, RunError};
use crate::view::{DistributionView, FleetView, RobotView};
use serde::Serialize;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Content of `report.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Duration of the run, seconds.
    pub seconds: f64,
    /// Room, or source of the world.
    pub room: String,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Figures of the paper; `None` if telemetry sent none.
    pub paper: Option<Paper>,
    /// All figures at the end of the run; `None` if telemetry sent none.
    pub fleet: Option<FleetView>,
    /// Measurements of the scripted operator at its end of TCP; `None` without one.
    pub operator: Option<serde_json::Value>,
    /// Paths of the maps without extension (.pgm, .yaml, .png).
    pub maps: Vec<PathBuf>,
    /// Deaths, restarts and changed edges, oldest first; the newest 1000.
    pub events: Vec<String>,
    /// Number of older events that were dropped.
    pub events_dropped: u64,
}

/// Figures of the paper for the whole fleet.
#[derive(Clone, Debug, Serialize)]
pub struct Paper {
    /// Scans that SLAM receives per second: mean over the run of the slowest robot (paper: 8.83).
    pub scan_hz: f64,
    /// Scans that were sent and not received by SLAM, all robots.
    pub scans_lost: u64,
    /// Known cells over all cells, mean over the robots' maps, 0 to 1.
    pub coverage: f64,
    /// Cross-instance consistency, 0 to 1 (paper: 0.947).
    pub consistency: Option<f64>,
    /// TF jitter of the worst robot, median, milliseconds (paper: 6.3).
    pub tf_jitter_ms: f32,
    /// Delay from the simulator's scan to the map that contains it, of the worst robot, median, milliseconds.
    pub scan_to_map_ms: f32,
}

impl Paper {
    fn new(fleet: &FleetView) -> Self {
        let robots = &fleet.robots;
        let slowest = robots.iter().map(|robot| robot.scan_hz).fold(f64::INFINITY, f64::min);
        let worst = |of: fn(&RobotView) -> &DistributionView| {
            robots.iter().map(|robot| of(robot).p50).fold(0.0, f32::max)
        };
        Self {
            scan_hz: if slowest.is_finite() { slowest } else { 0.0 },
            scans_lost: robots.iter().map(|robot| robot.scans_lost).sum(),
            coverage: robots.iter().map(|robot| robot.map.coverage).sum::<f64>() / robots.len().max(1) as f64,
            consistency: fleet.consistency,
            tf_jitter_ms: worst(|robot| &robot.tf_jitter_ms),
            scan_to_map_ms: worst(|robot| &robot.scan_to_map_ms),
        }
    }
}

impl Report {
    /// Collects the figures at the end of a run.
    pub(super) fn new(
        run: &Run,
        elapsed: Duration,
        fleet: Option<FleetView>,
        operator: Option<serde_json::Value>,
        maps: Vec<PathBuf>,
        events: Events,
    ) -> Self {
        let (events, events_dropped) = events.into_parts();
        Self {
            seconds: elapsed.as_secs_f64(),
            room: run.config.world_name().into(),
            seed: run.config.fleet.seed,
            paper: fleet.as_ref().map(Paper::new),
            fleet,
            operator,
            maps,
            events,
            events_dropped,
        }
    }

    /// Writes `report.json` into the run's folder.
    pub fn write(&self, dir: &Path) -> Result<(), RunError> {
        let path = dir.join("report.json");
        let json = serde_json::to_string_pretty(self).unwrap_or_default();
        std::fs::write(&path, json).map_err(|why| RunError::File { path, why: why.to_string() })
    }

    /// Formats the report for a terminal.
    pub fn summary(&self) -> String {
        let mut text = format!("\n{:.0} s in {}\n", self.seconds, self.room);
        if let Some(fleet) = &self.fleet {
            text += &fleet.table();
            text += &map_figures(fleet);
        }
        if let Some(paper) = &self.paper {
            let consistency = paper.consistency.map_or("-".into(), |c| format!("{:.1} %", 100.0 * c));
            let rows = [
                ("scan rate", format!("{:.2} Hz, {} lost", paper.scan_hz, paper.scans_lost), "8.83 Hz"),
                ("map coverage", format!("{:.1} %", 100.0 * paper.coverage), ""),
                ("consistency", consistency, "94.7 %"),
                ("TF jitter, median", format!("{:.3} ms", paper.tf_jitter_ms), "6.3 ms"),
                ("scan to map, median", format!("{:.2} ms", paper.scan_to_map_ms), ""),
            ];
            let _ = writeln!(text, "\n{:<22} {:<22} the paper", "", "this run");
            for (name, here, there) in rows {
                let _ = writeln!(text, "{name:<22} {here:<22} {there}");
            }
        }
        for map in &self.maps {
            let _ = writeln!(text, "{}.png", map.display());
        }
        text
    }
}

/// Formats how well the maps agree with each other and with the room: figures that a wrong merge cannot reach.
fn map_figures(fleet: &FleetView) -> String {
    let mut text = String::new();
    let percent = |value: Option<f64>| value.map_or_else(|| "-".into(), |v| format!("{:.1} %", 100.0 * v));
    let _ = writeln!(text, "\n{:<28} {:>9} {:>20}", "agreement of the robots' maps", "this run", "by chance");
    let rows = [
        ("consistency", fleet.consistency, fleet.null_consistency_mean),
        ("consistency within one cell", fleet.consistency_one_cell, None),
        ("occupied F1 within one cell", fleet.occupied_f1, fleet.null_f1_mean),
    ];
    for (name, here, chance) in rows {
        let _ = writeln!(text, "{name:<28} {:>9} {:>20}", percent(here), percent(chance));
    }
    let shared = fleet.overlap_m2.map_or_else(|| "-".into(), |m2| format!("{m2:.1} m2"));
    let chance = format!("{} wrong transforms", fleet.null_transforms);
    let _ = writeln!(text, "{:<28} {shared:>9} {chance:>20}", "shared area, mean of pairs");
    if let Some(room) = &fleet.against_room {
        let _ = writeln!(
            text,
            "merged map and room: {} of the observable area known, occupied F1 {:.1} %, map to room {:.3} m, \
             room to map {:.3} m, walls {:.3} m thick",
            percent(fleet.room_coverage),
            100.0 * room.occupied_f1,
            room.map_to_room_m,
            room.room_to_map_m,
            room.wall_thickness_m
        );
    }
    for robot in fleet.robots.iter().filter(|robot| robot.map_transform_error_m.is_some()) {
        let (m, deg) =
            (robot.map_transform_error_m.unwrap_or(0.0), robot.map_transform_error_deg.unwrap_or(0.0));
        let _ = writeln!(
            text,
            "{}'s map is {m:.3} m and {deg:.2} degrees from its true pose in the merged map",
            robot.robot
        );
    }
    text
}
