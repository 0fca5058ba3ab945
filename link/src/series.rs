//! Events that follow each other.

use msg::Monotonic;
use std::time::Duration;

/// Series of events: when it began, and its newest.
#[derive(Clone, Copy, Debug)]
pub struct Series {
    begun: Monotonic,
    /// When its newest event was.
    pub newest: Monotonic,
}

impl Series {
    /// Adds an event to a series, or begins one with it.
    pub fn with(before: Option<Self>, now: Monotonic) -> Self {
        Self { begun: before.map_or(now, |series| series.begun), newest: now }
    }

    /// Returns whether so much time lies between its first event and its newest.
    pub fn lasts(self, at_least: Duration) -> bool {
        self.newest.since(self.begun) >= at_least.as_nanos() as u64
    }
}
