//! What a console or an exploration costs: jitter of one fleet, and of the bare hops beside it, with it and without it.

use crate::bare::Bare;
use crate::console::Console;
use crate::fleet::Fleet;
use crate::fleet::browser::{Browser, wait_for_readers};
use crate::measure::Spread;
use crate::pairs::{Figure, Pairs, Ratio, in_turns};
use mr_slam::run::Run;
use serde_json::{Value, json};
use std::error::Error;
use std::ffi::OsStr;
use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;
use tempfile::TempDir;

/// Duration of a window. The two of a pair are close in time, as the machine's own jitter changes within a minute.
const WINDOW: Duration = Duration::from_secs(5);
/// Time until a fleet has maps, and until a console and a client that attach have what is there already.
const FLEET_SETTLES: Duration = Duration::from_secs(10);
const CLIENT_SETTLES: Duration = Duration::from_secs(3);
/// How much larger jitter may become.
const COST_MAX: f64 = 1.10;
/// The percentiles that are compared.
const PERCENTILES: [(&str, Figure); 3] =
    [("median", |spread| spread.p50_ms), ("95 %", |spread| spread.p95_ms), ("99 %", |spread| spread.p99_ms)];

/// Word that lets the fleet explore, and the room where it does: so large that it takes longer than all windows together.
const EXPLORATION: &str = "exploration";
const EXPLORED_ROOM: &str = "office:1";

/// What is attached.
#[expect(dead_code, reason = "it is held until it is dropped")]
enum Attached {
    Console(Console),
    Browser(Browser, TempDir),
    Exploration(Exploration),
}

impl Attached {
    fn start(name: &str, run: &Run) -> Result<Self, Box<dyn Error>> {
        let folder = tempfile::tempdir()?;
        Ok(match name {
            "console" => Self::Console(Console::start(run)?),
            EXPLORATION => Self::Exploration(Exploration::start(run)?),
            program => Self::Browser(Browser::open(OsStr::new(program), run, folder.path())?, folder),
        })
    }
}

/// The fleet explores; it stands again when this is dropped.
struct Exploration(PathBuf);

impl Exploration {
    fn start(run: &Run) -> Result<Self, Box<dyn Error>> {
        let exploration = Self(run.dir.clone());
        exploration.request("start")?;
        Ok(exploration)
    }

    /// Fails if the robots do not explore any more: what was measured is not what it is called.
    fn check(&self) -> Result<(), Box<dyn Error>> {
        let status = self.request("status")?;
        let state = &serde_json::from_str::<Value>(&status)?["state"];
        if state == "exploring" {
            Ok(())
        } else {
            Err(format!("exploration: {state}, expected exploring").into())
        }
    }

    fn request(&self, action: &str) -> Result<String, Box<dyn Error>> {
        let mut command = Command::new(env!("CARGO_BIN_EXE_mr-slam"));
        command.args(["explore", action, "--no-wait", "--json", "--run-dir"]).arg(&self.0);
        let output = command.output()?;
        if !output.status.success() {
            return Err(format!("explore {action}: {}", String::from_utf8_lossy(&output.stderr)).into());
        }
        Ok(String::from_utf8(output.stdout)?)
    }
}

impl Drop for Exploration {
    fn drop(&mut self) {
        let _ = self.request("stop");
    }
}

/// Mean processor time of a process that is compared, percent of a core, without and with.
struct Processor {
    process: &'static str,
    percent: [f64; 2],
}

impl Processor {
    fn of(process: &'static str) -> Self {
        Self { process, percent: [0.0; 2] }
    }

    /// Adds a window's share of the mean of so many pairs. Fails if the fleet has no figure of it: nothing is not zero.
    fn add(&mut self, fleet: &Fleet, is_attached: bool, pairs: usize) -> Result<(), Box<dyn Error>> {
        let processes = fleet.processes();
        let found = processes.iter().find(|process| process.process == self.process);
        let found = found.ok_or_else(|| format!("no figures of the process {}", self.process))?;
        self.percent[usize::from(is_attached)] += found.percent / pairs as f64;
        Ok(())
    }
}

/// Compares so many pairs of windows of a fleet, with and without what is named: `console`, `exploration`, or a browser's program.
pub fn compare(robots: usize, name: &str, pair_count: usize) -> Result<Value, Box<dyn Error>> {
    let room: &[&str] = if name == EXPLORATION { &["--room", EXPLORED_ROOM] } else { &[] };
    let reader_count = usize::from(name != EXPLORATION);
    let mut fleet = Fleet::start_with(robots, room)?;
    std::thread::sleep(FLEET_SETTLES);
    let (mut tf, mut bare, mut scans) = (Pairs::default(), Pairs::default(), Pairs::default());
    let mut processors = [Processor::of("bridge"), Processor::of("nav")];
    in_turns(pair_count, |is_attached| {
        wait_for_readers(fleet.run(), 0)?;
        let attached = is_attached.then(|| Attached::start(name, fleet.run())).transpose()?;
        wait_for_readers(fleet.run(), if is_attached { reader_count } else { 0 })?;
        let beside = Bare::start(robots)?;
        let beside = std::thread::spawn(move || beside.measure(CLIENT_SETTLES, WINDOW));
        let measured = fleet.measure(CLIENT_SETTLES, WINDOW)?;
        let beside = beside.join().map_err(|_| "the bare hops' client failed")??;
        if let Some(Attached::Exploration(exploration)) = &attached {
            exploration.check()?;
        }
        drop(attached);
        processors.iter_mut().try_for_each(|processor| processor.add(&fleet, is_attached, pair_count))?;
        for (pairs, window) in [(&mut tf, measured.tf), (&mut scans, measured.scans), (&mut bare, beside)] {
            pairs.push(is_attached, window);
        }
        Ok(())
    })?;
    println!(
        "{robots} robots, one fleet, {pair_count} pairs of {} s with and without: {name}",
        WINDOW.as_secs()
    );
    print("TF, each link", &tf, Some(COST_MAX));
    print("bare: timer, socket, relay, TCP", &bare, None);
    let hz = |windows: &[Spread]| windows.iter().map(|window| window.hz).fold(f64::INFINITY, f64::min);
    println!(
        "scans: {:.2} Hz without, {:.2} Hz with (slowest robot and window); {:?} lost",
        hz(&scans.without),
        hz(&scans.with),
        scans.sums(|window| window.lost)
    );
    for Processor { process, percent } in &processors {
        println!("{process}: {:.2} % of a core without, {:.2} % with", percent[0], percent[1]);
    }
    let ratios = |pairs: &Pairs| PERCENTILES.map(|(name, of)| (name, pairs.ratio(of)));
    Ok(json!({
        "attached": name, "robots": robots, "tf": tf, "bare": bare, "scans": scans,
        "percent": processors.each_ref().map(|processor| (processor.process, processor.percent)),
        "tf_ratios": ratios(&tf), "bare_ratios": ratios(&bare),
    }))
}

fn print(name: &str, pairs: &Pairs, limit: Option<f64>) {
    let [lost_without, lost_with] = pairs.sums(|window| window.lost);
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
