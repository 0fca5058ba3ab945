//! Statistics of the fleet, once a second.

use crate::map_metrics::{MapFigures, known_transform, true_transform, world_from_map};
use crate::merged::RoomAccuracy;
use crate::processes::ProcessTable;
use crate::robot::RobotTelemetry;
use msg::{
    FleetStats, GroundTruth, Header, MapTransforms, Monotonic, Pose2, PoseEstimate, ProcessHealth,
    ROBOTS_MAX, RobotId, RobotStats, Role, Stamp, Transforms,
};

/// Collects what the processes of a fleet send, and computes the fleet's statistics from it.
///
/// `received` is the time at which a message reached telemetry. Messages about a robot that the fleet does not have are
/// ignored. Each message costs a few operations and no allocation. What is computed from the cells of maps comes from
/// [`crate::MapMetrics`] when it is ready, by [`Telemetry::set_map_figures`].
///
/// ```
/// use msg::{PoseEstimate, Header, Monotonic, RobotId, Stamp};
/// use telemetry::Telemetry;
///
/// // SLAM answers ten scans a second, each 12 ms after it was sent.
/// let mut telemetry = Telemetry::new(1, &[], Monotonic(1_000_000_000));
/// let robot = RobotId::new(1).unwrap();
/// for n in 0..50_u64 {
///     let header = Header { stamp: Stamp(n as i64 * 100_000_000), seq: n, incarnation: 1, ..Default::default() };
///     let sent = Monotonic(1_000_000_000 + n * 100_000_000);
///     let pose_estimate = PoseEstimate { header, scan_seq: n, scan_sent: sent, ..Default::default() };
///     telemetry.add_pose_estimate(robot, &pose_estimate, Monotonic(sent.0 + 12_000_000));
/// }
/// let stats = telemetry.compute_stats(Stamp(4_950_000_000), Monotonic(6_000_000_000));
/// assert!((stats.robots[0].scan_hz - 10.0).abs() < 1e-9);
/// assert!((stats.robots[0].scan_to_pose_ms.p50 - 12.0).abs() < 0.1);
/// assert_eq!(stats.robots[0].scans_lost, 0);
/// ```
pub struct Telemetry {
    robots: Vec<RobotTelemetry>,
    /// Frame `world` from frame `robotK/map`, as far as it is known.
    world_from_robot_map: Vec<Option<Pose2>>,
    map_transforms: MapTransforms,
    map_figures: MapFigures,
    /// When the maps were taken from which these figures are; zero: there are none yet.
    maps_taken: Monotonic,
    processes: ProcessTable,
    /// When counting began.
    begun: Monotonic,
    are_lost_scans_known: bool,
    stats: FleetStats,
}

impl Telemetry {
    /// Creates the telemetry of a fleet, which counts from `begun` on.
    ///
    /// `world_from_robot_map` is where each robot's map lies in truth, by [`RobotId::index`], if that is known.
    pub fn new(robot_count: usize, world_from_robot_map: &[Option<Pose2>], begun: Monotonic) -> Self {
        let truth = |index: usize| world_from_robot_map.get(index).copied().flatten();
        let world_from_robot_map: Vec<_> = (0..robot_count.min(ROBOTS_MAX)).map(truth).collect();
        Self {
            robots: world_from_robot_map.iter().map(|_| RobotTelemetry::default()).collect(),
            processes: ProcessTable::new(world_from_robot_map.len()),
            world_from_robot_map,
            map_transforms: MapTransforms::default(),
            map_figures: MapFigures::default(),
            maps_taken: Monotonic::default(),
            begun,
            are_lost_scans_known: true,
            stats: FleetStats::default(),
        }
    }

    /// Says that pose estimates come from other machines, and not one for each scan: lost scans cannot be told by them.
    pub fn set_lost_scans_unknown(&mut self) {
        self.are_lost_scans_known = false;
    }

    /// Names a process of the fleet, which is listed also if it never reports.
    pub fn expect_process(&mut self, role: Role, robot: Option<RobotId>, now: Monotonic) {
        self.processes.expect(role, robot, now);
    }

    /// Adds a robot's transforms, for their jitter.
    pub fn add_transforms(&mut self, robot: RobotId, transforms: &Transforms, received: Monotonic) {
        if let Some(robot) = self.robots.get_mut(robot.index()) {
            robot.jitter.add(transforms, received);
        }
    }

    /// Adds SLAM's answer to a scan.
    pub fn add_pose_estimate(&mut self, robot: RobotId, pose_estimate: &PoseEstimate, received: Monotonic) {
        if let Some(robot) = self.robots.get_mut(robot.index()) {
            robot.add_pose_estimate(pose_estimate, received);
        }
    }

