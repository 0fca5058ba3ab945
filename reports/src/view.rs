//! Figures of a fleet as people and programs read them: tables and JSON.

mod alarms;
mod battery;
mod edges;
mod layout;
mod room;
mod slam;
mod table;

pub use edges::{EdgeView, edge_table, edges_json};
pub use layout::{Emphasis, Style};
pub use room::{AgainstRoomView, AlignedView};
pub use slam::{ClosureView, SlamView};

use crate::BridgeState;
use ::bridge::BatteryStatus;
use msg::{
    Distribution, FleetStats, MAP_OLD_AFTER_S, Pose2, ProcessStats, RobotId, RobotStats, Role, TrackingState,
};
use serde::Serialize;

/// Figures of a fleet, with names and units; JSON of `status`, `report.json` and `lockstep`.
// More than 12 fields: the fields are the keys of one JSON object, which scripts read.
#[derive(Clone, Debug, Serialize)]
pub struct FleetView {
    /// Time of the run: seconds since its start, or since 1970 if the world is not simulated here.
    pub time_s: f64,
    /// Time over which jitter, latencies and scans are counted, seconds: since telemetry was started last. Lost scans are, too, where
    /// `scan_hz` is null; else they are of the whole run.
    pub counted_s: f64,
    /// Age of the maps from which all that is said of maps was computed, seconds; `None`: there are no figures of maps yet.
    pub maps_age_s: Option<f64>,
    /// Figures of each robot, robot1 first.
    pub robots: Vec<RobotView>,
    /// Figures of the merged map.
    pub merged_map: MapView,
    /// Known cells of the merged map over the room's observable cells, 0 to 1; `None`: not a simulation.
    pub room_coverage: Option<f64>,
    /// Number of pairs of maps that overlap.
    pub pairs: u32,
    /// Cross-instance consistency of the paper, mean over pairs, 0 to 1.
    pub consistency: Option<f64>,
    /// Cross-instance consistency with a tolerance of one cell.
    pub consistency_one_cell: Option<f64>,
    /// F1 of occupied cells with a tolerance of one cell, mean over pairs.
    pub occupied_f1: Option<f64>,
    /// Area that two maps share, mean over pairs, square metres.
    pub overlap_m2: Option<f64>,
    /// Number of wrong transforms with at least half the overlap, under which the same maps were compared.
    pub null_transforms: u32,
    /// Cross-instance consistency under wrong transforms, mean: what chance gives.
    pub null_consistency_mean: Option<f64>,
    /// F1 of occupied cells under wrong transforms, mean: what chance gives.
    pub null_f1_mean: Option<f64>,
    /// Merged map compared with the room; `None`: not a simulation, or nothing merged.
    pub against_room: Option<AgainstRoomView>,
    /// Edges between robots' maps, with their evidence; empty if merging was not asked.
    pub merge_edges: Vec<EdgeView>,
    /// Robots whose given start the maps contradict: their places come from the maps.
    pub contradicted_starts: Vec<String>,
    /// Whether the edges, and what the operator said of them, are not saved.
    pub edges_unsaved: bool,
    /// Health of each process.
    pub processes: Vec<ProcessView>,
    /// State of the bridge; `None`: it was not asked, or did not answer. On the live table, its newest known state.
    pub bridge: Option<BridgeState>,
    /// Why the bridge did not answer: whether robots are stopped and who drives is not known. `None`: it answered, or was not
    /// asked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bridge_silence: Option<String>,
}

/// Figures of one robot.
// More than 12 fields: the fields are the keys of one JSON object, which scripts read.
#[derive(Clone, Debug, Serialize)]
pub struct RobotView {
    /// The robot by its number, such as `robot1`.
    pub robot: String,
    /// Its own name in this fleet, such as `alice`; `None`: it has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Tracking state of SLAM at its newest scan: `tracking`, `lost` ...; `scan_hz_last_second` and the alarms say whether scans come.
    pub state: &'static str,
    /// Scans that SLAM received per second: mean of the run; `None` where one moment is shown, as by `status`.
    pub scan_hz: Option<f64>,
    /// Scans that SLAM received in the last second, Hz.
    pub scan_hz_last_second: f64,
    /// Scans that SLAM received in the time that is counted.
    pub scans: u64,
    /// Scans that were sent and not received; see `counted_s`. `None`: not known, as SLAM is on another machine.
    pub scans_lost: Option<u64>,
    /// Figures of the robot's own map.
    pub map: MapView,
    /// TF jitter: |(receive - stamp) - its mean|, pooled over the robot's transforms, milliseconds.
    pub tf_jitter_ms: DistributionView,
    /// Delay from the simulator's scan to SLAM's pose, milliseconds.
    pub scan_to_pose_ms: DistributionView,
    /// Delay from the simulator's scan to the map that contains it, milliseconds.
    pub scan_to_map_ms: DistributionView,
    /// Pose of `base_footprint` in `robotK/map`: x m, y m, yaw rad; `None`: no scan yet, or the robot is lost.
    pub pose: Option<[f64; 3]>,
    /// Distance of SLAM's pose from the true pose, metres; `None`: not a simulation.
    pub pose_error_m: Option<f64>,
    /// Number of nodes in the pose graph.
    pub nodes: u32,
    /// Number of loop closures in the pose graph.
    pub closures: u32,
    /// Whether the robot's map is part of the merged map.
    pub merged: bool,
    /// Age of its part of the merged map, seconds: time since merging last heard of its SLAM; `None`: never.
    pub map_age_s: Option<f64>,
    /// State of its battery; `None`: it has sent nothing, or the bridge was not asked.
    pub battery: Option<BatteryStatus>,
    /// Where merging puts its map, against the truth as seen from the first merged robot: metres.
    pub map_transform_error_m: Option<f64>,
    /// The same, degrees.
    pub map_transform_error_deg: Option<f64>,
}

