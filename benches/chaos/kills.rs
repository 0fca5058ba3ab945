//! Random processes are killed: how soon they work again, and what the others notice.

use crate::fleet::{Fleet, Process, send};
use crate::footprint::{Footprint, exists, shared_files};
use crate::map_cells::{Cells, count_lost};
use crate::watch::Watch;
use crate::{Args, Row, Rows};
use mr_slam::clock::now;
use msg::RobotId;
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use rustix::process::Signal;
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;
use std::time::{Duration, Instant};

/// Time until a fleet has maps and its memory has been touched.
pub const WARM_UP: Duration = Duration::from_secs(15);
/// Age of the newest cells that a death may take.
pub const LOST_MAX: Duration = Duration::from_millis(500);
/// Time for which a process is left alone after its death: a life of 10 s lets the supervisor forget earlier deaths, after
/// which it waits on purpose.
const LIFE: Duration = Duration::from_secs(12);
/// Longest time until a process works again, and until SLAM and merging have their maps again.
const BACK_WITHIN_S: f64 = 1.0;
const MAP_BACK_WITHIN_S: f64 = 2.0;
/// Largest growth of the launcher's memory, megabytes: it keeps events and a time series.
const LAUNCHER_GROWTH_MAX_MB: f64 = 4.0;
/// Largest growth of all processes' own memory: maps and their graphs grow with what the robots see.
const MEMORY_GROWTH_MAX: f64 = 1.1;
/// Most descriptors that all processes may have more at the end: connections of clients that come and go.
const DESCRIPTORS_GROWTH_MAX: usize = 8;

/// Outcome of the kills of one kind of process.
#[derive(Default)]
struct Kind {
    kills: u32,
    back_s: Vec<f64>,
    map_back_s: Vec<f64>,
    lost_cells: usize,
}

/// Kills processes for as long as the command line says.
pub fn run(args: &Args) -> Rows {
    let mut fleet = Fleet::start("demo", args.robots, &["--record", "--seed", &args.seed.to_string()])?;
    let watch = Watch::start(&fleet.run)?;
    std::thread::sleep(WARM_UP);
    replace_all(&fleet)?;
    let before = Footprint::of(&fleet);
    let begun = now();
    let (kinds, hits, pids) = kill_all(&fleet, args)?;
    // The last ones to be killed settle.
    std::thread::sleep(LIFE);
    let missed = watch.missed(begun, &hits);
    let poses = watch.poses(begun);
    let after = Footprint::of(&fleet);
    let run = fleet.run.clone();
    drop(watch);
    let ended_well = fleet.end();
    let left = pids.iter().filter(|pid| exists(**pid)).count() + shared_files(&run).len();
    let mut rows: Vec<Row> = kinds.iter().flat_map(|(name, kind)| kind.rows(name)).collect();
    rows.push(Row::new(
        "kills",
        "scans without a pose, of robots that were not hit",
        format!("{missed} of {poses}"),
        "0",
        missed == 0,
    ));
    rows.extend(growth(&before, &after));
    rows.push(Row::new(
        "kills",
        "processes and shared memory left after the end",
        format!("{left}, {}", if ended_well { "ended well" } else { "ended with an error" }),
        "0, ended well",
        left == 0 && ended_well,
    ));
    Ok(rows)
}

/// Kills every process once. Those that are started again inherit descriptors of the launcher, which no later kill adds to.
fn replace_all(fleet: &Fleet) -> Result<(), Box<dyn Error>> {
    for process in fleet.processes() {
        send(process.pid, Signal::KILL);
        fleet.wait_for_other(&process.name, Some(process.pid))?;
    }
    std::thread::sleep(LIFE);
    Ok(())
}

type Killed = (BTreeMap<String, Kind>, Vec<(RobotId, msg::Monotonic)>, BTreeSet<u32>);

fn kill_all(fleet: &Fleet, args: &Args) -> Result<Killed, Box<dyn Error>> {
    let mut random = SplitMix64::seed_from_u64(args.seed);
    let mut uniform = move || f64::from(random.next_u32()) / f64::from(u32::MAX);
    let (mut kinds, mut hits, mut pids) = (BTreeMap::<String, Kind>::new(), Vec::new(), BTreeSet::new());
    let mut killed_at = BTreeMap::<String, Instant>::new();
    let begun = Instant::now();
    let spacing = Duration::from_secs_f64(60.0 * args.minutes / f64::from(args.kills));
    for number in 0..args.kills {
        let due = spacing.mul_f64(f64::from(number) + uniform());
        std::thread::sleep(due.saturating_sub(begun.elapsed()));
        let processes = fleet.processes();
        pids.extend(processes.iter().map(|process| process.pid));
        let rested: Vec<&Process> = processes
            .iter()
            .filter(|process| killed_at.get(&process.name).is_none_or(|at| at.elapsed() > LIFE))
            .collect();
        let Some(victim) = rested.get((uniform() * rested.len() as f64) as usize) else { continue };
        killed_at.insert(victim.name.clone(), Instant::now());
        let kind = victim.name.split(' ').next().unwrap_or_default().to_owned();
        kill(fleet, victim, kinds.entry(kind).or_default(), &mut hits)?;
        eprint!("\r{} of {} kills ", number + 1, args.kills);
    }
    eprintln!();
    pids.extend(fleet.processes().iter().map(|process| process.pid));
    Ok((kinds, hits, pids))
}

