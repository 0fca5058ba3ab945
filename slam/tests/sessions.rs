//! A map that is kept: the same after loading, refused when it is not what it says, gone on with,
//! and found one's way in.

mod common;

use common::{FULL, Lidar, Log, Noise, Robot, Wall, bits, cast, laboratory, rectangle, ring, ring_log};
use msg::grid::{Occupancy, occupancy};
use msg::{Odometry, Pose2, PoseEstimate, Scan, SlamMode, TrackingState};
use slam::session::VERSION;
use slam::{InitialPose, LocalFrameEstimate, Session, SessionError, SessionIdentity, Slam, SlamConfig};

/// Drives (linear m/s, angular rad/s, seconds) legs at 10 scans a second.
fn log(walls: &[Wall], lidar: &Lidar, robot: &mut Robot, legs: &[(f64, f64, f64)], seed: u64) -> Log {
    let mut noise = Noise::new(seed);
    let mut log = Vec::new();
    for &(linear, angular, seconds) in legs {
        for _ in 0..(seconds * 10.0).round() as usize {
            robot.drive(linear, angular, 0.1, &mut noise);
            let scan = cast(walls, lidar, robot.world_from_base, robot.stamp(), &mut noise);
            log.push((robot.odometry(), scan, robot.world_from_base));
        }
    }
    log
}

/// Feeds a log; every scan's pose as it was said then, and its state.
fn feed(slam: &mut Slam, log: &Log) -> Vec<(Pose2, TrackingState)> {
    let one = |(odometry, scan, _): &(Odometry, Box<Scan>, Pose2)| {
        slam.add_odometry(odometry);
        let pose_estimate = slam.process(scan).pose_estimate;
        slam.work();
        (pose_estimate.map_from_base, pose_estimate.state())
    };
    log.iter().map(one).collect()
}

fn start() -> Pose2 {
    Pose2::new(-1.0, -1.4, 0.0)
}

/// A round through the laboratory.
fn round() -> Vec<(f64, f64, f64)> {
    let quarter = (0.0, 0.5, core::f64::consts::PI);
    let (long, short) = ((0.15, 0.0, 20.0), (0.15, 0.0, 8.0));
    vec![short, quarter, long, quarter, short, short, quarter, long, quarter, short]
}

fn identity() -> SessionIdentity {
    SessionIdentity::new(1, 7, &SlamConfig::default())
}

/// The laboratory, mapped, and where its map lies in the world.
fn mapped(lidar: &Lidar) -> (Session, Pose2) {
    let mut slam = Slam::new(SlamConfig::default());
    let log = log(&laboratory(), lidar, &mut Robot::new(start()), &round(), 7);
    feed(&mut slam, &log);
    slam.finish();
    (slam.session(identity()), log[0].2)
}

#[test]
fn going_on_gives_the_bits_of_never_having_stopped() {
    let log = ring_log();
    // Its body is drawn, too.
    let mut config = SlamConfig::default();
    config.map.robot_radius_m = 0.105;
    // Before the closures, and after them.
    for stop in [40, log.len() - 12] {
        let (before, after) = (log[..stop].to_vec(), log[stop..].to_vec());
        let mut whole = Slam::new(config.clone());
        feed(&mut whole, &before);
        whole.map();
        feed(&mut whole, &after);
        whole.finish();
        assert!(whole.back_counts().closures > 0);
        let mut first = Slam::new(config.clone());
        feed(&mut first, &before);
        let drawn = first.map().to_owned();
        let bytes = first.session(identity()).encode().unwrap();
        let session = Session::decode(&bytes, &identity()).unwrap();
        assert!(drawn.cells.contains(&msg::grid::SWEPT_FREE));
        let mut second =
            Slam::create_or_resume(config.clone(), Some(session), SlamMode::Mapping, InitialPose::Continue);
        assert!(drawn == second.map().to_owned(), "another map after loading");
        feed(&mut second, &after);
        second.finish();
        let poses = |slam: &Slam| bits(slam.trajectory().map(|(_, pose)| pose));
        assert_eq!(whole.trajectory().count(), log.len());
        assert!(poses(&whole) == poses(&second), "another trajectory when stopped at {stop}");
        assert!(whole.map().to_owned() == second.map().to_owned(), "another map when stopped at {stop}");
    }
}

