//! A LiDAR that needs 0.2 s for a turn, on a robot that spins: what its beams' times are worth.

mod common;

use common::{FULL, Lidar, Noise, Robot, cast_driving, laboratory};
use msg::Pose2;
use msg::pose::wrap_angle;
use slam::{Slam, SlamConfig};

/// The LDS-01's 5 Hz.
const TURN_S: f64 = 0.2;

/// What is known of the motion.
#[derive(Clone, Copy, PartialEq)]
enum Known {
    /// Beams' times and odometry.
    All,
    /// Beams' times.
    Times,
    /// Odometry; the beams pretend to have been measured at once.
    Odometry,
}

/// Mean error of position (m) and heading (rad), and cells the walls take up in the map.
fn spin(known: Known) -> (f64, f64, usize) {
    spin_with(known, TURN_S)
}

/// The same with a scan each `interval_s`.
fn spin_with(known: Known, interval_s: f64) -> (f64, f64, usize) {
    let lidar = Lidar { range_max_m: 8.0, ..FULL };
    let (walls, mut noise) = (laboratory(), Noise::new(9));
    let mut robot = Robot::new(Pose2::new(-0.6, -0.5, 0.3));
    let start = robot.world_from_base;
    let mut slam = Slam::new(SlamConfig::default());
    if known != Known::Times {
        slam.add_odometry(&robot.odometry());
    }
    let (mut away_m, mut turned_rad) = (Vec::new(), Vec::new());
    for i in 0..(40.0 / interval_s) as u32 {
        // Stands, then spins one way, then the other, speeding up gently.
        let rate = 1.2 * (f64::from(i) * 0.25 * interval_s).sin();
        let twist = (0.1, rate);
        let mut scan = cast_driving(&walls, &lidar, &robot, twist, TURN_S, &mut noise);
        if known == Known::Odometry {
            scan.time_increment_s = 0.0;
        }
        let truth = start.between(robot.world_from_base);
        for _ in 0..4 {
            robot.drive(twist.0, twist.1, interval_s / 4.0, &mut noise);
            if known != Known::Times {
                slam.add_odometry(&robot.odometry());
            }
        }
        let pose = slam.process(&scan).pose_estimate.map_from_base;
        slam.work();
        away_m.push(truth.distance_m(pose));
        turned_rad.push(wrap_angle(truth.yaw_rad - pose.yaw_rad).abs());
    }
    slam.finish();
    assert_eq!(slam.counts().not_deskewed, u64::from(known == Known::Times));
    let map = slam.map();
    let walls = map.cells.iter().filter(|c| **c != msg::grid::UNKNOWN && **c > 0).count();
    let mean = |errors: Vec<f64>| errors.iter().sum::<f64>() / errors.len() as f64;
    (mean(away_m), mean(turned_rad), walls)
}

#[test]
fn a_spinning_robot_is_where_its_beams_times_say() {
    let (away, turned, walls) = spin(Known::All);
    let (away_skewed, turned_skewed, walls_skewed) = spin(Known::Odometry);
    println!(
        "deskewed {away} m {turned} rad {walls} cells; not {away_skewed} m {turned_skewed} rad {walls_skewed}"
    );
    assert!(away < 0.02 && turned < 0.01, "{away} m, {turned} rad");
    assert!(turned_skewed > 3.0 * turned, "without: {turned_skewed} rad, with: {turned} rad");
    assert!(walls_skewed * 10 > walls * 11, "without: {walls_skewed} cells, with: {walls}");
}

#[test]
fn the_last_motion_does_instead_of_odometry() {
    let (away, turned, _) = spin(Known::Times);
    let (_, turned_skewed, _) = spin(Known::Odometry);
    println!("deskewed {away} m {turned} rad; not {turned_skewed} rad");
    assert!(away < 0.04 && turned < 0.02, "{away} m, {turned} rad");
    assert!(turned_skewed > 2.0 * turned, "without: {turned_skewed} rad, with: {turned} rad");
}

#[test]
fn the_last_motion_does_for_sweeps_that_overlap() {
    for sweeps in [3.0, 7.0] {
        let (away, turned, _) = spin_with(Known::Times, TURN_S / sweeps);
        println!("{sweeps} intervals a sweep: {away} m {turned} rad");
        assert!(away < 0.04 && turned < 0.02, "{sweeps} intervals a sweep: {away} m, {turned} rad");
    }
}
