//! Refused messages from ROS 2. Nobody can be told there: the operator's log says what is refused, and why.

use super::Core;
use super::input::InputError;
use crate::router::RefusalKind;
use msg::Monotonic;

/// The same refusal is told again after this time, nanoseconds: 30 s.
const REPEAT_NS: u64 = 30_000_000_000;
/// Refusals that are remembered; beyond them the one that was told first is forgotten.
const REFUSALS_MAX: usize = 64;

/// A kind of refusal on a topic.
struct Refusal {
    kind: RefusalKind,
    topic: String,
    /// When it was told last.
    reported_at: Monotonic,
    /// Messages refused since then.
    unreported: u64,
}

/// What was refused, by kind and topic.
#[derive(Default)]
pub(super) struct RosRefusals {
    refusals: Vec<Refusal>,
}

impl RosRefusals {
    /// Counts a refusal. Returns the number of messages that were refused since it was told last, if it is to be told now.
    pub(super) fn add(&mut self, kind: RefusalKind, topic: &str, now: Monotonic) -> Option<u64> {
        let is_same = |known: &&mut Refusal| known.kind == kind && known.topic == topic;
        if let Some(known) = self.refusals.iter_mut().find(is_same) {
            known.unreported += 1;
            if now.since(known.reported_at) < REPEAT_NS {
                return None;
            }
            known.reported_at = now;
            return Some(std::mem::take(&mut known.unreported));
        }
        if self.refusals.len() == REFUSALS_MAX {
            self.refusals.remove(0);
        }
        self.refusals.push(Refusal { kind, topic: topic.into(), reported_at: now, unreported: 0 });
        Some(1)
    }
}

impl Core {
    /// Counts a refused message from ROS 2, and tells the operator why; the same reason on the same topic once in 30 s.
    pub(super) fn refuse_ros(&mut self, topic: &str, error: &InputError, now: Monotonic) {
        self.router.counted.refused += 1;
        if let Some(messages) = self.admission.ros_refusals.add(error.kind(), topic, now) {
            let times = if messages > 1 { format!(" ({messages} messages)") } else { String::new() };
            self.report(format!("ROS 2: {topic} is refused{times}: {error}"));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refusal_is_told_once_in_a_while_for_each_kind_and_topic() {
        let mut refusals = RosRefusals::default();
        let (scan, goal) = ("/robot1/scan", "/robot1/goal_pose");
        let at = |seconds: u64| Monotonic(seconds * 1_000_000_000);
        assert_eq!(refusals.add(RefusalKind::Content, scan, at(1)), Some(1));
        assert_eq!(refusals.add(RefusalKind::Content, goal, at(1)), Some(1));
        assert_eq!(refusals.add(RefusalKind::Payload, scan, at(1)), Some(1));
        for seconds in 2..31 {
            assert_eq!(refusals.add(RefusalKind::Content, scan, at(seconds)), None);
        }
        assert_eq!(refusals.add(RefusalKind::Content, scan, at(31)), Some(30));
        assert_eq!(refusals.add(RefusalKind::Content, scan, at(32)), None);
    }

    #[test]
    fn the_memory_of_refusals_is_bounded() {
        let mut refusals = RosRefusals::default();
        for topic in 0..1000 {
            refusals.add(RefusalKind::Content, &format!("/t{topic}"), Monotonic(0));
        }
        assert_eq!(refusals.refusals.len(), REFUSALS_MAX);
        assert_eq!(refusals.add(RefusalKind::Content, "/t999", Monotonic(1)), None);
    }
}
