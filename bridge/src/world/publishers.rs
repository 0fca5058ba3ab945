//! Publishers on DDS that send for one robot: two at once are two robots, or two drivers, under one name.
//!
//! Scans of two places make one wrong map, and mixed odometry makes a robot jump. So nothing is taken while two send.

use super::{ExternalWorld, MessageContext, SOURCE_TIMEOUT_S, SourceId, WorldError};
use msg::{RobotId, Stamp};

/// Identifier of a publisher among all of DDS (GUID).
pub type PublisherId = [u8; 16];

/// Who sent a message.
#[derive(Clone, Copy, Debug)]
pub struct Sender {
    /// The machine or client.
    pub source: SourceId,
    /// The publisher on DDS; a client on TCP has none.
    pub publisher: Option<PublisherId>,
}

impl From<SourceId> for Sender {
    fn from(source: SourceId) -> Self {
        Self { source, publisher: None }
    }
}

/// What a robot's publishers send.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RobotTopic {
    /// Messages of type sensor_msgs/LaserScan.
    Scan,
    /// Messages of type nav_msgs/Odometry.
    Odometry,
    /// The transform odom -> base in tf2_msgs/TFMessage.
    OdometryTransform,
    /// Messages of type sensor_msgs/BatteryState.
    Battery,
}

/// Number of [`RobotTopic`]s.
const ROBOT_TOPICS: usize = 4;

/// What becomes of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum MessageUse {
    Taken,
    /// Dropped until it is known whether the publisher before has ended.
    Waiting,
    /// Dropped: two publishers send at once.
    Mixed,
}

/// The publishers of one topic of one robot, each with the time of its last message.
#[derive(Clone, Copy, Debug, Default)]
struct TopicPublishers {
    taken: Option<(PublisherId, Stamp)>,
    other: Option<(PublisherId, Stamp)>,
    is_mixed: bool,
}

/// The publishers of all topics of one robot.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RobotPublishers([TopicPublishers; ROBOT_TOPICS]);

impl TopicPublishers {
    /// Takes a message. A publisher counts until it has been silent for [`SOURCE_TIMEOUT_S`].
    fn receive(&mut self, publisher: PublisherId, received: Stamp) -> MessageUse {
        for known in [&mut self.taken, &mut self.other] {
            known.take_if(|(_, last)| received - *last >= SOURCE_TIMEOUT_S);
        }
        let is_taken = self.taken.is_none_or(|(taken, _)| taken == publisher);
        if is_taken {
            self.taken = Some((publisher, received));
            self.other.take_if(|(other, _)| *other == publisher);
            // The other one began to send, and this one sends on.
            self.is_mixed = self.other.is_some();
        } else {
            self.other = Some((publisher, received));
        }
        match (self.is_mixed, is_taken) {
            (true, _) => MessageUse::Mixed,
            (false, true) => MessageUse::Taken,
            (false, false) => MessageUse::Waiting,
        }
    }
}

impl ExternalWorld {
    /// Returns whether a message may be taken: its publisher is the only one of the topic.
    pub(super) fn is_of_one_publisher(
        &mut self,
        context: &MessageContext<'_>,
        robot: RobotId,
        topic: RobotTopic,
    ) -> Result<bool, WorldError> {
        let Some(publisher) = context.publisher else { return Ok(true) };
        let publishers = &mut self.robots[robot.index()].publishers.0[topic as usize];
        match publishers.receive(publisher, context.received) {
            MessageUse::Taken => Ok(true),
            MessageUse::Waiting => Ok(false),
            MessageUse::Mixed => {
                if topic != RobotTopic::Battery {
                    self.robots[robot.index()].drivers.forget_waiting();
                }
                Err(WorldError::SeveralPublishers { robot, topic })
            }
        }
    }
}

impl RobotTopic {
    /// Returns the subject and the verb of the error: what comes from two publishers.
    pub(super) fn subject_and_verb(self) -> &'static str {
        match self {
            Self::Scan => "scans come",
            Self::Odometry => "odometry comes",
            Self::OdometryTransform => "transform odom -> base comes",
            Self::Battery => "battery's states come",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const A: PublisherId = [1; 16];
    const B: PublisherId = [2; 16];

    fn receive(publishers: &mut TopicPublishers, publisher: PublisherId, at_s: f64) -> MessageUse {
        publishers.receive(publisher, Stamp::from_seconds(at_s))
    }

    #[test]
    fn a_driver_that_was_started_again_is_taken_when_the_former_one_is_silent() {
        let mut publishers = TopicPublishers::default();
        let mut uses = |publisher, from: u32, to: u32| -> Vec<MessageUse> {
            (from..to).map(|tenth| receive(&mut publishers, publisher, f64::from(tenth) * 0.1)).collect()
        };
        assert_eq!(uses(A, 0, 30), [MessageUse::Taken; 30]);
        let after = uses(B, 30, 60);
        assert_eq!(after[..19], [MessageUse::Waiting; 19]);
        assert_eq!(after[19..], [MessageUse::Taken; 11]);
    }

    #[test]
    fn the_one_that_is_left_of_two_is_taken_again() {
        let mut publishers = TopicPublishers::default();
        for tenth in 0..20_u32 {
            let at_s = f64::from(tenth) * 0.1;
            let first = receive(&mut publishers, A, at_s);
            assert_eq!(first, if tenth == 0 { MessageUse::Taken } else { MessageUse::Mixed });
            let second = receive(&mut publishers, B, at_s + 0.05);
            assert_eq!(second, if tenth == 0 { MessageUse::Waiting } else { MessageUse::Mixed });
        }
        for left in [A, B] {
            let mut publishers = publishers;
            assert_eq!(receive(&mut publishers, left, 2.1), MessageUse::Mixed);
            assert_eq!(receive(&mut publishers, left, 4.0), MessageUse::Taken);
        }
    }

    proptest! {
        /// Of two publishers that both send more often than the timeout, one message at most is taken.
        #[test]
        fn two_publishers_at_any_rates_are_never_mixed(
            periods_s in prop::array::uniform2(0.02..1.9_f64), phase in 0.0..1.0_f64,
        ) {
            let times = |of: usize, publisher: PublisherId| {
                let begin_s = if of == 1 { phase * periods_s[1] } else { 0.0 };
                (0..200).map(move |k| (begin_s + f64::from(k) * periods_s[of], publisher))
            };
            let mut messages: Vec<_> = times(0, A).chain(times(1, B)).collect();
            let end_s = 200.0 * periods_s[0].min(periods_s[1]);
            messages.retain(|(at_s, _)| *at_s < end_s);
            messages.sort_by(|a, b| a.0.total_cmp(&b.0));
            let mut publishers = TopicPublishers::default();
            let mut taken = Vec::new();
            for (at_s, publisher) in messages {
                if receive(&mut publishers, publisher, at_s) == MessageUse::Taken { taken.push(publisher); }
            }
            taken.dedup();
            prop_assert!(taken.len() == 1, "messages of {} publishers in turns", taken.len());
        }
    }
}
