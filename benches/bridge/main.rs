//! The bridge as a headset feels it: the whole fleet of three runs on this machine's cores, and everything is done
//! to its bridge from outside, over TCP. One table, with what the machine itself takes beside it.
//!
//! `cargo bench --bench bridge [-- --seconds 30 --json FILE --check]`. With `--check` a row that misses its limit makes the
//! exit status 1.
//!
//! `--attach console` compares the rows that a console could change, in windows of one fleet with a console and without it, in turns.
//!
//! Two rows need the bridge's inside and run it on a thread of this process, beside the fleet: a map of 16 MB, for
//! which the laboratory is too small, and the count of allocations.

mod attached;
mod client;
mod commands;
#[path = "../jitter/console.rs"]
mod console;
#[path = "../launcher.rs"]
mod launcher;
// The mix, its bare hops and the jitter's definition are the jitter bench's.
#[path = "../jitter/bare.rs"]
mod bare;
#[path = "../jitter/fleet.rs"]
mod fleet;
mod inside;
#[path = "../jitter/measure.rs"]
mod measure;
#[path = "../shared/pairs.rs"]
mod pairs;
mod peer;
mod scenes;
mod weak;
#[path = "../shared/words.rs"]
mod words;

use client::{Client, EVERYTHING};
use serde_json::{Value, json};
use stats_alloc::{INSTRUMENTED_SYSTEM, StatsAlloc};
use std::alloc::System;
use std::error::Error;
use std::time::Duration;

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// Until processes have started and SLAM has its first maps.
const WARM_UP: Duration = Duration::from_secs(4);
const ROBOTS: usize = 3;
const RECONNECTS: usize = 10_000;
/// A weak link, bytes per second.
const WEAK_BYTES_PER_S: f64 = 60e3;

/// The table's rows, printed as they come.
#[derive(Default)]
struct Table(Vec<Value>);

impl Table {
    /// Returns the rows that missed their limit. A figure that could not be measured is not a number and misses it too.
    fn missed(&self) -> Vec<String> {
        let rows = self.0.iter().filter(|row| row["holds"] != true);
        rows.map(|row| row["what"].as_str().unwrap_or_default().trim().to_owned()).collect()
    }

    /// `measured` and what is to be reached, in the same unit; `machine` is what the bare machine takes, if known.
    fn row(&mut self, what: &str, measured: f64, reach: Reach, unit: &str, machine: Option<f64>) {
        let (holds, bound) = match reach {
            Reach::AtMost(most) => (measured <= most, format!("<= {most}")),
            Reach::AtLeast(least) => (measured >= least, format!(">= {least}")),
        };
        let machine_text = machine.map_or("-".into(), |machine| format!("{machine:.3}"));
        let verdict = if holds { "holds" } else { "MISSED" };
        println!("{what:<58} {measured:>12.3} {bound:>12} {unit:<8} {machine_text:>10} {verdict}");
        self.0.push(json!({
            "what": what, "measured": measured, "reach": bound, "unit": unit, "machine": machine, "holds": holds,
        }));
    }
}

enum Reach {
    AtMost(f64),
    AtLeast(f64),
}
use Reach::{AtLeast, AtMost};
use words::Words;

fn at(sorted: &[f64], share: f64) -> f64 {
    sorted.get(((sorted.len().max(1) - 1) as f64 * share) as usize).copied().unwrap_or(f64::NAN)
}

fn main() -> Result<(), Box<dyn Error>> {
    // This program is also the two processes of the bare hops.
    let words: Vec<String> = std::env::args().collect();
    match words.get(1).map(String::as_str) {
        Some("bare-timer") => return Ok(bare::timer(&words[2], words[3].parse()?)?),
        Some("bare-command") => return Ok(commands::hop(&words[2], words[3].parse()?)?),
        Some("ros-peer") => return peer::listen(words[2].parse()?, Duration::from_secs(words[3].parse()?)),
        Some("bare-relay") => return Ok(bare::relay(&words[2], words[3].parse()?)?),
        Some(console::WORD) => return console::read(words[2].parse()?),
        _ => {}
    }
    let words = Words::parse(&words[1..], &["--seconds", "--attach"], &["--check"])?;
    let seconds = words.number("--seconds", 30_u64)?;
    match words.value("--attach") {
        None => {}
        Some("console") => return words.write_json(&attached::compare()?),
        Some(other) => return Err(format!("--attach {other}: expected console").into()),
    }
    let mut table = Table::default();
    println!("{:<58} {:>12} {:>12} {:<8} {:>10}", "", "measured", "reach", "unit", "machine");
    let mut fleet = fleet::Fleet::start(ROBOTS)?;
    mix(&mut table, &mut fleet, Duration::from_secs(seconds))?;
    weak_link(&mut table, &fleet, seconds)?;
    outside(&mut table, &mut fleet, seconds)?;
    drop(fleet);
    with_ros(&mut table, Duration::from_secs(seconds))?;
    within(&mut table)?;
    let load = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    println!("machine's load average: {}", load.trim());
    words
        .write_json(&json!({ "robots": ROBOTS, "seconds": seconds, "load": load.trim(), "rows": table.0 }))?;
    let missed = table.missed();
    if !missed.is_empty() && words.has("--check") {
        return Err(format!("{} rows missed their limit: {}", missed.len(), missed.join("; ")).into());
    }
    Ok(())
}

