//! Invalid and nearly empty input: named, counted, and nothing else is lost.

mod common;

use common::{FULL, NARROW, Noise, Robot, cast, laboratory};
use msg::{Pose2, Scan, Stamp, TrackingState};
use proptest::prelude::*;
use slam::{ScanRejection, Slam, SlamConfig};

fn scan_at(seconds: f64) -> Box<Scan> {
    cast(&laboratory(), &FULL, Pose2::new(0.0, -0.5, 0.3), Stamp::from_seconds(seconds), &mut Noise::new(1))
}

#[test]
fn stamps_that_repeat_or_go_back_are_refused_and_counted() {
    let mut slam = Slam::new(SlamConfig::default());
    assert_eq!(slam.process(&scan_at(5.0)).rejected, None);
    assert_eq!(slam.process(&scan_at(5.0)).rejected, Some(ScanRejection::StampRepeated));
    assert_eq!(slam.process(&scan_at(4.0)).rejected, Some(ScanRejection::StampWentBack));
    assert_eq!(slam.process(&scan_at(6.0)).rejected, None);
    let counts = slam.counts();
    assert_eq!((counts.accepted, counts.rejected_stamp_repeated, counts.rejected_stamp_went_back), (2, 1, 1));
    slam.finish();
    assert_eq!(slam.trajectory().count(), 2);
}

#[test]
fn a_scan_without_beams_or_sense_is_refused() {
    let mut slam = Slam::new(SlamConfig::default());
    let mut scan = scan_at(1.0);
    scan.len = 0;
    assert_eq!(slam.process(&scan).rejected, Some(ScanRejection::BeamCount));
    scan.len = u32::MAX;
    assert_eq!(slam.process(&scan).rejected, Some(ScanRejection::BeamCount));
    for broken in [
        |s: &mut Scan| s.angle_min_rad = f32::NAN,
        |s: &mut Scan| s.angle_increment_rad = f32::INFINITY,
        |s: &mut Scan| s.range_max_m = f32::NAN,
        |s: &mut Scan| s.range_min_m = -1.0,
    ] {
        let mut scan = scan_at(1.0);
        broken(&mut scan);
        assert_eq!(slam.process(&scan).rejected, Some(ScanRejection::Geometry));
    }
}

#[test]
fn the_answer_names_its_scan() {
    let mut slam = Slam::new(SlamConfig::default());
    let mut scan = scan_at(1.0);
    scan.header.seq = 42;
    scan.header.sent = msg::Monotonic(99);
    let pose_estimate = slam.process(&scan).pose_estimate;
    assert_eq!(pose_estimate.header.stamp, scan.header.stamp);
    assert_eq!((pose_estimate.scan_seq, pose_estimate.scan_sent), (42, msg::Monotonic(99)));
}

#[test]
fn the_number_of_beams_may_change() {
    let walls = laboratory();
    let mut noise = Noise::new(2);
    let mut robot = Robot::new(Pose2::new(-1.0, -1.4, 0.0));
    let mut slam = Slam::new(SlamConfig::default());
    let start = robot.world_from_base;
    for i in 0..60 {
        robot.drive(0.15, 0.05, 0.1, &mut noise);
        slam.add_odometry(&robot.odometry());
        let lidar = if i % 2 == 0 { FULL } else { common::Lidar { beams: 97, ..NARROW } };
        let result = slam.process(&cast(&walls, &lidar, robot.world_from_base, robot.stamp(), &mut noise));
        assert_eq!(result.rejected, None);
        let wanted = start.between(robot.world_from_base);
        assert!(result.pose_estimate.map_from_base.distance_m(wanted) < 0.1);
    }
}

#[test]
fn a_scan_that_sees_nothing_has_the_pose_by_odometry() {
    let mut slam = Slam::new(SlamConfig::default());
    let mut noise = Noise::new(2);
    let mut robot = Robot::new(Pose2::new(-1.0, -1.4, 0.0));
    slam.add_odometry(&robot.odometry());
    slam.process(&cast(&laboratory(), &FULL, robot.world_from_base, robot.stamp(), &mut noise));
    robot.drive(0.15, 0.0, 0.2, &mut noise);
    slam.add_odometry(&robot.odometry());
    // Open floor; a LiDAR that is covered or broken.
    use TrackingState::{Degenerate, Lost};
    let empty =
        [(f32::INFINITY, Degenerate), (99.0, Degenerate), (f32::NAN, Lost), (0.0, Lost), (0.05, Lost)];
    for (i, (empty, state)) in empty.into_iter().enumerate() {
        let mut scan = scan_at(10.3 + i as f64);
        scan.header.stamp = Stamp(robot.stamp().0 + i as i64);
        scan.ranges_m.fill(empty);
        let result = slam.process(&scan);
        assert_eq!(result.pose_estimate.state(), state, "{empty}");
        assert!(result.pose_estimate.map_from_base.distance_m(robot.odom_from_base) < 0.02, "{empty}");
    }
    assert_eq!(slam.counts().lost, 3);
}

#[test]
fn open_floor_is_crossed_by_odometry_until_its_error_is_large() {
    let mut slam = Slam::new(SlamConfig::default());
    let mut noise = Noise::new(3);
    let mut robot = Robot::new(Pose2::IDENTITY);
    let mut crossed_m = 0.0;
    for i in 0..1000 {
        robot.drive(0.3, 0.0, 0.1, &mut noise);
        slam.add_odometry(&robot.odometry());
        let mut scan = scan_at(0.0);
        scan.header.stamp = robot.stamp();
        scan.ranges_m.fill(f32::INFINITY);
        let pose_estimate = slam.process(&scan).pose_estimate;
        let sigma_m = pose_estimate.covariance[0].max(pose_estimate.covariance[3]).sqrt();
        if pose_estimate.state() == TrackingState::Lost {
            assert!(sigma_m > 0.4, "{sigma_m} m after {crossed_m} m");
            break;
        }
        assert!(i == 0 || pose_estimate.state() == TrackingState::Degenerate);
        crossed_m = pose_estimate.map_from_base.x_m;
    }
    assert!((1.0..30.0).contains(&crossed_m), "{crossed_m} m");
}

