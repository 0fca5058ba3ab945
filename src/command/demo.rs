//! Tool `mr-slam demo`, which runs a fleet with a scripted operator that drives it over TCP, as a headset would.

use super::up::FleetHooks;
use crate::child_process::{own_program, signal, spawn};
use crate::clock::now;
use crate::progress;
use crate::restarts::{RestartPolicy, failing_text};
use crate::run::Run;
use crate::watchdog::{Finding, Watchdog};
use rustix::process::Signal;
use std::io::{self, Read};
use std::panic::resume_unwind;
use std::process::{Child, ChildStdout, Stdio};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Longest time that the operator may take to print its report after SIGTERM.
const REPORT_WAIT_MAX: Duration = Duration::from_secs(1);
/// Period at which the end of the operator is polled.
const EXIT_POLL: Duration = Duration::from_millis(5);
/// Longest time in which the operator is not scheduled once; it looks at its stick 20 times a second.
const SILENCE_MAX: Duration = Duration::from_secs(2);

/// Scripted operator in a process of its own. Killed or hanging, it is started again; when its tour is over, it is not.
pub struct OperatorProcess {
    seconds: Option<f64>,
    /// Port that it connects to; `None`: the bridge's own.
    port: Option<u16>,
    begun: Instant,
    child: Option<Child>,
    policy: RestartPolicy,
    watchdog: Watchdog,
    /// The fleet that it drives, from its first start on.
    run: Option<Run>,
    /// What the child prints: read while it runs, so that it never waits for this process.
    printed: Option<JoinHandle<Option<serde_json::Value>>>,
    /// How often it died or was replaced.
    deaths: u32,
    /// Report of an operator whose tour is over.
    report: Option<serde_json::Value>,
    is_done: bool,
}

impl OperatorProcess {
    /// Creates an operator for a run of this length; it divides a known length into the robots' turns.
    pub fn new(seconds: Option<f64>) -> Self {
        Self {
            seconds,
            port: None,
            begun: Instant::now(),
            child: None,
            policy: RestartPolicy::new(now()),
            watchdog: new_watchdog(),
            run: None,
            printed: None,
            deaths: 0,
            report: None,
            is_done: false,
        }
    }

    /// Makes it connect to a proxy's port instead of the bridge's, from its next start on.
    pub fn set_port(&mut self, port: u16) {
        self.port = Some(port);
    }

    /// Returns how often the operator died or was replaced: its report is that of the last one alone.
    pub fn deaths(&self) -> u32 {
        self.deaths
    }

    fn start(&mut self) -> io::Result<()> {
        let Some(run) = &self.run else { return Ok(()) };
        let mut command = own_program();
        command.args(["operator", "tour", "--json", "--port", &self.port.unwrap_or(run.port).to_string()]);
        command.args(["--robots", &run.config.fleet.robots.to_string()]);
        let names = &run.config.fleet.names;
        if !names.is_empty() {
            command.args(["--names", &names.join(",")]);
        }
        command.args(["--seed", &run.config.fleet.seed.to_string()]);
        command.args(["--launcher-pid", &std::process::id().to_string()]);
        if let Some(seconds) = self.seconds {
            let left = (seconds - self.begun.elapsed().as_secs_f64()).max(1.0);
            command.args(["--seconds", &left.to_string()]);
        }
        // Ctrl-C reaches the launcher alone, which then asks for the report.
        let mut child = spawn(command.stdin(Stdio::null()).stdout(Stdio::piped()))?;
        self.printed = child.stdout.take().map(|out| std::thread::spawn(move || read_report(out)));
        self.child = Some(child);
        self.policy.on_started(now());
        self.watchdog = new_watchdog();
        Ok(())
    }

    /// Handles the end of the process, if it ended.
    fn notice_end(&mut self, notify: &mut dyn FnMut(String)) {
        let Some(Ok(Some(status))) = self.child.as_mut().map(Child::try_wait) else { return };
        self.child = None;
        let report = self.take_report();
        // An operator that has printed its report is at its end, also if the report says that it could not drive.
        if status.success() || report.is_some() {
            (self.report, self.is_done) = (report, true);
            return;
        }
        notify(format!("the operator ended ({status}); nobody drives until it is back"));
        self.record_death(notify);
    }

    /// Waits until an operator that has ended is read to its end; returns its report.
    fn take_report(&mut self) -> Option<serde_json::Value> {
        self.printed.take()?.join().unwrap_or_else(|why| resume_unwind(why))
    }

    fn record_death(&mut self, notify: &mut dyn FnMut(String)) {
        self.deaths += 1;
        if self.policy.on_death(now()) {
            notify(format!("the operator {}", failing_text()));
        }
    }

    /// Kills the process if it hangs.
    fn replace_if_hung(&mut self, notify: &mut dyn FnMut(String)) {
        let Some(child) = &mut self.child else { return };
        let pid = child.id();
        let finding = self.watchdog.poll(now(), progress::switches(pid), || progress::sample(pid, pid));
        if let Some(Finding::Hung { silence, .. }) = finding {
            notify(format!("the operator has not answered for {:.1} s: replaced", silence.as_secs_f64()));
            let _ = child.kill();
        }
    }
}

fn new_watchdog() -> Watchdog {
    Watchdog::new(SILENCE_MAX, SILENCE_MAX, now())
}

/// Reads what an operator prints until it ends.
fn read_report(mut from: ChildStdout) -> Option<serde_json::Value> {
    let mut report = String::new();
    from.read_to_string(&mut report).ok()?;
    serde_json::from_str(&report).ok()
}

impl FleetHooks for OperatorProcess {
    fn on_start(&mut self, run: &Run) -> io::Result<()> {
        (self.run, self.begun) = (Some(run.clone()), Instant::now());
        self.start()
    }

    fn poll(&mut self, notify: &mut dyn FnMut(String)) -> bool {
        self.notice_end(notify);
        self.replace_if_hung(notify);
        if self.child.is_none() && !self.is_done && self.policy.is_due(now()) {
            match self.start() {
                Ok(()) => notify("the operator was started again".into()),
                Err(why) => {
                    notify(format!("cannot start the operator: {why}"));
                    self.record_death(notify);
                }
            }
        }
        true
    }

    fn retry_failing(&mut self) {
        self.policy.retry_if_failing(now());
    }

    fn on_stop(&mut self) -> Option<serde_json::Value> {
        let Some(mut child) = self.child.take() else { return self.report.take() };
        signal(&child, Signal::TERM);
        let deadline = Instant::now() + REPORT_WAIT_MAX;
        while matches!(child.try_wait(), Ok(None)) && Instant::now() < deadline {
            std::thread::sleep(EXIT_POLL);
        }
        let _ = child.kill();
        let _ = child.wait();
        self.take_report()
    }
}
