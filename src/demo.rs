//! `mr-slam demo`: a fleet, an operator who drives it over TCP as a headset would, and a report.

use crate::command::up::FleetHooks;
use crate::run::Run;
use rustix::process::{Pid, Signal, kill_process};
use std::io::{self, Read};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// How long the operator may take to say what it measured.
const FAREWELL: Duration = Duration::from_secs(1);

/// The operator's process.
pub struct Operator {
    seconds: Option<f64>,
    child: Option<Child>,
}

impl Operator {
    /// Who knows how long there is plans the robots' turns by it.
    pub fn new(seconds: Option<f64>) -> Self {
        Self { seconds, child: None }
    }
}

impl FleetHooks for Operator {
    fn on_start(&mut self, run: &Run) -> io::Result<()> {
        let mut command = Command::new(std::env::current_exe()?);
        command.args(["operator", "tour", "--json", "--port", &run.port.to_string()]);
        command.args(["--robots", &run.config.fleet.robots.to_string()]);
        command.args(["--seed", &run.config.fleet.seed.to_string()]);
        command.args(["--launcher-pid", &std::process::id().to_string()]);
        if let Some(seconds) = self.seconds {
            command.args(["--seconds", &seconds.to_string()]);
        }
        use std::os::unix::process::CommandExt;
        self.child = Some(command.stdin(Stdio::null()).stdout(Stdio::piped()).process_group(0).spawn()?);
        Ok(())
    }

    fn poll(&mut self) -> bool {
        true
    }

    fn on_stop(&mut self) -> Option<serde_json::Value> {
        let mut child = self.child.take()?;
        if let Some(pid) = Pid::from_raw(child.id() as i32) {
            let _ = kill_process(pid, Signal::TERM);
        }
        let deadline = Instant::now() + FAREWELL;
        while matches!(child.try_wait(), Ok(None)) && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(5));
        }
        let _ = child.kill();
        let _ = child.wait();
        let mut said = String::new();
        child.stdout.take()?.read_to_string(&mut said).ok()?;
        serde_json::from_str(&said).ok()
    }
}
