//! Tool `mr-slam demo`, which runs a fleet with a scripted operator that drives it over TCP, as a headset would.

use crate::command::up::FleetHooks;
use crate::run::Run;
use rustix::process::{Pid, Signal, kill_process};
use std::io::{self, Read};
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Longest time that the operator may take to print its report after SIGTERM.
const REPORT_WAIT_MAX: Duration = Duration::from_secs(1);
/// Period at which the end of the operator is polled.
const EXIT_POLL: Duration = Duration::from_millis(5);

/// Scripted operator in a process of its own.
pub struct OperatorProcess {
    seconds: Option<f64>,
    child: Option<Child>,
}

impl OperatorProcess {
    /// Creates an operator for a run of this length; it divides a known length into the robots' turns.
    pub fn new(seconds: Option<f64>) -> Self {
        Self { seconds, child: None }
    }
}

impl FleetHooks for OperatorProcess {
    fn on_start(&mut self, run: &Run) -> io::Result<()> {
        if !run.config.fleet.names.is_empty() {
            let why =
                "the demo's operator knows robot1, robot2 and so on only; leave out fleet.names, or use `up`";
            return Err(io::Error::new(io::ErrorKind::InvalidInput, why));
        }
        let mut command = Command::new(std::env::current_exe()?);
        command.args(["operator", "tour", "--json", "--port", &run.port.to_string()]);
        command.args(["--robots", &run.config.fleet.robots.to_string()]);
        command.args(["--seed", &run.config.fleet.seed.to_string()]);
        command.args(["--launcher-pid", &std::process::id().to_string()]);
        if let Some(seconds) = self.seconds {
            command.args(["--seconds", &seconds.to_string()]);
        }
        // A process group of its own: Ctrl-C reaches the launcher alone, which then asks for the report.
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
        let deadline = Instant::now() + REPORT_WAIT_MAX;
        while matches!(child.try_wait(), Ok(None)) && Instant::now() < deadline {
            std::thread::sleep(EXIT_POLL);
        }
        let _ = child.kill();
        let _ = child.wait();
        let mut report = String::new();
        child.stdout.take()?.read_to_string(&mut report).ok()?;
        serde_json::from_str(&report).ok()
    }
}
