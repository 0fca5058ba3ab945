//! The table of the fleet's topics, which are fixed at start, and of those that clients create.

use super::buffers::SharedFrame;
use super::client::ClientId;
use super::link::Urgency;
use crate::input::InputPurpose;
use std::collections::BTreeMap;
use thiserror::Error;

/// Index of a topic in the table.
pub type TopicId = usize;

/// Newest messages that wait for a slow subscriber by default: the history depth of the reference endpoint.
pub const DEPTH_DEFAULT: usize = 10;
/// The largest `queue_size` that a client gets.
const DEPTH_MAX: usize = 4096;

/// Who may publish a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The fleet alone.
    Fleet,
    /// Clients; the fleet interprets their messages.
    Input(InputPurpose),
    /// Clients; the messages are forwarded to other clients.
    Clients,
}

/// A client that is sent a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Subscriber {
    /// The client's index in the router's table.
    pub slot: usize,
    /// Whether the client wrote the topic's name without the leading slash, and knows it only so.
    pub without_slash: bool,
}

/// How many messages of a topic the bridge keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Retention {
    /// Newest messages that wait for a slow subscriber.
    pub depth: usize,
    /// Whether the newest message is kept and sent to late subscribers.
    pub latch: bool,
}

/// One topic with its subscribers and the message that late subscribers get.
#[derive(Debug)]
pub struct Topic {
    /// Name with leading slash.
    pub name: String,
    /// ROS type as `package/Type`, such as `geometry_msgs/Twist`.
    pub message_type: String,
    /// Who may publish the topic.
    pub source: Source,
    /// How many messages are kept.
    pub retention: Retention,
    /// The newest message as a frame, if the topic is latched.
    pub latched: Option<SharedFrame>,
    /// Subscribers in the order of their subscription.
    pub subscribers: Vec<Subscriber>,
    /// Slots of the clients that registered to publish.
    pub publishers: Vec<usize>,
    /// When its frames are written to a slow connection.
    pub urgency: Urgency,
    /// Length of the last frame, bytes: the size of the next frame's buffer.
    pub last_frame_bytes: usize,
}

impl Topic {
    fn is_unused(&self) -> bool {
        self.source == Source::Clients && self.subscribers.is_empty() && self.publishers.is_empty()
    }

    /// Sets the depth to a publisher's `queue_size`, or to the largest of several publishers'.
    pub fn set_depth(&mut self, queue_size: i64) {
        let asked = usize::try_from(queue_size).ok().filter(|size| *size > 0).unwrap_or(DEPTH_DEFAULT);
        let asked = asked.min(DEPTH_MAX);
        let has_others = self.publishers.len() > 1;
        self.retention.depth = if has_others { self.retention.depth.max(asked) } else { asked };
    }
}

/// Why a client cannot use a topic.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum TopicError {
    /// The topic exists with another type.
    #[error("'{name}' is {existing}, not {requested}")]
    OtherType {
        /// The topic's name.
        name: String,
        /// Its type, `package/Type`.
        existing: String,
        /// The type that the client asked for.
        requested: String,
    },
    /// Clients have created as many topics as they may.
    #[error("'{name}' would be one topic too many: the limit is {limit} (client_topics_max)")]
    TooMany {
        /// The topic's name.
        name: String,
        /// Most topics of all clients together (`client_topics_max`).
        limit: usize,
    },
}

/// The table of topics.
#[derive(Debug)]
pub struct TopicTable {
    topics: Vec<Option<Topic>>,
    free: Vec<TopicId>,
    /// Every name twice: with and without the leading slash.
    by_name: BTreeMap<String, TopicId>,
    client_topics: usize,
    client_topics_max: usize,
}

impl TopicTable {
    /// Creates an empty table in which clients may create `client_topics_max` topics.
    pub fn new(client_topics_max: usize) -> Self {
        Self {
            topics: Vec::new(),
            free: Vec::new(),
            by_name: BTreeMap::new(),
            client_topics: 0,
            client_topics_max,
        }
    }

