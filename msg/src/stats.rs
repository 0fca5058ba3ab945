//! Statistics of the fleet, which telemetry publishes once a second.

use crate::{Header, Pose2, ProcessHealth, ROBOTS_MAX};
use bytemuck::{Pod, Zeroable};

/// Largest number of processes of a fleet: two for each robot, and those of the fleet: merge, telemetry, bridge, recorder
/// and navigation today.
pub const PROCESSES_MAX: usize = 2 * ROBOTS_MAX + 8;

/// Percentiles of a measured quantity. With `count` 0, nothing was measured and all fields are zero.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Distribution {
    /// Number of measured values.
    pub count: u64,
    /// Median of the values.
    pub p50: f32,
    /// 95th percentile of the values.
    pub p95: f32,
    /// 99th percentile of the values.
    pub p99: f32,
    /// Largest of the values.
    pub max: f32,
}

/// Statistics of one robot.
// More than 12 fields: the message is one row of measurements, in a fixed layout.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct RobotStats {
    /// Number of free cells of the robot's map, by map_server's thresholds.
    pub free_cells: u32,
    /// Number of occupied cells, by map_server's thresholds.
    pub occupied_cells: u32,
    /// Number of cells that are neither free nor occupied.
    pub unknown_cells: u32,
    /// Width of the map, cells.
    pub width: u32,
    /// Height of the map, cells.
    pub height: u32,
    /// Code of a [`crate::TrackingState`].
    pub state: u32,
    /// Length of a cell's side, metres.
    pub resolution_m: f64,
    /// Known cells over all cells of the robot's map, 0 to 1: coverage as the MR-SLAM paper defines it.
    pub coverage: f64,
    /// Scans that reached SLAM in the last second of the run's clock, Hz.
    pub scan_hz: f64,
    /// Number of scans received since telemetry was started.
    pub scans: u64,
    /// Number of scans lost since telemetry was started; see `scans_lost_unknown`.
    pub scans_lost: u64,
    /// TF jitter since telemetry was started, milliseconds: |(receive - stamp) - its mean|, per link, pooled.
    pub tf_jitter_ms: Distribution,
    /// Latency from the simulator sending a scan to its pose estimate, milliseconds, since telemetry
    /// was started.
    pub scan_to_pose_ms: Distribution,
    /// Latency from the simulator sending a scan to the map that contains it, milliseconds, since telemetry
    /// was started.
    pub scan_to_map_ms: Distribution,
    /// Newest pose of `base_footprint` in `robotK/map`.
    pub map_from_base: Pose2,
    /// Newest distance of SLAM's pose from the true pose, metres. NaN without simulation.
    pub pose_error_m: f64,
    /// Error of the robot's map transform, relative to the first merged robot, metres. NaN without
    /// simulation and while the map is not merged.
    pub map_transform_error_m: f64,
    /// Error of the robot's map transform in heading, radians. NaN as
    /// [`RobotStats::map_transform_error_m`].
    pub map_transform_error_rad: f64,
    /// Number of nodes in the pose graph.
    pub nodes: u32,
    /// Number of loop closures in the pose graph.
    pub closures: u32,
    /// 1 if the robot's map is part of the merged map, 0 if its transform is unknown.
    pub is_merged: u32,
    /// 1 if `scans_lost` says nothing: SLAM is on another machine, and not each of its poses comes from there.
    pub scans_lost_unknown: u32,
    /// Age of the robot's part of the merged map: time since merging last received an answer of its SLAM to a scan,
    /// seconds. NaN before the first.
    pub map_age_s: f64,
}

/// Health of a process as telemetry received it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct ProcessStats {
    /// Newest health message of the process; `role` 0 means that there is no such process, `pid` 0 that it has not reported.
    pub health: ProcessHealth,
    /// Time since `health` was received, or since telemetry awaits it, seconds.
    pub age_s: f64,
    /// Number of times that the process was restarted.
    pub restarts: u64,
}

/// Statistics of the fleet.
// More than 12 fields: the message is one row of measurements, in a fixed layout.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct FleetStats {
    /// Header whose `stamp` is the end of the measured second.
    pub header: Header,
    /// Number of robots in the fleet.
    pub robot_count: u32,
    /// Number of pairs of maps that overlap.
    pub pair_count: u32,
    /// Statistics of each robot, by [`crate::RobotId::index`].
    pub robots: [RobotStats; ROBOTS_MAX],
    /// Statistics of the merged map (free, occupied, unknown, size, coverage; the rest is zero).
    pub merged_map: RobotStats,
    /// Known cells of the merged map over the observable cells of the room, 0 to 1; a wall is known within one cell. NaN
    /// without simulation.
    pub room_coverage: f64,
    /// Share of the cells known in both maps on which they agree, mean over pairs, 0 to 1: cross-instance
    /// consistency as the MR-SLAM paper defines it.
    pub consistency: f64,
    /// `consistency` with a tolerance of one cell: a cell agrees if a neighbour does.
    pub consistency_one_cell: f64,
    /// F1 score of occupied cells with a tolerance of one cell, mean over pairs, 0 to 1.
    pub occupied_f1: f64,
    /// Area that both maps of a pair know, mean over pairs, square metres.
    pub overlap_m2: f64,
    /// Consistency by chance: the mean over pairs under random wrong transforms that keep at least half of
    /// the overlap. NaN before the first.
    pub null_consistency_mean: f64,
    /// F1 score by chance, as [`FleetStats::null_consistency_mean`].
    pub null_f1_mean: f64,
    /// Number of wrong transforms evaluated, over all pairs.
    pub null_count: u32,
    /// Padding, always zero.
    pub reserved: u32,
    /// F1 score of the merged map's occupied cells against the room, tolerance one cell. NaN without simulation.
    pub room_f1: f64,
    /// Mean distance from the map's occupied cells to the nearest visible wall of the room, metres.
    pub map_to_room_m: f64,
    /// Mean distance from the room's visible walls to the nearest occupied cell of the map, metres.
    pub room_to_map_m: f64,
    /// Mean thickness of the merged map's walls, metres.
    pub wall_thickness_m: f64,
    /// [`FleetStats::room_coverage`] where the merged map lies best on the room. Its frame is the first robot's with unknown starts, and
    /// has the error of that robot's first scans.
    pub aligned_room_coverage: f64,
    /// F1 of occupied cells there, as [`FleetStats::room_f1`].
    pub aligned_room_f1: f64,
    /// Distance of the map's walls from the room's there, as [`FleetStats::map_to_room_m`].
    pub aligned_map_to_room_m: f64,
    /// Distance of the room's walls from the map's there, as [`FleetStats::room_to_map_m`].
    pub aligned_room_to_map_m: f64,
    /// By how much the map's origin is moved for that, metres.
    pub aligned_by_m: f64,
    /// By how much the map is turned for that, radians, 0 to pi.
    pub aligned_by_rad: f64,
    /// Time over which the robots' counts and distributions are counted, seconds: since telemetry was started last.
    pub counted_s: f64,
    /// Age of the maps from which all that is said of maps was computed, seconds. NaN before the first.
    pub maps_age_s: f64,
    /// Health of the processes in the launcher's order; unused entries have `health.role` 0.
    pub processes: [ProcessStats; PROCESSES_MAX],
}

impl Default for FleetStats {
    fn default() -> Self {
        Self::zeroed()
    }
}
