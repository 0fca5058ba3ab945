//! Recorded logs of several robots with unknown starts, through `mr-slam replay --merge unknown`: errors of surveyed
//! relations between robots, and of each robot's own relations alone and in the fleet. The same logs with given starts, one of them wrong.

use super::noise::Noise;
use super::relations::{Errors, Trajectory, Which, errors, parse};
use super::table::{Row, Table};
use std::path::{Path, PathBuf};
use std::process::Command;

type Error = Box<dyn std::error::Error>;

/// A building: its logs, and files of relations between robots and within each robot.
struct Case {
    name: &'static str,
    between: &'static str,
    /// Largest mean error between robots, metres. `None`: the robots may stay apart, but are not merged worse than
    /// [`WRONG_MERGE_M`].
    limit_m: Option<f64>,
    within: &'static str,
    odometry: &'static str,
}

const CASES: [Case; 3] = [
    Case {
        name: "intel_2",
        between: "inter_official.relations",
        limit_m: Some(0.12),
        within: "intel/official.relations",
        odometry: "intel/dense_odom.traj.gz",
    },
    Case {
        name: "intel_3",
        between: "inter_official.relations",
        limit_m: Some(0.12),
        within: "intel/official.relations",
        odometry: "intel/dense_odom.traj.gz",
    },
    Case {
        name: "aces_2",
        between: "inter_substitute.relations",
        limit_m: None,
        within: "aces/substitute.relations",
        odometry: "aces/dense_odom.traj.gz",
    },
];
/// Logs of one robot that are cut into halves (intel's are `intel_2`).
const HALVES: [&str; 6] = ["csail", "aces", "freiburg-101", "edmonton", "acapulco", NOT_COMPARED];
/// The log whose relations across the cut all are to scans that are not placed in the map: its error is not known.
const NOT_COMPARED: &str = "belgioioso";
/// Largest mean error between merged halves, metres: their substitute relations err by 0.05 to 0.07 m themselves.
const HALVES_LIMIT_M: f64 = 0.12;
/// Mean error above which a merge is wrong, metres.
const WRONG_MERGE_M: f64 = 0.3;
/// Least share of the relations of which both poses are in the merged map: the error of fewer says too little.
const COMPARED_SHARE_MIN: f64 = 0.6;
/// Number of runs with a wrong start, each building.
const WRONG_STARTS: u64 = 6;
/// A robot's own relations may be worse in the fleet than alone by this factor and this many metres, the accuracy of the
/// surveyed relations: the fleet's graph does move a robot's poses.
const WORSE_FACTOR: f64 = 1.1;
const WORSE_M: f64 = 0.002;

/// Adds a row for each building, and one for each robot.
pub fn rows(table: &mut Table, folder: &Path) -> Result<(), Error> {
    table.begin("logs of several robots, unknown starts", "mean error, m", "relations");
    for case in &CASES {
        let logs = logs(&folder.join(case.name));
        if logs.is_empty() {
            table.not_checked(format!("{} (not in {})", case.name, folder.display()));
            continue;
        }
        let between = folder.join(case.name).join(case.between);
        let merged = merge(case.name, false, &logs, &between, &folder.join(case.odometry))?;
        let Merged { row, together, all_merged } = merged;
        table.add(match case.limit_m {
            Some(limit_m) => row.at_most(limit_m),
            None if all_merged => row.at_most(WRONG_MERGE_M),
            None => row,
        });
        let within = parse(&std::fs::read_to_string(folder.join(case.within))?)?;
        for (index, (log, poses)) in logs.iter().zip(together).enumerate() {
            let own = |text: &str| -> Result<Errors, Error> {
                let found = errors(&Trajectory::parse(text)?, None, &within, Which::BothKept);
                Ok(Errors { mean_m: if found.count == 0 { f64::NAN } else { found.mean_m }, ..found })
            };
            let alone = tempfile::tempdir()?;
            let file = alone.path().join("alone.tum");
            replay_one(log, &file)?;
            let alone = own(&std::fs::read_to_string(&file)?)?;
            let together = own(&poses)?;
            let limit = WORSE_FACTOR * alone.mean_m + WORSE_M;
            let note = format!("alone {:.4} m", alone.mean_m);
            let row = Row::new(
                format!("  robot{} in itself, in the fleet", index + 1),
                together.mean_m,
                together.count as f64,
            );
            table.add(row.at_most((limit * 1e4).round() / 1e4).note(note));
        }
    }
    Ok(())
}