    /// Adds a topic whose name is not in the table yet.
    pub fn add(&mut self, name: String, message_type: &str, source: Source, retention: Retention) -> TopicId {
        let topic = Topic {
            name: name.clone(),
            message_type: message_type.to_owned(),
            source,
            retention,
            latched: None,
            subscribers: Vec::new(),
            publishers: Vec::new(),
            urgency: Urgency::of(message_type),
            last_frame_bytes: 0,
        };
        let id = self.free.pop().unwrap_or_else(|| {
            self.topics.push(None);
            self.topics.len() - 1
        });
        self.topics[id] = Some(topic);
        self.by_name.insert(name.trim_start_matches('/').to_owned(), id);
        self.by_name.insert(name, id);
        id
    }

    /// Returns the topic of that name and type, and creates it if there is none of that name.
    pub fn find_or_add(&mut self, name: String, message_type: &str) -> Result<TopicId, TopicError> {
        match self.find(&name).and_then(|id| Some((id, self.get(id)?))) {
            Some((id, topic)) if topic.message_type == message_type => Ok(id),
            Some((_, topic)) => Err(TopicError::OtherType {
                existing: topic.message_type.clone(),
                requested: message_type.to_owned(),
                name,
            }),
            None if self.client_topics >= self.client_topics_max => {
                Err(TopicError::TooMany { name, limit: self.client_topics_max })
            }
            None => {
                self.client_topics += 1;
                let retention = Retention { depth: DEPTH_DEFAULT, latch: false };
                Ok(self.add(name, message_type, Source::Clients, retention))
            }
        }
    }

    /// Finds a topic by its name, with or without leading slash.
    pub fn find(&self, name: &str) -> Option<TopicId> {
        self.by_name.get(name).copied()
    }

    /// Returns a topic, or `None` if it was removed.
    pub fn get(&self, id: TopicId) -> Option<&Topic> {
        self.topics.get(id)?.as_ref()
    }

    /// Returns a topic, or `None` if it was removed.
    pub fn get_mut(&mut self, id: TopicId) -> Option<&mut Topic> {
        self.topics.get_mut(id)?.as_mut()
    }

    /// Removes a client topic without publishers and subscribers; returns its latched frame.
    pub fn remove_if_unused(&mut self, id: TopicId) -> Option<SharedFrame> {
        if !self.get(id)?.is_unused() {
            return None;
        }
        let topic = self.topics[id].take()?;
        self.by_name.remove(&topic.name);
        self.by_name.remove(topic.name.trim_start_matches('/'));
        self.free.push(id);
        self.client_topics -= 1;
        topic.latched
    }

    /// Returns all latched messages.
    pub fn latched(&self) -> impl Iterator<Item = &SharedFrame> {
        self.topics.iter().flatten().filter_map(|topic| topic.latched.as_ref())
    }

    /// Returns all topics, sorted by name.
    pub fn sorted(&self) -> impl Iterator<Item = &Topic> {
        self.by_name.iter().filter(|(name, _)| name.starts_with('/')).filter_map(|(_, id)| self.get(*id))
    }

    /// Adds a client to the publishers of a topic, with its `queue_size` and latch flag.
    pub fn add_publisher(&mut self, client: ClientId, id: TopicId, queue_size: i64, latch: bool) {
        let Some(topic) = self.get_mut(id) else { return };
        if !topic.publishers.contains(&client.slot) {
            topic.publishers.push(client.slot);
        }
        if topic.source == Source::Clients {
            topic.set_depth(queue_size);
            topic.retention.latch |= latch;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_user_sets_the_type_and_the_last_user_removes_the_topic() {
        let mut table = TopicTable::new(1);
        let retention = Retention { depth: 1, latch: false };
        let clock = table.add("/clock".into(), "rosgraph_msgs/Clock", Source::Fleet, retention);
        let id = table.find_or_add("/a".into(), "std_msgs/String").unwrap();
        assert_eq!((table.find("/a"), table.find("a")), (Some(id), Some(id)));
        let other = table.find_or_add("/a".into(), "std_msgs/Bool").unwrap_err();
        assert_eq!(other.to_string(), "'/a' is std_msgs/String, not std_msgs/Bool");
        let too_many = TopicError::TooMany { name: "/b".into(), limit: 1 };
        assert_eq!(table.find_or_add("/b".into(), "std_msgs/Bool"), Err(too_many));
        table.remove_if_unused(id);
        table.remove_if_unused(clock);
        assert_eq!(table.find("/a"), None);
        assert!(table.find_or_add("/b".into(), "std_msgs/Bool").is_ok());
        assert_eq!(table.sorted().map(|topic| topic.name.as_str()).collect::<Vec<_>>(), ["/b", "/clock"]);
    }
}
