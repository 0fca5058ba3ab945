//! Requests to end this process: SIGINT, SIGTERM, SIGHUP, or the death of the launcher.

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Flag that is set when this process should end. Clones share the flag.
#[derive(Clone, Debug, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    /// Creates a flag that SIGINT, SIGTERM and SIGHUP set. SIGHUP says that the terminal was closed; where it is ignored,
    /// as after `nohup`, it stays so.
    pub fn on_signals() -> std::io::Result<Self> {
        let stop = Self::default();
        for signal in [SIGINT, SIGTERM, SIGHUP] {
            if signal != SIGHUP || !is_ignored(SIGHUP) {
                signal_hook::flag::register(signal, stop.0.clone())?;
            }
        }
        Ok(stop)
    }

    /// Creates a flag for a child of the launcher. It is set by signals and by the death of the launcher.
    pub fn for_child(launcher_pid: u32) -> std::io::Result<Self> {
        let stop = Self::on_signals()?;
        rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::TERM))?;
        // The launcher may have died before the line above.
        if rustix::process::getppid().map(|pid| pid.as_raw_nonzero().get() as u32) != Some(launcher_pid) {
            stop.request();
        }
        Ok(stop)
    }

    /// Sets the flag.
    pub fn request(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Clears the flag; returns whether it was set. A further request sets it again.
    pub fn take(&self) -> bool {
        self.0.swap(false, Ordering::Relaxed)
    }

    /// Returns whether a further request has come after one that was taken. The first one may come late.
    pub fn is_requested_again(&self, was_requested: &mut bool) -> bool {
        if !*was_requested {
            *was_requested = self.take();
            return false;
        }
        self.requested()
    }

    /// Returns whether the process should end.
    pub fn requested(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// Returns the flag, for libraries that poll it.
    pub fn flag(&self) -> &AtomicBool {
        &self.0
    }
}

/// Returns whether this process ignores a signal.
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}
