//! The queues between the bridge and the ROS 2 endpoint, which run on two threads.
//!
//! Both directions are bounded: of a topic the newest messages are kept, and what is dropped is counted.

use crate::relay::{RosCommand, RosEvent};
use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};
use tokio::sync::Notify;

/// Messages of one topic that may wait in one direction.
const DEPTH_MAX: usize = 64;
/// Bytes of messages that may wait in one direction; one longer message may wait alone.
const BYTES_MAX: usize = 32 << 20;
/// Registrations that may wait in one direction. They are few: clients may register a limited number of topics.
const REGISTRATIONS_MAX: usize = 16_384;

/// A command or an event.
trait Queued {
    /// Returns the topic and the length of a message, bytes; `None` for a registration, which is not dropped.
    fn message(&self) -> Option<(&str, usize)>;
}

impl Queued for RosCommand {
    fn message(&self) -> Option<(&str, usize)> {
        match self {
            Self::Publish { topic: name, payload }
            | Self::Call { service: name, payload, .. }
            | Self::Respond { service: name, payload, .. } => Some((name, payload.len())),
            _ => None,
        }
    }
}

impl Queued for RosEvent {
    fn message(&self) -> Option<(&str, usize)> {
        match self {
            Self::Message { topic, payload } => Some((topic, payload.len())),
            Self::Request { service, payload, .. } | Self::Response { service, payload, .. } => {
                Some((service, payload.len()))
            }
            Self::OtherEncoding { topic } => Some((topic, 0)),
            Self::Input(message) => Some((message.topic(), message.payload().len())),
            Self::Failure { .. }
            | Self::ServiceFailure { .. }
            | Self::Graph(_)
            | Self::RobotListens(_)
            | Self::DriverLost => None,
        }
    }
}

/// What waits in one direction.
#[derive(Debug)]
struct Waiting<T> {
    items: VecDeque<T>,
    bytes: usize,
    dropped: u64,
}

/// One direction of the queues.
#[derive(Debug)]
struct BoundedQueue<T> {
    waiting: Mutex<Waiting<T>>,
    arrived: Notify,
}

impl<T: Queued> BoundedQueue<T> {
    fn new() -> Self {
        let waiting = Waiting { items: VecDeque::new(), bytes: 0, dropped: 0 };
        Self { waiting: Mutex::new(waiting), arrived: Notify::new() }
    }

    fn lock(&self) -> MutexGuard<'_, Waiting<T>> {
        // Nothing panics while it is locked.
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn push(&self, item: T) {
        self.lock().push(item);
        self.arrived.notify_one();
    }

    /// Waits for the oldest item. One task at a time may wait.
    async fn next(&self) -> T {
        loop {
            let next = self.lock().pop();
            match next {
                Some(item) => return item,
                None => self.arrived.notified().await,
            }
        }
    }
}

impl<T: Queued> Waiting<T> {
    fn push(&mut self, item: T) {
        match item.message() {
            Some((topic, bytes)) => {
                let is_same = |other: &T| other.message().is_some_and(|(of, _)| of == topic);
                let depth = self.items.iter().filter(|other| is_same(other)).count();
                let oldest = self.items.iter().position(is_same).filter(|_| depth >= DEPTH_MAX);
                oldest.into_iter().for_each(|at| self.drop_at(at));
                while self.bytes > 0 && self.bytes + bytes > BYTES_MAX {
                    let long = |other: &T| other.message().is_some_and(|(_, bytes)| bytes > 0);
                    let Some(at) = self.items.iter().position(long) else { break };
                    self.drop_at(at);
                }
                self.bytes += bytes;
            }
            None if self.items.len() >= REGISTRATIONS_MAX => {
                self.dropped += 1;
                return;
            }
            None => {}
        }
        self.items.push_back(item);
    }

    fn drop_at(&mut self, at: usize) {
        if let Some(item) = self.items.remove(at) {
            self.bytes -= item.message().map_or(0, |(_, bytes)| bytes);
            self.dropped += 1;
        }
    }

    fn pop(&mut self) -> Option<T> {
        let item = self.items.pop_front()?;
        self.bytes -= item.message().map_or(0, |(_, bytes)| bytes);
        Some(item)
    }
}

/// The queues between one bridge and one endpoint.
#[derive(Debug)]
pub struct DdsQueues {
    commands: BoundedQueue<RosCommand>,
    events: BoundedQueue<RosEvent>,
}

impl Default for DdsQueues {
    fn default() -> Self {
        Self { commands: BoundedQueue::new(), events: BoundedQueue::new() }
    }
}

impl DdsQueues {
    /// Sends a command to the endpoint. Returns without waiting.
    pub fn send_command(&self, command: RosCommand) {
        self.commands.push(command);
    }

    /// Waits for the oldest event of the endpoint.
    pub async fn next_event(&self) -> RosEvent {
        self.events.next().await
    }

    /// Sends an event to the bridge. Returns without waiting.
    pub(super) fn send_event(&self, event: RosEvent) {
        self.events.push(event);
    }

    /// Waits for the oldest command of the bridge.
    pub(super) async fn next_command(&self) -> RosCommand {
        self.commands.next().await
    }

    /// Returns how many messages were dropped in both directions, because the other side was slow.
    pub fn dropped(&self) -> u64 {
        self.commands.lock().dropped + self.events.lock().dropped
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ros2_client::dds::rustdds::bytes::Bytes;

    fn message(topic: &str, bytes: usize) -> RosCommand {
        RosCommand::Publish { topic: topic.into(), payload: Bytes::from(vec![7; bytes]) }
    }

    #[test]
    fn the_newest_messages_of_a_topic_are_kept_and_registrations_are_never_dropped() {
        let queues = DdsQueues::default();
        queues.send_command(RosCommand::Unadvertise { topic: "/a".into() });
        (0..DEPTH_MAX + 3).for_each(|length| queues.send_command(message("/a", length)));
        queues.send_command(message("/b", 5));
        let waiting = &mut *queues.commands.lock();
        assert_eq!((waiting.items.len(), waiting.dropped), (DEPTH_MAX + 2, 3));
        assert!(matches!(waiting.pop(), Some(RosCommand::Unadvertise { .. })));
        assert!(matches!(waiting.pop(), Some(RosCommand::Publish { payload, .. }) if payload.len() == 3));
    }

    #[test]
    fn bytes_are_bounded_and_one_long_message_passes() {
        let queues = DdsQueues::default();
        (0..8).for_each(|_| queues.send_command(message("/map", BYTES_MAX / 4)));
        assert_eq!(queues.commands.lock().bytes, BYTES_MAX);
        assert_eq!(queues.dropped(), 4);
        queues.send_command(message("/map", 2 * BYTES_MAX));
        let waiting = &mut *queues.commands.lock();
        assert_eq!((waiting.items.len(), waiting.bytes), (1, 2 * BYTES_MAX));
        while waiting.pop().is_some() {}
        assert_eq!(waiting.bytes, 0);
    }
}
