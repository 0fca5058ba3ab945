//! The machine's clock, and the run's.

use crate::ports::{Clock, ProcessUsage};
use msg::{Monotonic, Stamp};
use rustix::time::{ClockId, clock_gettime};

/// CLOCK_MONOTONIC now. It is the same clock in every process of the machine.
pub fn now() -> Monotonic {
    let t = clock_gettime(ClockId::Monotonic);
    Monotonic(t.tv_sec as u64 * 1_000_000_000 + t.tv_nsec as u64)
}

/// The machine's clock, as loops see it.
#[derive(Clone, Copy, Debug)]
pub struct SystemClock;

impl Clock for SystemClock {
    fn now(&self) -> Monotonic {
        now()
    }

    fn usage(&self) -> ProcessUsage {
        ProcessUsage { pid: std::process::id(), memory_bytes: memory_bytes(), cpu_ns: cpu_ns() }
    }
}

/// Where a run's stamps count from. Every process of the run has the same.
#[derive(Clone, Copy, Debug)]
pub struct Epoch {
    /// CLOCK_MONOTONIC at stamp 0, nanoseconds; negative if that was before the machine started.
    pub monotonic_ns: i64,
}

impl Epoch {
    /// Stamps count from now.
    pub fn now() -> Self {
        Self { monotonic_ns: now().0 as i64 }
    }

    /// Stamps are the time of day, as real robots' are: since 1970, as the machine's clock has it now.
    pub fn unix() -> Self {
        let t = clock_gettime(ClockId::Realtime);
        Self { monotonic_ns: now().0 as i64 - (t.tv_sec * 1_000_000_000 + t.tv_nsec) }
    }

    /// The stamp of a moment; before the epoch it is negative.
    pub fn stamp(self, at: Monotonic) -> Stamp {
        Stamp((at.0 as i64).saturating_sub(self.monotonic_ns))
    }

    /// The moment of a stamp.
    pub fn moment(self, stamp: Stamp) -> Monotonic {
        Monotonic(self.monotonic_ns.saturating_add(stamp.0).max(0) as u64)
    }
}

/// Processor time this process has used, nanoseconds.
pub fn cpu_ns() -> u64 {
    let t = clock_gettime(ClockId::ProcessCPUTime);
    t.tv_sec as u64 * 1_000_000_000 + t.tv_nsec as u64
}

/// Resident memory of a process, bytes; 0 if the system does not say.
pub fn memory_bytes() -> u64 {
    let pages = std::fs::read_to_string("/proc/self/statm")
        .ok()
        .and_then(|line| line.split_whitespace().nth(1)?.parse::<u64>().ok());
    pages.unwrap_or(0) * rustix::param::page_size() as u64
}
