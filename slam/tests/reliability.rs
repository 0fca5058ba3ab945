//! Maps that are wrong without a way to be right: SLAM says so.

mod common;

use common::{FULL, Lidar, Noise, Robot, Wall, cast, laboratory, rectangle};
use msg::{Pose2, Scan, SlamMode, TrackingState};
use slam::session::{Session, SessionIdentity};
use slam::{InitialPose, PlaceInMap, Slam, SlamConfig};

/// A corridor of 28 m whose ends are out of sight for most of the way, and a room at either end.
fn corridor() -> Vec<Wall> {
    let mut walls = vec![[[0.0, -1.0], [28.0, -1.0]], [[0.0, 1.0], [28.0, 1.0]]];
    walls.extend([[[0.0, -1.0], [0.0, 1.0]], [[28.0, -1.0], [28.0, 1.0]]]);
    walls.extend(rectangle(2.5, 0.6, 3.0, 1.0));
    walls.extend(rectangle(25.0, -1.0, 25.5, -0.6));
    walls
}

/// What SLAM said of each scan, and the true pose.
type Said = Vec<(TrackingState, Pose2)>;

/// Drives from one end to the other; `has_odometry` says whether odometry comes with a scan.
fn drive(has_odometry: impl Fn(usize) -> bool) -> (Slam, Said) {
    drive_with(Robot::new(Pose2::new(1.0, 0.0, 0.0)), has_odometry)
}

fn drive_with(mut robot: Robot, has_odometry: impl Fn(usize) -> bool) -> (Slam, Said) {
    let walls = corridor();
    let mut noise = Noise::new(3);
    let mut slam = Slam::new(SlamConfig::default());
    let mut said = Said::new();
    for scan in 0..520 {
        robot.drive(0.5, 0.0, 0.1, &mut noise);
        // The corridor is straight, and so is the robot's way.
        robot.world_from_base = Pose2::new(robot.world_from_base.x_m, 0.0, 0.0);
        if has_odometry(scan) {
            slam.add_odometry(&robot.odometry());
        }
        let scan = cast(&walls, &FULL, robot.world_from_base, robot.stamp(), &mut noise);
        said.push((slam.process(&scan).pose_estimate.state(), robot.world_from_base));
        slam.work();
    }
    slam.finish();
    (slam, said)
}

/// Error of the poses that SLAM says are known, the largest, metres; and their number. The map is put where the first of them is right.
fn known_error_m(slam: &Slam, said: &Said) -> (f64, usize) {
    let places = slam.trajectory_with_places().zip(said);
    let known: Vec<(Pose2, Pose2)> = places
        .filter(|((_, _, place), _)| *place == PlaceInMap::Known)
        .map(|((_, pose, _), (_, truth))| (pose, *truth))
        .collect();
    let Some((pose, truth)) = known.first().copied() else { return (0.0, 0) };
    let world_from_map = truth * pose.inverse();
    let errors_m = known.iter().map(|(pose, truth)| (world_from_map * *pose).distance_m(*truth));
    (errors_m.fold(0.0, f64::max), known.len())
}

#[test]
fn a_corridor_without_odometry_is_in_the_map_only_where_its_place_is_known() {
    let (slam, said) = drive(|_| false);
    // In the middle of the corridor nothing measures the motion.
    assert_eq!(said[260].0, TrackingState::Lost);
    let (error_m, known) = known_error_m(&slam, &said);
    assert!(error_m < 1.0 && known > 20 && known < 260, "{error_m} m, {known} scans");
    let evidence = slam.back().reliability_evidence();
    assert!(evidence.unplaced_share > 0.5 && evidence.is_unreliable(), "{evidence:?}");
    // A session keeps them: who loads it is told.
    let back = slam.back();
    let identity = SessionIdentity::new(1, 0, back.config());
    let bytes = back.session(identity, None, &[]).encode().unwrap();
    let session = Session::decode(&bytes, &identity).unwrap();
    let (_, loaded) =
        slam::create_or_resume(back.config().clone(), Some(session), SlamMode::Mapping, InitialPose::Unknown);
    assert_eq!(loaded.reliability_evidence(), evidence);
    assert_eq!(loaded.unplaced_component_count(), back.unplaced_component_count());
}

#[test]
fn with_odometry_a_corridor_is_a_map_to_rely_on() {
    // Wheels that measure 3 % too long, too short, and right: where nothing faces along the corridor, they alone know its length.
    for slip in [0.03, -0.03, 0.0] {
        let robot = Robot { slip, ..Robot::new(Pose2::new(1.0, 0.0, 0.0)) };
        let (slam, said) = drive_with(robot, |_| true);
        let (error_m, known) = known_error_m(&slam, &said);
        let most_m = slip.abs() * 26.0 + 0.1;
        assert!(error_m < most_m && known == said.len(), "{slip}: {error_m} m, {known} scans");
        let evidence = slam.back().reliability_evidence();
        assert!(!evidence.is_unreliable(), "{slip}: {evidence:?}");
        // And the covariance says so.
        let graph = slam.back().graph();
        let sigma_m = graph.position_variance_trace_m2(graph.poses().len() as u32 - 1).sqrt();
        assert!(
            error_m < 3.0 * sigma_m && sigma_m < 1.0,
            "{slip}: {error_m} m, one standard deviation is {sigma_m} m"
        );
    }
}

