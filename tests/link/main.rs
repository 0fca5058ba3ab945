//! Robots and a base on one machine, joined over Zenoh: `cargo test --features link --test link`.

mod fleets;
mod goals;
mod power;
mod scans;
mod strangers;

use fleets::{Fleet, LIMIT, TestFolder, caught_up, endpoint, start, until};
use mr_slam::control::{self, Request};
use std::time::Duration;

/// Longest wait for a bridge's answer.
const PATIENCE: Duration = Duration::from_secs(2);

#[test]
fn a_robot_on_another_machine_is_mapped_driven_and_stopped_by_the_base() {
    let folder = TestFolder::new();
    let (mut base, mut robot) = start(folder.path());
    let first = until("the base has the robot's first map", LIMIT, || caught_up(&mut base, &mut robot));

    assert!(base.drive_and_watch("alice", 4.0, 0.15, 0.4, &mut robot), "nobody drove");
    let second = until("the base has the driven map", LIMIT, || {
        caught_up(&mut base, &mut robot).filter(|cells| *cells != first)
    });
    assert!(second > 0);
    until("the merged map shows it", LIMIT, || base.merged_shows_all_of(&mut robot));

    // The robot goes on mapping while the link is frozen, and the base catches up.
    robot.freeze_link(true);
    robot.drive("alice", 6.0, 0.15, -0.4);
    assert!(caught_up(&mut base, &mut robot).is_none(), "nothing crosses a frozen link");
    robot.freeze_link(false);
    until("the base has caught up", LIMIT, || caught_up(&mut base, &mut robot));

    control::ask(&base.run, Request::Stop, PATIENCE).unwrap();
    until("the stop is on the robot", LIMIT, || robot.is_stopped().filter(|stopped| *stopped));
    assert!(robot.run.dir.join("stopped").exists(), "the stop is latched in the robot's folder");
    // A base that dies releases nothing, and neither does the one that replaces it.
    let address = base.endpoint.clone();
    drop(base);
    let mut base = Fleet::start(folder.path(), "base2", &address, &fleets::base_args("alice", &address));
    until("another base has the whole map", LIMIT, || caught_up(&mut base, &mut robot));
    assert_eq!(base.is_stopped(), Some(false));
    assert_eq!(robot.is_stopped(), Some(true), "the stop holds");
}

#[test]
fn a_link_that_is_killed_comes_back_and_the_base_keeps_the_map() {
    let folder = TestFolder::new();
    let (mut base, mut robot) = start(folder.path());
    until("the base has the robot's map", LIMIT, || caught_up(&mut base, &mut robot));
    for fleet in [&base, &robot] {
        fleet.kill_link();
    }
    robot.drive("alice", 3.0, 0.15, 0.4);
    until("the base has the robot's map again", LIMIT, || caught_up(&mut base, &mut robot));
    control::ask(&base.run, Request::Stop, PATIENCE).unwrap();
    until("the stop is on the robot", LIMIT, || robot.is_stopped().filter(|stopped| *stopped));
    control::ask(&base.run, Request::Release, PATIENCE).unwrap();
    until("the base releases its stop", LIMIT, || robot.is_stopped().filter(|stopped| !stopped));
}

#[test]
fn plain_text_to_another_machine_is_refused_with_what_to_do() {
    let folder = TestFolder::new();
    let said = fleets::refused(folder.path(), &["robot", "--name", "alice", "--base", "tcp/192.0.2.1:7447"]);
    assert!(said.contains("--unencrypted") && said.contains("mr-slam keys"), "{said}");
    let said = fleets::refused(folder.path(), &["base", "--names", "alice", "--listen", &endpoint("tls")]);
    assert!(said.contains("mr-slam keys base"), "{said}");
    let said = fleets::refused(folder.path(), &["base", "--listen", &endpoint("tcp")]);
    assert!(said.contains("--names"), "{said}");
}
