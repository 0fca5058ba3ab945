//! How many robots a machine carries: fleets of a growing number in real time, and the largest in lockstep.
//!
//! `cargo bench --bench fleet [-- --robots 1,3,8,16,24,32 --seconds 30 --lockstep 64 --record 16 --json FILE --plot FILE --check]`
//!
//! Each robot scans 180 rays at 10 Hz. An operator drives one after the other; a TCP client receives all that a headset
//! would. `--record N` compares a fleet of N with and without a recorder, in 50 pairs of windows of 5 s;
//! 0 leaves it out, as does `--lockstep 0`.

#[allow(dead_code, reason = "the jitter bench uses all of it")]
#[path = "../jitter/fleet.rs"]
mod fleet;
#[path = "../launcher.rs"]
mod launcher;
#[allow(dead_code, reason = "the jitter bench uses all of it")]
#[path = "../jitter/measure.rs"]
mod measure;
#[path = "../shared/pairs.rs"]
mod pairs;
mod recorded;
mod row;
#[path = "../shared/words.rs"]
mod words;

use reports::{Line, Page, colour, plot_over};
use row::Row;
use serde_json::json;
use std::error::Error;
use std::process::Command;
use std::time::{Duration, Instant};
use words::Words;

/// Fleet that must lose no scan.
const LOSSLESS_ROBOTS: usize = 24;
/// Simulated time of the fleet in lockstep, seconds.
const LOCKSTEP_S: f64 = 20.0;

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().collect();
    let values = ["--seconds", "--robots", "--lockstep", "--record", "--plot"];
    let words = Words::parse(&words[1..], &values, &["--check"])?;
    let length = Duration::from_secs_f64(words.number("--seconds", 30.0)?);
    let robots = words.value("--robots").unwrap_or("1,3,8,16,24,32");
    println!("{}", Row::HEAD);
    let mut rows = Vec::new();
    for robots in robots.split(',').filter(|text| *text != "0") {
        let row = Row::measure(robots.parse()?, length)?;
        println!("{row}");
        rows.push(row);
    }
    let lockstep = words.number("--lockstep", 64_usize)?;
    let lockstep = if lockstep > 0 { Some(run_in_lockstep(lockstep)?) } else { None };
    let recorded = words.number("--record", 16_usize)?;
    let recorded = if recorded > 0 { Some(recorded::compare(recorded)?) } else { None };
    words.write_json(&json!({
        "seconds": length.as_secs_f64(), "fleets": rows, "lockstep": lockstep, "recorded": recorded,
    }))?;
    if let Some(path) = words.value("--plot") {
        std::fs::write(path, plot(&rows))?;
    }
    let missed: u64 = rows.iter().filter(|row| row.robots <= LOSSLESS_ROBOTS).map(|row| row.missed).sum();
    let costs = recorded.is_some_and(|recorded| !recorded.holds());
    match (words.has("--check"), missed, costs) {
        (true, 1.., _) => Err(format!("{missed} scans missed by fleets of at most {LOSSLESS_ROBOTS}").into()),
        (true, _, true) => Err("recording costs too much or loses messages".into()),
        _ => Ok(()),
    }
}

/// Runs a fleet on virtual time, and returns its figures.
fn run_in_lockstep(robots: usize) -> Result<serde_json::Value, Box<dyn Error>> {
    let begun = Instant::now();
    let ended = Command::new(env!("CARGO_BIN_EXE_mr-slam"))
        .args(["lockstep", "--json", "--robots", &robots.to_string(), "--seconds", &LOCKSTEP_S.to_string()])
        .output()?;
    if !ended.status.success() {
        return Err(String::from_utf8_lossy(&ended.stderr).into());
    }
    let report: serde_json::Value = serde_json::from_slice(&ended.stdout)?;
    let robots_of = report["fleet"]["robots"].as_array().ok_or("no robots in the report")?;
    let scans = robots_of.iter().filter_map(|robot| robot["scans"].as_u64());
    let (least, most) = scans.fold((u64::MAX, 0), |(least, most), n| (least.min(n), most.max(n)));
    let lost: u64 = robots_of.iter().filter_map(|robot| robot["scans_lost"].as_u64()).sum();
    let seconds = begun.elapsed().as_secs_f64();
    println!(
        "{robots} robots in lockstep: {LOCKSTEP_S} s in {seconds:.1} s, {least} to {most} scans a robot, {lost} missed"
    );
    Ok(json!({
        "robots": robots, "simulated_s": LOCKSTEP_S, "took_s": seconds, "scans_least": least, "scans_most": most,
        "scans_lost": lost,
    }))
}

/// Draws the figures over the number of robots, as one HTML file.
fn plot(rows: &[Row]) -> String {
    let line = |name: &str, index: usize, of: fn(&Row) -> f64| Line {
        name: name.to_owned(),
        colour: colour(index),
        points: rows.iter().map(|row| (row.robots as f64, Some(of(row)))).collect(),
    };
    let mut page = Page::new("Fleets of a growing number of robots", "180 rays, 10 Hz");
    let plots = [
        ("Scans missed by SLAM", "scans", vec![line("missed", 0, |row| row.missed as f64)]),
        (
            "Jitter of transforms at a TCP client",
            "ms",
            vec![
                line("median", 0, |row| row.tf.p50_ms),
                line("95 %", 1, |row| row.tf.p95_ms),
                line("99 %", 2, |row| row.tf.p99_ms),
            ],
        ),
        (
            "Scan to map",
            "ms",
            vec![
                line("median", 0, |row| row.scan_to_map_ms[0]),
                line("95 %", 1, |row| row.scan_to_map_ms[1]),
            ],
        ),
        ("Processor time", "cores", vec![line("all processes", 0, |row| row.cores)]),
        ("Memory for each robot", "MB", vec![line("memory", 0, |row| row.memory_per_robot_mb)]),
    ];
    let draw =
        |(title, y, lines): (&str, &str, Vec<Line>)| (String::new(), plot_over(title, ("robots", y), &lines));
    page.pictures(&plots.map(draw));
    page.finish()
}
