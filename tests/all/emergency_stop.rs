//! `mr-slam stop` without a folder: every fleet of the user, and bridges that do not answer.

use crate::harness::{Folder, WATCHDOG, mr_slam, output_of, send};
use rustix::fs::{CWD, RenameFlags, renameat_with};
use rustix::process::Signal;
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Fleets that share folders for temporary files with nobody else, so that no other test's fleet is stopped.
struct Fleets {
    folder: Folder,
    runtime: tempfile::TempDir,
    launchers: Vec<Child>,
}

/// Creates a folder with a short name that no other user may enter.
fn private_folder() -> tempfile::TempDir {
    let mode = std::fs::Permissions::from_mode(0o700);
    tempfile::Builder::new().prefix("f").permissions(mode).tempdir().unwrap()
}

impl Fleets {
    fn start(count: usize) -> Self {
        let mut fleets = Self { folder: Folder::new(), runtime: private_folder(), launchers: Vec::new() };
        for number in 0..count {
            let mut command = fleets.command();
            command.args(["up", "--port", "0", "--robots", "1", "--run-dir"]).arg(fleets.run_dir(number));
            let mut launcher = command.stdin(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
            let messages = BufReader::new(launcher.stderr.take().unwrap());
            fleets.launchers.push(launcher);
            // The launcher says a line when the run's folder is complete; it ends if it cannot. What it swept up comes before.
            let mut lines = messages.lines().map_while(Result::ok);
            let mut said = Vec::new();
            while !said.last().is_some_and(|line: &String| line.starts_with("fleet of")) {
                said.push(lines.next().unwrap_or_else(|| panic!("the launcher ended: {said:?}")));
            }
            std::thread::spawn(move || lines.for_each(|line| eprintln!("{line}")));
        }
        fleets
    }

    fn command(&self) -> Command {
        let mut command = mr_slam();
        let path = self.folder.path();
        // Sockets are below the runtime folder, and their paths must be short.
        let runtime = self.runtime.path();
        command
            .env("TMPDIR", runtime)
            .env("XDG_RUNTIME_DIR", runtime)
            .env("XDG_STATE_HOME", path.join("state"));
        command
    }

    fn run_dir(&self, number: usize) -> PathBuf {
        self.folder.path().join(format!("run-{number}"))
    }

    /// Returns the process id of a fleet's bridge, once there is one.
    fn bridge(&self, number: usize) -> u32 {
        let launcher = self.launchers[number].id();
        let children = format!("/proc/{launcher}/task/{launcher}/children");
        until("a bridge", || {
            let pids = std::fs::read_to_string(&children).unwrap_or_default();
            pids.split_whitespace().filter_map(|pid| pid.parse().ok()).find(|pid: &u32| {
                let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
                line.split(|byte| *byte == 0).any(|word| word == b"bridge")
            })
        })
    }

    /// Returns whether a fleet's bridge says that the emergency stop is set; `None` while it says nothing.
    fn is_stopped(&self, number: usize) -> Option<bool> {
        let status =
            output_of(self.command().args(["status", "--json", "--run-dir"]).arg(self.run_dir(number)));
        let figures: Value = serde_json::from_slice(&status.stdout).ok()?;
        figures["bridge"]["stopped"].as_bool()
    }
}

impl Drop for Fleets {
    fn drop(&mut self) {
        for launcher in &mut self.launchers {
            send(launcher.id(), Signal::TERM);
        }
        for launcher in &mut self.launchers {
            let begun = Instant::now();
            while matches!(launcher.try_wait(), Ok(None)) && begun.elapsed() < WATCHDOG {
                std::thread::sleep(Duration::from_millis(20));
            }
            let _ = launcher.kill();
        }
    }
}

fn until<T>(what: &str, mut value: impl FnMut() -> Option<T>) -> T {
    let begun = Instant::now();
    loop {
        if let Some(value) = value() {
            return value;
        }
        assert!(begun.elapsed() < WATCHDOG, "no {what} within {WATCHDOG:?}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn stop_reaches_every_fleet_and_bridges_that_do_not_answer() {
    let fleets = Fleets::start(3);
    for number in 0..3 {
        until("a bridge that answers", || fleets.is_stopped(number));
    }
    // One bridge answers, one is frozen, one is killed.
    send(fleets.bridge(1), Signal::STOP);
    send(fleets.bridge(2), Signal::KILL);
    let stop = output_of(fleets.command().args(["stop", "--json"]));
    let said = of_test(&stop);
    assert_eq!(said.len(), 3, "{said:?}");
    assert!(said.iter().all(|fleet| fleet["latched"] == true), "{said:?}");
    assert_eq!(said[0]["confirmed"], true, "{said:?}");
    let all_confirmed = said.iter().all(|fleet| fleet["confirmed"] == true);
    assert!(all_confirmed || !stop.status.success(), "what nobody has confirmed is no success: {said:?}");
    for number in 0..3 {
        until("a fleet that is stopped", || fleets.is_stopped(number).filter(|stopped| *stopped));
    }
    // A release names its fleet, and says what is so.
    let release = output_of(fleets.command().arg("release"));
    assert!(!release.status.success());
    assert!(String::from_utf8_lossy(&release.stderr).contains("--run-dir"));
    let release = output_of(fleets.command().args(["release", "--run-dir"]).arg(fleets.run_dir(1)));
    assert!(release.status.success(), "{}", String::from_utf8_lossy(&release.stderr));
    until("a fleet that is released", || fleets.is_stopped(1).filter(|stopped| !*stopped));
    assert_eq!(fleets.is_stopped(0), Some(true));
}

#[test]
fn status_does_not_hide_a_bridge_that_does_not_answer() {
    let fleets = Fleets::start(1);
    until("a bridge that answers", || fleets.is_stopped(0));
    // The launcher would replace the bridge.
    send(fleets.launchers[0].id(), Signal::STOP);
    let bridge = fleets.bridge(0);
    send(bridge, Signal::STOP);
    let ask =
        |words: &[&str]| output_of(fleets.command().args(words).arg("--run-dir").arg(fleets.run_dir(0)));
    let stop = ask(&["stop"]);
    let said = String::from_utf8_lossy(&stop.stdout).into_owned();
    assert!(!stop.status.success() && said.contains("NOT CONFIRMED"), "{said}");

    let status = ask(&["status", "--json"]);
    let figures: Value = serde_json::from_slice(&status.stdout).unwrap();
    assert!(!status.status.success());
    assert!(figures["bridge"].is_null(), "unknown is not false: {figures:#}");
    assert!(
        figures["bridge_silence"].as_str().unwrap().contains("the bridge does not answer"),
        "{figures:#}"
    );
    assert_eq!(figures["stop_latched"], true);
    assert_eq!(figures["robots"].as_array().unwrap().len(), 1, "the other figures are shown");

    send(bridge, Signal::KILL);
    let status = ask(&["status"]);
    let said = String::from_utf8_lossy(&status.stdout).into_owned();
    assert!(!status.status.success() && said.contains("the bridge does not answer"), "{said}");
    assert!(said.contains("EMERGENCY STOP is set in the run's folder"), "{said}");
    let release = ask(&["release"]);
    let said = String::from_utf8_lossy(&release.stdout).into_owned();
    assert!(said.contains("may have paused nobody"), "{said}");
    send(fleets.launchers[0].id(), Signal::CONT);
    until("a bridge that answers", || fleets.is_stopped(0));
}

#[test]
fn a_release_at_once_does_not_undo_the_stop_of_a_bridge_that_was_killed() {
    let fleets = Fleets::start(1);
    until("a bridge that answers", || fleets.is_stopped(0));
    let interruptions = || {
        let status =
            output_of(fleets.command().args(["status", "--json", "--run-dir"]).arg(fleets.run_dir(0)));
        let figures: Value = serde_json::from_slice(&status.stdout).ok()?;
        figures["bridge"]["interruptions"].as_u64()
    };
    send(fleets.bridge(0), Signal::KILL);
    let stop = output_of(fleets.command().args(["stop", "--run-dir"]).arg(fleets.run_dir(0)));
    let release = output_of(fleets.command().arg("release"));
    let text = |out: &std::process::Output| String::from_utf8_lossy(&out.stdout).into_owned();
    assert!(stop.status.success() && release.status.success(), "{} {}", text(&stop), text(&release));
    // The next bridge has set the stop, which pauses all robots, before it was released.
    assert_eq!(until("a state", interruptions), 1);
    assert_eq!(fleets.is_stopped(0), Some(false));
}

#[test]
fn a_fleet_whose_folder_was_moved_is_named_and_stopped_all_the_same() {
    let fleets = Fleets::start(2);
    for number in 0..2 {
        until("a bridge that answers", || fleets.is_stopped(number));
    }
    let (dir, elsewhere) = (fleets.run_dir(0), fleets.folder.path().join("elsewhere"));
    // A file in its place, at once: the launcher cannot make the folder anew.
    std::fs::write(&elsewhere, "in the way").unwrap();
    renameat_with(CWD, &dir, CWD, &elsewhere, RenameFlags::EXCHANGE).unwrap();
    let stop = output_of(fleets.command().args(["stop", "--json"]));
    let status = output_of(fleets.command().args(["status", "--json"]));
    let said = of_test(&stop);
    let lost = said.iter().find(|fleet| !fleet["lost"].is_null());
    let lost = lost.unwrap_or_else(|| panic!("the fleet is not named: {said:#?}"));
    assert_eq!(lost["lost"]["pid"], fleets.launchers[0].id(), "{said:#?}");
    assert!(lost["lost"]["missing"].as_str().unwrap().contains("run.json"), "{said:#?}");
    assert!(said.iter().all(|fleet| fleet["confirmed"] == true), "the bridges answer: {said:#?}");
    let moved = output_of(fleets.command().args(["status", "--json", "--run-dir"]).arg(&elsewhere));
    let figures: Value = serde_json::from_slice(&moved.stdout).unwrap();
    assert_eq!(figures["bridge"]["stopped"], true, "{figures:#}");
    let noted = String::from_utf8_lossy(&status.stderr).into_owned();
    assert!(noted.contains("folder cannot be read"), "{noted}");
}

/// Returns what `stop --json` says of the fleets of a test. Fleets of other tests, which it names, too, may run.
fn of_test(stop: &std::process::Output) -> Vec<Value> {
    let said: Vec<Value> = serde_json::from_slice(&stop.stdout).unwrap();
    said.into_iter().filter(|fleet| fleet["other"].is_null()).collect()
}

#[test]
fn a_fleet_of_another_runtime_folder_is_named_and_is_no_success() {
    let fleets = Fleets::start(1);
    until("a bridge that answers", || fleets.is_stopped(0));
    let elsewhere = Folder::new();
    let tool = |words: &[&str]| {
        let mut command = fleets.command();
        output_of(
            command.args(words).env("TMPDIR", elsewhere.path()).env("XDG_RUNTIME_DIR", elsewhere.path()),
        )
    };
    let dir = fleets.run_dir(0).display().to_string();
    for words in [&["stop"][..], &["status"], &["release"]] {
        let done = tool(words);
        let said = String::from_utf8_lossy(&[done.stdout, done.stderr].concat()).into_owned();
        let command = format!("`mr-slam stop --run-dir {dir}`");
        assert!(!done.status.success() && said.contains(&command), "{words:?}: {said}");
    }
    assert_eq!(fleets.is_stopped(0), Some(false), "it was not reached");
    assert!(tool(&["stop", "--run-dir", &dir]).status.success(), "the command that was named reaches it");
}
