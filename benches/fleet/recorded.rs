//! What recording costs: jitter and losses of one fleet while `mr-slam record` is attached, and while it is not, in turns.

use crate::fleet::Fleet;
use crate::pairs::{PAIRS, Pairs, Ratio, in_turns};
use crate::row::missed_scans;
use mr_slam::run::Run;
use serde::Serialize;
use std::error::Error;
use std::process::{Child, Command, Stdio};
use std::time::Duration;
use tempfile::TempDir;

/// Duration of a window. The two of a pair are close in time, as the machine's own jitter changes within a minute.
const WINDOW: Duration = Duration::from_secs(5);
/// Time until a fleet has maps, and until a client and a recorder that attach have what is there already.
const FLEET_SETTLES: Duration = Duration::from_secs(10);
const CLIENT_SETTLES: Duration = Duration::from_secs(3);
/// Time for which a recorder runs: it attaches before the window and is there until its end.
const RECORDED: Duration = Duration::from_secs(9);
/// How much larger the 99th percentile of jitter may become.
const COST_MAX: f64 = 1.05;

/// Figures with and without a recorder.
#[derive(Debug, Serialize)]
pub struct Comparison {
    /// Jitter of transforms with and without a recorder.
    pub tf: Pairs,
    /// Median of the 99th percentiles of jitter: without, with; milliseconds.
    pub p99_ms: [f64; 2],
    /// Ratio of the 99th percentiles.
    pub cost: Ratio,
    /// Messages missed by the client and scans missed by SLAM: without, with.
    pub lost: [u64; 2],
    /// Messages that the recorders missed or dropped.
    pub unrecorded: u64,
}

impl Comparison {
    /// Returns whether recording costs at most 5 % and loses nothing.
    pub fn holds(&self) -> bool {
        self.cost.mean <= COST_MAX && self.lost[1] == 0 && self.unrecorded == 0
    }
}

/// Compares windows of a fleet of this size.
pub fn compare(robots: usize) -> Result<Comparison, Box<dyn Error>> {
    let mut fleet = Fleet::start_command("demo", robots, &[])?;
    std::thread::sleep(FLEET_SETTLES);
    let (mut tf, mut lost, mut unrecorded) = (Pairs::default(), [0, 0], 0);
    in_turns(PAIRS, |is_recorded| {
        let recorder = is_recorded.then(|| Recorder::start(fleet.run())).transpose()?;
        tf.push(is_recorded, fleet.measure(CLIENT_SETTLES, WINDOW)?.tf);
        if let Some(recorder) = recorder {
            unrecorded += recorder.finish()?;
        }
        let (before, after) = fleet.views().ok_or("telemetry sent no figures twice")?;
        lost[usize::from(is_recorded)] += missed_scans(before, after);
        Ok(())
    })?;
    for (lost, of_client) in lost.iter_mut().zip(tf.sums(|window| window.lost)) {
        *lost += of_client;
    }
    let p99_ms = tf.medians(|window| window.p99_ms);
    let cost = tf.ratio(|window| window.p99_ms);
    let comparison = Comparison { tf, p99_ms, cost, lost, unrecorded };
    comparison.print(robots);
    Ok(comparison)
}

/// A recorder that is attached to the fleet, and the folder of its file.
struct Recorder {
    process: Child,
    _folder: TempDir,
}

impl Recorder {
    fn start(run: &Run) -> Result<Self, Box<dyn Error>> {
        let folder = tempfile::tempdir()?;
        let process = Command::new(env!("CARGO_BIN_EXE_mr-slam"))
            .args(["record", "--json", "--seconds", &RECORDED.as_secs().to_string(), "--run-dir"])
            .arg(&run.dir)
            .arg("--out")
            .arg(folder.path().join("window.mcap"))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()?;
        Ok(Self { process, _folder: folder })
    }

    /// Waits for its end; returns the number of messages that it does not have.
    fn finish(self) -> Result<u64, Box<dyn Error>> {
        let ended = self.process.wait_with_output()?;
        if !ended.status.success() {
            return Err(format!("the recorder ended with {}", ended.status).into());
        }
        let summary: serde_json::Value = serde_json::from_slice(&ended.stdout)?;
        let count =
            |name: &str| summary[name].as_u64().ok_or(format!("the recorder's summary has no {name}"));
        Ok(count("dropped")? + count("lost")?)
    }
}

impl Comparison {
    fn print(&self, robots: usize) {
        let seconds = WINDOW.as_secs();
        println!("{robots} robots, one fleet, {PAIRS} pairs of {seconds} s with and without mr-slam record");
        for (name, at) in [("without a recorder", 0), ("recorded", 1)] {
            let (p99_ms, lost) = (self.p99_ms[at], self.lost[at]);
            println!("{name:<20} TF jitter P99 {p99_ms:.3} ms (median of the windows), {lost} lost");
        }
        let holds = if self.holds() { "holds" } else { "MISSED" };
        let unrecorded = self.unrecorded;
        println!("cost {}, {unrecorded} messages not recorded: {holds}", self.cost);
    }
}
