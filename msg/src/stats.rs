//! What telemetry found out, once a second.

use crate::{Header, Pose2, ProcessHealth, ROBOTS_MAX};
use bytemuck::{Pod, Zeroable};

/// The most processes a fleet has: two a robot, merge, telemetry, bridge.
pub const PROCESSES_MAX: usize = 2 * ROBOTS_MAX + 3;

/// A measured quantity's median and tail. `count` 0: nothing measured, all zero.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Distribution {
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

/// One robot's figures.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct RobotStats {
    /// Cells of the robot's map, map_server's thresholds: free.
    pub free_cells: u32,
    /// Occupied.
    pub occupied_cells: u32,
    /// Neither.
    pub unknown_cells: u32,
    /// Of the map, in cells.
    pub width: u32,
    /// Of the map, in cells.
    pub height: u32,
    /// A [`crate::TrackingState`]'s code.
    pub state: u32,
    /// Side of a cell, metres.
    pub resolution_m: f64,
    /// Known cells over all cells of the robot's map: the paper's coverage, 0 to 1.
    pub coverage: f64,
    /// Scans that reached SLAM in the last second of the run's clock.
    pub scan_hz: f64,
    /// Scans received since the start.
    pub scans: u64,
    /// Scans lost since the start.
    pub scans_lost: u64,
    /// TF jitter since the start, milliseconds: |(receive - stamp) - its mean|, per link, pooled.
    pub tf_jitter_ms: Distribution,
    /// From a scan's leaving the simulator to its correction, milliseconds, since the start.
    pub scan_to_pose_ms: Distribution,
    /// From a scan's leaving the simulator to the map that contains it, milliseconds, since the start.
    pub scan_to_map_ms: Distribution,
    /// `robotK/map` from `base_footprint`, newest.
    pub map_from_base: Pose2,
    /// Distance of SLAM's pose from the truth, metres, newest (simulation only, else NaN).
    pub pose_error_m: f64,
    /// Where merging puts the robot's map, against where it truly lies as seen from the first merged robot's map:
    /// metres and radians (simulation only, else NaN; NaN while it is not merged).
    pub map_transform_error_m: f64,
    /// See [`RobotStats::map_transform_error_m`].
    pub map_transform_error_rad: f64,
    /// Nodes in the pose graph.
    pub nodes: u32,
    /// Loop closures in force.
    pub closures: u32,
    /// 1: its map is in the merged map, 0: where it lies is not known yet.
    pub merged: u32,
    /// Zero.
    pub reserved: u32,
}

/// A process as telemetry sees it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct ProcessStats {
    /// Its newest account; `role` 0: no such process.
    pub health: ProcessHealth,
    /// Seconds since it was received.
    pub age_s: f64,
    /// How many incarnations before this one.
    pub restarts: u64,
}

/// The fleet's figures.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct FleetStats {
    /// `stamp` is the end of the second described.
    pub header: Header,
    /// How many robots the fleet has.
    pub robot_count: u32,
    /// How many pairs of maps overlap.
    pub pair_count: u32,
    /// By [`crate::RobotId::index`].
    pub robots: [RobotStats; ROBOTS_MAX],
    /// The merged map's figures (free, occupied, unknown, size, coverage; the rest zero).
    pub merged: RobotStats,
    /// Known cells of the merged map over the cells of the room that can be known, 0 to 1
    /// (simulation only, else NaN).
    pub room_coverage: f64,
    /// The paper's cross-instance consistency, mean over pairs of maps: of the cells that both
    /// know, the share on which they agree, 0 to 1.
    pub consistency: f64,
    /// The same, where a cell agrees if a neighbour does.
    pub consistency_one_cell: f64,
    /// F1 of occupied cells at one cell's tolerance, mean over pairs, 0 to 1.
    pub occupied_f1: f64,
    /// Floor that two maps both know, mean over pairs, square metres.
    pub overlap_m2: f64,
    /// What chance gives: the same two maps under wrong transforms that leave at least half the overlap. Strict
    /// consistency and F1, means over pairs and transforms; NaN before any.
    pub null_consistency_mean: f64,
    /// See [`FleetStats::null_consistency_mean`].
    pub null_f1_mean: f64,
    /// Wrong transforms that went into it, of all pairs.
    pub null_count: u32,
    /// Zero.
    pub reserved: u32,
    /// The merged map against the room (simulation only, else NaN): F1 of occupied cells at one cell's tolerance.
    pub room_f1: f64,
    /// Mean distance from the map's occupied cells to the room's nearest visible wall, metres.
    pub map_to_room_m: f64,
    /// Mean distance from the room's visible walls to the map's nearest occupied cell, metres.
    pub room_to_map_m: f64,
    /// Mean thickness of the merged map's walls, metres.
    pub wall_thickness_m: f64,
    /// In the launcher's order; unused ones have `health.role` 0.
    pub processes: [ProcessStats; PROCESSES_MAX],
}

impl Default for FleetStats {
    fn default() -> Self {
        Self::zeroed()
    }
}
