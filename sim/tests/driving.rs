//! The robot follows velocity commands within its limits.

mod common;

use common::{Run, drive, quiet, robot};
use msg::pose::wrap_angle;
use msg::{Pose2, VelocityCommand};
use sim::{Room, SimConfig, Simulator};

/// A pose in the laboratory with 1 m of free floor ahead and around.
const OPEN: Pose2 = Pose2::new(-1.2, -1.7, 0.6);

fn simulator(start: Pose2) -> Simulator {
    Simulator::new(&Room::laboratory(), &quiet(), robot(1), start, 1).unwrap()
}

#[test]
fn a_robot_drives_straight() {
    for speed in [0.15, -0.1, 0.05] {
        let run = Run::of(&mut simulator(OPEN), speed, 0.0, 400);
        // In the first second the robot accelerates.
        let way = run.truths[99].world_from_base.between(run.truths[399].world_from_base);
        assert!((way.x_m - speed * 3.0).abs() < 0.002, "{speed}: {way:?}");
        assert!(way.y_m.abs() < 0.002 && way.yaw_rad.abs() < 0.003, "{speed}: {way:?}");
        assert!((run.truths[399].linear_m_s - speed).abs() < 0.001);
        assert_eq!(run.truths[399].contacts, 0);
    }
}

#[test]
fn a_robot_turns_in_place() {
    for rate in [1.5, -0.7] {
        let run = Run::of(&mut simulator(OPEN), 0.0, rate, 400);
        assert!((run.turned_rad(100..400) - rate * 3.0).abs() < 0.01, "{rate}");
        assert!(run.truths[399].world_from_base.distance_m(OPEN) < 0.005);
        assert!((run.truths[399].angular_rad_s - rate).abs() < 0.01);
    }
}

#[test]
fn an_arc_is_part_of_a_circle() {
    let run = Run::of(&mut simulator(OPEN), 0.15, 0.75, 1000);
    let radius_m = 0.2;
    // All poses lie on the circle that the last one's normal points to.
    let centre = run.truths[999].world_from_base.apply([0.0, radius_m]);
    for truth in &run.truths[100..] {
        let pose = truth.world_from_base;
        let distance = (pose.x_m - centre[0]).hypot(pose.y_m - centre[1]);
        assert!((distance - radius_m).abs() < 0.003, "{distance}");
    }
}

#[test]
fn odometry_without_errors_equals_the_ground_truth() {
    let mut simulator = simulator(OPEN);
    for (linear, angular) in [(0.15, 0.0), (0.0, 1.5), (0.1, -0.8), (-0.1, 0.3)] {
        let run = Run::of(&mut simulator, linear, angular, 200);
        let odometry = run.odometry.last().unwrap();
        let truth = run.truths.iter().find(|truth| truth.header.stamp == odometry.header.stamp).unwrap();
        let world_from_base = OPEN * odometry.odom_from_base;
        assert!(world_from_base.distance_m(truth.world_from_base) < 0.005, "{world_from_base:?} {truth:?}");
        assert!(wrap_angle(world_from_base.yaw_rad - truth.world_from_base.yaw_rad).abs() < 0.01);
        assert!(
            (odometry.linear_m_s - linear).abs() < 0.002 && (odometry.angular_rad_s - angular).abs() < 0.02
        );
    }
}

#[test]
fn odometry_with_errors_starts_at_the_origin_and_drifts() {
    let room = Room::laboratory();
    let mut simulator = Simulator::new(&room, &SimConfig::default(), robot(1), OPEN, 3).unwrap();
    let run = Run::of(&mut simulator, 0.15, 0.75, 3000);
    assert!(run.odometry[0].odom_from_base.distance_m(Pose2::IDENTITY) < 0.01);
    let odometry = run.odometry.last().unwrap();
    let truth = run.truths.iter().find(|truth| truth.header.stamp == odometry.header.stamp).unwrap();
    let believed = OPEN * odometry.odom_from_base;
    let error = believed.distance_m(truth.world_from_base);
    assert!((0.001..1.0).contains(&error), "{error}");
    assert!(wrap_angle(believed.yaw_rad - truth.world_from_base.yaw_rad).abs() > 0.001);
}

