//! A killed SLAM process comes back with all nodes but those of the last half second, at whatever moment it is killed.

use mr_slam::config::FleetConfig;
use mr_slam::lockstep::Lockstep;
use mr_slam::lockstep::faults::{Fault, FaultPlan};
use msg::{Monotonic, RobotId, SlamMode, Stamp};
use slam::{InitialPose, Session};
use std::collections::BTreeSet;

/// Kills of a test run, each in a run of its own.
const KILLS: u64 = 24;
/// What a process may lose: the newest nodes, up to this age, seconds.
const LOST_MAX_S: f64 = 0.5;
/// Time until a killed process works again, seconds: in lockstep its start takes 0.2 s.
const BACK_AFTER_S: f64 = 0.3;
/// First and last moment of a kill, seconds.
const KILLED_FROM_S: f64 = 1.0;
const KILLED_UNTIL_S: f64 = 9.0;
/// Index of robot 1's SLAM process in a fleet of two.
const SLAM_1: usize = 2;

fn config(seed: u64) -> FleetConfig {
    let mut config = FleetConfig::default();
    (config.fleet.robots, config.fleet.seed) = (2, seed);
    // Sessions are saved during some of the runs, and records are spread over both files.
    config.sessions.autosave_s = if seed.is_multiple_of(2) { 2.0 } else { 30.0 };
    config
}

/// Runs a fleet until a moment, and returns robot 1's session; `None` if its process does not run.
fn session_at(fleet: &mut Lockstep, seconds: f64) -> Option<Session> {
    while fleet.now().seconds() < seconds {
        fleet.tick(&mut |_, _| {});
    }
    fleet.sessions().find(|(robot, _)| *robot == RobotId::new(1).unwrap()).map(|(_, session)| session)
}

fn stamps(session: &Session) -> BTreeSet<Stamp> {
    session.back.nodes.iter().map(|node| node.header.stamp).collect()
}

/// Cells that the session's map knows, in whole cells from the origin of the map's frame.
fn known_cells(config: &FleetConfig, session: Session) -> BTreeSet<(i64, i64)> {
    let (_, mut back) =
        slam::create_or_resume(config.slam.clone(), Some(session), SlamMode::Mapping, InitialPose::Continue);
    let map = back.map();
    let cell = |metres: f64| (metres / map.header.resolution_m).round() as i64;
    let (x0, y0) = (cell(map.header.origin.x_m), cell(map.header.origin.y_m));
    let width = map.header.width as usize;
    let known = map.cells.iter().enumerate().filter(|(_, cell)| **cell != 0);
    known.map(|(k, _)| (x0 + (k % width) as i64, y0 + (k / width) as i64)).collect()
}

#[test]
fn a_fleet_that_is_killed_at_any_moment_leaves_all_but_half_a_second_to_a_later_one() {
    let robot = RobotId::new(1).unwrap();
    let mut with_records = 0;
    for seed in 1..=2 {
        let mut fleet = Lockstep::new(&config(seed), true).unwrap();
        let mut before = None;
        for half_seconds in 4..20 {
            let now = session_at(&mut fleet, 0.5 * f64::from(half_seconds)).expect("the process runs");
            // Nothing was saved yet in the first seconds.
            let saved = fleet.saved_session(robot);
            if let (Some(saved), Some(before)) = (&saved, &before) {
                let missing: Vec<Stamp> = stamps(before).difference(&stamps(saved)).copied().collect();
                assert!(
                    missing.is_empty(),
                    "seed {seed}, {half_seconds} half seconds: nodes of {missing:?} are lost"
                );
                with_records += usize::from(stamps(saved).len() > 5);
            }
            before = Some(now);
        }
    }
    assert!(with_records > 10, "{with_records}");
}

#[test]
fn slam_killed_at_any_moment_loses_half_a_second_at_most() {
    let mut lost_cells = Vec::new();
    for seed in 1..=KILLS {
        // A low-discrepancy sequence: the golden ratio's multiples.
        let share = (seed as f64 * 0.618_033_988_749_895).fract();
        let at_s = KILLED_FROM_S + share * (KILLED_UNTIL_S - KILLED_FROM_S);
        let config = config(seed);
        let kill = Fault::Kill(SLAM_1);
        let faults = FaultPlan::none().with(Monotonic((at_s * 1e9) as u64), kill);
        let mut fleet = Lockstep::with_faults(&config, true, faults).unwrap();
        let before = session_at(&mut fleet, at_s - LOST_MAX_S).expect("the process runs");
        let mut seconds = at_s + BACK_AFTER_S;
        let after = loop {
            match session_at(&mut fleet, seconds) {
                Some(after) => break after,
                None => seconds += 0.05,
            }
            assert!(seconds < at_s + 2.0, "kill {seed} at {at_s:.2} s: the process did not come back");
        };
        let missing: Vec<Stamp> = stamps(&before).difference(&stamps(&after)).copied().collect();
        assert!(missing.is_empty(), "kill {seed} at {at_s:.2} s: nodes of {missing:?} are lost");
        let (before, after) = (known_cells(&config, before), known_cells(&config, after));
        // A solution of the pose graph in between may move a wall by a cell.
        let is_near =
            |(x, y): &(i64, i64)| (-1..=1).any(|i| (-1..=1).any(|j| after.contains(&(x + i, y + j))));
        lost_cells.push((before.iter().filter(|cell| !is_near(cell)).count(), before.len()));
    }
    assert!(lost_cells.iter().all(|(lost, _)| *lost == 0), "cells lost, of cells known: {lost_cells:?}");
}