#[test]
fn what_is_not_a_session_is_refused_with_the_reason() {
    let (session, _) = mapped(&FULL);
    let bytes = session.encode().unwrap();
    assert_eq!(Session::decode(&bytes, &identity()).unwrap().encode().unwrap(), bytes);
    let refused = |bytes: &[u8]| Session::decode(bytes, &identity()).unwrap_err();
    for cut in [0, 1, 7, 8, 23, 24, 25, bytes.len() / 2, bytes.len() - 1] {
        let said = refused(&bytes[..cut]).to_string();
        let truncated = said.contains("truncated") || said.contains("ends") || said.contains("not a session");
        assert!(truncated, "cut at {cut}: {said}");
    }
    for at in (0..bytes.len()).step_by(bytes.len() / 500) {
        let mut flipped = bytes.clone();
        flipped[at] ^= 1 << (at % 8);
        refused(&flipped);
    }
    let mut flipped = bytes.clone();
    flipped[5000] ^= 4;
    assert!(matches!(refused(&flipped), SessionError::Checksum { .. }));
    let mut other = bytes.clone();
    let found = VERSION + 1;
    other[8..12].copy_from_slice(&found.to_le_bytes());
    assert_eq!(refused(&other), SessionError::Version { found });
    assert_eq!(refused(b"P5\n3 3\n255\n..........................."), SessionError::Magic);
    assert!(matches!(refused(&[&bytes[..], b"x"].concat()), SessionError::Length { .. }));

    let mut config = SlamConfig::default();
    let said = Session::decode(&bytes, &SessionIdentity::new(2, 7, &config)).unwrap_err().to_string();
    assert_eq!(said, "is another robot's: the robot's number is 1, here 2");
    config.lidar.base_from_scan[0] += 1e-12;
    assert!(
        Session::decode(&bytes, &SessionIdentity::new(1, 0, &config)).is_ok(),
        "rounding makes no other robot"
    );
    config.lidar.base_from_scan[0] = 0.2;
    let said = Session::decode(&bytes, &SessionIdentity::new(1, 7, &config)).unwrap_err().to_string();
    assert!(said.contains("LiDAR's place"), "{said}");
    assert!(
        Session::decode(&bytes, &SessionIdentity::new(1, 8, &SlamConfig::default())).is_ok(),
        "another run may"
    );
}

/// The robot is put down somewhere in the laboratory and drives on.
fn elsewhere(lidar: &Lidar, seed: u64) -> Log {
    let mut robot = Robot::new(Pose2::new(1.8, 0.4, 2.0));
    let legs = [(0.15, 0.1, 12.0), (0.0, 0.5, 4.0), (0.15, 0.1, 12.0), (0.15, -0.2, 12.0)];
    log(&laboratory(), lidar, &mut robot, &legs, seed)
}

/// Errors of the poses said while the robot was located: mean, largest; and how many.
fn errors(said: &[(Pose2, TrackingState)], log: &Log, world_from_map: Pose2) -> (f64, f64, usize) {
    let located = said.iter().zip(log).filter(|((_, state), _)| *state != TrackingState::Lost);
    let errors: Vec<f64> =
        located.map(|((pose, _), (_, _, truth))| (world_from_map * *pose).distance_m(*truth)).collect();
    let mean = errors.iter().sum::<f64>() / errors.len().max(1) as f64;
    (mean, errors.iter().copied().fold(0.0, f64::max), errors.len())
}