#[test]
fn wheels_that_slip_unseen_in_a_corridor_are_within_what_the_covariance_says() {
    let mut robot = Robot { slip: 0.0, ..Robot::new(Pose2::new(1.0, 0.0, 0.0)) };
    let mut noise = Noise::new(5);
    let mut slam = Slam::new(SlamConfig::default());
    let mut said = Said::new();
    for scan in 0..520 {
        // Half a metre too much, three times, where nothing faces along the corridor.
        robot.slip = if (150..400).contains(&scan) && scan % 80 < 10 { 1.0 } else { 0.0 };
        robot.drive(0.5, 0.0, 0.1, &mut noise);
        robot.world_from_base = Pose2::new(robot.world_from_base.x_m, 0.0, 0.0);
        slam.add_odometry(&robot.odometry());
        let scan = cast(&corridor(), &FULL, robot.world_from_base, robot.stamp(), &mut noise);
        said.push((slam.process(&scan).pose_estimate.state(), robot.world_from_base));
        slam.work();
    }
    slam.finish();
    let (error_m, _) = known_error_m(&slam, &said);
    let graph = slam.back().graph();
    let sigma_m = graph.position_variance_trace_m2(graph.poses().len() as u32 - 1).sqrt();
    assert!(error_m > 1.0, "{error_m} m: the slips were seen");
    assert!(error_m < 3.0 * sigma_m, "{error_m} m, one standard deviation is {sigma_m} m");
}

#[test]
fn odometry_that_comes_back_in_a_corridor_is_used_again() {
    // It is missing for two seconds, in which nothing else measures the motion: where the robot is then is not known.
    let (slam, said) = drive(|scan| !(200..220).contains(&scan));
    let (error_m, known) = known_error_m(&slam, &said);
    assert!(error_m < 0.5 && known > 200 && known < said.len(), "{error_m} m, {known} scans");
    // The rest is a component of its own, as long as it should be.
    let poses: Vec<Pose2> = slam.trajectory().map(|(_, pose)| pose).collect();
    let (driven_m, true_m) = (poses[225].distance_m(poses[515]), said[225].1.distance_m(said[515].1));
    assert!((driven_m - true_m).abs() < 0.5, "{driven_m} m of {true_m} m");
}

#[test]
fn many_noisy_beams_do_not_shorten_a_corridor() {
    // Sees 30 m far: the normals of 1081 beams have much noise, and together claim much.
    let lidar = Lidar { beams: 1081, fov_rad: 1.5 * core::f64::consts::PI, range_max_m: 30.0, sigma_m: 0.02 };
    let walls: Vec<Wall> = rectangle(-40.0, -1.1, 90.0, 1.1).into_iter().collect();
    let mut noise = Noise::new(4);
    let mut robot = Robot { slip: 0.0, veer_rad_per_m: 0.0, ..Robot::new(Pose2::IDENTITY) };
    let mut slam = Slam::new(SlamConfig::default());
    let mut said = Said::new();
    for _ in 0..400 {
        robot.drive(0.5, 0.0, 0.1, &mut noise);
        slam.add_odometry(&robot.odometry());
        let scan = cast(&walls, &lidar, robot.world_from_base, robot.stamp(), &mut noise);
        said.push((slam.process(&scan).pose_estimate.state(), robot.world_from_base));
        slam.work();
    }
    slam.finish();
    let (error_m, known) = known_error_m(&slam, &said);
    assert!(error_m < 0.1 && known == said.len(), "{error_m} m, {known} scans");
}

/// Drives around in the laboratory with scans and odometry that are not as described; returns the reasons why the map is unreliable.
fn reasons_with(
    change_scan: impl Fn(&mut Scan),
    change_odometry: impl Fn(Pose2) -> Pose2,
) -> Vec<&'static str> {
    let (walls, mut noise) = (laboratory(), Noise::new(8));
    let mut robot = Robot::new(Pose2::new(0.0, -0.75, 0.0));
    let mut slam = Slam::new(SlamConfig::default());
    for _ in 0..320 {
        robot.drive(0.15, 0.2, 0.1, &mut noise);
        let mut odometry = robot.odometry();
        odometry.odom_from_base = change_odometry(odometry.odom_from_base);
        slam.add_odometry(&odometry);
        let mut scan = cast(&walls, &FULL, robot.world_from_base, robot.stamp(), &mut noise);
        change_scan(&mut scan);
        slam.process(&scan);
        slam.work();
    }
    slam.finish();
    slam.back().reliability_evidence().reasons().collect()
}

#[test]
fn sensors_that_are_not_as_described_are_named() {
    let same = |odom_from_base: Pose2| odom_from_base;
    assert_eq!(reasons_with(|_| {}, same), Vec::<&str>::new());
    let mirror = |scan: &mut Scan| {
        let beams = scan.len as usize;
        scan.ranges_m[..beams].reverse();
    };
    let turned = |yaw_rad: f32| move |scan: &mut Scan| scan.angle_min_rad += yaw_rad;
    let longer = |scan: &mut Scan| {
        scan.range_max_m *= 2.0;
        let beams = scan.len as usize;
        scan.ranges_m[..beams].iter_mut().for_each(|range_m| *range_m *= 2.0);
    };
    let said = |reasons: Vec<&'static str>, words: &str| {
        assert!(reasons.iter().any(|reason| reason.contains(words)), "{words}: {reasons:?}");
    };
    said(reasons_with(mirror, same), "turn the other way");
    said(reasons_with(|_| {}, |pose| Pose2::new(pose.x_m, -pose.y_m, -pose.yaw_rad)), "turn the other way");
    said(reasons_with(turned(0.3), same), "another direction");
    said(reasons_with(turned(-1.5), same), "another direction");
    said(reasons_with(longer, same), "another distance");
}
