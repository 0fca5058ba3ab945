//! The fleet's figures, once a second.

use crate::pairs::{Pairs, PlacedMap};
use crate::processes::Processes;
use crate::robot::{Robot, count};
use crate::truth::{MapErrors, ObservableArea};
use msg::{
    Correction, FleetStats, Grid, GridView, GroundTruth, Header, MapTransforms, Monotonic, Pose2,
    ProcessHealth, ROBOTS_MAX, RobotId, RobotStats, Stamp, Transforms,
};

/// Walls are compared with the room's each so many calls, and each so many cells of the map one call later: two
/// distance transforms, about 40 ms a million cells.
const AGAINST_ROOM_CALLS: usize = 5;
const AGAINST_ROOM_CELLS: usize = 100_000;

/// Takes in what the processes say, and sums it up.
///
/// `received` is when the message reached telemetry. A robot that the fleet does not have is
/// ignored. Transforms and corrections cost a few operations and no allocation; maps are copied
/// when they come and compared in [`Telemetry::compute_stats`].
pub struct Telemetry {
    robots: Vec<Robot>,
    room: Option<ObservableArea>,
    merged: Grid,
    merged_counts: RobotStats,
    merged_version: u64,
    map_transforms: MapTransforms,
    room_coverage: Option<(u64, Pose2, f64)>,
    /// The merged map's walls against the room's, and how long ago, in calls, that was.
    against_room: Option<MapErrors>,
    against_room_age: usize,
    pairs: Pairs,
    processes: Processes,
    stats: FleetStats,
}

impl Telemetry {
    /// `room_plan` is the room, frame `world`, if it is known; `world_from_robot_map` says where
    /// each robot's map truly lies, by [`RobotId::index`], if that is known.
    pub fn new(robot_count: usize, room_plan: Option<Grid>, world_from_robot_map: &[Option<Pose2>]) -> Self {
        let place = |index: usize| world_from_robot_map.get(index).copied().flatten();
        let robot = |index| Robot::new(place(index));
        let robot_count = robot_count.min(ROBOTS_MAX);
        let starts_m = (0..robot_count).filter_map(place).map(|pose| [pose.x_m, pose.y_m]);
        let sound_plan = room_plan.filter(|plan| GridView::new(&plan.header, &plan.cells).is_some());
        Self {
            robots: (0..robot_count).map(robot).collect(),
            room: sound_plan.map(|plan| ObservableArea::new(plan, starts_m)),
            merged: Grid::default(),
            merged_counts: RobotStats::default(),
            merged_version: 0,
            map_transforms: MapTransforms::default(),
            room_coverage: None,
            against_room: None,
            against_room_age: 0,
            pairs: Pairs::new(),
            processes: Processes::new(robot_count),
            stats: FleetStats::default(),
        }
    }

    /// A robot's part of /tf.
    pub fn add_transforms(&mut self, robot: RobotId, transforms: &Transforms, received: Monotonic) {
        if let Some(robot) = self.robots.get_mut(robot.index()) {
            robot.jitter.add(transforms, received);
        }
    }

    /// SLAM's answer to a scan.
    pub fn add_correction(&mut self, robot: RobotId, correction: &Correction, received: Monotonic) {
        if let Some(robot) = self.robots.get_mut(robot.index()) {
            robot.correction(correction, received);
        }
    }

    /// A robot's map has come; what is in it need be said only now and then, with [`Telemetry::update_map`].
    pub fn record_map_arrival(&mut self, robot: RobotId, scan_sent: Monotonic, received: Monotonic) {
        if let Some(robot) = self.robots.get_mut(robot.index()) {
            robot.map_came(scan_sent, received);
        }
    }

    /// A robot's map as it is. One that makes no sense is ignored.
    pub fn update_map(&mut self, robot: RobotId, map: GridView<'_>) {
        if let Some(robot) = self.robots.get_mut(robot.index()) {
            robot.map(map);
        }
    }

    /// Both at once.
    pub fn add_map(&mut self, robot: RobotId, map: GridView<'_>, received: Monotonic) {
        self.record_map_arrival(robot, map.header.scan_sent, received);
        self.update_map(robot, map);
    }

    /// The fleet's map. One that makes no sense is ignored.
    pub fn update_merged_map(&mut self, map: GridView<'_>, _received: Monotonic) {
        if GridView::new(map.header, map.cells).is_none() {
            return;
        }
        self.merged.header = *map.header;
        self.merged.cells.clear();
        self.merged.cells.extend_from_slice(map.cells);
        self.merged_counts = count(map);
        self.merged_version += 1;
    }

    /// Where the robots' maps lie in the fleet's.
    pub fn map_transforms(&mut self, map_transforms: &MapTransforms) {
        self.map_transforms = *map_transforms;
    }

    /// Where a simulated robot really is.
    pub fn add_truth(&mut self, robot: RobotId, truth: &GroundTruth) {
        if let Some(robot) = self.robots.get_mut(robot.index()) {
            robot.truth(truth);
        }
    }