/// Adds a row for each log of one robot cut in the middle, as two robots. Staying apart is no error here: the halves of
/// some logs hardly overlap.
pub fn halves(table: &mut Table, folder: &Path) -> Result<(), Error> {
    table.begin("logs cut into halves, unknown starts", "mean error, m", "relations");
    for name in HALVES {
        let log = folder.join(name).join(format!("{name}.log.gz"));
        if !log.is_file() {
            table.not_checked(format!("{name} (not in {})", folder.display()));
            continue;
        }
        let text = unpacked(&log)?;
        let scans: Vec<&str> = text.lines().filter(|line| line.contains("LASER")).collect();
        let scratch = tempfile::tempdir()?;
        let (first, second) = scans.split_at(scans.len() / 2);
        let mut logs = Vec::new();
        for (half, k) in [first, second].into_iter().zip(1..) {
            logs.push(scratch.path().join(format!("robot{k}.log")));
            std::fs::write(&logs[k - 1], half.join("\n") + "\n")?;
        }
        let folder = folder.join(name);
        let odometry = folder.join("dense_odom.traj.gz");
        let merged = merge(name, true, &logs, &folder.join("substitute.relations"), &odometry)?;
        let is_checked = merged.all_merged && name != NOT_COMPARED;
        table.add(if is_checked { merged.row.at_most(HALVES_LIMIT_M) } else { merged.row });
    }
    Ok(())
}

/// Adds a row for each building whose robots' starts are given: as they were surveyed, and with one of them wrong, drawn from seeds.
/// A wrong merged map that nothing calls wrong misses the limit.
pub fn wrong_starts(table: &mut Table, folder: &Path) -> Result<(), Error> {
    table.begin("starts given, one of them wrong", "silent", "runs");
    for case in &CASES {
        let (home, starts) = (folder.join(case.name), folder.join(case.name).join("starts.txt"));
        let logs = logs(&home);
        if logs.is_empty() || !starts.is_file() {
            table.not_checked(format!("starts of {} (not in {})", case.name, folder.display()));
            continue;
        }
        let lines: Vec<String> = std::fs::read_to_string(&starts)?
            .lines()
            .filter(|line| !line.starts_with('#'))
            .map(str::to_owned)
            .collect();
        let scratch = tempfile::tempdir()?;
        let file = scratch.path().join("starts.txt");
        let (mut counts, mut surveyed) = ([0; 4], String::new());
        for seed in 0..=WRONG_STARTS {
            // Seed 0: as surveyed.
            let given = if seed == 0 { lines.clone() } else { with_wrong_start(&lines, seed)? };
            std::fs::write(&file, given.join("\n") + "\n")?;
            let starts = format!("known:{}", file.display());
            let (summary, _, found) =
                fleet(&starts, false, &logs, &home.join(case.between), &folder.join(case.odometry))?;
            if seed == 0 {
                surveyed =
                    format!("{:.3} m over {} of {} relations", found.mean_m, found.count, found.known());
                continue;
            }
            let contradicted = |edge: &serde_json::Value| edge["contradicted"] == true;
            counts[if merged_count(&summary) < logs.len() {
                1
            } else if found.mean_m <= WRONG_MERGE_M {
                0
            } else if summary["edges"].as_array().into_iter().flatten().any(contradicted) {
                2
            } else {
                3
            }] += 1;
        }
        let [right, apart, named, silent] = counts;
        let note = format!(
            "{right} right, {apart} with a robot apart, {named} wrong and named; as surveyed {surveyed}"
        );
        table.add(Row::new(case.name, f64::from(silent), WRONG_STARTS as f64).at_most(0.0).note(note));
    }
    Ok(())
}

/// Moves one robot's start, as often by little as by much: up to 20 m and 3 rad.
fn with_wrong_start(lines: &[String], seed: u64) -> Result<Vec<String>, Error> {
    let mut noise = Noise::new(seed);
    let mut lines = lines.to_vec();
    let robot = noise.below(lines.len());
    let scale = noise.uniform().powi(2);
    let mut numbers: Vec<f64> = lines[robot].split_whitespace().map(str::parse).collect::<Result<_, _>>()?;
    for (number, most) in numbers.iter_mut().skip(2).zip([20.0, 20.0, 3.0]) {
        *number += scale * noise.between(-most, most);
    }
    lines[robot] = numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
    Ok(lines)
}

