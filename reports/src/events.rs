//! Events of a run, such as deaths and restarts, for the report.

use serde::Serialize;
use std::collections::VecDeque;
use std::time::Duration;

/// Events that are kept. A fleet that restarts a process every five seconds fills them in more than an hour.
const EVENTS_MAX: usize = 1000;

/// Event of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Event {
    /// Time since the start of the run, seconds.
    pub at_s: f64,
    /// What happened, for people.
    pub event: String,
}

/// Newest events of a run, oldest first, and the number of those that were dropped.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Events {
    /// Deaths, restarts and changed edges with their times, oldest first; the newest 1000.
    pub events: VecDeque<Event>,
    /// Number of older events that were dropped.
    pub events_dropped: u64,
}

impl Events {
    /// Adds an event; the oldest makes way.
    pub fn push(&mut self, at: Duration, event: String) {
        if self.events.len() == EVENTS_MAX {
            self.events.pop_front();
            self.events_dropped += 1;
        }
        let at_s = (at.as_secs_f64() * 1e3).round() / 1e3;
        self.events.push_back(Event { at_s, event });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_events_are_dropped_and_counted() {
        let mut events = Events::default();
        let seconds = |number: usize| Duration::from_secs(number as u64);
        (0..EVENTS_MAX + 3).for_each(|number| events.push(seconds(number), number.to_string()));
        let Events { events: newest, events_dropped } = events;
        assert_eq!((newest.len(), events_dropped), (EVENTS_MAX, 3));
        assert_eq!(newest[0], Event { at_s: 3.0, event: "3".into() });
        assert_eq!(newest[EVENTS_MAX - 1], Event { at_s: 1002.0, event: "1002".into() });
    }
}
