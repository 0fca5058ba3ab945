//! A base that loses its power while it drives a robot: all of its processes are killed at once.

use crate::fleets::{self, Fleet, LIMIT, TestFolder, caught_up, start, until};
use mr_slam::control::{self, Request};
use std::time::{Duration, Instant};

/// Time after which a robot that nobody drives must stand: the 0.3 s of its own bridge, and as much for a machine that is busy
/// with other tests.
const STAND_WITHIN: Duration = Duration::from_millis(600);

#[test]
fn a_robot_stops_when_all_of_its_base_is_killed_and_keeps_its_emergency_stop() {
    let folder = TestFolder::new();
    let (mut base, mut robot) = start(folder.path());
    until("the base has the robot's map", LIMIT, || caught_up(&mut base, &mut robot));
    let begun = Instant::now();
    base.drive_until("alice", 0.1, 0.3, || {
        assert!(begun.elapsed() < LIMIT, "the base does not drive the robot");
        robot.is_driving()
    });
    let address = base.endpoint.clone();
    base.kill();
    until("the robot stands", STAND_WITHIN, || (!robot.is_driving()).then_some(()));
    assert_eq!(robot.is_stopped(), Some(false), "it stands because nobody drives it");

    // With the stop set, killing the base releases nothing, and neither does the one that replaces it.
    let mut base = Fleet::start(folder.path(), "base2", &address, &fleets::base_args("alice", &address));
    until("another base has the whole map", LIMIT, || caught_up(&mut base, &mut robot));
    control::ask(&base.run, Request::Stop, LIMIT).unwrap();
    until("the stop is on the robot", LIMIT, || robot.is_stopped().filter(|stopped| *stopped));
    base.kill();
    let mut base = Fleet::start(folder.path(), "base3", &address, &fleets::base_args("alice", &address));
    until("the third base has the whole map", LIMIT, || caught_up(&mut base, &mut robot));
    assert_eq!(robot.is_stopped(), Some(true), "the stop holds");
    robot.drive("alice", 1.0, 0.1, 0.0);
    assert!(!robot.is_driving(), "a robot with its stop set was driven");
}