/// Found by fuzzing: the cells of points beyond a billion metres overflowed.
#[test]
fn wheels_that_leap_while_the_beams_turn_break_nothing() {
    for leap_m in [1e8, 3e9, -3e9, 1e30, -1e30] {
        let mut slam = Slam::new(SlamConfig::default());
        for (i, x) in [0.0, leap_m, 0.0, leap_m].into_iter().enumerate() {
            let mut scan = scan_at(1.0 + 0.1 * i as f64);
            scan.time_increment_s = 0.1 / 360.0;
            for after in [0.0, 0.05] {
                let mut odometry = msg::Odometry {
                    odom_from_base: Pose2::new(x * (1.0 + after), x, 0.1),
                    ..Default::default()
                };
                odometry.header.stamp = Stamp::from_seconds(1.0 + 0.1 * i as f64 + after);
                slam.add_odometry(&odometry);
            }
            assert!(slam.process(&scan).pose_estimate.map_from_base.is_finite());
            slam.work();
        }
    }
}

#[test]
fn every_range_is_drawn_as_what_it_means() {
    let mut scan = scan_at(1.0);
    let ranges = [f32::INFINITY, 99.0, f32::NAN, f32::NEG_INFINITY, 0.0, -1.0, 0.05, 2.0];
    scan.len = ranges.len() as u32;
    scan.ranges_m[..ranges.len()].copy_from_slice(&ranges);
    let config = SlamConfig::default();
    let rays = slam::Rays::new(&scan, &slam::BeamPoses::still(Pose2::IDENTITY), &config);
    // REP-117: +inf and beyond the maximum are free space, up to as far as the sensor sees.
    assert_eq!(rays.misses.len(), 2);
    let reach = |p: &[f32; 2]| p[0].hypot(p[1]);
    assert!(rays.misses.iter().all(|p| (reach(p) - scan.range_max_m).abs() < 1e-4), "{:?}", rays.misses);
    // NaN, -inf, zero, negative and below the minimum say nothing.
    assert_eq!(rays.hits.len(), 1);
    assert!((reach(&rays.hits[0]) - 2.0).abs() < 1e-5);
}

#[test]
fn one_beam_and_4096_are_scans() {
    let mut slam = Slam::new(SlamConfig::default());
    for (i, beams) in [1, 4096, 1, 2, 4096].into_iter().enumerate() {
        let lidar = common::Lidar { beams, ..FULL };
        let stamp = Stamp::from_seconds(1.0 + i as f64);
        let scan = cast(&laboratory(), &lidar, Pose2::new(0.0, -0.5, 0.3), stamp, &mut Noise::new(1));
        let result = slam.process(&scan);
        assert_eq!(result.rejected, None);
        let pose_estimate = result.pose_estimate;
        assert!(
            pose_estimate.map_from_base.distance_m(Pose2::IDENTITY) < 0.05,
            "{beams} beams: {pose_estimate:?}"
        );
        assert!(pose_estimate.covariance.iter().all(|v| v.is_finite()));
        slam.work();
    }
}

#[test]
fn the_default_configuration_is_valid_and_unknown_fields_are_not() {
    let config = SlamConfig::default();
    config.validate().unwrap();
    let text = serde_json::to_string(&config).unwrap();
    assert_eq!(serde_json::from_str::<SlamConfig>(&text).unwrap(), config);
    assert!(serde_json::from_str::<SlamConfig>(r#"{"tracking": {"nodes": 3}}"#).is_err());
    let mut broken = config;
    broken.map.resolution_m = f64::NAN;
    let message = broken.validate().unwrap_err().to_string();
    assert!(message.contains("map.resolution_m"), "{message}");
}

fn any_range() -> impl Strategy<Value = f32> {
    prop_oneof![4 => 0.0_f32..30.0, 1 => any::<f32>(), 1 => Just(f32::NAN), 1 => Just(f32::INFINITY)]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn nothing_makes_it_panic(
        scans in prop::collection::vec(
            (prop::collection::vec(any_range(), 1..200), any::<f32>(), any::<f32>(), 0_i64..3_000_000_000, -1e9..1e9),
            1..12,
        )
    ) {
        let mut slam = Slam::new(SlamConfig::default());
        let mut stamp = 0;
        for (ranges, angle_min, increment, wait, x) in scans {
            stamp += wait;
            let mut scan: Box<Scan> = bytemuck::allocation::zeroed_box();
            scan.header.stamp = Stamp(stamp);
            scan.len = ranges.len() as u32;
            scan.ranges_m[..ranges.len()].copy_from_slice(&ranges);
            (scan.angle_min_rad, scan.angle_increment_rad) = (angle_min, increment % 0.1);
            (scan.range_min_m, scan.range_max_m) = (0.1, 25.0);
            let odom_from_base = Pose2::new(x, -x, x);
            slam.add_odometry(&msg::Odometry { header: scan.header, odom_from_base, ..Default::default() });
            let result = slam.process(&scan);
            prop_assert!(result.pose_estimate.map_from_base.is_finite());
            slam.work();
        }
        slam.finish();
        let grid = slam.map();
        prop_assert!(grid.cells.len() <= msg::grid::CELLS_MAX);
    }
}
