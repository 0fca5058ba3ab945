//! What the operator's log is told of an external world.

use msg::ROBOTS_MAX;

/// Most notices that wait; further ones are dropped.
const NOTICES_MAX: usize = 2 * ROBOTS_MAX;

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