/// The fleet's own mix at one client.
fn mix(table: &mut Table, fleet: &mut fleet::Fleet, length: Duration) -> Result<(), Box<dyn Error>> {
    let bare = bare::Bare::start(ROBOTS)?;
    let bare = std::thread::spawn(move || bare.measure(WARM_UP, length).map_err(|why| why.to_string()));
    let figures = fleet.measure(WARM_UP, length)?;
    let floor = bare.join().map_err(|_| "the bare hops' client failed")??;
    let tf = &figures.tf;
    table.row("TF jitter, 18 links at 20 Hz: median", tf.p50_ms, AtMost(0.1), "ms", Some(floor.p50_ms));
    table.row("  P95", tf.p95_ms, AtMost(0.5), "ms", Some(floor.p95_ms));
    table.row("  P99", tf.p99_ms, AtMost(2.0), "ms", Some(floor.p99_ms));
    let lost = tf.lost + figures.clock.lost + figures.scans.lost;
    table.row(
        "lost in the mix: TF, clock, scans",
        lost as f64,
        AtMost(0.0),
        "messages",
        Some(floor.lost as f64),
    );
    let percent = percent_of_bridge(fleet);
    table.row("bridge's processor time in the mix, one client", percent, AtMost(4.0), "% core", None);
    Ok(())
}

/// The same with a ROS 2 peer that has a reader of everything beside the client.
fn with_ros(table: &mut Table, length: Duration) -> Result<(), Box<dyn Error>> {
    let domain = peer::domain();
    let mut fleet = fleet::Fleet::start_with(ROBOTS, &["--ros-domain", &domain.to_string()])?;
    let peer = peer::Peer::start(domain, WARM_UP + length)?;
    let bare = bare::Bare::start(ROBOTS)?;
    let bare = std::thread::spawn(move || bare.measure(WARM_UP, length).map_err(|why| why.to_string()));
    let figures = fleet.measure(WARM_UP, length)?;
    let floor = bare.join().map_err(|_| "the bare hops' client failed")??;
    let heard = peer.heard()? as f64 / (WARM_UP + length).as_secs_f64();
    let what = format!("bridge's processor time, ROS 2 peer too ({heard:.0} messages/s)");
    let percent = if heard > 0.0 { percent_of_bridge(&fleet) } else { f64::NAN };
    table.row(&what, percent, AtMost(8.0), "% core", None);
    table.row(
        "TF jitter at the TCP client beside it: P99",
        figures.tf.p99_ms,
        AtMost(2.0),
        "ms",
        Some(floor.p99_ms),
    );
    let lost = figures.tf.lost + figures.clock.lost + figures.scans.lost;
    table.row("  lost", lost as f64, AtMost(0.0), "messages", Some(floor.lost as f64));
    Ok(())
}

fn percent_of_bridge(fleet: &fleet::Fleet) -> f64 {
    let bridge = fleet.processes().into_iter().find(|process| process.process == "bridge");
    bridge.map_or(f64::NAN, |bridge| bridge.percent)
}