#[test]
fn a_robot_put_down_anywhere_is_found_and_the_map_gone_on_with() {
    let (session, world_from_map) = mapped(&FULL);
    let nodes = session.back.nodes.len();
    let log = elsewhere(&FULL, 3);
    let mut slam =
        Slam::create_or_resume(SlamConfig::default(), Some(session), SlamMode::Mapping, InitialPose::Unknown);
    let said = feed(&mut slam, &log);
    slam.finish();
    let (mean, most, located) = errors(&said, &log, world_from_map);
    assert!(located * 2 > log.len(), "located in {located} of {}: {:?}", log.len(), slam.back_counts());
    assert!(mean < 0.05 && most < 0.15, "mean {mean} m, most {most} m");
    let counts = slam.back_counts();
    assert_eq!(counts.relocalization.accepted, 1);
    assert!(counts.nodes > nodes + 10, "{} nodes after {nodes}", counts.nodes);
    // Every scan since it was put down is in the trajectory, at its place in the old map.
    let newer = slam.trajectory().skip(slam.trajectory().count() - log.len());
    for ((_, pose), (_, _, truth)) in newer.zip(&log) {
        assert!((world_from_map * pose).distance_m(*truth) < 0.15);
    }
}

#[test]
fn a_robot_that_is_told_where_it_is_is_there_at_once() {
    let (session, world_from_map) = mapped(&FULL);
    let log = elsewhere(&FULL, 4);
    let truth = world_from_map.between(log[0].2);
    let guess = Pose2::new(truth.x_m + 0.25, truth.y_m - 0.2, truth.yaw_rad + 0.15);
    let hint = LocalFrameEstimate { map_from_local: guess, sigma_m: 0.3, sigma_rad: 0.2 };
    for mode in [SlamMode::Mapping, SlamMode::Localization] {
        let mut slam = Slam::create_or_resume(
            SlamConfig::default(),
            Some(session.clone()),
            mode,
            InitialPose::Near(hint),
        );
        let said = feed(&mut slam, &log);
        assert!(said.iter().all(|(_, state)| *state != TrackingState::Lost), "{mode:?}");
        let (mean, most, _) = errors(&said[60..], &log[60..].to_vec(), world_from_map);
        assert!(mean < 0.05 && most < 0.15, "{mode:?}: mean {mean} m, most {most} m");
    }
}

#[test]
fn a_given_pose_has_the_uncertainty_it_was_given_with_until_scans_confirm_it() {
    let (session, world_from_map) = mapped(&FULL);
    let log = elsewhere(&FULL, 4);
    // 2 m beside the true place, where the scans fit nothing, and longer than 10 nodes.
    let truth = world_from_map.between(log[0].2);
    let wrong = Pose2::new(truth.x_m + 2.0, truth.y_m, truth.yaw_rad + 1.0);
    for (reported, is_right) in [(truth, true), (wrong, false)] {
        let hint = LocalFrameEstimate { map_from_local: reported, sigma_m: 0.3, sigma_rad: 0.2 };
        let start = InitialPose::Near(hint);
        let mut slam = Slam::create_or_resume(
            SlamConfig::default(),
            Some(session.clone()),
            SlamMode::Localization,
            start,
        );
        let said: Vec<_> = log
            .iter()
            .map(|(odometry, scan, _)| {
                slam.add_odometry(odometry);
                let pose_estimate = slam.process(scan).pose_estimate;
                slam.work();
                pose_estimate
            })
            .collect();
        let is_sure = |estimate: &PoseEstimate| estimate.position_sigma_m() < 0.29;
        let confirmed = said.iter().position(|estimate| estimate.state() == TrackingState::Tracking);
        assert_eq!(confirmed.is_some(), is_right, "{:?}", said.last());
        for estimate in &said[..confirmed.unwrap_or(said.len())] {
            assert_eq!(estimate.state(), TrackingState::Unconfirmed);
            assert!(!estimate.is_located() && !is_sure(estimate), "{estimate:?}");
        }
        assert_eq!(said.last().is_some_and(is_sure), is_right);
    }
}

