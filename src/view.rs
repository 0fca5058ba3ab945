//! The fleet's figures as people and programs read them: a table, and JSON.

use crate::control::Doors;
use crate::merge_edges::EdgeView;
use msg::{Distribution, FleetStats, Pose2, ProcessStats, RobotId, RobotStats, Role, TrackingState};
use serde::Serialize;
use std::fmt::Write;

/// A fleet's figures with names and units.
#[derive(Clone, Debug, Serialize)]
pub struct FleetView {
    /// The run's time: seconds since it began, or since 1970 where the world is not simulated here.
    pub time_s: f64,
    /// Each robot's.
    pub robots: Vec<RobotView>,
    /// The merged map's.
    pub merged_map: MapView,
    /// Known cells of the merged map over those that can be known in the room; `None`: not a simulation.
    pub room_coverage: Option<f64>,
    /// How many pairs of maps overlap.
    pub pairs: u32,
    /// The paper's cross-instance consistency, mean over pairs, 0 to 1.
    pub consistency: Option<f64>,
    /// The same, tolerant of one cell.
    pub consistency_one_cell: Option<f64>,
    /// F1 of occupied cells at one cell's tolerance.
    pub occupied_f1: Option<f64>,
    /// Mean floor two maps share, square metres.
    pub overlap_m2: Option<f64>,
    /// What chance gives: the same maps under wrong transforms with at least half the overlap; their number.
    pub null_transforms: u32,
    /// Mean of the paper's consistency under them.
    pub null_consistency_mean: Option<f64>,
    /// Mean F1 of occupied cells under them.
    pub null_f1_mean: Option<f64>,
    /// The merged map against the room; `None`: not a simulation, or nothing merged.
    pub against_room: Option<AgainstRoomView>,
    /// What merging believes of each pair of robots, and why, if somebody asked.
    pub merge_edges: Vec<EdgeView>,
    /// Each process's health.
    pub processes: Vec<ProcessView>,
    /// Who is at the doors, by the bridge's account; `None`: it was not asked, or did not answer.
    pub doors: Option<Doors>,
}

/// One robot's figures.
#[derive(Clone, Debug, Serialize)]
pub struct RobotView {
    /// `robot1`.
    pub robot: String,
    /// `tracking`, `lost` ...
    pub state: &'static str,
    /// Scans that reach SLAM, a second.
    pub scan_hz: f64,
    /// Since the start.
    pub scans: u64,
    /// Since the start.
    pub scans_lost: u64,
    /// Its own map.
    pub map: MapView,
    /// |(receive - stamp) - its mean|, pooled over the robot's links.
    pub tf_jitter_ms: DistributionView,
    /// From the simulator to SLAM's pose.
    pub scan_to_pose_ms: DistributionView,
    /// From the simulator to the map that contains the scan.
    pub scan_to_map_ms: DistributionView,
    /// `robotK/map` from `base_footprint`: x, y in metres, yaw in radians.
    pub pose: [f64; 3],
    /// Distance of SLAM's pose from the truth; `None`: not a simulation.
    pub pose_error_m: Option<f64>,
    /// Nodes in the pose graph.
    pub nodes: u32,
    /// Loop closures in force.
    pub closures: u32,
    /// Whether its map is in the merged one.
    pub merged: bool,
    /// Where merging puts its map, against the truth as seen from the first merged robot: metres.
    pub map_transform_error_m: Option<f64>,
    /// The same, degrees.
    pub map_transform_error_deg: Option<f64>,
}

/// The merged map's walls against the room's, in a simulation.
#[derive(Clone, Debug, Serialize)]
pub struct AgainstRoomView {
    /// F1 of occupied cells at one cell's tolerance.
    pub occupied_f1: f64,
    /// Mean distance from the map's occupied cells to the nearest visible wall, each at most 1 m.
    pub map_to_room_m: f64,
    /// Mean distance from visible walls to the map's nearest occupied cell, each at most 1 m.
    pub room_to_map_m: f64,
    /// Mean thickness of the map's walls.
    pub wall_thickness_m: f64,
}

/// A map's figures.
#[derive(Clone, Debug, Serialize)]
pub struct MapView {
    /// The paper's seven: free, occupied, unknown, total, width, height, resolution.
    pub slam_stats: [f64; 7],
    /// Known over all cells, 0 to 1.
    pub coverage: f64,
}

