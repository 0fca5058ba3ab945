//! What clients on TCP and ROS 2 nodes exchange beyond the fleet's own topics: topics and services, and who in ROS has them.
//!
//! The core asks the ROS 2 endpoint by [`RosCommand`] and is told by [`RosEvent`]; both are plain values, so that the
//! endpoint may run on another thread. Names are those on TCP: the endpoint adds and removes its namespace.

mod received_message;
mod services;
mod table;

pub use received_message::ReceivedMessage;
pub use services::ServiceExchange;
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
    /// Prepare to call a service.
    OpenClient {
        /// The service's name with leading slash.
        service: Arc<str>,
        /// Its type, `package/Type`.
        service_type: String,
    },
    /// Call a service no longer.
    CloseClient {
        /// The service's name with leading slash.
        service: Arc<str>,
    },
    /// Call a service that was prepared.
    Call {
        /// The service's name with leading slash.
        service: Arc<str>,
        /// The bridge's number of the call, which the response carries.
        number: i64,
        /// The request as CDR with its encapsulation header.
        payload: Bytes,
    },
    /// Do not send a request any more if it has not been sent yet: nobody waits for its response.
    Cancel {
        /// The service's name with leading slash.
        service: Arc<str>,
        /// The bridge's number of the call.
        number: i64,
    },
    /// Offer a service to ROS.
    OpenServer {
        /// The service's name with leading slash.
        service: Arc<str>,
        /// Its type, `package/Type`.
        service_type: String,
    },
    /// Offer a service no longer.
    CloseServer {
        /// The service's name with leading slash.
        service: Arc<str>,
    },
    /// Answer a ROS node's request.
    Respond {
        /// The service's name with leading slash.
        service: Arc<str>,
        /// The request that is answered.
        request: RosRequestId,
        /// The response as CDR with its encapsulation header.
        payload: Bytes,
    },
}

/// Longest request or response that carries an identity beside the payload, bytes: what fits into one datagram.
///
/// RustDDS 0.15 writes one byte too many into each fragment of a longer one: nobody can read it.
pub const IDENTIFIED_BYTES_MAX: usize = 1024;

/// Identity of a ROS node's request, which the response must carry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RosRequestId {
    /// The requester's identifier: of its reader or writer on Fast DDS, its own number on CycloneDDS.
    pub requester: [u8; 16],
    /// The requester's number of the call.
    pub number: i64,
    /// Whether the identity stands in the payload, as with CycloneDDS, and not beside it.
    pub is_in_payload: bool,
}

impl RosRequestId {
    /// Returns whether a response of so many bytes can be sent to the requester.
    pub fn can_carry(&self, response_bytes: usize) -> bool {
        self.is_in_payload || response_bytes <= IDENTIFIED_BYTES_MAX
    }
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
    /// A ROS node's request to a service that is offered to ROS.
    Request {
        /// The service's name with leading slash.
        service: Arc<str>,
        /// The request's identity.
        id: RosRequestId,
        /// The request as CDR with its encapsulation header.
        payload: Bytes,
    },
    /// The response of a ROS node to a call.
    Response {
        /// The service's name with leading slash.
        service: Arc<str>,
        /// The bridge's number of the call.
        number: i64,
        /// The response as CDR with its encapsulation header.
        payload: Bytes,
    },
    /// The endpoint cannot call or offer a service.
    ServiceFailure {
        /// The service's name with leading slash.
        service: Arc<str>,
        /// Why it failed, for the client.
        text: String,
    },
    /// The topics and services of ROS nodes, after a change.
    Graph(RosGraph),
    /// A robot of an external world listens to its velocities from now on.
    RobotListens(RobotId),
    /// The participant or writer that sent the last velocity is gone.
    DriverLost,
}

impl RosCommand {
    /// Returns the name with leading slash of the topic or service.
    pub fn name(&self) -> &Arc<str> {
        match self {
            Self::Subscribe { topic: name, .. }
            | Self::Unsubscribe { topic: name }
            | Self::Advertise { topic: name, .. }
            | Self::Unadvertise { topic: name }
            | Self::Publish { topic: name, .. }
            | Self::OpenClient { service: name, .. }
            | Self::CloseClient { service: name }
            | Self::Call { service: name, .. }
            | Self::Cancel { service: name, .. }
            | Self::OpenServer { service: name, .. }
            | Self::CloseServer { service: name }
            | Self::Respond { service: name, .. } => name,
        }
    }

    /// Returns whether the command is about a service.
    pub fn is_of_service(&self) -> bool {
        !matches!(
            self,
            Self::Subscribe { .. }
                | Self::Unsubscribe { .. }
                | Self::Advertise { .. }
                | Self::Unadvertise { .. }
                | Self::Publish { .. }
        )
    }
}

impl RosEvent {
    /// Returns whether the event is the time of an external world.
    pub fn is_clock(&self) -> bool {
        matches!(self, Self::Input(message) if message.is_clock())
    }
}

/// The topics and services of ROS nodes outside this endpoint, by name with leading slash.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RosGraph {
    /// What is known of each topic.
    pub topics: BTreeMap<String, RosTopic>,
    /// The types of each service that a node offers, `package/Type`, sorted; usually one.
    pub services: BTreeMap<String, Vec<String>>,
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
