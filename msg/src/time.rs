//! The two kinds of time, which never mix: there is no conversion between them.

use bytemuck::{Pod, Zeroable};
use core::ops::{Add, Sub};
use core::time::Duration;

/// When something was measured: nanoseconds since the epoch of the run (ROS's sim time).
/// Virtual in lockstep runs, so that a run can be repeated.
#[repr(transparent)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Pod, Zeroable)]
pub struct Stamp(pub i64);

/// CLOCK_MONOTONIC in nanoseconds: when something was sent or received. For latency only.
#[repr(transparent)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Pod, Zeroable)]
pub struct Monotonic(pub u64);

impl Stamp {
    /// From seconds since the epoch of the run.
    pub fn from_seconds(seconds: f64) -> Self {
        Self((seconds * 1e9).round() as i64)
    }

    /// Seconds since the epoch of the run.
    pub fn seconds(self) -> f64 {
        self.0 as f64 * 1e-9
    }

    /// ROS's pair: whole seconds and the nanoseconds (0..1e9) beyond them.
    pub fn sec_nanosec(self) -> (i32, u32) {
        (self.0.div_euclid(1_000_000_000) as i32, self.0.rem_euclid(1_000_000_000) as u32)
    }
}

impl Sub for Stamp {
    type Output = f64;
    /// Seconds from `earlier` to `self`.
    // Nanoseconds to seconds.
    #[expect(clippy::suspicious_arithmetic_impl)]
    fn sub(self, earlier: Self) -> f64 {
        self.0.wrapping_sub(earlier.0) as f64 * 1e-9
    }
}

impl Add<Duration> for Stamp {
    type Output = Self;
    fn add(self, step: Duration) -> Self {
        Self(self.0.saturating_add(step.as_nanos() as i64))
    }
}

impl Add<Duration> for Monotonic {
    type Output = Self;
    fn add(self, step: Duration) -> Self {
        Self(self.0.saturating_add(step.as_nanos() as u64))
    }
}

impl Monotonic {
    /// Nanoseconds from `earlier` to `self`; 0 if `earlier` is later.
    pub fn since(self, earlier: Self) -> u64 {
        self.0.saturating_sub(earlier.0)
    }
}