/// Median and tail.
#[derive(Clone, Debug, Serialize)]
pub struct DistributionView {
    /// How many values.
    pub count: u64,
    /// Median.
    pub p50: f32,
    /// 95th percentile.
    pub p95: f32,
    /// 99th percentile.
    pub p99: f32,
    /// Largest.
    pub max: f32,
}

/// One process's health.
#[derive(Clone, Debug, Serialize)]
pub struct ProcessView {
    /// `sim of robot2`, `merge` ...
    pub process: String,
    /// Its process id.
    pub pid: u32,
    /// `up`, or `silent` if it has not been heard of for two seconds.
    pub state: &'static str,
    /// Incarnations before this one.
    pub restarts: u64,
    /// Messages of its main input received.
    pub received: u64,
    /// Messages of its main input lost.
    pub lost: u64,
    /// Messages dropped for slow readers.
    pub dropped: u64,
    /// Messages refused.
    pub refused: u64,
    /// Clients attached (bridge).
    pub clients: u32,
    /// Time per unit of work, median of the last second.
    pub work_p50_us: f32,
    /// The slowest of the last second.
    pub work_max_us: f32,
    /// How late periodic work began, median of the last second.
    pub late_p50_us: f32,
    /// The latest of the last second.
    pub late_max_us: f32,
    /// Resident memory.
    pub memory_mb: f64,
    /// Processor time since its start.
    pub cpu_s: f64,
}

/// A process is silent after missing one health message.
const SILENT_AFTER_S: f64 = 2.5;

impl FleetView {
    /// Names the figures.
    pub fn new(stats: &FleetStats) -> Self {
        let count = (stats.robot_count as usize).min(stats.robots.len());
        let pairs = stats.pair_count > 0;
        let of_pairs = |value: f64| (pairs && value.is_finite()).then_some(value);
        Self {
            time_s: stats.header.stamp.seconds(),
            robots: RobotId::first(count)
                .map(|robot| RobotView::new(robot, &stats.robots[robot.index()]))
                .collect(),
            merged_map: MapView::new(&stats.merged),
            room_coverage: finite(stats.room_coverage),
            pairs: stats.pair_count,
            consistency: of_pairs(stats.consistency),
            consistency_one_cell: of_pairs(stats.consistency_one_cell),
            occupied_f1: of_pairs(stats.occupied_f1),
            overlap_m2: of_pairs(stats.overlap_m2),
            null_transforms: stats.null_count,
            null_consistency_mean: finite(stats.null_consistency_mean),
            null_f1_mean: finite(stats.null_f1_mean),
            against_room: stats.room_f1.is_finite().then_some(AgainstRoomView {
                occupied_f1: stats.room_f1,
                map_to_room_m: stats.map_to_room_m,
                room_to_map_m: stats.room_to_map_m,
                wall_thickness_m: stats.wall_thickness_m,
            }),
            merge_edges: Vec::new(),
            processes: stats.processes.iter().filter_map(ProcessView::new).collect(),
            doors: None,
        }
    }

    /// A table for a terminal.
    pub fn table(&self) -> String {
        let mut text = String::new();
        let _ = writeln!(
            text,
            "{:<8} {:<10} {:>7} {:>6} {:>9} {:>16} {:>16} {:>9}",
            "robot", "state", "scan Hz", "lost", "coverage", "TF jitter ms", "scan→pose ms", "error m"
        );
        let _ = writeln!(
            text,
            "{:<8} {:<10} {:>7} {:>6} {:>9} {:>16} {:>16}",
            "", "", "", "", "", "p50 / p99", "p50 / p99"
        );
        for robot in &self.robots {
            let _ = writeln!(
                text,
                "{:<8} {:<10} {:>7.2} {:>6} {:>8.1}% {:>16} {:>16} {:>9}",
                robot.robot,
                robot.state,
                robot.scan_hz,
                robot.scans_lost,
                100.0 * robot.map.coverage,
                robot.tf_jitter_ms.short(),
                robot.scan_to_pose_ms.short(),
                robot.pose_error_m.map_or_else(|| "-".into(), |error| format!("{error:.3}")),
            );
        }
        let percent = |value: Option<f64>| value.map_or_else(|| "-".into(), |v| format!("{:.1}%", 100.0 * v));
        let _ = writeln!(
            text,
            "merged   room {}   consistency {} ({} within a cell)   occupied F1 {} (chance: {}, F1 {})",
            percent(self.room_coverage),
            percent(self.consistency),
            percent(self.consistency_one_cell),
            percent(self.occupied_f1),
            percent(self.null_consistency_mean),
            percent(self.null_f1_mean),
        );
        text += &self.merge_lines();
        if let Some(doors) = &self.doors {
            text += &doors.table();
        }
        text
    }

