//! What the operator's log is told of an external world.

use msg::{ROBOTS_MAX, Stamp};

/// Most notices that wait; further ones are dropped.
const NOTICES_MAX: usize = 2 * ROBOTS_MAX;

/// Shortest time between two notices of one kind about a robot, seconds.
const NOTICE_PERIOD_S: f64 = 30.0;

/// Whether the last notice is old enough, or there was none. A time that was set back does not silence the next one.
pub(super) fn is_due(reported: Option<Stamp>, now: Stamp) -> bool {
    reported.is_none_or(|reported| !(0.0..NOTICE_PERIOD_S).contains(&(now - reported)))
}

/// Notices that wait for the log, oldest first.
#[derive(Debug, Default)]
pub(super) struct Notices(Vec<String>);

impl Notices {
    /// Adds a notice, if there is room.
    pub(super) fn push(&mut self, notice: String) {
        if self.0.len() < NOTICES_MAX {
            self.0.push(notice);
        }
    }

    /// Takes the oldest notice.
    pub(super) fn take(&mut self) -> Option<String> {
        if self.0.is_empty() { None } else { Some(self.0.remove(0)) }
    }
}