#[test]
fn localization_changes_nothing_and_needs_no_more_memory() {
    let (session, world_from_map) = mapped(&FULL);
    let mut slam = Slam::create_or_resume(
        SlamConfig::default(),
        Some(session.clone()),
        SlamMode::Localization,
        InitialPose::Unknown,
    );
    let before = slam.map().to_owned();
    for seed in 0..4 {
        // Carried to its start each time: lost, and found again.
        let mut log = elsewhere(&FULL, seed);
        for (odometry, scan, _) in &mut log {
            let later = core::time::Duration::from_secs(1000 * seed);
            odometry.header.stamp = odometry.header.stamp + later;
            odometry.header.incarnation = seed;
            scan.header.stamp = odometry.header.stamp;
        }
        let said = feed(&mut slam, &log);
        let tail = log.len() / 2;
        let (mean, most, located) = errors(&said[tail..], &log[tail..].to_vec(), world_from_map);
        assert!(located > 0 && mean < 0.05 && most < 0.2, "{seed}: {located} located, {mean} m, {most} m");
    }
    assert!(before == slam.map().to_owned());
    let counts = slam.back_counts();
    assert_eq!(counts.nodes, session.back.nodes.len());
    assert!(counts.localized.matched > 60, "{:?}", counts.localized);
}

#[test]
fn a_robot_in_another_building_is_not_found() {
    let (session, _) = mapped(&FULL);
    let lidar = Lidar { range_max_m: 3.5, ..FULL };
    for seed in 3..6 {
        let mut robot = Robot::new(Pose2::new(-7.8, -5.8, 0.0));
        let log = log(&ring(seed), &lidar, &mut robot, &[(0.15, 0.0, 60.0)], seed);
        let mut slam = Slam::create_or_resume(
            SlamConfig::default(),
            Some(session.clone()),
            SlamMode::Localization,
            InitialPose::Unknown,
        );
        let said = feed(&mut slam, &log);
        let counts = slam.back_counts().relocalization;
        assert!(counts.searches > 5 && counts.accepted == 0, "{counts:?}");
        assert!(said.iter().all(|(_, state)| *state == TrackingState::Lost));
    }
}

#[test]
fn a_grid_is_enough_to_be_found_in() {
    let (session, world_from_map) = mapped(&FULL);
    let config = SlamConfig::default();
    let grid =
        Slam::create_or_resume(config.clone(), Some(session), SlamMode::Mapping, InitialPose::Continue)
            .map()
            .to_owned();
    let session = Session::from_grid(identity(), grid.view(), &config);
    assert!(session.back.nodes.len() > 10, "{} places", session.back.nodes.len());
    let log = elsewhere(&FULL, 5);
    let mut slam =
        Slam::create_or_resume(config, Some(session), SlamMode::Localization, InitialPose::Unknown);
    let said = feed(&mut slam, &log);
    let (mean, most, located) = errors(&said, &log, world_from_map);
    assert!(located * 2 > log.len(), "located in {located} of {}: {:?}", log.len(), slam.back_counts());
    assert!(mean < 0.07 && most < 0.2, "mean {mean} m, most {most} m");
}

/// Drives rounds, the walls changing from round to round.
fn rounds(slam: &mut Slam, walls: &dyn Fn(usize) -> Vec<Wall>, count: usize) -> Vec<usize> {
    let mut robot = Robot::new(start());
    let mut nodes = Vec::new();
    for i in 0..count {
        let mut legs = round();
        legs.push((0.0, 0.0, 0.1));
        feed(slam, &log(&walls(i), &FULL, &mut robot, &legs, i as u64));
        // Back to the start as the round ends: the wheels' drift is the robot's to bear.
        nodes.push(slam.back_counts().nodes);
    }
    nodes
}

fn laboratory_with_a_box(there: bool) -> Vec<Wall> {
    let mut walls = laboratory();
    if there {
        walls.extend(rectangle(-0.2, -0.3, 0.4, 0.3));
    }
    walls
}

fn occupied(slam: &mut Slam, world_from_map: Pose2) -> usize {
    let grid = slam.map();
    let at = |x: f64, y: f64| {
        let (x, y) = grid.cell_of(world_from_map.inverse().apply([x, y]));
        usize::from(occupancy(grid.cell(x, y)) == Occupancy::Occupied)
    };
    (0..20)
        .flat_map(|i| (0..20).map(move |k| (i, k)))
        .map(|(i, k)| at(-0.4 + 0.05 * f64::from(i), -0.5 + 0.05 * f64::from(k)))
        .sum()
}