    /// Who is in the merged map and who is not; what is not as it should be between two of them.
    fn merge_lines(&self) -> String {
        let of = |merged: bool| {
            let robots = self.robots.iter().filter(|robot| robot.merged == merged);
            robots.map(|robot| robot.robot.as_str()).collect::<Vec<_>>().join(", ")
        };
        let mut text = String::new();
        let (there, apart) = (of(true), of(false));
        if !apart.is_empty() {
            let there = if there.is_empty() { "nobody" } else { &there };
            let _ = writeln!(
                text,
                "         the map is of {there}; not known where {apart} is (each has its own map)"
            );
        }
        for edge in self.merge_edges.iter().filter(|edge| edge.is_news()) {
            let _ = writeln!(text, "         {edge}");
        }
        text
    }

    /// The processes' table.
    pub fn process_table(&self) -> String {
        let mut text = format!(
            "{:<16} {:>8} {:<7} {:>8} {:>9} {:>6} {:>8} {:>11} {:>9} {:>8}\n",
            "process",
            "pid",
            "state",
            "restarts",
            "received",
            "lost",
            "dropped",
            "work us",
            "memory MB",
            "cpu s"
        );
        for p in &self.processes {
            let _ = writeln!(
                text,
                "{:<16} {:>8} {:<7} {:>8} {:>9} {:>6} {:>8} {:>5.0}/{:<5.0} {:>9.1} {:>8.1}",
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

impl RobotView {
    fn new(robot: RobotId, stats: &RobotStats) -> Self {
        let Pose2 { x_m, y_m, yaw_rad } = stats.map_from_base;
        Self {
            robot: robot.to_string(),
            state: TrackingState::from_code(stats.state).map_or("?", TrackingState::name),
            scan_hz: stats.scan_hz,
            scans: stats.scans,
            scans_lost: stats.scans_lost,
            map: MapView::new(stats),
            tf_jitter_ms: DistributionView::new(&stats.tf_jitter_ms),
            scan_to_pose_ms: DistributionView::new(&stats.scan_to_pose_ms),
            scan_to_map_ms: DistributionView::new(&stats.scan_to_map_ms),
            pose: [x_m, y_m, yaw_rad],
            pose_error_m: finite(stats.pose_error_m),
            nodes: stats.nodes,
            closures: stats.closures,
            merged: stats.merged == 1,
            map_transform_error_m: finite(stats.map_transform_error_m),
            map_transform_error_deg: finite(stats.map_transform_error_rad.to_degrees()),
        }
    }
}

impl MapView {
    fn new(stats: &RobotStats) -> Self {
        let cells = |count: u32| f64::from(count);
        let (width, height) = (cells(stats.width), cells(stats.height));
        let [free, occupied, unknown] =
            [stats.free_cells, stats.occupied_cells, stats.unknown_cells].map(cells);
        let slam_stats = [free, occupied, unknown, width * height, width, height, stats.resolution_m];
        Self { slam_stats, coverage: stats.coverage }
    }
}

impl DistributionView {
    fn new(distribution: &Distribution) -> Self {
        let Distribution { count, p50, p95, p99, max } = *distribution;
        Self { count, p50, p95, p99, max }
    }

    fn short(&self) -> String {
        if self.count == 0 { "-".into() } else { format!("{:.3} / {:.3}", self.p50, self.p99) }
    }
}

impl ProcessView {
    fn new(stats: &ProcessStats) -> Option<Self> {
        let health = &stats.health;
        let role = Role::from_code(health.role)?;
        let process = match RobotId::new(health.robot as usize) {
            Some(robot) => format!("{} of {robot}", role.name()),
            None => role.name().into(),
        };
        Some(Self {
            process,
            pid: health.pid,
            state: if stats.age_s < SILENT_AFTER_S { "up" } else { "silent" },
            restarts: stats.restarts,
            received: health.received,
            lost: health.lost,
            dropped: health.dropped,
            refused: health.refused,
            clients: health.clients,
            work_p50_us: health.work_p50_us,
            work_max_us: health.work_max_us,
            late_p50_us: health.late_p50_us,
            late_max_us: health.late_max_us,
            memory_mb: health.memory_bytes as f64 / 1e6,
            cpu_s: health.cpu_ns as f64 * 1e-9,
        })
    }
}

fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}