/// Merged logs.
struct Merged {
    /// Mean error of the relations between the logs; NaN if they are not all merged, or too few can be compared.
    row: Row,
    /// Trajectory of each robot.
    together: Vec<String>,
    /// Whether all robots are in the merged map.
    all_merged: bool,
}

/// Merges logs. Of a log that was `cut`, the relations across the cut count.
fn merge(
    name: &str,
    cut: bool,
    logs: &[PathBuf],
    relations: &Path,
    odometry: &Path,
) -> Result<Merged, Error> {
    let (summary, together, found) = fleet("unknown", cut, logs, relations, odometry)?;
    let merged = merged_count(&summary);
    let [wall_s, merge_s] = ["wall_s", "merge_s"].map(|key| summary[key].as_f64().unwrap_or(f64::NAN));
    let closures: u64 =
        summary["edges"].as_array().into_iter().flatten().filter_map(|e| e["closures"].as_u64()).sum();
    let note = format!(
        "of {}; {merged} of {} merged, {closures} closures, {wall_s:.1} s, {merge_s:.1} s of it merging",
        found.known(),
        logs.len()
    );
    let all_merged = merged == logs.len();
    let value = if all_merged { found.mean_m } else { f64::NAN };
    Ok(Merged { row: Row::new(name, value, found.count as f64).note(note), together, all_merged })
}

/// Replays the logs of a fleet, with these starts as `--merge` takes them. Returns the summary, the trajectories, and the errors of
/// relations between poses in the merged map: no number where they are too few.
fn fleet(
    starts: &str,
    cut: bool,
    logs: &[PathBuf],
    relations: &Path,
    odometry: &Path,
) -> Result<(serde_json::Value, Vec<String>, Errors), Error> {
    let scratch = tempfile::tempdir()?;
    let summary = replay(logs, &["--merge", starts], scratch.path())?;
    let together = trajectories(scratch.path(), logs.len())?;
    let mut relations = parse(&std::fs::read_to_string(relations)?)?;
    if cut {
        let halves = together.iter().map(|text| Trajectory::parse(text)).collect::<Result<Vec<_>, _>>()?;
        relations.retain(|relation| !halves.iter().any(|half| half.spans(relation)));
    }
    let all = Trajectory::parse(&together.concat())?;
    // Odometry between kept scans is the same in any frame.
    let odometry = if odometry.is_file() { Some(Trajectory::parse(&unpacked(odometry)?)?) } else { None };
    let mut found = errors(&all, odometry.as_ref(), &relations, Which::All);
    if found.count == 0 || (found.count as f64) < COMPARED_SHARE_MIN * found.known() as f64 {
        found.mean_m = f64::NAN;
    }
    Ok((summary, together, found))
}

fn merged_count(summary: &serde_json::Value) -> usize {
    summary["robots"].as_array().map_or(0, |robots| robots.iter().filter(|r| r["merged"] == true).count())
}

fn logs(folder: &Path) -> Vec<PathBuf> {
    let path = |k: usize| folder.join(format!("robot{k}.log.gz"));
    (1..=16).map(path).take_while(|path| path.is_file()).collect()
}

fn replay(logs: &[PathBuf], args: &[&str], folder: &Path) -> Result<serde_json::Value, Error> {
    let mut command = Command::new(env!("CARGO_BIN_EXE_mr-slam"));
    let output =
        command.arg("replay").args(logs).args(args).arg("--json").arg("--trajectory").arg(folder).output()?;
    if !output.status.success() {
        return Err(String::from_utf8_lossy(&output.stderr).into());
    }
    Ok(serde_json::from_slice(&output.stdout)?)
}

fn replay_one(log: &Path, file: &Path) -> Result<(), Error> {
    let output = Command::new(env!("CARGO_BIN_EXE_mr-slam"))
        .arg("replay")
        .arg(log)
        .arg("--json")
        .arg("--trajectory")
        .arg(file)
        .output()?;
    if output.status.success() { Ok(()) } else { Err(String::from_utf8_lossy(&output.stderr).into()) }
}

fn trajectories(folder: &Path, robots: usize) -> Result<Vec<String>, Error> {
    (1..=robots).map(|k| Ok(std::fs::read_to_string(folder.join(format!("robot{k}.tum")))?)).collect()
}

/// Largest log when unpacked, bytes: a safety limit, public logs are below 100 MB.
const LOG_BYTES_MAX: u64 = 1 << 30;

fn unpacked(path: &Path) -> Result<String, Error> {
    Ok(String::from_utf8(formats::gzip::unpack(std::fs::read(path)?, LOG_BYTES_MAX)?)?)
}
