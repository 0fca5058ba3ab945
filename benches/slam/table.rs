//! The tables, and the same as JSON.

use crate::drive::{Outcome, Spread};
use crate::{Row, relocalize};
use serde_json::{Value, json};

/// Bounds on the Intel log: scan path p99 and max, ms; whole log, s; memory, MB.
const SCAN_P99_MS: f64 = 3.0;
const SCAN_MAX_MS: f64 = 10.0;
const LOG_S: f64 = 1.5;
const MEMORY_MB: f64 = 45.0;

/// Prints all tables.
pub fn print(done: &[(&Row, Outcome)]) {
    accuracy(done);
    times(done);
    stages(done);
    intel(done);
}

/// Whether all errors are within their limits.
pub fn met(row: &Row, outcome: &Outcome) -> bool {
    let found = [outcome.all, outcome.revisit, outcome.both_kept];
    row.limits_m
        .iter()
        .zip(found)
        .all(|(limit, found)| limit.is_none_or(|limit| found.count > 0 && found.mean_m <= limit))
}

fn accuracy(done: &[(&Row, Outcome)]) {
    println!(
        "mean translation error, m      all  revisit  (limits)          kept  SLAM Toolbox's   max  deg   n"
    );
    for (row, o) in done {
        let limit = |limit: Option<f64>| limit.map_or("    -".into(), |limit| format!("{limit:.3}"));
        let [all, revisit, kept] = row.limits_m.map(limit);
        let toolbox = row.toolbox_m.map(limit);
        let verdict = match (row.limits_m[0], met(row, o)) {
            (None, _) => "",
            (_, true) => "met",
            (_, false) => "MISSED",
        };
        println!(
            "{:<24} {:>9.4} {:>8.4}  {all} / {revisit}  {:>9} {:>7} / {} {:>6.3} {:>4.2} {:>4}  {verdict}",
            row.name,
            o.all.mean_m,
            o.revisit.mean_m,
            if row.limits_m[2].is_some() { format!("{:.3}<={kept}", o.both_kept.mean_m) } else { "-".into() },
            toolbox[0],
            toolbox[1],
            o.all.max_m,
            o.all.mean_deg,
            o.all.count,
        );
        for reason in o.evidence.reasons() {
            println!("  called unreliable: {reason} ({:?})", o.evidence);
        }
    }
}

fn times(done: &[(&Row, Outcome)]) {
    println!();
    println!(
        "{:<18} {:>5} {:>5} {:>4} {:>8}  {:>17}  {:>17}  {:>17}  {:>11}  {:>10} {:>5} {:>6}",
        "",
        "scans",
        "nodes",
        "lost",
        "closures",
        "scan wall, ms",
        "scan cpu, ms",
        "beside cpu, ms",
        "growth, ms",
        "wall, cpu s",
        "MB",
        "allocs"
    );
    println!(
        "{:<18} {:>5} {:>5} {:>4} {:>8}  {:>17}  {:>17}  {:>17}  {:>11}",
        "", "", "", "", "- undone", "p50 / p99 / max", "p50 / p99 / max", "p50 / p99 / max", "first  last"
    );
    let spread = |s: &Spread| format!("{:.2} {:.2} {:.2}", s.p50, s.p99, s.max);
    for (row, o) in done {
        println!(
            "{:<18} {:>5} {:>5} {:>4} {:>8}  {:>17}  {:>17}  {:>17}  {:>5.2} {:>5.2}  {:>5.2} {:>4.2} {:>5.1} {:>6.1}",
            row.name,
            o.scans,
            o.nodes,
            o.lost,
            format!("{}-{}", o.closures, o.retracted),
            spread(&o.scan_wall_ms),
            spread(&o.scan_cpu_ms),
            spread(&o.beside_cpu_ms),
            o.first_nodes_cpu_ms.p50,
            o.last_nodes_cpu_ms.p50,
            o.wall_s,
            o.cpu_s,
            o.memory_mb,
            o.allocations as f64 / o.allocations_scans.max(1) as f64,
        );
    }
    println!("load of this machine now: {}", load());
    println!(
        "growth: median of the scans of the first and the last 100 nodes; allocs: a scan, after 100 nodes"
    );
}

fn stages(done: &[(&Row, Outcome)]) {
    println!();
    print!("{:<18}", "processor time, ms");
    for times in done.first().map(|(_, o)| o.stages.as_slice()).unwrap_or_default() {
        print!(" {:>15}", times.stage);
    }
    println!();
    for (row, o) in done {
        print!("{:<18}", row.name);
        for times in &o.stages {
            print!(
                " {:>15}",
                format!("{:.3} ({:.1})", times.total_ms / times.count.max(1) as f64, times.max_ms)
            );
        }
        println!();
    }
    println!("mean and, in brackets, the longest; drawing: the whole map, once, at the end");
}