/// Figures of a map.
#[derive(Clone, Debug, Serialize)]
pub struct MapView {
    /// The paper's seven figures: free, occupied, unknown, total cells, width, height (cells), resolution (m).
    pub slam_stats: [f64; 7],
    /// Known cells over all cells, 0 to 1.
    pub coverage: f64,
}

/// Median and tail of a distribution, in the unit of the field that holds it.
#[derive(Clone, Debug, Serialize)]
pub struct DistributionView {
    /// Number of values.
    pub count: u64,
    /// 50th percentile of the values; `None` without values, like the others.
    pub p50: Option<f32>,
    /// 95th percentile of the values.
    pub p95: Option<f32>,
    /// 99th percentile of the values.
    pub p99: Option<f32>,
    /// Largest of the values.
    pub max: Option<f32>,
}

/// Health of one process.
// More than 12 fields: the fields are the keys of one flat JSON object, which scripts read.
#[derive(Clone, Debug, Serialize)]
pub struct ProcessView {
    /// `sim of robot2`, `merge` ...
    pub process: String,
    /// Process id of the operating system; 0: it has not reported.
    pub pid: u32,
    /// `up`, `silent` if no heartbeat came for 2.5 s, `not reporting` if none ever came, `ended` if its process is no more, or
    /// `failing` if it dies again and again.
    pub state: &'static str,
    /// Number of restarts.
    pub restarts: u64,
    /// Messages of its main input received.
    pub received: u64,
    /// Messages of its main input lost.
    pub lost: u64,
    /// Messages dropped for slow readers.
    pub dropped: u64,
    /// Messages refused because their content is invalid.
    pub refused: u64,
    /// Clients attached (bridge).
    pub clients: u32,
    /// Time per unit of work, median of the last second, microseconds.
    pub work_p50_us: f32,
    /// Time per unit of work, largest of the last second, microseconds.
    pub work_max_us: f32,
    /// Delay of periodic work, median of the last second, microseconds.
    pub late_p50_us: f32,
    /// Delay of periodic work, largest of the last second, microseconds.
    pub late_max_us: f32,
    /// Resident memory, megabytes.
    pub memory_mb: f64,
    /// CPU time since its start, seconds.
    pub cpu_s: f64,
}

/// Age of the newest heartbeat after which a process counts as silent, seconds: two are missing then.
const SILENT_AFTER_S: f64 = 2.5;
/// Time without any heartbeat after which a process counts as not reporting, seconds: it has 10 s to start, and then reports once a
/// second.
const NOT_REPORTING_AFTER_S: f64 = 12.0;

impl FleetView {
    /// Removes the figures of time, where time is virtual and they say nothing.
    pub fn on_virtual_time(mut self) -> Self {
        let nothing = DistributionView { count: 0, p50: None, p95: None, p99: None, max: None };
        for robot in &mut self.robots {
            (robot.tf_jitter_ms, robot.scan_to_pose_ms) = (nothing.clone(), nothing.clone());
            robot.scan_to_map_ms = nothing.clone();
        }
        self
    }

    /// Removes the errors of the robots' map transforms where these were given, because the starts are known: they say nothing.
    pub fn without_given_transforms(mut self, starts_known: bool) -> Self {
        if starts_known {
            for robot in &mut self.robots {
                (robot.map_transform_error_m, robot.map_transform_error_deg) = (None, None);
            }
        }
        self
    }

    /// Adds the robots' own names, robot1's first. An empty one is none.
    #[must_use]
    pub fn with_names(mut self, names: &[String]) -> Self {
        for (robot, name) in self.robots.iter_mut().zip(names) {
            robot.name = Some(name.clone()).filter(|name| !name.is_empty() && *name != robot.robot);
        }
        self
    }

    /// Marks the processes that are no more; `is_alive` tells it of a process id on this machine.
    pub fn with_ended_processes(mut self, is_alive: impl Fn(u32) -> bool) -> Self {
        for process in self.processes.iter_mut().filter(|process| process.pid != 0 && !is_alive(process.pid))
        {
            process.state = "ended";
        }
        self
    }

