//! Soak test: memory and jitter of a fleet of three over many minutes, with clients that connect, leave and stall.
//!
//! Each minute it also measures the same wake-ups without a fleet, which shows the effect of other load on the
//! machine. The test passes if neither memory nor jitter grows.
//!
//! `cargo bench --bench soak [-- --minutes 20 --record --json FILE]`
//!
//! With `--record` the fleet is recorded: the recorder's memory must not grow either, and no message may be lost or dropped.
//! The recording takes about 25 MB a minute below the temporary folder and is removed at the end.

#[path = "jitter/bare.rs"]
mod bare;
#[allow(dead_code, reason = "shared with the bridge bench, which uses more of it")]
#[path = "bridge/client.rs"]
mod client;
#[allow(dead_code, reason = "shared with the jitter bench, which uses all of it")]
#[path = "jitter/fleet.rs"]
mod fleet;
mod launcher;
#[allow(dead_code, reason = "shared with the jitter bench, which uses all of it")]
#[path = "jitter/measure.rs"]
mod measure;
#[path = "shared/words.rs"]
mod words;

use client::{Client, EVERYTHING};
use serde_json::json;
use std::error::Error;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};
use words::Words;

const ROBOTS: usize = 3;
/// Time until processes have started and SLAM has its first maps.
const WARM_UP: Duration = Duration::from_secs(10);
/// Length of one measurement, which is one row of the table.
const MINUTE: Duration = Duration::from_secs(60);
/// Time between two connections of the client that connects and leaves.
const VISIT: Duration = Duration::from_millis(100);
/// Time for which a stalled client stays connected.
const STALL: Duration = Duration::from_secs(15);
/// Largest growth of memory from the first third to the last, MB. Pools and parsers reach their sizes late.
const GROWTH_MAX_MB: f64 = 3.0;
/// Largest growth factor of the 95th percentile of jitter, relative to that of the bare hops.
const JITTER_RATIO_MAX: f64 = 2.0;
/// Jitter up to which growth does not count, 95th percentile, milliseconds.
const JITTER_FLOOR_MS: f64 = 0.5;

fn main() -> Result<(), Box<dyn Error>> {
    // The bare hops run this program again as their two processes.
    let words: Vec<String> = std::env::args().collect();
    match words.get(1).map(String::as_str) {
        Some("bare-timer") => return Ok(bare::timer(&words[2], words[3].parse()?)?),
        Some("bare-relay") => return Ok(bare::relay(&words[2], words[3].parse()?)?),
        _ => {}
    }
    let words = Words::parse(&words[1..], &["--minutes"], &["--record"])?;
    let minutes = words.number("--minutes", 20_usize)?.max(1);
    let is_recorded = words.has("--record");
    let mut fleet = fleet::Fleet::start_with(ROBOTS, if is_recorded { &["--record"] } else { &[] })?;
    let port = fleet.run().port;
    fleet.measure(WARM_UP, Duration::from_secs(1))?;

    let (over, visits) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
    let clients = [visitor(port, &over, &visits), staller(port, &over), staller(port, &over)];
    let rows = measure(&mut fleet, minutes, is_recorded, &visits)?;
    over.store(true, Ordering::Relaxed);
    clients.into_iter().for_each(|thread| drop(thread.join()));

    let flat = check_growth(&rows);
    let minute = |row: &Minute| {
        let recorder = row.recorder.as_ref().map(|recorder| {
            json!({ "mb": recorder.memory_mb, "received": recorder.received, "missed": recorder.missed() })
        });
        json!({ "bridge_mb": row.bridge_mb, "tf": row.tf, "bare": row.floor, "recorder": recorder })
    };
    let of_minutes = rows.iter().map(minute).collect::<Vec<_>>();
    words.write_json(&json!({ "flat": flat, "minutes": of_minutes }))?;
    drop(fleet);
    if flat { Ok(()) } else { Err("memory or jitter grew".into()) }
}

/// Measures minute by minute and prints a table.
fn measure(
    fleet: &mut fleet::Fleet,
    minutes: usize,
    is_recorded: bool,
    visits: &AtomicU64,
) -> Result<Vec<Minute>, Box<dyn Error>> {
    println!(
        "{:>6} {:>10} {:>10} {:>9} {:>9} {:>9} {:>6} {:>9} {:>9} {:>9} {:>11}",
        "minute",
        "bridge MB",
        "others MB",
        "TF p50",
        "P95",
        "P99 ms",
        "lost",
        "bare p50",
        "P95 ms",
        "visits",
        "recorder MB"
    );
    let mut rows = Vec::new();
    for minute in 1..=minutes {
        let bare = bare::Bare::start(ROBOTS)?;
        let bare =
            std::thread::spawn(move || bare.measure(Duration::ZERO, MINUTE).map_err(|why| why.to_string()));
        let tf = fleet.measure(Duration::ZERO, MINUTE)?.tf;
        let floor = bare.join().map_err(|_| "the bare hops' client failed")??;
        let (bridge_mb, others_mb) = fleet.memory_mb();
        let recorder = if is_recorded { Some(Recorder::of(fleet)?) } else { None };
        let recorder_mb =
            recorder.as_ref().map_or("-".to_owned(), |recorder| format!("{:.1}", recorder.memory_mb));
        let visits = visits.load(Ordering::Relaxed);
        println!(
            "{minute:>6} {bridge_mb:>10.1} {others_mb:>10.1} {:>9.3} {:>9.3} {:>9.3} {:>6} {:>9.3} {:>9.3} {visits:>9} {recorder_mb:>11}",
            tf.p50_ms, tf.p95_ms, tf.p99_ms, tf.lost, floor.p50_ms, floor.p95_ms
        );
        rows.push(Minute { bridge_mb, tf, floor, recorder });
    }
    Ok(rows)
}

