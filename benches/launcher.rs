//! Start and end of a launcher whose fleet is measured.

use rustix::process::{Pid, Signal, kill_process};
use std::io::{BufRead, BufReader};
use std::process::{Child, Command};

/// Returns `mr-slam COMMAND`, `up` or `demo`, of a fleet that ends with the calling thread's process, also if that is killed.
pub fn command(command: &str) -> Command {
    let mut launcher = Command::new(env!("CARGO_BIN_EXE_mr-slam"));
    launcher.args([command, "--parent-pid", &std::process::id().to_string()]);
    launcher
}

/// Waits until a launcher with piped standard error says that its run's folder is complete; discards what it says later.
pub fn wait_until_ready(launcher: &mut Child) -> Result<(), String> {
    let output = BufReader::new(launcher.stderr.take().ok_or("the launcher's standard error is not piped")?);
    let mut lines = output.lines().map_while(Result::ok);
    let mut said = Vec::new();
    // What it removed of killed fleets comes before.
    while !said.last().is_some_and(|line: &String| line.starts_with("fleet of")) {
        said.push(lines.next().ok_or_else(|| format!("the launcher ended; it said: {}", said.join("; ")))?);
    }
    // Read to its end, so that the pipe does not fill.
    std::thread::spawn(move || lines.for_each(drop));
    Ok(())
}

/// Asks a launcher to end its fleet.
pub fn terminate(launcher: &Child) {
    if let Some(pid) = Pid::from_raw(launcher.id() as i32) {
        let _ = kill_process(pid, Signal::TERM);
    }
}
