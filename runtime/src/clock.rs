//! The machine's monotonic clock, the run's clock, and the process's use of the machine.

use crate::ports::{Clock, ProcessUsage};
use msg::{Monotonic, Stamp};
use rustix::time::{ClockId, clock_gettime};
use std::sync::OnceLock;

/// Nanoseconds in a second.
const NS_PER_S: i64 = 1_000_000_000;

/// Variable in which the launcher tells a process how often it was started before.
pub const RESTARTS_VARIABLE: &str = "MR_SLAM_RESTARTS";
/// What the variable said when the process asked first.
static RESTARTS: OnceLock<u64> = OnceLock::new();

/// Reads CLOCK_MONOTONIC, which is the same clock in every process of the machine.
pub fn now() -> Monotonic {
    let t = clock_gettime(ClockId::Monotonic);
    Monotonic((t.tv_sec * NS_PER_S + t.tv_nsec) as u64)
}

/// The machine's clock as a port of the process loops.
#[derive(Clone, Copy, Debug)]
pub struct SystemClock;

impl Clock for SystemClock {
    fn now(&self) -> Monotonic {
        now()
    }

    fn usage(&self) -> ProcessUsage {
        let restarts = *RESTARTS.get_or_init(|| {
            std::env::var(RESTARTS_VARIABLE).ok().and_then(|count| count.parse().ok()).unwrap_or(0)
        });
        ProcessUsage { pid: std::process::id(), memory_bytes: memory_bytes(), cpu_ns: cpu_ns(), restarts }
    }
}

/// Epoch of a run: the moment of stamp 0. It is the same in every process of the run.
#[derive(Clone, Copy, Debug)]
pub struct Epoch {
    /// CLOCK_MONOTONIC at stamp 0, nanoseconds. It is negative if the machine started later.
    pub monotonic_ns: i64,
}

impl Epoch {
    /// Starts the run's clock at zero now.
    pub fn now() -> Self {
        Self { monotonic_ns: now().0 as i64 }
    }

    /// Makes stamps the time since 1970, as on real robots, by the machine's wall clock now.
    pub fn unix() -> Self {
        let t = clock_gettime(ClockId::Realtime);
        Self { monotonic_ns: now().0 as i64 - (t.tv_sec * NS_PER_S + t.tv_nsec) }
    }

    /// Converts a moment to its stamp, which is negative before the epoch.
    pub fn stamp(self, at: Monotonic) -> Stamp {
        Stamp((at.0 as i64).saturating_sub(self.monotonic_ns))
    }

    /// Converts a stamp to its moment.
    pub fn moment(self, stamp: Stamp) -> Monotonic {
        Monotonic(self.monotonic_ns.saturating_add(stamp.0).max(0) as u64)
    }
}

/// Returns the processor time that this process has used, nanoseconds.
pub fn cpu_ns() -> u64 {
    let t = clock_gettime(ClockId::ProcessCPUTime);
    (t.tv_sec * NS_PER_S + t.tv_nsec) as u64
}

/// Returns the resident memory of this process, bytes; 0 if the system does not report it.
pub fn memory_bytes() -> u64 {
    let pages = std::fs::read_to_string("/proc/self/statm")
        .ok()
        .and_then(|line| line.split_whitespace().nth(1)?.parse::<u64>().ok());
    pages.unwrap_or(0) * rustix::param::page_size() as u64
}
