//! The two kinds of time: stamps on the run's clock, and monotonic time. Only `Epoch` of `runtime` converts between them.

use bytemuck::{Pod, Zeroable};
use core::ops::{Add, Sub};
use core::time::Duration;

/// Time of a measurement, in nanoseconds since the epoch of the run (ROS's sim time).
///
/// It is virtual in lockstep runs, so that a run can be repeated.
#[repr(transparent)]
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Hash,
    Pod,
    Zeroable,
    serde::Serialize,
    serde::Deserialize,
)]
pub struct Stamp(pub i64);

/// Time of sending or receiving, CLOCK_MONOTONIC in nanoseconds. Used for latencies and deadlines.
#[repr(transparent)]
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Hash,
    Pod,
    Zeroable,
    serde::Serialize,
    serde::Deserialize,
)]
pub struct Monotonic(pub u64);

impl Stamp {
    /// Converts from seconds since the epoch of the run.
    pub fn from_seconds(seconds: f64) -> Self {
        Self((seconds * 1e9).round() as i64)
    }

    /// Converts to seconds since the epoch of the run.
    pub fn seconds(self) -> f64 {
        self.0 as f64 * 1e-9
    }

    /// Splits into ROS's pair: whole seconds and the remaining nanoseconds (0..1e9).
    pub fn sec_nanosec(self) -> (i32, u32) {
        (self.0.div_euclid(1_000_000_000) as i32, self.0.rem_euclid(1_000_000_000) as u32)
    }
}

impl Sub for Stamp {
    type Output = f64;
    /// Returns the seconds from `earlier` to `self`.
    // The factor converts nanoseconds to seconds.
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
    /// Converts to seconds since the clock's zero.
    pub fn seconds(self) -> f64 {
        self.0 as f64 * 1e-9
    }

    /// Returns the nanoseconds from `earlier` to `self`; 0 if `earlier` is later.
    pub fn since(self, earlier: Self) -> u64 {
        self.0.saturating_sub(earlier.0)
    }

    /// Returns the first multiple of `period` after `self`; `self` if `period` is zero.
    ///
    /// Timers that end at such multiples end together: a process wakes once for all of them.
    pub fn next_multiple(self, period: Duration) -> Self {
        let period_ns = u64::try_from(period.as_nanos()).unwrap_or(u64::MAX);
        self.0.checked_rem(period_ns).map_or(self, |past| Self(self.0.saturating_add(period_ns - past)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn timers_of_one_period_end_together() {
        let period = Duration::from_nanos(100);
        for at in [0, 1, 99] {
            assert_eq!(Monotonic(at).next_multiple(period), Monotonic(100));
        }
        assert_eq!(Monotonic(100).next_multiple(period), Monotonic(200));
        assert_eq!(Monotonic(7).next_multiple(Duration::ZERO), Monotonic(7));
        assert_eq!(Monotonic(u64::MAX).next_multiple(period), Monotonic(u64::MAX));
    }
}
