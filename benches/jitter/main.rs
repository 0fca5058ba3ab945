//! TF jitter of a running fleet as a headset experiences it: at a TCP client over loopback.
//!
//! The cost of the same hops without a fleet is measured on the same machine at the same time.
//!
//! `cargo bench --bench jitter [-- --seconds 60 --robots 3 --json FILE]`; with `MR_SLAM_BENCH_BROWSER=chromium` a browser draws the
//! operator's page beside it, at the lowest priority, as on another machine. `--attach console` compares windows of one fleet
//! with and without a console that reads what the page reads and does not draw; `--attach chromium` with a browser that draws;
//! `--attach exploration` while its robots explore an office, and while they stand. `--pairs` is the number of windows of both kinds.
//!
//! Jitter is defined as in the MR-SLAM paper: |(receive - stamp) - its mean|, for each link, pooled over the
//! links. The bare hops are a timer process, a relay process that it wakes through a socket, and TCP to a
//! client. Any fleet of processes has at least this cost on the machine.

mod attached;
mod bare;
mod console;
mod fleet;
#[path = "../launcher.rs"]
mod launcher;
mod measure;
#[path = "../shared/pairs.rs"]
mod pairs;
#[path = "../shared/words.rs"]
mod words;

use measure::{Figures, Spread};
use serde_json::json;
use std::error::Error;
use std::time::Duration;
use words::Words;

/// Time until processes have started and SLAM has its first maps.
const WARM_UP: Duration = Duration::from_secs(3);

fn main() -> Result<(), Box<dyn Error>> {
    // The bare hops run this program again as their two processes.
    let words: Vec<String> = std::env::args().collect();
    match words.get(1).map(String::as_str) {
        Some("bare-timer") => return Ok(bare::timer(&words[2], words[3].parse()?)?),
        Some("bare-relay") => return Ok(bare::relay(&words[2], words[3].parse()?)?),
        Some(console::WORD) => return console::read(words[2].parse()?),
        _ => {}
    }
    let words = Words::parse(&words[1..], &["--seconds", "--robots", "--attach", "--pairs"], &[])?;
    let (seconds, robots) = (words.number("--seconds", 60.0)?, words.number("--robots", 3_usize)?);
    if let Some(name) = words.value("--attach") {
        return words.write_json(&attached::compare(robots, name, words.number("--pairs", pairs::PAIRS)?)?);
    }
    eprintln!("{robots} robots for {seconds} s, after {} s to warm up", WARM_UP.as_secs());
    let bare = bare::Bare::start(robots)?;
    let mut fleet = fleet::Fleet::start(robots)?;
    let for_client = Duration::from_secs_f64(seconds);
    let bare = std::thread::spawn(move || bare.measure(WARM_UP, for_client));
    let measured = fleet.measure(WARM_UP, for_client)?;
    let processes = fleet.processes();
    let bare = bare.join().map_err(|_| "the bare hops' client failed")??;
    drop(fleet);
    print(&measured, &bare, &processes);
    words.write_json(&json!({
        "robots": robots, "seconds": seconds,
        "tf": measured.tf, "clock": measured.clock, "scans": measured.scans,
        "bare": bare, "processes": processes,
    }))
}

fn print(measured: &Figures, bare: &Spread, processes: &[fleet::Cpu]) {
    println!(
        "{:<34} {:>8} {:>8} {:>8} {:>8} {:>8} {:>6} {:>7}",
        "jitter, ms", "median", "P95", "P99", "max", "Hz", "lost", "n"
    );
    let row = |name: &str, spread: &Spread| {
        println!(
            "{name:<34} {:>8.3} {:>8.3} {:>8.3} {:>8.3} {:>8.2} {:>6} {:>7}",
            spread.p50_ms, spread.p95_ms, spread.p99_ms, spread.max_ms, spread.hz, spread.lost, spread.count
        );
    };
    row("TF, each link", &measured.tf);
    row("clock", &measured.clock);
    row("scans, each robot", &measured.scans);
    row("bare: timer, socket, relay, TCP", bare);
    println!("TF median over bare: {:.2}", measured.tf.p50_ms / bare.p50_ms.max(1e-6));
    println!("MR-SLAM paper: 6.3 ms median; ROS-TCP-Endpoint in Python: 1.4 to 4.8 ms mean, 0.2 to 8 % lost");
    for cpu in processes {
        println!(
            "{:<16} {:>5.1} % of a core, ticks late by {:.3} ms (median), {:.3} (max of the last second)",
            cpu.process, cpu.percent, cpu.late_p50_ms, cpu.late_max_ms
        );
    }
}
