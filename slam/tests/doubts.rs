//! Maps that are wrong without a way to be right: SLAM says so.

mod common;

use common::{FULL, Noise, Robot, Wall, cast, rectangle};
use msg::{Pose2, SlamMode, TrackingState};
use slam::session::{Identity, Session};
use slam::{InitialPose, Slam, SlamConfig};

/// A corridor of 28 m whose ends are out of sight for most of the way, and a room at either end.
fn corridor() -> Vec<Wall> {
    let mut walls = vec![[[0.0, -1.0], [28.0, -1.0]], [[0.0, 1.0], [28.0, 1.0]]];
    walls.extend([[[0.0, -1.0], [0.0, 1.0]], [[28.0, -1.0], [28.0, 1.0]]]);
    walls.extend(rectangle(2.5, 0.6, 3.0, 1.0));
    walls.extend(rectangle(25.0, -1.0, 25.5, -0.6));
    walls
}

/// Drives from one end to the other; returns SLAM and the last state.
fn drive(has_odometry: bool) -> (Slam, TrackingState) {
    let walls = corridor();
    let (mut noise, mut robot) = (Noise::new(3), Robot::new(Pose2::new(1.0, 0.0, 0.0)));
    let mut slam = Slam::new(SlamConfig::default());
    let mut state = TrackingState::Starting;
    for _ in 0..520 {
        robot.drive(0.5, 0.0, 0.1, &mut noise);
        // The corridor is straight, and so is the robot's way.
        robot.world_from_base = Pose2::new(robot.world_from_base.x_m, 0.0, 0.0);
        if has_odometry {
            slam.add_odometry(&robot.odometry());
        }
        let scan = cast(&walls, &FULL, robot.world_from_base, robot.stamp(), &mut noise);
        state = slam.process(&scan).correction.state();
        slam.work();
    }
    slam.finish();
    (slam, state)
}

#[test]
fn a_corridor_without_odometry_is_no_map_to_rely_on() {
    let (slam, state) = drive(false);
    let doubts = slam.back().doubts();
    assert!(doubts.is_unreliable(), "{doubts:?}");
    assert!(doubts.unmeasured_motion_s > 10.0, "{doubts:?}");
    assert!(
        matches!(state, TrackingState::Unreliable | TrackingState::Degenerate | TrackingState::Lost),
        "{state:?}"
    );
    // A session keeps them: who loads it is told.
    let back = slam.back();
    let identity = Identity::new(1, 0, back.config());
    let bytes = back.session(identity, None, &[]).encode();
    let session = Session::decode(&bytes, &identity).unwrap();
    let (_, loaded) =
        slam::begin(back.config().clone(), Some(session), SlamMode::Mapping, InitialPose::Unknown);
    assert_eq!(loaded.doubts(), doubts);
    let (slam, _) = drive(true);
    assert!(!slam.back().doubts().is_unreliable(), "{:?}", slam.back().doubts());
}
