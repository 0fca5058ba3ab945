//! What every door is told of the fleet.

use crate::bridge::Bridge;
use msg::{Clock, Correction, FleetStats, GridView, MapTransforms, Odometry, RobotId, Scan, Transforms};

/// A door: the fleet's messages go out through it. Every method returns at once.
pub trait Outlet {
    /// `/robotN/scan`.
    fn scan(&self, robot: RobotId, scan: &Scan);
    /// `/tf`: the robot's own links.
    fn transforms(&self, robot: RobotId, transforms: &Transforms);
    /// `/tf`: the robot's map from its odometry; `/robotN/pose`.
    fn correction(&self, robot: RobotId, correction: &Correction);
    /// `/tf`: the merged map from the robots' maps.
    fn map_transforms(&self, map_transforms: &MapTransforms);
    /// `/clock`.
    fn clock(&self, clock: &Clock);
    /// `/robotN/odom`.
    fn odometry(&self, robot: RobotId, odometry: &Odometry);
    /// `/robotN/map`.
    fn map(&self, robot: RobotId, map: GridView<'_>);
    /// `/merged_map`.
    fn merged_map(&self, map: GridView<'_>);
    /// `/robotN/slam_stats` of every robot.
    fn stats(&self, stats: &FleetStats);
    /// `/merge_edges`, as JSON.
    fn merge_edges(&self, json: &str);
}

impl Outlet for Bridge {
    fn scan(&self, robot: RobotId, scan: &Scan) {
        self.scan(robot, scan);
    }
    fn transforms(&self, robot: RobotId, transforms: &Transforms) {
        self.transforms(robot, transforms);
    }
    fn correction(&self, robot: RobotId, correction: &Correction) {
        self.correction(robot, correction);
    }
    fn map_transforms(&self, map_transforms: &MapTransforms) {
        self.map_transforms(map_transforms);
    }
    fn clock(&self, clock: &Clock) {
        self.clock(clock);
    }
    fn odometry(&self, robot: RobotId, odometry: &Odometry) {
        self.odometry(robot, odometry);
    }
    fn map(&self, robot: RobotId, map: GridView<'_>) {
        self.map(robot, map);
    }
    fn merged_map(&self, map: GridView<'_>) {
        self.merged_map(map);
    }
    fn stats(&self, stats: &FleetStats) {
        self.stats(stats);
    }
    fn merge_edges(&self, json: &str) {
        self.merge_edges(json);
    }
}