/// Compares the first third of the minutes with the last, prints the result, and returns whether nothing grew.
fn check_growth(rows: &[Minute]) -> bool {
    let third = rows.len().div_ceil(3);
    let median = |rows: &[Minute], of: fn(&Minute) -> f64| {
        let mut values = rows.iter().map(of).collect::<Vec<_>>();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let (first, last) = (&rows[..third], &rows[rows.len() - third..]);
    let grown_mb = median(last, |row| row.bridge_mb) - median(first, |row| row.bridge_mb);
    let jitter_ms = [first, last].map(|rows| median(rows, |row| row.tf.p95_ms));
    let ratio = [first, last].map(|rows| median(rows, |row| row.tf.p95_ms / row.floor.p95_ms.max(1e-3)));
    let lost = rows.iter().map(|row| row.tf.lost).sum::<u64>();
    let is_recorder_well = check_recorder(rows, grown_mb_of_recorder(first, last));
    let flat = is_recorder_well
        && grown_mb <= GROWTH_MAX_MB
        && (jitter_ms[1] <= JITTER_FLOOR_MS || ratio[1] <= JITTER_RATIO_MAX * ratio[0])
        && lost == 0;
    println!(
        "bridge's memory grew by {grown_mb:.1} MB from the first third to the last, TF's P95 from {:.3} to {:.3} ms, \
         {:.1} to {:.1} times that of the bare hops, {lost} lost: {}",
        jitter_ms[0],
        jitter_ms[1],
        ratio[0],
        ratio[1],
        if flat { "flat" } else { "NOT FLAT" }
    );
    flat
}

/// Returns by how much the recorder's memory grew, MB; 0 without a recorder.
fn grown_mb_of_recorder(first: &[Minute], last: &[Minute]) -> f64 {
    let largest = |rows: &[Minute]| {
        let recorders = rows.iter().filter_map(|row| row.recorder.as_ref());
        recorders.map(|recorder| recorder.memory_mb).fold(0.0, f64::max)
    };
    largest(last) - largest(first)
}

/// Prints what the recorder missed, and returns whether it missed nothing, was never replaced and did not grow.
fn check_recorder(rows: &[Minute], grown_mb: f64) -> bool {
    let Some(newest) = rows.iter().filter_map(|row| row.recorder.as_ref()).next_back() else { return true };
    let is_same = rows.iter().filter_map(|row| row.recorder.as_ref()).all(|one| one.pid == newest.pid);
    println!(
        "recorder: {} messages, {} lost, {} dropped, its memory grew by {grown_mb:.1} MB{}",
        newest.received,
        newest.lost,
        newest.dropped,
        if is_same { "" } else { "; IT WAS REPLACED" }
    );
    is_same && newest.received > 0 && newest.missed() == 0 && grown_mb <= GROWTH_MAX_MB
}

/// The recorder at the end of a minute; its counts are those since its start.
struct Recorder {
    pid: u32,
    memory_mb: f64,
    received: u64,
    lost: u64,
    dropped: u64,
}

impl Recorder {
    fn of(fleet: &mut fleet::Fleet) -> Result<Self, Box<dyn Error>> {
        let process = fleet.process("record").ok_or("the fleet has no recorder")?;
        let reports::ProcessView { pid, memory_mb, received, lost, dropped, .. } = process;
        Ok(Self { pid, memory_mb, received, lost, dropped })
    }

    fn missed(&self) -> u64 {
        self.lost + self.dropped
    }
}

/// Measurements of one minute.
struct Minute {
    recorder: Option<Recorder>,
    bridge_mb: f64,
    tf: measure::Spread,
    floor: measure::Spread,
}

type Thread = std::thread::JoinHandle<()>;

/// Starts a client that connects with ten subscriptions, waits for all of them, and leaves, ten times a second.
fn visitor(port: u16, over: &Arc<AtomicBool>, visits: &Arc<AtomicU64>) -> Thread {
    let (over, visits) = (over.clone(), visits.clone());
    std::thread::spawn(move || {
        while !over.load(Ordering::Relaxed) {
            if let Ok(client) = Client::connect(port, &EVERYTHING) {
                visits.fetch_add(1, Ordering::Relaxed);
                // Every second client aborts its connection instead of closing it.
                if visits.load(Ordering::Relaxed).is_multiple_of(2) {
                    let _ = client.abort();
                }
            }
            std::thread::sleep(VISIT);
        }
    })
}

/// Starts a client that subscribes to everything and reads nothing, and reconnects from time to time.
fn staller(port: u16, over: &Arc<AtomicBool>) -> Thread {
    let over = over.clone();
    std::thread::spawn(move || {
        while !over.load(Ordering::Relaxed) {
            let client = Client::connect_only(port, &EVERYTHING);
            let begun = Instant::now();
            while begun.elapsed() < STALL && !over.load(Ordering::Relaxed) {
                std::thread::sleep(VISIT);
            }
            drop(client);
        }
    })
}
