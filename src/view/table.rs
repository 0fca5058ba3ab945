//! Tables of a fleet's figures for a terminal.

use super::{DistributionView, FleetView};
use std::fmt::Write;

impl FleetView {
    /// Formats the robots' and the merged map's figures for a terminal.
    pub fn table(&self) -> String {
        let mut text = format!(
            "{:<8} {:<10} {:>8} {:>6} {:>9} {:>16} {:>16} {:>9}\n{:<8} {:<10} {:>8} {:>6} {:>9} {:>16} {:>16} {:>9}\n",
            "robot",
            "state",
            "scans",
            "lost",
            "coverage",
            "TF jitter",
            "scan to pose",
            "pose error",
            "",
            "",
            "Hz",
            "scans",
            "%",
            "p50 / p99 ms",
            "p50 / p99 ms",
            "m"
        );
        for robot in &self.robots {
            let _ = writeln!(
                text,
                "{:<8} {:<10} {:>8.2} {:>6} {:>9.1} {:>16} {:>16} {:>9}",
                robot.robot,
                robot.state,
                robot.scan_hz_last_second,
                robot.scans_lost,
                100.0 * robot.map.coverage,
                robot.tf_jitter_ms.p50_and_p99(),
                robot.scan_to_pose_ms.p50_and_p99(),
                robot.pose_error_m.map_or_else(|| "-".into(), |error| format!("{error:.3}")),
            );
        }
        let percent = |value: Option<f64>| value.map_or_else(|| "-".into(), |v| format!("{:.1}%", 100.0 * v));
        let _ = writeln!(
            text,
            "merged   room covered {}   consistency {} ({} within one cell)   occupied F1 {} (by chance: {}, F1 {})",
            percent(self.room_coverage),
            percent(self.consistency),
            percent(self.consistency_one_cell),
            percent(self.occupied_f1),
            percent(self.null_consistency_mean),
            percent(self.null_f1_mean),
        );
        text += &self.merge_lines();
        if let Some(bridge) = &self.bridge {
            text += &bridge.table();
        }
        text
    }

    /// Lists the robots that are not in the merged map, and the edges that were found.
    fn merge_lines(&self) -> String {
        let of = |merged: bool| {
            let robots = self.robots.iter().filter(|robot| robot.merged == merged);
            robots.map(|robot| robot.robot.as_str()).collect::<Vec<_>>().join(", ")
        };
        let mut text = String::new();
        let (merged, unmerged) = (of(true), of(false));
        if !unmerged.is_empty() {
            let merged = if merged.is_empty() { "no robot" } else { &merged };
            let _ = writeln!(
                text,
                "         merged map of {merged}; place of {unmerged} not known (each keeps its own map)"
            );
        }
        for edge in self.merge_edges.iter().filter(|edge| edge.was_found()) {
            let _ = writeln!(text, "         {edge}");
        }
        text
    }

    /// Formats the processes' figures for a terminal.
    pub fn process_table(&self) -> String {
        let mut text = format!(
            "{:<16} {:>8} {:<7} {:>8} {:>9} {:>6} {:>8} {:>15} {:>9} {:>8}\n",
            "process",
            "pid",
            "state",
            "restarts",
            "received",
            "lost",
            "dropped",
            "work p50/max us",
            "memory MB",
            "CPU s"
        );
        for p in &self.processes {
            let _ = writeln!(
                text,
                "{:<16} {:>8} {:<7} {:>8} {:>9} {:>6} {:>8} {:>8.0}/{:<6.0} {:>9.1} {:>8.1}",
                p.process,
                p.pid,
                p.state,
                p.restarts,
                p.received,
                p.lost,
                p.dropped,
                p.work_p50_us,
                p.work_max_us,
                p.memory_mb,
                p.cpu_s
            );
        }
        text
    }
}

impl DistributionView {
    fn p50_and_p99(&self) -> String {
        match (self.p50, self.p99) {
            (Some(p50), Some(p99)) => format!("{p50:.3} / {p99:.3}"),
            _ => "-".into(),
        }
    }
}