    /// Marks the processes that die again and again, as `is_failing` tells by their names.
    #[must_use]
    pub fn with_failing_processes(mut self, is_failing: impl Fn(&str) -> bool) -> Self {
        for process in self.processes.iter_mut().filter(|process| is_failing(&process.process)) {
            process.state = "failing";
        }
        self
    }

    /// Converts telemetry's message; edges and the bridge's state are added by the caller.
    pub fn new(stats: &FleetStats) -> Self {
        let count = (stats.robot_count as usize).min(stats.robots.len());
        let pairs = stats.pair_count > 0;
        let of_pairs = |value: f64| (pairs && value.is_finite()).then_some(value);
        Self {
            time_s: stats.header.stamp.seconds(),
            counted_s: stats.counted_s,
            maps_age_s: finite(stats.maps_age_s),
            robots: RobotId::first(count)
                .map(|robot| RobotView::new(robot, &stats.robots[robot.index()]))
                .collect(),
            merged_map: MapView::new(&stats.merged_map),
            room_coverage: finite(stats.room_coverage),
            pairs: stats.pair_count,
            consistency: of_pairs(stats.consistency),
            consistency_one_cell: of_pairs(stats.consistency_one_cell),
            occupied_f1: of_pairs(stats.occupied_f1),
            overlap_m2: of_pairs(stats.overlap_m2),
            null_transforms: stats.null_count,
            null_consistency_mean: finite(stats.null_consistency_mean),
            null_f1_mean: finite(stats.null_f1_mean),
            against_room: AgainstRoomView::new(stats),
            merge_edges: Vec::new(),
            contradicted_starts: Vec::new(),
            edges_unsaved: false,
            processes: stats.processes.iter().filter_map(ProcessView::new).collect(),
            bridge: None,
            bridge_silence: None,
        }
    }
}

impl RobotView {
    /// Returns whether SLAM does not know where the robot is.
    pub fn is_lost(&self) -> bool {
        self.state == TrackingState::Lost.name()
    }

    /// Returns whether there is evidence that the robot's map is wrong.
    pub fn is_unreliable(&self) -> bool {
        self.state == TrackingState::MapUnreliable.name()
    }

    /// Returns whether scans came once and do not come any more.
    pub fn has_stale_scans(&self) -> bool {
        self.scans > 0 && self.scan_hz_last_second == 0.0
    }

    /// Returns the age of its part of the merged map, seconds, if that part is old.
    pub fn old_map_age_s(&self) -> Option<f64> {
        self.map_age_s.filter(|age_s| self.merged && *age_s > MAP_OLD_AFTER_S)
    }

    /// Known share of the robot's map, 0 to 1; `None`: it has no map.
    pub fn coverage(&self) -> Option<f64> {
        (self.map.slam_stats[3] > 0.0).then_some(self.map.coverage)
    }

    fn new(robot: RobotId, stats: &RobotStats) -> Self {
        let Pose2 { x_m, y_m, yaw_rad } = stats.map_from_base;
        let has_pose = stats.scans > 0 && stats.state != TrackingState::Lost as u32;
        Self {
            robot: robot.to_string(),
            name: None,
            state: TrackingState::from_code(stats.state).map_or("?", TrackingState::name),
            scan_hz: None,
            scan_hz_last_second: stats.scan_hz,
            scans: stats.scans,
            scans_lost: (stats.scans_lost_unknown == 0).then_some(stats.scans_lost),
            map: MapView::new(stats),
            tf_jitter_ms: DistributionView::new(&stats.tf_jitter_ms),
            scan_to_pose_ms: DistributionView::new(&stats.scan_to_pose_ms),
            scan_to_map_ms: DistributionView::new(&stats.scan_to_map_ms),
            pose: has_pose.then_some([x_m, y_m, yaw_rad]),
            pose_error_m: finite(stats.pose_error_m),
            nodes: stats.nodes,
            closures: stats.closures,
            merged: stats.is_merged == 1,
            map_age_s: finite(stats.map_age_s),
            battery: None,
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
        let [p50, p95, p99, max] = [p50, p95, p99, max].map(|value| (count > 0).then_some(value));
        Self { count, p50, p95, p99, max }
    }
}

impl ProcessView {
    fn new(stats: &ProcessStats) -> Option<Self> {
        let health = &stats.health;
        let role = Role::from_code(health.role)?;
        let has_reported = health.pid != 0;
        // One that has just been started is not listed yet.
        if !has_reported && stats.age_s < NOT_REPORTING_AFTER_S {
            return None;
        }
        let process = match RobotId::new(health.robot as usize) {
            Some(robot) => format!("{} of {robot}", role.name()),
            None => role.name().into(),
        };
        Some(Self {
            process,
            pid: health.pid,
            state: match (has_reported, stats.age_s < SILENT_AFTER_S) {
                (false, _) => "not reporting",
                (true, true) => "up",
                (true, false) => "silent",
            },
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

/// Returns a value that is known.
pub(crate) fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}
