//! Robots that do not know where they are, and look for their place.

use super::{Drive, id, scan};
use crate::command::Twist;
use crate::navigation::{NavigatedRobot, NavigationFailure, NavigationInput, NavigationState};
use crate::observation::ScanView;
use crate::test_world::TestWorld;
use msg::ExclusionZone;

fn lost(seed: u64) -> Drive {
    let mut drive = Drive::new(TestWorld::new(1, seed));
    drive.knows_poses = false;
    drive.navigator.find_place(drive.now(), id(1));
    drive
}

fn twist(drive: &Drive) -> Option<Twist> {
    drive.navigator.robots().next().unwrap().twist
}

#[test]
fn a_lost_robot_looks_around_then_drives_by_its_lidar_and_gives_up_in_the_end() {
    for seed in 0..8 {
        let mut drive = lost(seed);
        let start = drive.world.pose(0);
        drive.run_until(5.0, |_| false);
        assert!(drive.world.pose(0).distance_m(start) < 0.05, "it turns first");
        let left = drive.run_until(100.0, |drive| drive.world.pose(0).distance_m(start) > 1.0);
        assert!(left.is_some(), "seed {seed}: still at {:?}", drive.world.pose(0));
        assert_eq!(drive.state(1), NavigationState::FindingPlace);
        drive.run_until(120.0, |drive| !drive.navigator.is_active());
        assert_eq!(drive.state(1), NavigationState::Failed(NavigationFailure::NoPose));
        assert_eq!(twist(&drive), Some(Twist::STOP));
        assert_eq!(drive.world.bumps(), 0, "seed {seed}");
        drive.step();
        assert_eq!(twist(&drive), None);
    }
}

#[test]
fn a_robot_whose_lidar_is_covered_does_not_drive() {
    let mut drive = lost(1);
    for _ in 0..600 {
        drive.steps += 1;
        let now = drive.now();
        let mut robot = NavigatedRobot::unknown(id(1));
        let covered = [0.0; 180];
        robot.observation.scan = Some(ScanView { ranges_m: &covered, ..scan(&drive.world, 0, now) });
        drive.navigator.step(&NavigationInput { stamp: now, robots: &[robot], exclusion_zones: &[] });
        assert_eq!(twist(&drive).unwrap().linear_m_s, 0.0);
    }
    assert_eq!(drive.state(1), NavigationState::FindingPlace);
}

#[test]
fn the_search_ends_when_the_pose_is_known() {
    let mut drive = lost(1);
    drive.run_until(20.0, |_| false);
    drive.knows_poses = true;
    drive.step();
    assert_eq!((drive.state(1), twist(&drive)), (NavigationState::Idle, Some(Twist::STOP)));
}

#[test]
fn a_robot_that_cannot_keep_out_of_zones_stands() {
    let mut drive = lost(1);
    drive.run_until(1.0, |_| false);
    drive.zones = vec![ExclusionZone::new(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]).unwrap()];
    drive.step();
    assert_eq!(drive.state(1), NavigationState::Failed(NavigationFailure::NoPose));
    assert_eq!(twist(&drive), Some(Twist::STOP));
}

#[test]
fn people_and_goals_end_the_search() {
    let ends: [fn(&mut Drive); 2] =
        [|drive| drive.navigator.pause(id(1)), |drive| drive.navigator.cancel(id(1))];
    for end in ends {
        let mut drive = lost(1);
        drive.run_until(20.0, |_| false);
        end(&mut drive);
        drive.step();
        assert!(!drive.navigator.is_active());
        assert_eq!(twist(&drive), Some(Twist::STOP));
    }
    let mut drive = lost(1);
    drive.run_until(20.0, |_| false);
    drive.go(1, [5.2, 7.2]);
    drive.step();
    assert_eq!(drive.state(1), NavigationState::Blocked(NavigationFailure::NoPose));
    assert_eq!(twist(&drive), Some(Twist::STOP));
}
