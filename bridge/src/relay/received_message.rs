//! A message from DDS for the fleet.

use crate::input::InputPurpose;
use crate::world::PublisherId;

/// A message from DDS on a topic of the fleet, not decoded yet.
#[derive(Clone, Debug)]
pub struct ReceivedMessage {
    input: InputPurpose,
    topic: String,
    is_stamped: bool,
    payload: Vec<u8>,
    publisher: Option<PublisherId>,
}

impl ReceivedMessage {
    /// Creates a message; the parameters are what the methods return.
    pub(crate) fn new(input: InputPurpose, topic: String, is_stamped: bool, payload: Vec<u8>) -> Self {
        Self { input, topic, is_stamped, payload, publisher: None }
    }

    /// Returns the message with its publisher.
    pub(crate) fn with_publisher(self, publisher: PublisherId) -> Self {
        Self { publisher: Some(publisher), ..self }
    }

    /// Returns who published the message.
    pub(crate) fn publisher(&self) -> Option<PublisherId> {
        self.publisher
    }

    /// Returns whether the message is the time of an external world.
    pub fn is_clock(&self) -> bool {
        self.input == InputPurpose::Clock
    }

    /// Returns what the fleet does with the message.
    pub(crate) fn input(&self) -> InputPurpose {
        self.input
    }

    /// Returns the topic's name among the topics on TCP.
    pub(crate) fn topic(&self) -> &str {
        &self.topic
    }

    /// Returns whether the message is geometry_msgs/TwistStamped instead of Twist.
    pub(crate) fn is_stamped(&self) -> bool {
        self.is_stamped
    }

    /// Returns the message as CDR with its encapsulation header.
    pub(crate) fn payload(&self) -> &[u8] {
        &self.payload
    }
}
