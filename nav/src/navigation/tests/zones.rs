//! Zones that are drawn while robots drive.

use super::*;

/// The robot brakes from its cruising speed within this distance, metres; it has gone on for a step by then.
const BRAKING_M: f64 = 0.1;
/// A robot that is slower than this turns or begins to drive.
const DRIVING_M_S: f64 = 0.1;
/// Side of a zone, metres.
const SIDE_M: f64 = 0.4;

/// A square across the robot's way, whose near side is so far ahead of it.
fn zone_ahead(robot: Pose2, ahead_m: f64) -> ExclusionZone {
    let half_m = SIDE_M / 2.0;
    let corners =
        [[ahead_m, -half_m], [ahead_m + SIDE_M, -half_m], [ahead_m + SIDE_M, half_m], [ahead_m, half_m]];
    ExclusionZone::new(&corners.map(|corner| robot.apply(corner))).unwrap()
}

#[test]
fn a_robot_stops_before_a_zone_that_is_drawn_across_its_way() {
    let mut drawn = 0;
    for moment in 0..30 {
        let mut drive = Drive::new(TestWorld::new(1, 7));
        drive.go(1, [5.2, 7.2]);
        drive.run_until(2.0 + 0.3 * f64::from(moment), |_| false);
        let moved_m = {
            let before = drive.world.pose(0);
            drive.step();
            distance_m(&drive.world, 1, [before.x_m, before.y_m])
        };
        // One that turns on the spot leaves the way ahead of it by itself.
        if drive.state(1) != NavigationState::Driving || moved_m < STEP_S * DRIVING_M_S {
            continue;
        }
        drawn += 1;
        let drawn_at = drive.world.pose(0);
        drive.zones = vec![zone_ahead(drawn_at, BRAKING_M)];
        for _ in 0..(10.0 / STEP_S) as usize {
            drive.step();
            let pose = drawn_at.between(drive.world.pose(0));
            let is_inside =
                (BRAKING_M..BRAKING_M + SIDE_M).contains(&pose.x_m) && pose.y_m.abs() < SIDE_M / 2.0;
            assert!(!is_inside, "zone drawn at moment {moment}: {pose:?}");
        }
    }
    assert!(drawn > 10, "{drawn}");
}
