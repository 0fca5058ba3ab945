//! Waypoints drawn at random: places again and again, with and without headings, several at one place.

use super::*;
use crate::random::RandomNumbers;

/// Free places of the test world.
const PLACES_M: [[f64; 2]; 4] = [[2.6, 1.8], [0.6, 1.8], [1.7, 2.8], [0.5, 0.6]];
/// Distance from a pose's position within which it is reached, metres.
const REACHED_M: f64 = 0.2;
/// Error of the last heading, and of one that is passed, radians.
const LAST_RAD: f64 = 0.15;
const PASSED_RAD: f64 = 0.4;
/// Longest simulated time of a goal, seconds.
const LIMIT_S: f64 = 240.0;

fn draw(random: &mut RandomNumbers) -> Vec<GoalPose> {
    let count = 1 + random.index_below(5);
    let mut place = random.index_below(PLACES_M.len());
    (0..count)
        .map(|_| {
            // Every second pose is where the one before is.
            if random.index_below(2) == 0 {
                place = random.index_below(PLACES_M.len());
            }
            let yaw_rad = (random.index_below(3) > 0).then(|| random.index_below(600) as f64 / 100.0 - 3.0);
            GoalPose { position_m: PLACES_M[place], yaw_rad }
        })
        .collect()
}

/// Asserts that a robot that leaves a pose of its goal behind is there.
fn check_passed(drive: &Drive, poses: &[GoalPose], passed: usize, error_rad: f64) {
    let (pose, at) = (poses[passed], drive.world.pose(0));
    let away_m = distance_m(&drive.world, 1, pose.position_m);
    assert!(away_m < REACHED_M, "{poses:?}: pose {passed} was passed at {at:?}");
    let is_last = passed + 1 == poses.len();
    let counts = is_last || distance_between(pose, poses[passed + 1]) < 0.01;
    if let Some(yaw_rad) = pose.yaw_rad.filter(|_| counts) {
        assert!(wrap_angle(yaw_rad - at.yaw_rad).abs() < error_rad, "{poses:?}: heading {passed}: {at:?}");
    }
}

fn distance_between(a: GoalPose, b: GoalPose) -> f64 {
    crate::geometry::distance_m(a.position_m, b.position_m)
}

#[test]
fn every_waypoint_is_visited_in_its_order_before_the_goal_is_reached() {
    for seed in 0..24 {
        let mut random = RandomNumbers::new(seed);
        let poses = draw(&mut random);
        // Some are taken elsewhere by a person on the way, and go on.
        let taken_at = (random.index_below(3) == 0).then(|| random.index_below(600) as u64);
        let mut drive = Drive::new(TestWorld::new(1, seed));
        let goal = NavigationGoal::new(GoalFrame::MergedMap, poses.clone()).unwrap();
        drive.navigator.set_goal(Stamp(0), id(1), goal);
        let mut next = 0;
        while drive.state(1).is_active() && (drive.steps as f64) * STEP_S < LIMIT_S {
            if taken_at == Some(drive.steps) {
                drive.navigator.pause(id(1));
                drive.step();
                drive.world.place(0, Pose2::new(3.0, 3.9, 1.0));
                drive.navigator.resume(drive.now(), id(1));
            }
            drive.step();
            let now = drive.navigator.robots().next().unwrap().next_pose.unwrap_or(next);
            assert!(now == next || now == next + 1, "seed {seed}: from pose {next} to {now}");
            if now > next {
                check_passed(&drive, &poses, next, PASSED_RAD);
            }
            next = now;
        }
        assert_eq!(drive.state(1), NavigationState::Reached, "seed {seed}: {poses:?}");
        assert_eq!(next + 1, poses.len(), "seed {seed}: {poses:?}");
        check_passed(&drive, &poses, next, LAST_RAD);
    }
}
