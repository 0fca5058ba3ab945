//! A fleet that is stopped while it starts, on busy cores: whatever the moment, it ends and leaves its report.

use crate::fleet::PATIENCE;
use crate::hogs::Hogs;
use crate::{Args, Row, Rows, launcher};
use mr_slam::run::Run;
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use serde_json::json;
use std::error::Error;
use std::fs::File;
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

/// Longest time between the start of the first process and the signal. The launcher opens its channels within it.
const DELAY_MAX: Duration = Duration::from_millis(30);
/// Time between two looks at what the launcher wrote.
const LOOK: Duration = Duration::from_millis(1);
/// Robots of each fleet.
const ROBOTS: &str = "2";
/// Error of iceoryx2 if a signal arrives while it waits.
const INTERRUPT: &str = "Interrupt";

/// Starts and stops `--kills` fleets.
pub fn run(args: &Args) -> Rows {
    let _hogs = Hogs::start()?;
    let mut random = SplitMix64::seed_from_u64(args.seed);
    let (mut without_report, mut interrupted, mut endless) = (0_u32, 0_u32, 0_u32);
    for _ in 0..args.kills {
        let delay = DELAY_MAX.mul_f64(f64::from(random.next_u32()) / f64::from(u32::MAX));
        let dir = tempfile::tempdir()?;
        let stop = stop_after(dir.path(), delay)?;
        without_report += u32::from(!stop.has_report);
        interrupted += u32::from(stop.text.contains(INTERRUPT));
        endless += u32::from(!stop.has_ended);
    }
    let figures = json!({
        "fleets": args.kills, "without_report": without_report, "interrupted": interrupted, "endless": endless,
    });
    let measured = format!(
        "{without_report} without report, {interrupted} interrupted, {endless} endless of {}",
        args.kills
    );
    let holds = without_report + interrupted + endless == 0;
    let what = format!("stopped within {} ms of their start", DELAY_MAX.as_millis());
    Ok(vec![Row::new("starts", &what, measured, "0 of each", holds).with(figures)])
}

/// How a fleet ended.
struct Stop {
    has_report: bool,
    has_ended: bool,
    /// What the launcher and its processes wrote to standard error.
    text: String,
}

/// Starts a fleet, and asks it to end `delay` after its first process is started.
fn stop_after(dir: &Path, delay: Duration) -> Result<Stop, Box<dyn Error>> {
    let (run, output) = (dir.join("run"), dir.join("stderr.txt"));
    let mut fleet = launcher::command("up")
        .args(["--port", "0", "--page", "0", "--robots", ROBOTS, "--seconds", "60", "--run-dir"])
        .arg(&run)
        .env("XDG_STATE_HOME", dir.join("state"))
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(File::create(&output)?)
        .spawn()?;
    let text = || std::fs::read_to_string(&output).unwrap_or_default();
    // The supervisor creates this file before it starts the processes.
    let starts = || Run::open_running(&run).is_ok_and(|run| run.domain.progress_file().exists());
    let has_started = wait_until(starts);
    std::thread::sleep(delay);
    launcher::terminate(&fleet);
    let has_ended = wait_until(|| has_ended(&mut fleet));
    if !has_ended {
        fleet.kill()?;
        fleet.wait()?;
    }
    if !has_started {
        return Err(format!("a fleet did not start; it said: {}", text()).into());
    }
    Ok(Stop { has_report: run.join("report.json").exists(), has_ended, text: text() })
}

fn has_ended(child: &mut Child) -> bool {
    !matches!(child.try_wait(), Ok(None))
}

/// Waits until something holds; returns false if it does not hold in time.
fn wait_until(mut holds: impl FnMut() -> bool) -> bool {
    let begun = Instant::now();
    while begun.elapsed() < PATIENCE {
        if holds() {
            return true;
        }
        std::thread::sleep(LOOK);
    }
    false
}
