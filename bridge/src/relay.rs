//! What clients on TCP and ROS 2 nodes exchange beyond the fleet's own topics, and who publishes what in ROS.
//!
//! The core asks the ROS 2 endpoint by [`RosCommand`] and is told by [`RosEvent`]; both are plain values, so that the
//! endpoint may run on another thread. Names are those on TCP: the endpoint adds and removes its namespace.

mod received_message;
mod table;

pub use received_message::ReceivedMessage;
pub use table::{RelayTable, Unpublished};

use msg::RobotId;
use ros2_client::dds::rustdds::bytes::Bytes;
use std::collections::BTreeMap;
use std::sync::Arc;

/// What the core asks of the ROS 2 endpoint.
#[derive(Clone, Debug)]
pub enum RosCommand {
    /// Receive a topic.
    Subscribe {
        /// The topic's name with leading slash.
        topic: Arc<str>,
        /// Its type, `package/Type`.
        message_type: String,
    },
    /// Receive a topic no longer.
    Unsubscribe {
        /// The topic's name with leading slash.
        topic: Arc<str>,
    },
    /// Announce that messages on a topic will follow.
    Advertise {
        /// The topic's name with leading slash.
        topic: Arc<str>,
        /// Its type, `package/Type`.
        message_type: String,
        /// Whether late subscribers get the newest message (transient local).
        latch: bool,
    },
    /// Announce that no more messages follow.
    Unadvertise {
        /// The topic's name with leading slash.
        topic: Arc<str>,
    },
    /// Publish a message on a topic that was announced.
    Publish {
        /// The topic's name with leading slash.
        topic: Arc<str>,
        /// The message as CDR with its encapsulation header.
        payload: Bytes,
    },
}

/// What the ROS 2 endpoint tells the core.
#[derive(Clone, Debug)]
pub enum RosEvent {
    /// A message on a topic of the fleet, for the fleet.
    Input(ReceivedMessage),
    /// A message on a topic that the core subscribed to.
    Message {
        /// The topic's name with leading slash.
        topic: Arc<str>,
        /// The message as CDR with its encapsulation header.
        payload: Bytes,
    },
    /// A message that is dropped because its encoding is not little-endian CDR.
    OtherEncoding {
        /// The topic's name with leading slash.
        topic: Arc<str>,
    },
    /// The endpoint cannot do what was asked.
    Failure {
        /// The topic's name with leading slash.
        topic: Arc<str>,
        /// Why it failed, for the client.
        text: String,
    },
    /// The topics that ROS nodes publish and subscribe to, after a change.
    Graph(RosGraph),
    /// A robot of an external world listens to its velocities from now on.
    RobotListens(RobotId),
    /// The participant or writer that sent the last velocity is gone.
    DriverLost,
}

impl RosCommand {
    /// Returns the name with leading slash of a client's topic.
    pub fn topic(&self) -> &Arc<str> {
        match self {
            Self::Subscribe { topic, .. }
            | Self::Unsubscribe { topic }
            | Self::Advertise { topic, .. }
            | Self::Unadvertise { topic }
            | Self::Publish { topic, .. } => topic,
        }
    }
}

impl RosEvent {
    /// Returns whether the event is the time of an external world.
    pub fn is_clock(&self) -> bool {
        matches!(self, Self::Input(message) if message.is_clock())
    }
}

/// The topics of ROS nodes outside this endpoint, by name with leading slash.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RosGraph {
    /// What is known of each topic.
    pub topics: BTreeMap<String, RosTopic>,
}

/// What ROS nodes do with one topic.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RosTopic {
    /// Types of its publishers, `package/Type`, sorted; usually one.
    pub published: Vec<String>,
    /// Types of its subscribers, `package/Type`, sorted; usually one.
    pub subscribed: Vec<String>,
    /// Whether every publisher keeps its newest messages for late subscribers (transient local).
    pub is_latched: bool,
}

impl RosTopic {
    /// Returns the topic's types, the publishers' first.
    pub fn types(&self) -> impl Iterator<Item = &str> {
        self.published.iter().chain(&self.subscribed).map(String::as_str)
    }
}