    /// Records that a robot's map has arrived.
    pub fn record_map_arrival(&mut self, robot: RobotId, scan_sent: Monotonic, received: Monotonic) {
        if let Some(robot) = self.robots.get_mut(robot.index()) {
            robot.record_map_arrival(scan_sent, received);
        }
    }

    /// Replaces the metrics of the maps by those of the maps at `taken`.
    pub fn set_map_figures(&mut self, map_figures: MapFigures, taken: Monotonic) {
        (self.map_figures, self.maps_taken) = (map_figures, taken);
    }

    /// Replaces the transforms of the robots' maps in the merged map.
    pub fn update_map_transforms(&mut self, map_transforms: &MapTransforms) {
        self.map_transforms = *map_transforms;
    }

    /// Adds the true pose of a simulated robot.
    pub fn add_truth(&mut self, robot: RobotId, truth: &GroundTruth) {
        if let Some(robot) = self.robots.get_mut(robot.index()) {
            robot.add_truth(truth);
        }
    }

    /// Records the health that a process reports.
    pub fn add_process_health(&mut self, message: &ProcessHealth, received: Monotonic) {
        self.processes.receive(message, received);
    }

    /// Computes the statistics at `stamp` of the run's clock, which is `now` on the machine's.
    ///
    /// The metrics of the maps in it are the newest that were set; it says how old their maps are.
    pub fn compute_stats(&mut self, stamp: Stamp, now: Monotonic) -> &FleetStats {
        let MapFigures { robots: map_counts, merged_map, pairs, room_coverage, accuracy } = &self.map_figures;
        let RoomAccuracy { placed, aligned } = accuracy;
        let world_from_map = world_from_map(&self.world_from_robot_map, &self.map_transforms);
        self.stats = FleetStats {
            header: Header { stamp, ..Default::default() },
            robot_count: self.robots.len() as u32,
            pair_count: pairs.count,
            merged_map: *merged_map,
            room_coverage: *room_coverage,
            consistency: pairs.mean.agreement,
            consistency_one_cell: pairs.mean.agreement_near,
            occupied_f1: pairs.mean.occupied_f1,
            overlap_m2: pairs.mean.overlap_m2,
            null_consistency_mean: pairs.null_agreement_mean,
            null_f1_mean: pairs.null_f1_mean,
            null_count: pairs.null_count,
            room_f1: placed.occupied_f1,
            map_to_room_m: placed.map_to_room_m,
            room_to_map_m: placed.room_to_map_m,
            wall_thickness_m: placed.wall_thickness_m,
            aligned_room_coverage: aligned.accuracy.room_coverage,
            aligned_room_f1: aligned.accuracy.occupied_f1,
            aligned_map_to_room_m: aligned.accuracy.map_to_room_m,
            aligned_room_to_map_m: aligned.accuracy.room_to_map_m,
            aligned_by_m: aligned.moved_m,
            aligned_by_rad: aligned.turned_rad,
            counted_s: now.since(self.begun) as f64 * 1e-9,
            maps_age_s: age_s(self.maps_taken, now),
            processes: self.processes.health(now),
            ..Default::default()
        };
        for (index, (robot, counts)) in self.robots.iter().zip(map_counts).enumerate() {
            let transform = known_transform(&self.map_transforms, index);
            let truth = true_transform(&self.world_from_robot_map, &self.map_transforms, index);
            let [error_m, error_rad] = transform_error(world_from_map, transform, truth);
            self.stats.robots[index] = RobotStats {
                map_transform_error_m: error_m,
                map_transform_error_rad: error_rad,
                is_merged: u32::from(transform.is_some()),
                scans_lost_unknown: u32::from(!self.are_lost_scans_known),
                map_age_s: age_s(self.map_transforms.pose_estimate_received[index], now),
                ..robot.stats(*counts, truth, now)
            };
        }
        &self.stats
    }
}

/// Returns the time since a moment, seconds; NaN if it is zero: never.
fn age_s(at: Monotonic, now: Monotonic) -> f64 {
    if at == Monotonic::default() { f64::NAN } else { now.since(at) as f64 * 1e-9 }
}

/// Returns the distance (metres) and rotation (radians) between the estimated and the true transform of a robot's map;
/// NaN if either is unknown.
fn transform_error(
    world_from_map: Option<Pose2>,
    map_from_robot_map: Option<Pose2>,
    world_from_robot_map: Option<Pose2>,
) -> [f64; 2] {
    let known = world_from_map.zip(map_from_robot_map).zip(world_from_robot_map);
    known.map_or([f64::NAN; 2], |((world_from_map, map_from_robot_map), truth)| {
        let error = truth.between(world_from_map * map_from_robot_map);
        [error.x_m.hypot(error.y_m), error.yaw_rad.abs()]
    })
}

#[cfg(test)]
mod tests;
