//! Figures of a fleet of one size.

use crate::fleet::{Cpu, Fleet};
use crate::measure::Spread;
use reports::{FleetView, RobotView};
use serde::Serialize;
use std::error::Error;
use std::fmt;
use std::time::Duration;

/// Time until all robots have maps: processes of large fleets start one after the other.
const WARM_UP: Duration = Duration::from_secs(6);
/// The same for each robot.
const WARM_UP_PER_ROBOT: Duration = Duration::from_millis(400);

/// Row of the table.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Number of robots.
    pub robots: usize,
    /// Scans that were sent and not received by SLAM.
    pub missed: u64,
    /// Scans that SLAM received.
    pub scans: u64,
    /// Scan rate of the slowest robot, Hz.
    pub scan_hz: f64,
    /// Jitter of the transforms at a TCP client.
    pub tf: Spread,
    /// Delay from a scan to the map that contains it, of the slowest robot: median and 95th percentile, milliseconds.
    pub scan_to_map_ms: [f64; 2],
    /// Processor time of all processes, cores.
    pub cores: f64,
    /// Memory of all processes for each robot, megabytes.
    pub memory_per_robot_mb: f64,
    /// Process that takes most of a core, and how much in percent.
    pub busiest: (String, f64),
}

impl Row {
    /// Names of the columns.
    pub const HEAD: &'static str = "robots  missed    scans     Hz   TF median     P95     P99  lost   \
        scan to map: median    P95 ms  cores  core/robot  MB/robot  busiest process";

    /// Runs a fleet for so long.
    pub fn measure(robots: usize, length: Duration) -> Result<Self, Box<dyn Error>> {
        let mut fleet = Fleet::start_command("demo", robots, &["--page", "off"])?;
        let tf = fleet.measure(WARM_UP + WARM_UP_PER_ROBOT * robots as u32, length)?.tf;
        let cpus = fleet.processes();
        let busiest = cpus.iter().max_by(|a, b| a.percent.total_cmp(&b.percent));
        let (before, after) = fleet.views().ok_or("telemetry sent no figures twice; measure for longer")?;
        let seconds = after.time_s - before.time_s;
        let pairs = || before.robots.iter().zip(&after.robots);
        let rates = pairs().map(|(then, now)| now.scans.saturating_sub(then.scans) as f64 / seconds);
        let worst = |of: fn(&reports::RobotView) -> Option<f32>| {
            after.robots.iter().filter_map(of).fold(0.0, f32::max).into()
        };
        Ok(Self {
            robots,
            missed: missed_scans(before, after),
            scans: pairs().map(|(then, now)| now.scans.saturating_sub(then.scans)).sum(),
            scan_hz: rates.fold(f64::INFINITY, f64::min),
            tf,
            scan_to_map_ms: [
                worst(|robot| robot.scan_to_map_ms.p50),
                worst(|robot| robot.scan_to_map_ms.p95),
            ],
            cores: cpus.iter().map(|cpu| cpu.percent).sum::<f64>() / 100.0,
            memory_per_robot_mb: after.processes.iter().map(|process| process.memory_mb).sum::<f64>()
                / robots as f64,
            busiest: busiest
                .map_or((String::new(), 0.0), |Cpu { process, percent, .. }| (process.clone(), *percent)),
        })
    }
}

/// Returns the number of scans that SLAM missed between two views of a fleet.
pub fn missed_scans(before: &FleetView, after: &FleetView) -> u64 {
    let pairs = before.robots.iter().zip(&after.robots);
    let lost = |(then, now): (&RobotView, &RobotView)| {
        now.scans_lost.unwrap_or(0).saturating_sub(then.scans_lost.unwrap_or(0))
    };
    pairs.map(lost).sum()
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { robots, missed, scans, scan_hz, tf, scan_to_map_ms, cores, .. } = self;
        write!(
            f,
            "{robots:>6} {missed:>7} {scans:>8} {scan_hz:>6.2} {:>11.3} {:>7.3} {:>7.3} {:>5} {:>22.1} {:>9.1} \
             {cores:>6.2} {:>11.3} {:>9.1}  {} ({:.0} % of a core)",
            tf.p50_ms,
            tf.p95_ms,
            tf.p99_ms,
            tf.lost,
            scan_to_map_ms[0],
            scan_to_map_ms[1],
            cores / *robots as f64,
            self.memory_per_robot_mb,
            self.busiest.0,
            self.busiest.1,
        )
    }
}
