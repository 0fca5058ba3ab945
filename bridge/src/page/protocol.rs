//! Messages of the Foxglove WebSocket protocol (`foxglove.sdk.v1`), as far as the bridge speaks it.
//!
//! Text messages are JSON objects with the field `op`. Binary messages begin with one byte that says what they are;
//! numbers in them are little-endian. Source: the protocol's description in foxglove/ws-protocol and foxglove-sdk.

use crate::bridge::FleetStatus;
use msg::Monotonic;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Names of the protocol that the bridge accepts, the preferred first.
pub const SUBPROTOCOLS: [&str; 2] = ["foxglove.sdk.v1.1", "foxglove.sdk.v1"];
/// Encoding of all messages: CDR with its encapsulation header, as on DDS.
pub const ENCODING: &str = "cdr";
/// Encoding of all schemas: ROS 2 message definitions.
pub const SCHEMA_ENCODING: &str = "ros2msg";
/// The parameter with the state of the fleet: figures of telemetry, and who drives each robot.
pub const FLEET_PARAMETER: &str = "/mr_slam/fleet";
/// The parameter with the newest time of the run, seconds: clients that ask for it learn how old messages are.
pub const TIME_PARAMETER: &str = "/mr_slam/time";
/// The parameter with the bridge's own time, seconds: clients that know it say when they sent a command.
pub const CLOCK_PARAMETER: &str = "/mr_slam/clock";
/// First byte of a message on a subscription, from the server.
pub const MESSAGE_DATA: u8 = 1;
/// First byte of a service's response, from the server.
pub const SERVICE_RESPONSE: u8 = 3;
/// First byte of a message that a client publishes.
const CLIENT_MESSAGE: u8 = 1;
/// First byte of a message that a client publishes with the time at which it did: the bridge's own addition.
const TIMED_CLIENT_MESSAGE: u8 = 128;
/// First byte of a client's call of a service.
const SERVICE_REQUEST: u8 = 2;
/// Characters of a text about a device that are logged.
const SELFCHECK_CHARS_MAX: usize = 2000;
/// Bytes before the payload of [`MESSAGE_DATA`]: kind, subscription, time.
pub const MESSAGE_HEADER_BYTES: usize = 1 + 4 + 8;

/// A text message from a client.
#[derive(Debug, PartialEq, Eq, Deserialize)]
#[serde(tag = "op", rename_all = "camelCase")]
pub enum ClientCommand {
    /// Begins to receive topics.
    Subscribe {
        /// What to subscribe to.
        subscriptions: Vec<Subscription>,
    },
    /// Ends some of the client's subscriptions.
    #[serde(rename_all = "camelCase")]
    Unsubscribe {
        /// The client's numbers of the subscriptions.
        subscription_ids: Vec<u32>,
    },
    /// Registers topics that the client will publish.
    Advertise {
        /// Topics with the numbers that the client gives them.
        channels: Vec<ClientChannel>,
    },
    /// Ends some of the client's publications.
    #[serde(rename_all = "camelCase")]
    Unadvertise {
        /// The client's numbers of the topics.
        channel_ids: Vec<u32>,
    },
    /// Asks for parameters' values now.
    #[serde(rename_all = "camelCase")]
    GetParameters {
        /// Names of the parameters; all of them if there are none.
        parameter_names: Vec<String>,
        /// The client's name of the request, which the answer repeats.
        id: Option<String>,
    },
    /// Asks for parameters' values whenever they change: the bridge sends [`FLEET_PARAMETER`] always.
    SubscribeParameterUpdates,
    /// Ends what [`Self::SubscribeParameterUpdates`] began.
    UnsubscribeParameterUpdates,
    /// Anything that the bridge does not offer, such as assets.
    #[serde(other)]
    Other,
}

/// A subscription that a client asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Subscription {
    /// Number that the client chose: its messages carry it.
    pub id: u32,
    /// The server's number of the topic.
    pub channel_id: u64,
}

/// A topic that a client will publish.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct ClientChannel {
    /// Number that the client chose: its messages carry it.
    pub id: u32,
    /// Topic's name in ROS.
    pub topic: String,
    /// Encoding of the messages; the bridge takes [`ENCODING`].
    pub encoding: String,
    /// ROS type, as `geometry_msgs/msg/Twist` or `geometry_msgs/Twist`.
    pub schema_name: String,
}