#[test]
fn commands_are_clamped() {
    let run = Run::of(&mut simulator(OPEN), 9.0, 0.0, 200);
    assert!((run.truths[199].linear_m_s - 0.15).abs() < 0.001);
    let run = Run::of(&mut simulator(OPEN), 0.0, -99.0, 200);
    assert!((run.truths[199].angular_rad_s + 1.5).abs() < 0.01);
}

#[test]
fn a_robot_without_commands_stops() {
    let mut simulator = simulator(OPEN);
    simulator.set_velocity_command(&drive(0.15, 0.0));
    let truths: Vec<_> = (0..100).map(|_| simulator.step().truth).collect();
    assert!((truths[29].linear_m_s - 0.15).abs() < 0.02, "valid for 0.3 s");
    assert!(truths[60].linear_m_s.abs() < 0.005, "stopped soon after");
    let rest = truths[70].world_from_base.distance_m(truths[99].world_from_base);
    assert!(rest < 0.0005, "{rest}");
}

#[test]
fn commands_that_are_not_finite_are_refused_and_counted() {
    let mut simulator = simulator(OPEN);
    simulator.set_velocity_command(&drive(0.1, 0.0));
    for (linear, angular) in [(f64::NAN, 0.0), (0.0, f64::INFINITY), (f64::NEG_INFINITY, f64::NAN)] {
        simulator.set_velocity_command(&VelocityCommand {
            linear_m_s: linear,
            angular_rad_s: angular,
            ..VelocityCommand::default()
        });
    }
    assert_eq!(simulator.refused(), 3);
    let truth = (0..25).map(|_| simulator.step().truth).last().unwrap();
    assert!(truth.linear_m_s > 0.08, "the command before is still valid");
}

#[test]
fn a_wall_stops_the_robot() {
    // The face of the west wall is ahead at x = -4.
    let start = Pose2::new(-3.5, -0.3, core::f64::consts::PI);
    let mut simulator = simulator(start);
    let run = Run::of(&mut simulator, 0.15, 0.0, 1500);
    let end = run.truths[1499];
    // The LiDAR's rim is the foremost point of the body at x = 0.038.
    assert!((end.world_from_base.x_m - (-4.0 + 0.038)).abs() < 0.01, "{end:?}");
    assert!(end.linear_m_s.abs() < 0.01);
    assert_eq!(end.contacts, 1, "one touch that lasts");
    // The motors stall: the robot neither climbs the wall nor turns its wheels.
    let odometry = run.odometry.last().unwrap();
    assert!((odometry.odom_from_base.x_m - 0.462).abs() < 0.01, "{odometry:?}");
    // The robot can drive away again.
    let run = Run::of(&mut simulator, -0.15, 0.0, 200);
    assert!(run.truths[199].world_from_base.x_m > -3.72);
}

#[test]
fn odometry_and_scans_have_their_rates_and_phases() {
    let room = Room::laboratory();
    for k in [1, 2, 16] {
        let mut simulator = Simulator::new(&room, &quiet(), robot(k), OPEN, 1).unwrap();
        let ticks: Vec<_> = (0..1000).map(|_| simulator.step()).collect();
        assert!(ticks.windows(2).all(|w| w[1].stamp.0 - w[0].stamp.0 == 10_000_000));
        assert_eq!(ticks[0].stamp.0, 10_000_000);
        assert_eq!(ticks.iter().filter(|t| t.odometry.is_some()).count(), 200);
        assert_eq!(ticks.iter().filter(|t| t.scan_due).count(), 100);
        for tick in &ticks {
            assert_eq!(tick.odometry.is_some(), tick.transforms.is_some());
            assert!(!tick.scan_due || tick.odometry.is_some());
            assert_eq!(tick.truth.header.stamp, tick.stamp);
        }
    }
}

#[test]
fn a_simulator_joins_a_running_fleet() {
    let mut simulator = simulator(OPEN);
    simulator.set_time(msg::Stamp(12_345_678_901));
    assert_eq!(simulator.step().stamp.0, 12_350_000_000);
}
