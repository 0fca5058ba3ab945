//! Times at which messages were recorded, where the recorder's clock was set back.

use super::epochs::{PAUSE_MIN_NS, STEP_MIN_S};
use msg::Stamp;
use std::collections::HashMap;
use std::rc::Rc;

/// Topics whose times are followed: a bag has fewer.
const TOPICS_MAX: usize = 4096;

/// Follows the recorder's times of all topics, over the files of a bag in the order in which they were recorded.
#[derive(Debug, Default)]
pub struct RecordedTimes {
    /// For each topic: some programs write one after the other.
    topics: HashMap<Rc<str>, RecordedTime>,
}

impl RecordedTimes {
    /// Returns the time of a topic's next message, as [`RecordedTime::next`] does.
    pub(super) fn next(&mut self, topic: &Rc<str>, at: Stamp) -> Stamp {
        if self.topics.len() >= TOPICS_MAX && !self.topics.contains_key(topic) {
            return at;
        }
        self.topics.entry(topic.clone()).or_default().next(at)
    }
}

/// Follows the recorder's time of one topic, and removes steps back of its clock: the messages of a topic stand in the
/// order in which they were recorded, but for what a recorder's cache delays.
#[derive(Clone, Copy, Debug, Default)]
pub struct RecordedTime {
    newest: Option<Stamp>,
    offset_ns: i64,
}

impl RecordedTime {
    /// Returns the time of the topic's next message. After a step back of the clock the times go on after those before it.
    pub fn next(&mut self, at: Stamp) -> Stamp {
        let mut steady = Stamp(at.0.saturating_add(self.offset_ns));
        if let Some(newest) = self.newest.filter(|newest| *newest - steady > STEP_MIN_S) {
            let step_ns = newest.0.saturating_sub(steady.0).saturating_add(PAUSE_MIN_NS);
            self.offset_ns = self.offset_ns.saturating_add(step_ns);
            steady = Stamp(steady.0.saturating_add(step_ns));
        }
        self.newest = self.newest.max(Some(steady));
        steady
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_keep_their_order_where_the_clock_is_set_back_and_late_ones_their_times() {
        let mut time = RecordedTime::default();
        let mut next = |seconds: f64| time.next(Stamp::from_seconds(seconds)).seconds();
        let times = [10.0, 10.2, 10.1, 7.0, 7.1, 3.0, 3.5].map(&mut next);
        let expected = [10.0, 10.2, 10.1, 10.201, 10.301, 10.302, 10.802];
        assert!(times.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{times:?}");
    }

    #[test]
    fn extreme_times_do_not_overflow() {
        let mut time = RecordedTime::default();
        for at in [i64::MAX, i64::MIN, 0, i64::MIN, i64::MAX] {
            time.next(Stamp(at));
        }
    }
}