/// A text message from the server.
#[derive(Debug, Serialize)]
#[serde(tag = "op", rename_all = "camelCase")]
pub enum ServerCommand<'a> {
    /// The first message: what the server can do.
    #[serde(rename_all = "camelCase")]
    ServerInfo {
        /// Name for people.
        name: &'a str,
        /// What clients may do beside subscribing.
        capabilities: &'a [&'a str],
        /// Encodings of clients' messages.
        supported_encodings: &'a [&'a str],
        /// Number of this bridge process: another one after a restart.
        session_id: &'a str,
        /// What else clients may want to know of the server.
        metadata: Metadata<'a>,
    },
    /// Topics that clients may subscribe to.
    Advertise {
        /// Topics with the numbers that the server gives them.
        channels: Vec<Channel<'a>>,
    },
    /// Topics that are gone.
    #[serde(rename_all = "camelCase")]
    Unadvertise {
        /// The server's numbers of the topics.
        channel_ids: Vec<u64>,
    },
    /// Services that clients may call.
    AdvertiseServices {
        /// Services with the numbers that the server gives them.
        services: Vec<Service<'a>>,
    },
    /// Services that are gone.
    #[serde(rename_all = "camelCase")]
    UnadvertiseServices {
        /// The server's numbers of the services.
        service_ids: Vec<u32>,
    },
    /// A call that gets no response.
    #[serde(rename_all = "camelCase")]
    ServiceCallFailure {
        /// The server's number of the service.
        service_id: u32,
        /// The client's number of the call.
        call_id: u32,
        /// Why it failed, for a person.
        message: &'a str,
    },
    /// Values of parameters.
    ParameterValues {
        /// The parameters with their values.
        parameters: &'a [Parameter<'a>],
        /// The client's name of the request that this answers.
        #[serde(skip_serializing_if = "Option::is_none")]
        id: Option<&'a str>,
    },
    /// Text for a person.
    Status {
        /// How much it matters.
        level: StatusLevel,
        /// Text for a person.
        message: &'a str,
    },
}

/// What [`ServerCommand::ServerInfo`] says beside the protocol's own fields.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Metadata<'a> {
    /// Identity of the fleet's run: the same after a restart of the bridge, another one in the next run.
    pub run: &'a str,
}

/// A parameter with its value.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Parameter<'a> {
    /// Name of the parameter.
    pub name: &'a str,
    /// Value of the parameter.
    pub value: ParameterValue<'a>,
}

/// A parameter's value.
#[derive(Clone, Copy, Debug, Serialize)]
#[serde(untagged)]
pub enum ParameterValue<'a> {
    /// Value of [`FLEET_PARAMETER`].
    Fleet(&'a FleetStatus),
    /// Value of [`TIME_PARAMETER`] or [`CLOCK_PARAMETER`], seconds.
    Time(f64),
}

/// Severity of a status, as the protocol numbers it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StatusLevel {
    /// Something happened that nobody needs to act on.
    Info = 0,
    /// Something needs attention.
    Warning = 1,
    /// Something was refused.
    Error = 2,
}

impl Serialize for StatusLevel {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_u8(*self as u8)
    }
}

/// A topic that clients may subscribe to.
#[derive(Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Channel<'a> {
    /// The server's number of the topic on this connection.
    pub id: u64,
    /// Topic's name in ROS.
    pub topic: &'a str,
    /// Encoding of the messages: [`ENCODING`].
    pub encoding: &'a str,
    /// ROS type, as `geometry_msgs/msg/Twist`.
    pub schema_name: String,
    /// The type's definition and those of the types that it uses.
    pub schema: String,
    /// Encoding of the schema: [`SCHEMA_ENCODING`].
    pub schema_encoding: &'a str,
}

/// A service that clients may call.
#[derive(Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Service<'a> {
    /// The server's number of the service on this connection.
    pub id: u32,
    /// Service's name in ROS.
    pub name: &'a str,
    /// ROS type, as `std_srvs/srv/Trigger`.
    pub r#type: String,
    /// Type of the requests.
    pub request: ServiceSchema<'a>,
    /// Type of the responses.
    pub response: ServiceSchema<'a>,
}

/// The type of a service's requests or responses.
#[derive(Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct ServiceSchema<'a> {
    /// Encoding of the messages: [`ENCODING`].
    pub encoding: &'a str,
    /// ROS type, as `std_srvs/srv/Trigger_Request`.
    pub schema_name: String,
    /// Encoding of the schema: [`SCHEMA_ENCODING`].
    pub schema_encoding: &'a str,
    /// The type's definition and those of the types that it uses.
    pub schema: String,
}

/// Identifies a call on a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CallId {
    /// The server's number of the service.
    pub service: u32,
    /// The client's number of the call.
    pub call: u32,
}