/// What clients do to it.
fn outside(table: &mut Table, fleet: &mut fleet::Fleet, seconds: u64) -> Result<(), Box<dyn Error>> {
    let port = fleet.run().port;
    let (heard, lost) = scenes::bursts(port, seconds.min(20) as usize)?;
    table.row(&format!("lost in bursts of 0.4 s, of {heard}"), lost as f64, AtMost(0.0), "messages", None);

    let commands::Times { fleet: times, bare: floor } = commands::measure(fleet.run(), 500)?;
    table.row(
        "cmd_vel field by field to the simulator: median",
        at(&times, 0.5),
        AtMost(0.3),
        "ms",
        Some(at(&floor, 0.5)),
    );
    table.row("  P95", at(&times, 0.95), AtMost(1.5), "ms", Some(at(&floor, 0.95)));

    let mut lossless = 0.0;
    for per_second in [50_000, 75_000, 100_000, 150_000, 200_000] {
        let (_, lost, rate) = scenes::rate(port, per_second, 3)?;
        if lost > 0 {
            break;
        }
        lossless = rate;
    }
    table.row("52-byte messages, client to client, none lost", lossless, AtLeast(50_000.0), "/s", None);
    let (sent, lost, rate) = scenes::rate(port, 0, 1)?;
    println!(
        "  as fast as they go in: {rate:.0}/s arrive, {:.1} % of {sent} dropped, the oldest first",
        100.0 * lost as f64 / sent as f64
    );

    let pid = fleet.pid("bridge").ok_or("the bridge has not been heard of")?;
    let megabytes = |bytes: u64| bytes as f64 / 1e6;
    let before = scenes::resident_bytes(pid);
    let slow = (0..3).map(|_| Client::connect_only(port, &EVERYTHING)).collect::<Result<Vec<_>, _>>()?;
    let (settle, length) = (Duration::from_secs(2), Duration::from_secs(seconds.min(20)));
    let bare = bare::Bare::start(ROBOTS)?;
    let bare = std::thread::spawn(move || bare.measure(settle, length).map_err(|why| why.to_string()));
    let beside = fleet.measure(settle, length)?;
    let floor = bare.join().map_err(|_| "the bare hops' client failed")??;
    let each = megabytes(scenes::resident_bytes(pid).saturating_sub(before)) / slow.len() as f64;
    table.row("memory for each of 3 clients that read nothing", each, AtMost(8.0), "MB", None);
    table.row("TF jitter beside them: P99", beside.tf.p99_ms, AtMost(2.0), "ms", Some(floor.p99_ms));
    table.row("  lost", beside.tf.lost as f64, AtMost(0.0), "messages", None);
    drop(slow);

    scenes::reconnects(port, RECONNECTS / 20)?;
    let before = scenes::resident_bytes(pid);
    scenes::reconnects(port, RECONNECTS)?;
    let grown = megabytes(scenes::resident_bytes(pid).saturating_sub(before));
    let alive = fleet.pid("bridge") == Some(pid);
    let what = format!("{RECONNECTS} abrupt reconnects, 5 registrations each: memory grown");
    table.row(&what, if alive { grown } else { f64::INFINITY }, AtMost(1.0), "MB", None);
    Ok(())
}

/// A client behind a weak link.
fn weak_link(table: &mut Table, fleet: &fleet::Fleet, seconds: u64) -> Result<(), Box<dyn Error>> {
    let outcome = weak::measure(fleet.run().port, WEAK_BYTES_PER_S, Duration::from_secs(seconds))?;
    let ages = &outcome.ages_ms;
    let what = format!("age of transforms at 60 kB/s, first maps included, {} of them: median", ages.len());
    table.row(&what, at(ages, 0.5), AtMost(500.0), "ms", None);
    table.row("  P95", at(ages, 0.95), AtMost(500.0), "ms", None);
    table.row("  oldest", at(ages, 1.0), AtMost(500.0), "ms", None);
    table.row("  maps that arrived", outcome.maps as f64, AtLeast(seconds as f64 / 10.0), "maps", None);
    Ok(())
}

/// What needs the bridge's inside.
fn within(table: &mut Table) -> Result<(), Box<dyn Error>> {
    let maps = inside::large_maps(20)?;
    let floor = bare::bulk(16_000_000, 20)?;
    table.row("16 MB map to a client: median", at(&maps, 0.5), AtMost(25.0), "ms", Some(at(&floor, 0.5)));
    table.row("  slowest", at(&maps, 1.0), AtMost(50.0), "ms", Some(at(&floor, 1.0)));
    let (allocations, messages) = inside::allocations(2000)?;
    let what = format!("allocations in steady state, {messages} messages");
    table.row(&what, allocations as f64, AtMost(0.0), "", None);
    Ok(())
}