    /// A process's account of itself.
    pub fn process_health(&mut self, message: &ProcessHealth, received: Monotonic) {
        self.processes.receive(message, received);
    }

    /// The figures at `stamp` of the run's clock, which is `now` on the machine's. Compares at most
    /// a bounded number of cells: with many large maps the pairs take turns.
    pub fn compute_stats(&mut self, stamp: Stamp, now: Monotonic) -> &FleetStats {
        let map_transform = |index: usize| {
            let map_transform = &self.map_transforms.robots[index];
            (map_transform.known == 1 && map_transform.map_from_robot_map.is_finite())
                .then_some(map_transform.map_from_robot_map)
        };
        let maps = self.robots.iter().enumerate();
        let maps: Vec<_> = maps
            .map(|(index, robot)| PlacedMap {
                grid: &robot.grid,
                version: robot.version,
                map_from_robot_map: map_transform(index),
            })
            .collect();
        self.pairs.refresh(&maps);
        self.pairs.draw_null(&maps);
        let pairs = self.pairs.means();
        let room = self.against_room();
        self.stats = FleetStats {
            header: Header { stamp, ..Default::default() },
            robot_count: self.robots.len() as u32,
            pair_count: pairs.count,
            merged: self.merged_counts,
            room_coverage: self.room_coverage(),
            consistency: pairs.mean.strict,
            consistency_one_cell: pairs.mean.one_cell,
            occupied_f1: pairs.mean.occupied_f1,
            overlap_m2: pairs.mean.overlap_m2,
            null_consistency_mean: pairs.null[0],
            null_f1_mean: pairs.null[1],
            null_count: pairs.null_count,
            room_f1: room.occupied_f1,
            map_to_room_m: room.map_to_room_m,
            room_to_map_m: room.room_to_map_m,
            wall_thickness_m: room.wall_thickness_m,
            processes: self.processes.health(now),
            ..Default::default()
        };
        let world_from_map = self.world_from_map();
        let robots = self.robots.iter().zip(&self.map_transforms.robots);
        for (stats, (robot, map_transform)) in self.stats.robots.iter_mut().zip(robots) {
            let place =
                Some(map_transform.map_from_robot_map).filter(|p| map_transform.known == 1 && p.is_finite());
            let error = world_from_map.zip(place).zip(robot.world_from_robot_map);
            let [error_m, error_rad] = error.map_or([f64::NAN; 2], |((world_from_map, place), truth)| {
                let off = truth.between(world_from_map * place);
                [off.x_m.hypot(off.y_m), off.yaw_rad.abs()]
            });
            *stats = RobotStats {
                map_transform_error_m: error_m,
                map_transform_error_rad: error_rad,
                merged: u32::from(place.is_some()),
                ..robot.stats(stamp)
            };
        }
        &self.stats
    }

    /// NaN where the room or the place is not known. The newest that was computed, now and then.
    fn against_room(&mut self) -> MapErrors {
        let unknown = MapErrors {
            occupied_f1: f64::NAN,
            map_to_room_m: f64::NAN,
            room_to_map_m: f64::NAN,
            coverage: f64::NAN,
            wall_thickness_m: f64::NAN,
        };
        let (Some(room), Some(world_from_map)) = (&self.room, self.world_from_map()) else {
            self.against_room = None;
            return unknown;
        };
        self.against_room_age += 1;
        let due = AGAINST_ROOM_CALLS + self.merged.cells.len() / AGAINST_ROOM_CELLS;
        if self.merged_version > 0 && (self.against_room.is_none() || self.against_room_age >= due) {
            self.against_room = Some(room.compare(self.merged.view(), world_from_map));
            self.against_room_age = 0;
        }
        self.against_room.unwrap_or(unknown)
    }

    /// Computed when the merged map or its place changed; NaN if the room or the place is not known.
    fn room_coverage(&mut self) -> f64 {
        let (Some(room), Some(world_from_map)) = (&self.room, self.world_from_map()) else { return f64::NAN };
        match self.room_coverage {
            Some((version, place, coverage)) if version == self.merged_version && place == world_from_map => {
                coverage
            }
            _ => {
                let coverage = room.coverage(self.merged.view(), world_from_map);
                self.room_coverage = Some((self.merged_version, world_from_map, coverage));
                coverage
            }
        }
    }

    /// By the first robot whose map's place is known both in the world and in the merged map.
    fn world_from_map(&self) -> Option<Pose2> {
        self.robots.iter().zip(&self.map_transforms.robots).find_map(|(robot, map_transform)| {
            let world_from_robot_map = robot.world_from_robot_map?;
            (map_transform.known == 1)
                .then(|| world_from_robot_map * map_transform.map_from_robot_map.inverse())
        })
    }
}

#[cfg(test)]
mod tests;