impl CallId {
    /// Returns the number of the call in ros_tcp: both numbers, that of the service above the other's 32 bits.
    pub fn number(self) -> i64 {
        (u64::from(self.service) << 32 | u64::from(self.call)).cast_signed()
    }

    /// Returns the call of a number in ros_tcp.
    pub fn of_number(number: i64) -> Self {
        let number = number.cast_unsigned();
        Self { service: (number >> 32) as u32, call: number as u32 }
    }
}

/// A binary message from a client.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClientMessage<'a> {
    /// A message on one of the client's topics.
    Publish {
        /// The client's number of the topic.
        channel: u32,
        /// When it was sent, on the bridge's own clock, if the client says so.
        sent: Option<Monotonic>,
        /// The message, CDR with its encapsulation header.
        payload: &'a [u8],
    },
    /// A call of a service.
    Call {
        /// Number of the call.
        id: CallId,
        /// Encoding of the request; the bridge takes [`ENCODING`].
        encoding: &'a [u8],
        /// The request, CDR with its encapsulation header.
        payload: &'a [u8],
    },
}

/// Why a binary message is refused.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum BinaryError {
    /// The message ends before its header does.
    #[error("a binary message of {0} bytes is too short")]
    Short(usize),
    /// The first byte names nothing that the bridge offers.
    #[error(
        "a binary message begins with {0}; the bridge takes 1 (a message on a topic), 2 (a service call) and 128 (a message with \
         its time)"
    )]
    Kind(u8),
}

impl<'a> ClientMessage<'a> {
    /// Reads a binary message.
    pub fn parse(bytes: &'a [u8]) -> Result<Self, BinaryError> {
        let short = || BinaryError::Short(bytes.len());
        let (kind, rest) = bytes.split_first().ok_or_else(short)?;
        match *kind {
            CLIENT_MESSAGE => {
                let (channel, payload) = split_number(rest).ok_or_else(short)?;
                Ok(Self::Publish { channel, sent: None, payload })
            }
            TIMED_CLIENT_MESSAGE => {
                let (channel, rest) = split_number(rest).ok_or_else(short)?;
                let (nanoseconds, payload) = rest.split_first_chunk().ok_or_else(short)?;
                let sent = Some(Monotonic(u64::from_le_bytes(*nanoseconds)));
                Ok(Self::Publish { channel, sent, payload })
            }
            SERVICE_REQUEST => Self::parse_call(rest).ok_or_else(short),
            kind => Err(BinaryError::Kind(kind)),
        }
    }

    fn parse_call(bytes: &'a [u8]) -> Option<Self> {
        let (service, rest) = split_number(bytes)?;
        let (call, rest) = split_number(rest)?;
        let (encoding_bytes, rest) = split_number(rest)?;
        let (encoding, payload) = rest.split_at_checked(encoding_bytes as usize)?;
        Some(Self::Call { id: CallId { service, call }, encoding, payload })
    }
}

fn split_number(bytes: &[u8]) -> Option<(u32, &[u8])> {
    let (number, rest) = bytes.split_first_chunk()?;
    Some((u32::from_le_bytes(*number), rest))
}

/// Returns a ROS type as ROS 2 tools write it: `geometry_msgs/msg/Twist`.
pub fn schema_name(message_type: &str) -> String {
    match message_type.split_once('/') {
        Some((package, name)) => format!("{package}/msg/{name}"),
        None => message_type.to_owned(),
    }
}

/// Returns a service's ROS type as ROS 2 tools write it, `std_srvs/srv/Trigger`, with this at its end.
pub fn service_type_name(service_type: &str, end: &str) -> String {
    match service_type.split_once('/') {
        Some((package, name)) => format!("{package}/srv/{name}{end}"),
        None => format!("{service_type}{end}"),
    }
}

/// Returns a ROS type as the bridge writes it: `geometry_msgs/Twist`.
pub fn message_type(schema_name: &str) -> String {
    schema_name.replacen("/msg/", "/", 1)
}

/// Returns the text of a std_msgs/String in CDR, shortened and without control characters; empty if it is none.
pub fn selfcheck_text(payload: &[u8]) -> String {
    // A header of four bytes, then the length, which counts the NUL at the end.
    let text = payload.get(8..).unwrap_or_default();
    let text = String::from_utf8_lossy(&text[..text.len().min(4 * SELFCHECK_CHARS_MAX)]);
    text.chars().filter(|character| !character.is_control()).take(SELFCHECK_CHARS_MAX).collect()
}

#[cfg(test)]
mod tests;