/// The bounds that were set for the Intel log.
fn intel(done: &[(&Row, Outcome)]) {
    let Some((_, o)) = done.iter().find(|(row, _)| row.name == "intel") else { return };
    println!();
    let line = |what: &str, found: f64, limit: f64, unit: &str| {
        let verdict = if found <= limit { "met" } else { "MISSED" };
        println!("intel, {what:<28} {found:>8.2} {unit:<2} (limit {limit})  {verdict}");
    };
    line("scan path p99, wall", o.scan_wall_ms.p99, SCAN_P99_MS, "ms");
    line("scan path max, wall", o.scan_wall_ms.max, SCAN_MAX_MS, "ms");
    line(
        "last 100 nodes over first 100",
        o.last_nodes_cpu_ms.p50 / o.first_nodes_cpu_ms.p50.max(1e-9),
        1.1,
        "",
    );
    line("allocations in steady state", o.allocations as f64, 0.0, "");
    line("whole log, wall", o.wall_s, LOG_S, "s");
    line("largest resident memory", o.memory_mb, MEMORY_MB, "MB");
}

/// Robots looked for in the first half of a log's map without a guess.
pub fn relocalized(relocalization: &[(relocalize::Task, relocalize::Outcome)]) {
    if relocalization.is_empty() {
        return;
    }
    println!();
    println!(
        "{:<24} places  in map  right (of these)  wrong  refused  search cpu p50 / max, ms  prepare, ms  way p50 / max, m",
        "looked for, no guess"
    );
    for (task, o) in relocalization {
        let name =
            |path: &std::path::Path| path.file_stem().map(|name| name.to_string_lossy().replace(".log", ""));
        let robot = name(&task.robot).unwrap_or_default();
        let mut way = o.way_m.clone();
        way.sort_by(f64::total_cmp);
        let way = |share: f64| {
            way.get((share * way.len().saturating_sub(1) as f64) as usize).copied().unwrap_or(0.0)
        };
        println!(
            "{:<24} {:>6}  {:>6}  {:>5} {:>10}  {:>5}  {:>7}  {:>12.0} {:>11.0}  {:>11.0}  {:>8.1} {:>7.1}",
            format!("{robot}{} in intel", task.fov_deg.map_or(String::new(), |fov| format!("@{fov}"))),
            o.places,
            o.known,
            o.right,
            format!("({})", o.right_of_known),
            o.wrong,
            o.rejected,
            o.search_ms.p50,
            o.search_ms.max,
            o.prepare_ms.max,
            way(0.5),
            way(1.0),
        );
    }
}

/// Logs as other robots would have made them: the log, what was varied, and what came of it.
pub fn varied(outcomes: &[crate::VariedLog]) {
    if outcomes.is_empty() {
        return;
    }
    println!();
    println!(
        "{:<13} {:<20} {:>7} {:>7} {:>6} {:>4}  {:>7} {:>6} {:>4}  {:>5} {:>5} {:>5} {:>6} {:>8} {:>7} {:>6}  {:>15}",
        "varied, m",
        "",
        "all",
        "revisit",
        "max",
        "n",
        "in map",
        "max",
        "n",
        "scans",
        "lost",
        "nodes",
        "unplaced",
        "closures",
        "wrong",
        "wall s",
        "as it is"
    );
    let mut as_it_is = String::new();
    for (name, label, o) in outcomes {
        if *label == "as it is" {
            as_it_is = format!("{:.3} / {:.3}", o.all.mean_m, o.revisit.mean_m);
        }
        println!(
            "{:<13} {:<20} {:>7.3} {:>7.3} {:>6.2} {:>4}  {:>7.3} {:>6.2} {:>4}  {:>5} {:>5} {:>5} {:>6} {:>8} {:>7} {:>6.1}  {:>15}",
            name,
            label,
            o.all.mean_m,
            o.revisit.mean_m,
            o.all.max_m,
            o.all.count,
            o.in_map.mean_m,
            o.in_map.max_m,
            o.in_map.count,
            o.scans,
            o.lost,
            o.nodes,
            o.unplaced,
            format!("{}-{}", o.closures, o.retracted),
            format!("{}, {}", o.wrong_closures, o.wrong_links),
            o.wall_s,
            as_it_is,
        );
    }
    println!(
        "in map: relations between poses that are placed in the map; unplaced: nodes that are not; wrong: active closures and links that the log as it is contradicts"
    );
}

/// Everything, by log.
pub fn json(
    done: &[(&Row, Outcome)],
    relocalization: &[(relocalize::Task, relocalize::Outcome)],
    varied: &[crate::VariedLog],
) -> Value {
    let rows = done.iter().map(|(row, outcome)| {
        json!({
            "log": row.name, "limits_m": row.limits_m, "slam_toolbox_m": row.toolbox_m,
            "met": met(row, outcome), "outcome": outcome,
        })
    });
    let relocalization =
        relocalization.iter().map(|(task, outcome)| json!({ "task": task, "outcome": outcome }));
    let varied =
        varied.iter().map(|(log, label, outcome)| json!({ "log": log, "varied": label, "outcome": outcome }));
    json!({
        "rows": rows.collect::<Vec<Value>>(),
        "relocalized": relocalization.collect::<Vec<Value>>(),
        "varied": varied.collect::<Vec<Value>>(),
    })
}

/// Wall times mean little on a loaded machine.
fn load() -> String {
    let words = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    words.split(' ').take(3).collect::<Vec<&str>>().join(" ")
}