#[test]
fn a_map_that_lasts_forgets_a_box_that_left_and_stays_small() {
    let world_from_map = log(&laboratory(), &FULL, &mut Robot::new(start()), &[(0.15, 0.0, 0.1)], 7)[0].2;
    let mut slam =
        Slam::create_or_resume(SlamConfig::default(), None, SlamMode::Lifelong, InitialPose::Unknown);
    let with = rounds(&mut slam, &|_| laboratory_with_a_box(true), 1);
    let seen = occupied(&mut slam, world_from_map);
    assert!(seen > 15, "the box is {seen} cells");
    // The same robot goes on, six rounds later the box is long gone.
    let log_of = |i: usize, robot: &mut Robot| {
        log(&laboratory_with_a_box(false), &FULL, robot, &round(), 20 + i as u64)
    };
    let mut robot = Robot::new(start());
    // Picks the robot up where the first rounds left it.
    log(&laboratory_with_a_box(true), &FULL, &mut robot, &round(), 0);
    log(&laboratory_with_a_box(true), &FULL, &mut robot, &[(0.0, 0.0, 0.1)], 0);
    let (mut nodes, mut left) = (with.clone(), Vec::new());
    for i in 0..6 {
        feed(&mut slam, &log_of(i, &mut robot));
        nodes.push(slam.back_counts().nodes);
        left.push(occupied(&mut slam, world_from_map));
    }
    slam.finish();
    left.push(occupied(&mut slam, world_from_map));
    assert!(left[2..].iter().all(|left| *left == 0), "{seen} cells of the box, left by round: {left:?}");
    let state = slam.session(identity()).back;
    assert!(slam.back_counts().removed_nodes > 50, "{:?}", slam.back_counts());
    assert!(nodes[6] < nodes[3] + nodes[3] / 5, "nodes by round: {nodes:?}");
    // Nothing of the box is left to match against, either.
    let phantom = state.nodes.iter().zip(&state.poses).flat_map(|(node, pose)| {
        node.cloud.points().iter().map(|p| (world_from_map * *pose).apply(p.at.map(f64::from)))
    });
    let phantom = phantom.filter(|[x, y]| (-0.3..0.5).contains(x) && (-0.4..0.4).contains(y)).count();
    let all: usize = state.nodes.iter().map(|n| n.cloud.points().len()).sum();
    assert!(phantom * 100 < all, "{phantom} of {all} points are the box's");
    // And the robot still knows where it is.
    let last = state.poses.last().unwrap();
    assert!((world_from_map * *last).distance_m(robot.world_from_base) < 0.5);
}

#[test]
fn a_closure_can_be_looked_at_undone_and_stays_undone() {
    let mut slam = Slam::new(SlamConfig::default());
    feed(&mut slam, &ring_log());
    slam.finish();
    let closures: Vec<_> = slam.back().closures().filter(|c| c.is_active).collect();
    assert!(!closures.is_empty());
    for closure in &closures {
        assert!(closure.response > 0.5 && closure.chi_squared < 40.0, "{closure:?}");
        assert!(closure.older < closure.newer);
    }
    let (closed, number) = (slam.back_counts(), closures[0].number);
    assert!(slam.back_mut().undo_closure(number));
    assert!(!slam.back_mut().undo_closure(number), "it is undone already");
    assert!(!slam.back_mut().undo_closure(1000));
    assert!(slam.back_counts().closures < closed.closures);
    assert!(slam.back().closures().any(|c| c.number == number && !c.is_active));
    slam.back_mut().clear_closures();
    assert_eq!(slam.back_counts().closures, 0);
    // What passes shared through the closures is gone with them.
    let apart =
        |e: &&slam::Edge| e.is_active && e.kind == slam::EdgeKind::ScanMatch && e.a.abs_diff(e.b) > 60;
    assert_eq!(slam.back().graph().edges().iter().filter(apart).count(), 0);
    slam.finish();
    assert_eq!(slam.back_counts().closures, 0, "an undone closure was accepted again");
}
