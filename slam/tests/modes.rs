//! What people change while SLAM runs: the mode, where the robot is, when the next node is made.

mod common;

use common::{FULL, Noise, Robot, cast, laboratory};
use msg::{Odometry, Pose2, Scan, SlamMode, TrackingState};
use slam::{BackEnd, FrontEnd, InitialPose, LocalFrameEstimate, Session, SessionIdentity, Slam, SlamConfig};

type Log = Vec<(Odometry, Box<Scan>, Pose2)>;

/// Twice around the middle of the laboratory, at 10 scans a second.
fn log(robot: &mut Robot, seconds: usize, seed: u64) -> Log {
    let (walls, mut noise) = (laboratory(), Noise::new(seed));
    let mut one = || {
        robot.drive(0.15, 0.2, 0.1, &mut noise);
        let scan = cast(&walls, &FULL, robot.world_from_base, robot.stamp(), &mut noise);
        (robot.odometry(), scan, robot.world_from_base)
    };
    (0..10 * seconds).map(|_| one()).collect()
}

/// The largest error of the poses said at once; none may be of a lost robot, nor in a map that is called unreliable.
fn error_m(slam: &mut Slam, log: &Log, world_from_map: Pose2) -> f64 {
    let mut worst = 0.0_f64;
    for (odometry, scan, truth) in log {
        slam.add_odometry(odometry);
        let pose_estimate = slam.process(scan).pose_estimate;
        slam.work();
        let state = pose_estimate.state();
        assert!(!matches!(state, TrackingState::Lost | TrackingState::MapUnreliable), "{state:?}");
        worst = worst.max((world_from_map * pose_estimate.map_from_base).distance_m(*truth));
    }
    worst
}

#[test]
fn a_robot_keeps_its_place_when_the_mode_changes() {
    let mut robot = Robot::new(Pose2::new(0.0, -0.75, 0.0));
    let first = log(&mut robot, 32, 1);
    let world_from_map = first[0].2;
    let mut slam = Slam::new(SlamConfig::default());
    assert!(error_m(&mut slam, &first, world_from_map) < 0.1);
    let identity = SessionIdentity::new(1, 7, &SlamConfig::default());
    let has_front = |slam: &mut Slam| slam.session(identity).front.is_some();
    assert!(has_front(&mut slam));

    slam.back_mut().set_mode(SlamMode::Localization);
    let (map, nodes) = (slam.map().to_owned(), slam.back_counts().nodes);
    assert!(error_m(&mut slam, &log(&mut robot, 16, 2), world_from_map) < 0.1);
    assert_eq!(slam.back_counts().nodes, nodes);
    assert!(map == slam.map().to_owned(), "the map stays as it is");
    assert!(slam.back_counts().localized.matched > 5);
    // The scan path's newest scans are not in the map: who goes on later must look for the robot.
    assert!(!has_front(&mut slam));

    slam.back_mut().set_mode(SlamMode::Mapping);
    assert!(error_m(&mut slam, &log(&mut robot, 16, 3), world_from_map) < 0.1);
    assert!(slam.back_counts().nodes > nodes + 5);
    assert!(has_front(&mut slam));
    // Every node since lies where the robot was, not where the graph left it half a round before.
    let (_, last) = slam.trajectory().last().unwrap();
    assert!((world_from_map * last).distance_m(robot.world_from_base) < 0.1);

    slam.back_mut().start_relocalization(None);
    assert!(!has_front(&mut slam), "nor while it is looked for");
}