/// Map that a process writes: a robot's, or the merged one; `None`: it writes none.
pub fn own_map(process: &Process) -> Option<Option<RobotId>> {
    match process.name.split(' ').next() {
        Some("slam") => Some(process.robot),
        Some("merge") => Some(None),
        _ => None,
    }
}

/// Kills a process and waits until it works again, with its map if it has one.
fn kill(
    fleet: &Fleet,
    victim: &Process,
    kind: &mut Kind,
    hits: &mut Vec<(RobotId, msg::Monotonic)>,
) -> Result<(), Box<dyn Error>> {
    let map = own_map(victim);
    let before = match map {
        Some(robot) => Some(fleet.cells(robot, |cells| !cells.is_empty())?),
        None => None,
    };
    std::thread::sleep(LOST_MAX);
    kind.kills += 1;
    hits.extend(victim.robot.map(|robot| (robot, now())));
    let killed = Instant::now();
    send(victim.pid, Signal::KILL);
    fleet.wait_for_other(&victim.name, Some(victim.pid))?;
    kind.back_s.push(killed.elapsed().as_secs_f64());
    if let (Some(robot), Some(before)) = (map, before) {
        let after = fleet.cells(robot, |after: &Cells| count_lost(&before, after) == 0)?;
        kind.map_back_s.push(killed.elapsed().as_secs_f64());
        kind.lost_cells += count_lost(&before, &after);
    }
    Ok(())
}

/// Median and largest of values.
pub fn median_and_largest(values: &[f64]) -> (f64, f64) {
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    (values.get(values.len() / 2).copied().unwrap_or(f64::NAN), values.last().copied().unwrap_or(f64::NAN))
}

impl Kind {
    fn rows(&self, name: &str) -> Vec<Row> {
        let (median, largest) = median_and_largest(&self.back_s);
        let mut rows = vec![
            Row::new(
                "kills",
                &format!("{name}: works again after, median and longest of {}", self.kills),
                format!("{median:.2} s, {largest:.2} s"),
                "<= 1 s",
                largest <= BACK_WITHIN_S,
            )
            .with(json!({ "process": name, "back_s": self.back_s })),
        ];
        if !self.map_back_s.is_empty() {
            let (median, largest) = median_and_largest(&self.map_back_s);
            rows.push(
                Row::new(
                    "kills",
                    &format!("{name}: has its map again after; cells lost"),
                    format!("{median:.2} s, {largest:.2} s; {} cells", self.lost_cells),
                    "<= 2 s; 0",
                    largest <= MAP_BACK_WITHIN_S && self.lost_cells == 0,
                )
                .with(
                    json!({ "process": name, "map_back_s": self.map_back_s, "lost_cells": self.lost_cells }),
                ),
            );
        }
        rows
    }
}

/// Compares what the fleet took before and after the kills.
fn growth(before: &Footprint, after: &Footprint) -> Vec<Row> {
    let both = json!({ "before": before, "after": after });
    let counts = |name: &str, [then, now]: [usize; 2], more: usize| {
        let limit = if more == 0 { "the same".to_owned() } else { format!("<= {more} more") };
        Row::new("kills", name, format!("{then}, then {now}"), &limit, now <= then + more)
    };
    let launcher = format!("{:.1} MB, then {:.1} MB", before.launcher_mb, after.launcher_mb);
    vec![
        counts("processes", [before.processes, after.processes], 0).with(both),
        counts("files in shared memory", [before.shared_files, after.shared_files], 0),
        counts(
            "descriptors of the launcher",
            [before.launcher_descriptors, after.launcher_descriptors],
            DESCRIPTORS_GROWTH_MAX,
        ),
        counts(
            "descriptors of all processes",
            [before.descriptors, after.descriptors],
            DESCRIPTORS_GROWTH_MAX,
        ),
        Row::new(
            "kills",
            "memory of the launcher",
            launcher,
            "<= 4 MB more",
            after.launcher_mb <= before.launcher_mb + LAUNCHER_GROWTH_MAX_MB,
        ),
        Row::new(
            "kills",
            "memory of all processes that is theirs alone",
            format!("{:.1} MB, then {:.1} MB", before.memory_mb, after.memory_mb),
            "<= 10 % more",
            after.memory_mb <= MEMORY_GROWTH_MAX * before.memory_mb,
        ),
    ]
}
