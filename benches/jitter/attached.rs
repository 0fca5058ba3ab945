//! What a console costs: jitter of one fleet, and of the bare hops beside it, while a console is attached and while it is not.

use crate::bare::Bare;
use crate::console::Console;
use crate::fleet::Fleet;
use crate::fleet::browser::{Browser, readers};
use crate::pairs::{PAIRS, Pairs, Percentile, Ratio};
use mr_slam::run::Run;
use serde_json::{Value, json};
use std::error::Error;
use std::ffi::OsStr;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Duration of a window. The two of a pair are close in time, as the machine's own jitter changes within a minute.
const WINDOW: Duration = Duration::from_secs(5);
/// Time until a fleet has maps, and until a console and a client that attach have what is there already.
const FLEET_SETTLES: Duration = Duration::from_secs(10);
const CLIENT_SETTLES: Duration = Duration::from_secs(3);
/// Longest time until the bridge knows of a console that came or went.
const PATIENCE: Duration = Duration::from_secs(60);
/// How much larger jitter may become.
const COST_MAX: f64 = 1.10;
/// The percentiles that are compared.
const PERCENTILES: [(&str, Percentile); 3] =
    [("median", |spread| spread.p50_ms), ("95 %", |spread| spread.p95_ms), ("99 %", |spread| spread.p99_ms)];

/// What is attached.
#[expect(dead_code, reason = "it is held until it is dropped")]
enum Attached {
    Console(Console),
    Browser(Browser, TempDir),
}

impl Attached {
    fn start(name: &str, run: &Run) -> Result<Self, Box<dyn Error>> {
        let folder = tempfile::tempdir()?;
        Ok(match name {
            "console" => Self::Console(Console::start(run)?),
            program => Self::Browser(Browser::open(OsStr::new(program), run, folder.path())?, folder),
        })
    }
}

/// Compares windows of a fleet with and without what is named: `console`, or a browser's program.
pub fn compare(robots: usize, name: &str) -> Result<Value, Box<dyn Error>> {
    let mut fleet = Fleet::start(robots)?;
    std::thread::sleep(FLEET_SETTLES);
    let (mut tf, mut bare, mut bridge) = (Pairs::default(), Pairs::default(), [0.0, 0.0]);
    for pair in 0..PAIRS {
        // Now the one comes first, now the other: what changes with time hits both.
        for is_attached in [pair % 2 == 0, pair % 2 == 1] {
            wait_for_readers(fleet.run(), 0)?;
            let attached = is_attached.then(|| Attached::start(name, fleet.run())).transpose()?;
            wait_for_readers(fleet.run(), usize::from(is_attached))?;
            let beside = Bare::start(robots)?;
            let beside = std::thread::spawn(move || beside.measure(CLIENT_SETTLES, WINDOW));
            let measured = fleet.measure(CLIENT_SETTLES, WINDOW)?.tf;
            let beside = beside.join().map_err(|_| "the bare hops' client failed")??;
            drop(attached);
            let processes = fleet.processes();
            let of_bridge = processes.iter().find(|process| process.process == "bridge");
            bridge[usize::from(is_attached)] += of_bridge.map_or(0.0, |bridge| bridge.percent) / PAIRS as f64;
            for (pairs, window) in [(&mut tf, measured), (&mut bare, beside)] {
                if is_attached { &mut pairs.with } else { &mut pairs.without }.push(window);
            }
        }
        eprint!("\r{} of {PAIRS} pairs ", pair + 1);
    }
    eprintln!();
    println!("{robots} robots, one fleet, {PAIRS} pairs of {} s with and without: {name}", WINDOW.as_secs());
    print("TF, each link", &tf, Some(COST_MAX));
    print("bare: timer, socket, relay, TCP", &bare, None);
    println!("bridge: {:.2} % of a core without, {:.2} % with", bridge[0], bridge[1]);
    let ratios = |pairs: &Pairs| PERCENTILES.map(|(name, of)| (name, pairs.ratio(of)));
    Ok(json!({
        "attached": name, "robots": robots, "tf": tf, "bare": bare, "bridge_percent": bridge,
        "tf_ratios": ratios(&tf), "bare_ratios": ratios(&bare),
    }))
}

fn print(name: &str, pairs: &Pairs, limit: Option<f64>) {
    let [lost_without, lost_with] = pairs.lost();
    println!("{name}: {lost_without} lost without, {lost_with} with");
    for (percentile, of) in PERCENTILES {
        let ([without, with], ratio) = (pairs.medians(of), pairs.ratio(of));
        let holds = limit.map_or("", |limit| if holds(ratio, limit) { ": holds" } else { ": MISSED" });
        println!(
            "  {percentile:<7} {without:.3} ms without, {with:.3} with (medians of the windows); {ratio}{holds}"
        );
    }
}

fn holds(ratio: Ratio, limit: f64) -> bool {
    ratio.mean <= limit
}

/// Waits until this many clients read from the bridge.
fn wait_for_readers(run: &Run, count: usize) -> Result<(), Box<dyn Error>> {
    let begun = Instant::now();
    while readers(run) != count {
        if begun.elapsed() > PATIENCE {
            return Err(format!("{} clients read from the bridge, expected {count}", readers(run)).into());
        }
        std::thread::sleep(Duration::from_millis(200));
    }
    Ok(())
}
