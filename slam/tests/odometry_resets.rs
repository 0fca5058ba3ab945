//! Odometry that jumps while the robot does not: its driver lost its origin, or its pose was set. And motion that looks like it.

mod common;

use common::{FULL, HALF, Lidar, NARROW, Noise, Robot, Wall, cast, laboratory, ring};
use core::f64::consts::PI;
use msg::{Pose2, TrackingState};
use slam::{Slam, SlamConfig};

/// Time between two scans, seconds.
const PERIOD_S: f64 = 0.1;
/// Longest time in which neither scans nor odometry come, seconds.
const SILENCE_MAX_S: f64 = 2.0;
/// An estimate that is so far from the truth is wrong, metres.
const WRONG_M: f64 = 0.3;
/// Runs of each world.
const RUNS: u64 = 25;

/// What happens to odometry in the middle of a run.
#[derive(Clone, Copy)]
enum Step {
    /// It begins at the origin again, or at another pose.
    Jump,
    /// The robot drives on while nothing comes.
    Motion,
}

/// What came of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    Right,
    /// Wrong, or not known, and said so.
    Said,
    /// Wrong, and given as right.
    Silent,
}

struct World {
    walls: Vec<Wall>,
    lidar: Lidar,
    start: Pose2,
    /// What the robot drives, m/s and rad/s.
    velocity: (f64, f64),
}

impl World {
    /// Drives, for 2 to 6 s, then after a step of odometry for 6 s. `seed` draws when, what, and for how long nothing comes meanwhile.
    fn run(&self, step: Step, seed: u64) -> Outcome {
        let mut noise = Noise::new(seed);
        let (mut slam, mut robot) = (Slam::new(SlamConfig::default()), Robot::new(self.start));
        let step_at = 20 + (40.0 * noise.uniform()) as usize;
        let silence_s = if noise.uniform() < 0.5 { PERIOD_S } else { SILENCE_MAX_S * noise.uniform() };
        let is_at_origin = noise.uniform() < 0.5;
        let [x_m, y_m, yaw_rad] = [2.5, 2.5, PI].map(|reach| reach * (2.0 * noise.uniform() - 1.0));
        let mut outcome = Outcome::Right;
        for scan in 0..step_at + 60 {
            if scan == step_at {
                match step {
                    Step::Motion => {
                        let turn_rad_s = 3.0 * self.velocity.1;
                        robot.drive(self.velocity.0, turn_rad_s, silence_s, &mut noise);
                    }
                    Step::Jump => {
                        robot.odom_from_base =
                            if is_at_origin { Pose2::IDENTITY } else { Pose2::new(x_m, y_m, yaw_rad) };
                        robot.time_s += silence_s;
                    }
                }
            }
            slam.add_odometry(&robot.odometry());
            let scan = cast(&self.walls, &self.lidar, robot.world_from_base, robot.stamp(), &mut noise);
            let estimate = slam.process(&scan).pose_estimate;
            slam.work();
            let truth = self.start.between(robot.world_from_base);
            let is_said = matches!(estimate.state(), TrackingState::Lost | TrackingState::MapUnreliable);
            outcome = match (estimate.map_from_base.distance_m(truth) < WRONG_M, is_said) {
                (true, _) => Outcome::Right,
                (false, true) => Outcome::Said,
                (false, false) => Outcome::Silent,
            };
            robot.drive(self.velocity.0, self.velocity.1, PERIOD_S, &mut noise);
        }
        outcome
    }

    /// Returns the numbers of runs that are right, and that are wrong without saying so.
    fn count(&self, step: Step) -> [usize; 2] {
        let outcomes: Vec<Outcome> = (0..RUNS).map(|seed| self.run(step, seed)).collect();
        [Outcome::Right, Outcome::Silent].map(|of| outcomes.iter().filter(|outcome| **outcome == of).count())
    }
}

fn room(lidar: Lidar) -> World {
    World { walls: laboratory(), lidar, start: Pose2::new(0.0, -0.5, 0.3), velocity: (0.2, 0.4) }
}

fn corridor() -> World {
    let lidar = Lidar { range_max_m: 6.0, ..HALF };
    World { walls: ring(3), lidar, start: Pose2::new(-7.8, -5.8, 0.0), velocity: (0.3, 0.0) }
}

/// Where all steps are taken for motion, 5 of 400 runs are right, and 190 are wrong without saying so.
#[test]
fn odometry_that_jumps_moves_no_robot() {
    for world in [room(FULL), room(HALF), corridor()] {
        let [right, silent] = world.count(Step::Jump);
        assert!(right >= 23 && silent <= 1, "{right} right, {silent} silent");
    }
    // A LiDAR of 90° that has seen nothing for a second may have turned away, as odometry says.
    let [right, silent] = room(NARROW).count(Step::Jump);
    assert!(right >= 17 && silent <= 8, "{right} right, {silent} silent");
}

#[test]
fn a_motion_that_no_scan_has_seen_is_believed() {
    for world in [room(FULL), room(HALF), corridor()] {
        assert_eq!(world.count(Step::Motion), [RUNS as usize, 0]);
    }
    let [right, silent] = room(NARROW).count(Step::Motion);
    assert!(right >= 23 && silent == 0, "{right} right, {silent} silent");
}
