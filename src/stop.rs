//! Asking a process to end: SIGINT, SIGTERM, or the launcher's death.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Set once somebody wants this process to end.
#[derive(Clone, Debug, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    /// Set by SIGINT and SIGTERM from now on.
    pub fn on_signals() -> std::io::Result<Self> {
        let stop = Self::default();
        for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
            signal_hook::flag::register(signal, stop.0.clone())?;
        }
        Ok(stop)
    }

    /// As [`Stop::on_signals`], for a child of the launcher: it does not outlive it.
    pub fn for_child(launcher_pid: u32) -> std::io::Result<Self> {
        let stop = Self::on_signals()?;
        rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::TERM))?;
        // The launcher may have died before the line above.
        if rustix::process::getppid().map(|pid| pid.as_raw_nonzero().get() as u32) != Some(launcher_pid) {
            stop.request();
        }
        Ok(stop)
    }

    /// Asks from within.
    pub fn request(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether to end.
    pub fn requested(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// The flag itself.
    pub fn flag(&self) -> &AtomicBool {
        &self.0
    }
}