#[test]
fn an_estimate_that_nothing_can_be_compared_with_stays_unconfirmed() {
    for mode in [SlamMode::Mapping, SlamMode::Lifelong, SlamMode::Localization] {
        let mut robot = Robot::new(Pose2::new(0.0, -0.75, 0.0));
        let first = log(&mut robot, 32, 1);
        let mut slam = Slam::new(SlamConfig::default());
        error_m(&mut slam, &first, first[0].2);
        slam.back_mut().set_mode(mode);
        // Far outside of the map.
        let map_from_local = Pose2::new(40.0, 0.0, 1.0);
        let estimate = LocalFrameEstimate { map_from_local, sigma_m: 0.3, sigma_rad: 0.2 };
        slam.back_mut().start_relocalization(Some(estimate));
        let mut accepted = 0;
        for (scan_number, (odometry, scan, _)) in log(&mut robot, 40, 2).into_iter().enumerate() {
            slam.add_odometry(&odometry);
            let pose_estimate = slam.process(&scan).pose_estimate;
            slam.work();
            if scan_number < 40 {
                // The front end is told with its second node from here.
                continue;
            }
            accepted += usize::from(slam.back().grows_map());
            if mode == SlamMode::Localization && pose_estimate.state() == TrackingState::Lost {
                // Nothing of the map was seen over some metres.
                break;
            }
            assert_eq!(pose_estimate.state(), TrackingState::Unconfirmed, "{mode:?}");
            assert!(pose_estimate.position_sigma_m() > 0.29, "{mode:?}: {pose_estimate:?}");
        }
        assert!(
            mode == SlamMode::Localization || accepted > 50,
            "{mode:?}: {:?}",
            slam.back_counts().relocalization
        );
        // Nothing is drawn there.
        let map = slam.map();
        let reaches_m = map.header.origin.x_m + f64::from(map.header.width) * map.header.resolution_m;
        assert!(reaches_m < 20.0, "{mode:?}: the map reaches to {reaches_m:.1} m");
        if mode != SlamMode::Mapping {
            continue;
        }
        // Nor after the session is loaded again.
        let identity = || SessionIdentity::new(1, 7, &SlamConfig::default());
        let bytes = slam.session(identity()).encode().unwrap();
        let session = Session::decode(&bytes, &identity()).unwrap();
        let mut slam =
            Slam::create_or_resume(SlamConfig::default(), Some(session), mode, InitialPose::Continue);
        let next = log(&mut robot, 4, 3);
        let states = next.iter().map(|(odometry, scan, _)| {
            slam.add_odometry(odometry);
            let state = slam.process(scan).pose_estimate.state();
            slam.work();
            state
        });
        let states: Vec<TrackingState> = states.collect();
        let is_unconfirmed = states.iter().all(|state| *state == TrackingState::Unconfirmed);
        assert!(is_unconfirmed && slam.back_counts().unplaced > 10, "{states:?}, {:?}", slam.back_counts());
    }
}

#[test]
fn a_map_begins_where_it_is_told_to() {
    let mut robot = Robot::new(Pose2::new(0.0, -0.75, 0.0));
    let log = log(&mut robot, 16, 4);
    let (mut front, mut back) = (FrontEnd::new(SlamConfig::default()), BackEnd::new(SlamConfig::default()));
    let reported = Pose2::new(5.0, -3.0, 2.0);
    back.start_relocalization(Some(LocalFrameEstimate {
        map_from_local: reported,
        sigma_m: 0.1,
        sigma_rad: 0.05,
    }));
    front.set_map_from_local(Some(reported));
    let world_from_map = log[0].2 * reported.inverse();
    for (odometry, scan, truth) in &log {
        front.add_odometry(odometry);
        let result = front.process(scan);
        let at = world_from_map * result.pose_estimate.map_from_base;
        assert!(at.distance_m(*truth) < 0.1, "{at:?} instead of {truth:?}");
        result.node.into_iter().for_each(|node| front.add_frame_update(back.add_node(node)));
    }
    assert!(back.is_located() && back.nodes().len() > 10);
    assert_eq!(back.graph().poses()[0], reported);
}

#[test]
fn a_standing_robot_makes_a_node_when_somebody_waits_for_one() {
    let (walls, mut noise) = (laboratory(), Noise::new(5));
    let mut robot = Robot::new(Pose2::new(0.0, -0.75, 0.0));
    let mut front = FrontEnd::new(SlamConfig::default());
    let mut made = |front: &mut FrontEnd| {
        robot.drive(0.0, 0.0, 0.1, &mut noise);
        front.add_odometry(&robot.odometry());
        let scan = cast(&walls, &FULL, robot.world_from_base, robot.stamp(), &mut noise);
        front.process(&scan).node_id
    };
    assert_eq!([0; 4].map(|_| made(&mut front)), [Some(0), None, None, None]);
    front.request_node();
    assert_eq!([0; 3].map(|_| made(&mut front)), [Some(1), None, None]);
}
