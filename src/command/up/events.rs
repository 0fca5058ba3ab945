//! Events of a run, such as deaths and restarts, for the report.

use std::collections::VecDeque;

/// Events that are kept. A fleet that restarts a process every five seconds fills them in more than an hour.
const EVENTS_MAX: usize = 1000;

/// Newest events of a run, oldest first, and the number of those that were dropped.
#[derive(Clone, Debug, Default)]
pub(super) struct Events {
    newest: VecDeque<String>,
    dropped: u64,
}

impl Events {
    /// Adds an event; the oldest makes way.
    pub fn push(&mut self, event: String) {
        if self.newest.len() == EVENTS_MAX {
            self.newest.pop_front();
            self.dropped += 1;
        }
        self.newest.push_back(event);
    }

    /// Returns the kept events, and how many older ones were dropped.
    pub fn into_parts(self) -> (Vec<String>, u64) {
        (self.newest.into(), self.dropped)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_events_are_dropped_and_counted() {
        let mut events = Events::default();
        (0..EVENTS_MAX + 3).for_each(|number| events.push(number.to_string()));
        let (newest, dropped) = events.into_parts();
        assert_eq!((newest.len(), dropped), (EVENTS_MAX, 3));
        assert_eq!((newest[0].as_str(), newest[EVENTS_MAX - 1].as_str()), ("3", "1002"));
    }
}
