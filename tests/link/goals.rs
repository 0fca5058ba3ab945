//! Goals at the base for a robot on another machine: navigation at the base drives it over the link.

use crate::fleets::{Ended, Fleet, LIMIT, TestFolder, caught_up, start, until};
use operator::client::Client;
use ros_messages::{Empty, PoseStamped};
use std::path::Path;
use std::time::{Duration, Instant};

/// Free place ahead of the robot's start in the built-in room, metres: far enough to cut the link on the way.
const GOAL_M: [f64; 2] = [0.9, 0.0];

/// Starts `mr-slam goto` at the base.
fn go_to(folder: &Path, base: &Fleet, [x, y]: [f64; 2]) -> Ended {
    let (goal, run) = (format!("{x},{y}"), base.run.dir.display().to_string());
    Ended::start(folder, &["goto", "robot1", &goal, "--run-dir", &run])
}

#[test]
fn the_base_drives_a_robot_to_a_goal_through_an_outage_and_cancels() {
    let folder = TestFolder::new();
    let (mut base, mut robot) = start(folder.path());
    until("the base has the robot's map", LIMIT, || caught_up(&mut base, &mut robot));

    let mut goto = go_to(folder.path(), &base, GOAL_M);
    until("the robot drives", LIMIT, || robot.is_driving().then_some(()));
    robot.freeze_link(true);
    until("the robot stands without its base", LIMIT, || (!robot.is_driving()).then_some(()));
    until("the base says why", LIMIT, || goto.has_said("no scan has arrived").then_some(()));
    assert_eq!(goto.exit(), None, "the goal is kept");
    robot.freeze_link(false);
    let exit = until("the robot has gone on to its goal", LIMIT, || goto.exit());
    assert!(exit.success(), "{exit}");
    until("the robot stands at its goal", LIMIT, || (!robot.is_driving()).then_some(()));

    let mut client = Client::new(format!("127.0.0.1:{}", base.run.port));
    let handle = client.handle();
    handle.advertise::<PoseStamped>("/alice/goal_pose");
    handle.advertise::<Empty>("/alice/cancel_navigation");
    let back =
        PoseStamped { frame_id: "map".into(), orientation: [0.0, 0.0, 0.0, 1.0], ..Default::default() };
    let poll = |client: &mut Client| {
        client.poll(Instant::now() + Duration::from_millis(50), &mut |_| {});
    };
    until("a client's goal drives the robot", LIMIT, || {
        poll(&mut client);
        handle.publish("/alice/goal_pose", &back);
        robot.is_driving().then_some(())
    });
    until("the robot stands after the cancellation", LIMIT, || {
        handle.publish("/alice/cancel_navigation", &Empty {});
        poll(&mut client);
        (!robot.is_driving()).then_some(())
    });
}
