//! Topics of a recording, and numbers of their messages.

use msg::Stamp;
use serde::Serialize;

/// Whether a topic's newest message matters to late subscribers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Durability {
    /// Present subscribers only.
    Volatile,
    /// The newest message is for late subscribers too (latched, transient local).
    Latched,
}

/// Index of a topic in a writer, by the order in which topics were added.
pub type TopicIndex = usize;

/// Number of a topic's messages in a file.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct TopicCount {
    /// Name of the topic.
    pub topic: String,
    /// Number of messages.
    pub messages: u64,
    /// Bytes of the messages, each with its encapsulation header.
    pub bytes: u64,
}

/// Numbers of messages by topic, and their times.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PartCounts {
    /// Number of messages of each topic and their bytes, by its index.
    topics: Vec<(u64, u64)>,
    /// Times of the first and the last message; `None` without any.
    pub times: Option<(Stamp, Stamp)>,
    /// Number of all messages.
    pub messages: u64,
}

impl PartCounts {
    /// Counts a message of a topic.
    pub(crate) fn add(&mut self, topic: TopicIndex, at: Stamp, bytes: usize) {
        self.topics.resize(self.topics.len().max(topic + 1), (0, 0));
        let (of_topic, of_bytes) = &mut self.topics[topic];
        (*of_topic, *of_bytes, self.messages) = (*of_topic + 1, *of_bytes + bytes as u64, self.messages + 1);
        self.times = union(self.times, Some((at, at)));
    }

    /// Adds the counts of another part.
    pub fn append(&mut self, other: &Self) {
        self.topics.resize(self.topics.len().max(other.topics.len()), (0, 0));
        for ((messages, bytes), (more, more_bytes)) in self.topics.iter_mut().zip(&other.topics) {
            (*messages, *bytes) = (*messages + more, *bytes + more_bytes);
        }
        self.times = union(self.times, other.times);
        self.messages += other.messages;
    }

    /// Returns the number of messages of a topic, and their bytes.
    pub fn of_topic(&self, topic: TopicIndex) -> (u64, u64) {
        self.topics.get(topic).copied().unwrap_or_default()
    }
}

/// Returns the first and the last of the times of both.
pub(crate) fn union(a: Option<(Stamp, Stamp)>, b: Option<(Stamp, Stamp)>) -> Option<(Stamp, Stamp)> {
    match (a, b) {
        (Some((first, last)), Some((other, end))) => Some((first.min(other), last.max(end))),
        (one, other) => one.or(other),
    }
}
