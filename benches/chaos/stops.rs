//! A process of each kind is stopped for 5 s, as by a debugger or a machine that pages.

use crate::fleet::{Fleet, LOOK_PERIOD, PATIENCE, Process, send};
use crate::footprint::exists;
use crate::kills::{LOST_MAX, WARM_UP, own_map};
use crate::map_cells::count_lost;
use crate::watch::Watch;
use crate::{Args, Row, Rows};
use mr_slam::clock::now;
use rustix::process::Signal;
use serde_json::json;
use std::collections::BTreeSet;
use std::error::Error;
use std::time::{Duration, Instant};

/// Time for which a process is stopped.
const STOPPED: Duration = Duration::from_secs(5);
/// Longest time until another works in its place: the watchdog waits for 2 s, of the bridge for 1 s.
const BACK_WITHIN_S: f64 = 3.5;
/// Time between two stops.
const REST: Duration = Duration::from_secs(2);

/// Stops a process of each kind, one after the other.
pub fn run(args: &Args) -> Rows {
    let fleet = Fleet::start("demo", args.robots, &["--record", "--seed", &args.seed.to_string()])?;
    let watch = Watch::start(&fleet.run)?;
    std::thread::sleep(WARM_UP);
    let begun = now();
    let (mut rows, mut hits, mut seen) = (Vec::new(), Vec::new(), BTreeSet::new());
    let names = fleet.run.config.processes().map(|(row, robot)| row.title(robot));
    let names: Vec<String> = names.chain(["operator".to_owned()]).collect();
    // The last of a kind: robot1's simulator also sends the clock, which the kills cover.
    for name in names.into_iter().rev() {
        fleet.wait_for_other(&name, None)?;
        let process = fleet.process(&name).ok_or("a process that worked is gone")?;
        let kind = process.name.split(' ').next().unwrap_or_default().to_owned();
        if !seen.insert(kind) {
            continue;
        }
        hits.extend(process.robot.map(|robot| (robot, now())));
        rows.push(stop(&fleet, &process)?);
        // A robot's process is back only now; what it missed until then is its own.
        hits.extend(process.robot.map(|robot| (robot, now())));
        std::thread::sleep(REST);
    }
    let (missed, poses) = (watch.missed(begun, &hits), watch.poses(begun));
    rows.push(Row::new(
        "stops",
        "scans without a pose, of robots that were not hit",
        format!("{missed} of {poses}"),
        "0",
        missed == 0,
    ));
    Ok(rows)
}

fn stop(fleet: &Fleet, process: &Process) -> Result<Row, Box<dyn Error>> {
    let before = match own_map(process) {
        Some(robot) => Some((robot, fleet.cells(robot, |cells| !cells.is_empty())?)),
        None => None,
    };
    std::thread::sleep(LOST_MAX);
    let stopped = Instant::now();
    send(process.pid, Signal::STOP);
    let (mut back_s, mut is_stopped) = (None, true);
    while is_stopped || (back_s.is_none() && !exists(process.pid) && stopped.elapsed() < PATIENCE) {
        let is_other = |now: &Process| now.pid != process.pid;
        if back_s.is_none() && fleet.process(&process.name).as_ref().is_some_and(is_other) {
            back_s = Some(stopped.elapsed().as_secs_f64());
        }
        if is_stopped && stopped.elapsed() >= STOPPED {
            // If it was replaced, it does not exist any more.
            send(process.pid, Signal::CONT);
            is_stopped = false;
        }
        std::thread::sleep(LOOK_PERIOD);
    }
    let lost = match before {
        Some((robot, before)) => {
            let after = fleet.cells(robot, |after| count_lost(&before, after) == 0)?;
            count_lost(&before, &after)
        }
        None => 0,
    };
    let measured = back_s.map_or("not replaced".to_owned(), |back_s| format!("{back_s:.2} s"));
    let holds = back_s.is_some_and(|back_s| back_s <= BACK_WITHIN_S) && lost == 0;
    Ok(Row::new(
        "stops",
        &format!("{}: another works in its place after", process.name),
        format!("{measured}; {lost} cells lost"),
        "<= 3.5 s; 0",
        holds,
    )
    .with(json!({ "process": process.name, "back_s": back_s, "lost_cells": lost })))
}
