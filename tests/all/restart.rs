//! A killed process is restarted, and the other processes are not affected.

use crate::harness::{Fleet, process, send};
use rustix::process::Signal;

/// Kills one process of a running fleet of three, waits for its return, and checks the others.
fn kill_and_recover(name: &str) {
    let mut fleet = Fleet::start("up", &["--robots", "3"]);
    let before = fleet.until("scans of all robots", |view| {
        view.robots.len() == 3
            && view.robots.iter().all(|robot| robot.scans >= 20)
            && process(view, name).is_some()
    });
    let killed = process(&before, name).unwrap().pid;
    send(killed, Signal::KILL);
    let after = fleet.until("the process's return", |view| {
        let back = process(view, name).is_some_and(|p| p.pid != killed && p.state == "up" && p.restarts == 1);
        back && view.robots.iter().zip(&before.robots).all(|(now, then)| now.scans >= then.scans + 30)
    });
    for peer in after.processes.iter().filter(|peer| peer.process != name) {
        assert_eq!(peer.restarts, 0, "{peer:?}");
    }
    // Nobody lost its place, not even the robot whose process died.
    for robot in &after.robots {
        assert!(robot.pose_error_m.is_some_and(|error| error < 0.10), "{robot:?}");
    }
    for robot in after.robots.iter().filter(|robot| !name.ends_with(&robot.robot)) {
        assert_eq!(robot.scans_lost, 0, "{robot:?}");
        assert_eq!(robot.state, "tracking", "{robot:?}");
    }
}

#[test]
fn a_fleet_survives_a_killed_slam_process() {
    kill_and_recover("slam of robot2");
}

#[test]
fn a_fleet_survives_a_killed_bridge() {
    kill_and_recover("bridge");
}

#[test]
fn a_fleet_survives_a_killed_simulator() {
    kill_and_recover("sim of robot3");
}
