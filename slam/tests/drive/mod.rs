//! A robot that drives, is carried, and runs SLAM, with what it said of each scan.

#![allow(dead_code)]

use super::common::{Lidar, Noise, Robot, Wall, cast, laboratory, rectangle};
use msg::grid::{Occupancy, occupancy};
use msg::{Pose2, TrackingState};
use slam::{Slam, SlamConfig};

/// Two rooms without a door between them: what a robot sees that is carried from one to the other.
pub fn two_rooms() -> Vec<Wall> {
    let mut walls = laboratory();
    let shift = |[x, y]: [f64; 2]| [x + 20.0, y];
    let other =
        [(-4.0, -3.0, 3.0, 2.5), (-3.5, 1.0, -2.0, 2.0), (0.5, -2.5, 1.0, -0.5), (1.8, 1.2, 2.6, 2.0)];
    let other = other.iter().flat_map(|b| rectangle(b.0, b.1, b.2, b.3));
    walls.extend(other.map(|wall| wall.map(shift)));
    walls
}

/// A robot, its SLAM, and what it said of each scan.
pub struct Drive {
    pub walls: Vec<Wall>,
    pub lidar: Lidar,
    pub robot: Robot,
    pub noise: Noise,
    pub slam: Slam,
    /// Number of the driver's process, which each start raises.
    pub incarnation: u64,
    /// State, `map_from_base` as said, and the truth.
    pub said: Vec<(TrackingState, Pose2, Pose2)>,
    /// Covariance that it gave with the newest pose: xx, xy, x yaw, yy, y yaw, yaw yaw; m and rad.
    pub covariance: [f64; 6],
}

impl Drive {
    pub fn new(walls: Vec<Wall>, lidar: Lidar, start: Pose2) -> Self {
        let slam = Slam::new(SlamConfig::default());
        let (robot, noise) = (Robot::new(start), Noise::new(3));
        Self { walls, lidar, robot, noise, slam, incarnation: 0, said: Vec::new(), covariance: [0.0; 6] }
    }

    /// Legs of (linear m/s, angular rad/s, seconds) at ten scans a second.
    pub fn drive(&mut self, legs: &[(f64, f64, f64)]) {
        for &(linear, angular, seconds) in legs {
            for _ in 0..(seconds * 10.0).round() as usize {
                self.robot.drive(linear, angular, 0.1, &mut self.noise);
                let mut odometry = self.robot.odometry();
                odometry.header.incarnation = self.incarnation;
                self.slam.add_odometry(&odometry);
                let (pose, stamp) = (self.robot.world_from_base, self.robot.stamp());
                let scan = cast(&self.walls, &self.lidar, pose, stamp, &mut self.noise);
                let pose_estimate = self.slam.process(&scan).pose_estimate;
                self.slam.work();
                self.covariance = pose_estimate.covariance;
                self.said.push((pose_estimate.state(), pose_estimate.map_from_base, pose));
            }
        }
    }

    /// Drives for so long while odometry comes and no scan does.
    pub fn drive_without_scans(&mut self, linear: f64, angular: f64, seconds: f64) {
        for _ in 0..(seconds * 10.0).round() as usize {
            self.robot.drive(linear, angular, 0.1, &mut self.noise);
            self.slam.add_odometry(&self.robot.odometry());
        }
    }

    /// It stands, and neither scans nor odometry come for so long.
    pub fn pause(&mut self, seconds: f64) {
        self.robot.time_s += seconds;
    }

    /// Somebody lifts it, for a moment it sees nothing, and puts it down elsewhere.
    pub fn carry_to(&mut self, pose: Pose2) {
        self.robot.world_from_base = pose;
        self.pause(5.0);
    }

    /// Its driver is started again, and somebody has put it elsewhere meanwhile.
    pub fn restart_driver_at(&mut self, pose: Pose2) {
        self.robot.world_from_base = pose;
        self.incarnation += 1;
    }

    /// Scans that were said to be known, though they were off by more than this.
    pub fn wrong(&self, world_from_map: Pose2, most_m: f64) -> usize {
        let wrong = |(state, said, truth): &&(TrackingState, Pose2, Pose2)| {
            *state != TrackingState::Lost && (world_from_map * *said).distance_m(*truth) > most_m
        };
        self.said.iter().filter(wrong).count()
    }

    /// Occupied cells of the map that are no wall.
    pub fn ghosts(&mut self, world_from_map: Pose2) -> (usize, usize) {
        let walls = self.walls.clone();
        let grid = self.slam.map();
        let (mut ghosts, mut occupied) = (0, 0);
        for y in 0..i64::from(grid.header.height) {
            for x in 0..i64::from(grid.header.width) {
                if occupancy(grid.cell(x, y)) != Occupancy::Occupied {
                    continue;
                }
                occupied += 1;
                let at = [x as f64 + 0.5, y as f64 + 0.5].map(|v| v * grid.header.resolution_m);
                let at = (world_from_map * grid.header.origin).apply(at);
                ghosts += usize::from(walls.iter().all(|wall| away(wall, at) > 0.2));
            }
        }
        (ghosts, occupied)
    }
}

fn away([a, b]: &Wall, p: [f64; 2]) -> f64 {
    let (ex, ey) = (b[0] - a[0], b[1] - a[1]);
    let t = (((p[0] - a[0]) * ex + (p[1] - a[1]) * ey) / (ex * ex + ey * ey)).clamp(0.0, 1.0);
    (p[0] - a[0] - t * ex).hypot(p[1] - a[1] - t * ey)
}

/// A round through the laboratory.
pub fn round() -> Vec<(f64, f64, f64)> {
    let quarter = (0.0, 0.5, core::f64::consts::PI);
    let (long, short) = ((0.15, 0.0, 20.0), (0.15, 0.0, 8.0));
    vec![short, quarter, long, quarter, short, short, quarter, long, quarter, short]
}

/// Where the drives begin.
pub const START: Pose2 = Pose2 { x_m: -1.0, y_m: -1.4, yaw_rad: 0.0 };

/// Some ways with turns.
pub fn wander() -> Vec<(f64, f64, f64)> {
    vec![(0.15, 0.1, 12.0), (0.0, 0.5, 4.0), (0.15, 0.1, 12.0), (0.15, -0.2, 12.0), (0.0, 0.5, 12.6)]
}
