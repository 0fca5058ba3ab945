//! Statistics of the fleet, once a second.

use crate::merged::MergedMap;
use crate::pairs::{PairComparisons, PlacedMap};
use crate::processes::ProcessTable;
use crate::robot::RobotTelemetry;
use crate::truth::ObservableArea;
use msg::{
    FleetStats, Grid, GridView, GroundTruth, Header, MapTransforms, Monotonic, Pose2, PoseEstimate,
    ProcessHealth, ROBOTS_MAX, RobotId, RobotStats, Role, Stamp, Transforms,
};

/// Collects what the processes of a fleet send, and computes the fleet's statistics from it.
///
/// `received` is the time at which a message reached telemetry. Messages about a robot that the fleet does not have are
/// ignored. Transforms and pose estimates cost a few operations and no allocation. Maps are copied when they come and
/// compared in [`Telemetry::compute_stats`].
///
/// ```
/// use msg::{PoseEstimate, Header, Monotonic, RobotId, Stamp};
/// use telemetry::Telemetry;
///
/// // SLAM answers ten scans a second, each 12 ms after it was sent.
/// let mut telemetry = Telemetry::new(1, None, &[]);
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
    /// Where the robots start, frame `world`, metres, as far as it is known.
    starts_m: Vec<[f64; 2]>,
    room: Option<ObservableArea>,
    merged: MergedMap,
    map_transforms: MapTransforms,
    pairs: PairComparisons,
    processes: ProcessTable,
    stats: FleetStats,
}

impl Telemetry {
    /// Creates the telemetry of a fleet.
    ///
    /// `room_plan` is the room's floor plan in frame `world`, if it is known; [`Telemetry::set_room`] sets it later. `world_from_robot_map` is where each
    /// robot's map lies in truth, by [`RobotId::index`], if that is known.
    pub fn new(robot_count: usize, room_plan: Option<Grid>, world_from_robot_map: &[Option<Pose2>]) -> Self {
        let truth = |index: usize| world_from_robot_map.get(index).copied().flatten();
        let robot_count = robot_count.min(ROBOTS_MAX);
        let mut telemetry = Self {
            robots: (0..robot_count).map(|index| RobotTelemetry::new(truth(index))).collect(),
            starts_m: (0..robot_count).filter_map(truth).map(|pose| [pose.x_m, pose.y_m]).collect(),
            room: None,
            merged: MergedMap::default(),
            map_transforms: MapTransforms::default(),
            pairs: PairComparisons::new(robot_count),
            processes: ProcessTable::new(robot_count),
            stats: FleetStats::default(),
        };
        if let Some(plan) = room_plan {
            telemetry.set_room(plan);
        }
        telemetry
    }

    /// Sets the room's floor plan in frame `world`. Until then coverage and errors against the room are unknown. A malformed
    /// plan is ignored.
    pub fn set_room(&mut self, plan: Grid) {
        if GridView::new(&plan.header, &plan.cells).is_some() {
            self.room = Some(ObservableArea::new(plan, self.starts_m.iter().copied()));
        }
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

    /// Records that a robot's map has arrived. Its cells need be given only now and then, by [`Telemetry::update_map`].
    pub fn record_map_arrival(&mut self, robot: RobotId, scan_sent: Monotonic, received: Monotonic) {
        if let Some(robot) = self.robots.get_mut(robot.index()) {
            robot.record_map_arrival(scan_sent, received);
        }
    }

    /// Replaces a robot's map. A malformed one is ignored.
    pub fn update_map(&mut self, robot: RobotId, map: GridView<'_>) {
        if let Some(robot) = self.robots.get_mut(robot.index()) {
            robot.update_map(map);
        }
    }

    /// Records a map's arrival and replaces the robot's map.
    pub fn add_map(&mut self, robot: RobotId, map: GridView<'_>, received: Monotonic) {
        self.record_map_arrival(robot, map.header.scan_sent, received);
        self.update_map(robot, map);
    }

    /// Replaces the merged map. A malformed one is ignored.
    pub fn update_merged_map(&mut self, map: GridView<'_>, _received: Monotonic) {
        self.merged.update(map);
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
    /// It compares a bounded number of cells: many large maps take turns.
    pub fn compute_stats(&mut self, stamp: Stamp, now: Monotonic) -> &FleetStats {
        self.compare_pairs();
        let pairs = self.pairs.means();
        let (room, world_from_map) = (self.room.as_ref(), self.world_from_map());
        let accuracy = self.merged.accuracy(room, world_from_map);
        self.stats = FleetStats {
            header: Header { stamp, ..Default::default() },
            robot_count: self.robots.len() as u32,
            pair_count: pairs.count,
            merged_map: self.merged.counts(),
            room_coverage: self.merged.room_coverage(room, world_from_map),
            consistency: pairs.mean.agreement,
            consistency_one_cell: pairs.mean.agreement_near,
            occupied_f1: pairs.mean.occupied_f1,
            overlap_m2: pairs.mean.overlap_m2,
            null_consistency_mean: pairs.null_agreement_mean,
            null_f1_mean: pairs.null_f1_mean,
            null_count: pairs.null_count,
            room_f1: accuracy.occupied_f1,
            map_to_room_m: accuracy.map_to_room_m,
            room_to_map_m: accuracy.room_to_map_m,
            wall_thickness_m: accuracy.wall_thickness_m,
            processes: self.processes.health(now),
            ..Default::default()
        };
        for (index, robot) in self.robots.iter().enumerate() {
            let transform = self.map_transform(index);
            let truth = robot.world_from_robot_map;
            let [error_m, error_rad] = transform_error(world_from_map, transform, truth);
            self.stats.robots[index] = RobotStats {
                map_transform_error_m: error_m,
                map_transform_error_rad: error_rad,
                is_merged: u32::from(transform.is_some()),
                map_age_s: age_s(self.map_transforms.pose_estimate_received[index], now),
                ..robot.stats(now)
            };
        }
        &self.stats
    }

    /// Compares the pairs of maps that have changed, and draws one more wrong transform.
    fn compare_pairs(&mut self) {
        let maps = self.robots.iter().enumerate();
        let maps: Vec<_> = maps
            .map(|(index, robot)| PlacedMap {
                grid: &robot.grid,
                version: robot.version,
                map_from_robot_map: self.map_transform(index),
            })
            .collect();
        self.pairs.refresh(&maps);
        self.pairs.draw_null(&maps);
    }

    /// Frame `map` from frame `robotK/map`, if it is known.
    fn map_transform(&self, index: usize) -> Option<Pose2> {
        self.map_transforms.robots[index].known_pose().filter(|pose| pose.is_finite())
    }

    /// Frame `world` from frame `map`, by the first robot whose map's place is known in both.
    fn world_from_map(&self) -> Option<Pose2> {
        self.robots.iter().zip(&self.map_transforms.robots).find_map(|(robot, transform)| {
            let world_from_robot_map = robot.world_from_robot_map?;
            Some(world_from_robot_map * transform.known_pose()?.inverse())
        })
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
