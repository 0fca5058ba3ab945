//! What one browser has subscribed to and publishes: commands of the Foxglove protocol become ros_tcp frames.

use super::encoder::Encoder;
use super::protocol::{
    BinaryError, Channel, ClientChannel, ClientCommand, ClientMessage, ENCODING, FLEET_PARAMETER, Parameter,
    ParameterValue, SCHEMA_ENCODING, ServerCommand, StatusLevel, Subscription, TIME_PARAMETER, message_type,
    schema_name,
};
use crate::bridge::FleetStatus;
use crate::command::{Registration, name};
use ros_messages::schema::schema;
use std::collections::BTreeMap;
use std::io;
use thiserror::Error;

/// Topics that one browser may publish.
const PUBLICATIONS_MAX: usize = 256;
/// Longest name of a request for parameters, bytes: the answer repeats it.
const REQUEST_NAME_MAX: usize = 64;

/// A topic of the bridge: name and type, `package/Type`.
pub type TopicName = (String, String);

/// Why a command of a client is refused.
#[derive(Debug, Error)]
pub enum SessionError {
    /// The text is no command.
    #[error("the message is not a command of the protocol: {0}")]
    Json(#[from] serde_json::Error),
    /// The binary message cannot be read.
    #[error(transparent)]
    Binary(#[from] BinaryError),
    /// The bridge does not offer this.
    #[error("the bridge offers subscriptions, publications and reading of parameters only")]
    NotOffered,
    /// There is no such topic on this connection.
    #[error("there is no channel {0}")]
    NoSuchChannel(u64),
    /// The client has this subscription, or another one of this number.
    #[error("subscription {id}: '{topic}' or this number is subscribed already")]
    Subscribed {
        /// The client's number.
        id: u32,
        /// Name of the topic.
        topic: String,
    },
    /// There is no such subscription.
    #[error("there is no subscription {0}")]
    NoSuchSubscription(u32),
    /// The client encodes its messages otherwise.
    #[error("'{topic}' is in '{encoding}'; the bridge takes '{ENCODING}'")]
    Encoding {
        /// Name of the topic.
        topic: String,
        /// The encoding that the client announced.
        encoding: String,
    },
    /// The name of a request for parameters is too long.
    #[error("a request for parameters has a name of {0} bytes; at most {REQUEST_NAME_MAX} are allowed")]
    RequestName(usize),
    /// The client publishes as many topics as it may.
    #[error("a client publishes at most {PUBLICATIONS_MAX} topics")]
    TooManyPublications,
}

/// A frame for the bridge, as a client on TCP would send it.
#[derive(Debug, PartialEq, Eq)]
pub struct OwnedFrame {
    /// A command's name.
    pub name: &'static str,
    /// The command's JSON.
    pub payload: Vec<u8>,
}

/// A client's request for the values of parameters.
#[derive(Debug, PartialEq, Eq)]
struct ParameterRequest {
    names: Vec<String>,
    id: Option<String>,
}

/// The state of one connection.
#[derive(Debug, Default)]
pub struct Session {
    /// All topics at the last update, sorted by name.
    topics: Vec<TopicName>,
    /// Topics that the client knows of, by their numbers on this connection.
    channels: BTreeMap<u64, TopicName>,
    next_channel: u64,
    /// Topics that the client publishes, by its numbers.
    publications: BTreeMap<u32, TopicName>,
    /// Whether the client wants to know the state of the fleet.
    wants_status: bool,
    /// The state that the client knows.
    known_status: Option<FleetStatus>,
    /// The request for parameters that [`Session::answer_request`] answers.
    request: Option<ParameterRequest>,
}

impl Session {
    /// Tells the client which topics have come and gone since the last call.
    pub fn update_channels(&mut self, topics: &[TopicName], encoder: &mut Encoder) -> io::Result<()> {
        if self.topics == topics {
            return Ok(());
        }
        self.topics = topics.to_vec();
        let is_gone = |topic: &TopicName| !topics.contains(topic);
        let gone: Vec<u64> =
            self.channels.iter().filter(|(_, topic)| is_gone(topic)).map(|(id, _)| *id).collect();
        if !gone.is_empty() {
            self.channels.retain(|id, _| !gone.contains(id));
            encoder.send(&ServerCommand::Unadvertise { channel_ids: gone })?;
        }
        let mut channels = Vec::new();
        for topic in topics {
            if self.channels.values().any(|known| known == topic) {
                continue;
            }
            let Some(schema) = schema(&topic.1) else { continue };
            self.next_channel += 1;
            self.channels.insert(self.next_channel, topic.clone());
            channels.push(Channel {
                id: self.next_channel,
                topic: &topic.0,
                encoding: ENCODING,
                schema_name: schema_name(&topic.1),
                schema,
                schema_encoding: SCHEMA_ENCODING,
            });
        }
        if channels.is_empty() { Ok(()) } else { encoder.send(&ServerCommand::Advertise { channels }) }
    }

    /// Tells the client of the fleet's state if it wants to know and does not yet.
    pub fn update_status(
        &mut self,
        status: impl FnOnce() -> FleetStatus,
        encoder: &mut Encoder,
    ) -> io::Result<()> {
        if !self.wants_status {
            return Ok(());
        }
        let status = status();
        if self.known_status.as_ref() == Some(&status) {
            return Ok(());
        }
        let parameters = [Parameter { name: FLEET_PARAMETER, value: ParameterValue::Fleet(&status) }];
        encoder.send(&ServerCommand::ParameterValues { parameters: &parameters, id: None })?;
        self.known_status = Some(status);
        Ok(())
    }

    /// Answers the client's last message if it asks for parameters. Names of other parameters are left out of the answer.
    pub fn answer_request(
        &mut self,
        status: impl FnOnce() -> FleetStatus,
        run_time_s: f64,
        encoder: &mut Encoder,
    ) -> io::Result<()> {
        let Some(ParameterRequest { names, id }) = self.request.take() else { return Ok(()) };
        let is_wanted = |name: &str| names.is_empty() || names.iter().any(|wanted| wanted == name);
        let status = is_wanted(FLEET_PARAMETER).then(status);
        let fleet = status.as_ref().map(|status| (FLEET_PARAMETER, ParameterValue::Fleet(status)));
        let time = is_wanted(TIME_PARAMETER).then_some((TIME_PARAMETER, ParameterValue::Time(run_time_s)));
        let values = fleet.into_iter().chain(time).map(|(name, value)| Parameter { name, value });
        let parameters: Vec<Parameter<'_>> = values.collect();
        encoder.send(&ServerCommand::ParameterValues { parameters: &parameters, id: id.as_deref() })
    }

    /// Handles a text message; returns the frames for the bridge. What is refused, the client is told.
    pub fn receive_text(&mut self, text: &str, encoder: &mut Encoder) -> io::Result<Vec<OwnedFrame>> {
        let mut frames = Vec::new();
        let results: Vec<Result<OwnedFrame, SessionError>> = match serde_json::from_str(text) {
            Err(error) => vec![Err(error.into())],
            Ok(ClientCommand::SubscribeParameterUpdates) => {
                (self.wants_status, self.known_status) = (true, None);
                Vec::new()
            }
            Ok(ClientCommand::UnsubscribeParameterUpdates) => {
                self.wants_status = false;
                Vec::new()
            }
            Ok(ClientCommand::GetParameters { parameter_names: names, id }) => {
                match id.as_ref().map_or(0, String::len) {
                    0..=REQUEST_NAME_MAX => {
                        self.request = Some(ParameterRequest { names, id });
                        Vec::new()
                    }
                    bytes => vec![Err(SessionError::RequestName(bytes))],
                }
            }
            Ok(ClientCommand::Other) => vec![Err(SessionError::NotOffered)],
            Ok(ClientCommand::Subscribe { subscriptions }) => {
                subscriptions.into_iter().map(|wanted| self.subscribe(wanted, encoder)).collect()
            }
            Ok(ClientCommand::Unsubscribe { subscription_ids }) => {
                subscription_ids.into_iter().map(|id| unsubscribe(id, encoder)).collect()
            }
            Ok(ClientCommand::Advertise { channels }) => {
                channels.into_iter().map(|channel| self.advertise(channel)).collect()
            }
            Ok(ClientCommand::Unadvertise { channel_ids }) => {
                channel_ids.into_iter().map(|id| self.unadvertise(id)).collect()
            }
        };
        for result in results {
            match result {
                Ok(frame) => frames.push(frame),
                Err(error) => refuse(&error, encoder)?,
            }
        }
        Ok(frames)
    }

    /// Reads a binary message; returns the topic and the payload. What is refused, the client is told.
    pub fn receive_binary<'a>(
        &'a self,
        bytes: &'a [u8],
        encoder: &mut Encoder,
    ) -> io::Result<Option<(&'a str, &'a [u8])>> {
        let found = ClientMessage::parse(bytes).map_err(SessionError::from).and_then(|message| {
            let topic = self.publications.get(&message.channel);
            let topic = topic.ok_or(SessionError::NoSuchChannel(message.channel.into()))?;
            Ok((topic.0.as_str(), message.payload))
        });
        match found {
            Ok(found) => Ok(Some(found)),
            Err(error) => refuse(&error, encoder).map(|()| None),
        }
    }

    fn subscribe(&self, wanted: Subscription, encoder: &mut Encoder) -> Result<OwnedFrame, SessionError> {
        let Subscription { id, channel_id } = wanted;
        let topic = self.channels.get(&channel_id).ok_or(SessionError::NoSuchChannel(channel_id))?;
        if encoder.is_taken(&topic.0, id) {
            return Err(SessionError::Subscribed { id, topic: topic.0.clone() });
        }
        encoder.subscribe(&topic.0, &topic.1, id);
        Ok(registration(name::SUBSCRIBE, &topic.0, &topic.1))
    }

    fn advertise(&mut self, channel: ClientChannel) -> Result<OwnedFrame, SessionError> {
        let ClientChannel { id, topic, encoding, schema_name } = channel;
        if encoding != ENCODING {
            return Err(SessionError::Encoding { topic, encoding });
        }
        if self.publications.len() >= PUBLICATIONS_MAX && !self.publications.contains_key(&id) {
            return Err(SessionError::TooManyPublications);
        }
        let message_type = message_type(&schema_name);
        let frame = registration(name::PUBLISH, &topic, &message_type);
        self.publications.insert(id, (topic, message_type));
        Ok(frame)
    }

    fn unadvertise(&mut self, id: u32) -> Result<OwnedFrame, SessionError> {
        let (topic, _) = self.publications.remove(&id).ok_or(SessionError::NoSuchChannel(id.into()))?;
        Ok(registration(name::REMOVE_PUBLISHER, &topic, ""))
    }
}

fn unsubscribe(id: u32, encoder: &mut Encoder) -> Result<OwnedFrame, SessionError> {
    let topic = encoder.unsubscribe(id).ok_or(SessionError::NoSuchSubscription(id))?;
    Ok(registration(name::REMOVE_SUBSCRIBER, &topic, ""))
}

fn refuse(error: &SessionError, encoder: &mut Encoder) -> io::Result<()> {
    encoder.send(&ServerCommand::Status { level: StatusLevel::Error, message: &error.to_string() })
}

fn registration(name: &'static str, topic: &str, message_name: &str) -> OwnedFrame {
    let (topic, message_name) = (topic.to_owned(), message_name.to_owned());
    let body = Registration { topic, message_name, ..Registration::default() };
    // A struct of strings and numbers serializes without errors.
    OwnedFrame { name, payload: serde_json::to_vec(&body).unwrap_or_default() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn topics() -> Vec<TopicName> {
        let topic = |name: &str, of: &str| (name.to_owned(), of.to_owned());
        vec![topic("/robot1/scan", "sensor_msgs/LaserScan"), topic("/chat", "own_msgs/Chat")]
    }

    #[test]
    fn topics_of_known_types_are_offered_once() {
        let (mut session, mut encoder) = (Session::default(), Encoder::new(Vec::new()));
        session.update_channels(&topics(), &mut encoder).unwrap();
        assert_eq!(session.channels.keys().collect::<Vec<_>>(), [&1], "the schema of /chat is not known");
        assert!(encoder.has_waiting());
        let mut encoder = Encoder::new(Vec::new());
        session.update_channels(&topics(), &mut encoder).unwrap();
        assert!(!encoder.has_waiting(), "nothing has changed");
        session.update_channels(&[], &mut encoder).unwrap();
        assert!(encoder.has_waiting() && session.channels.is_empty());
    }

    #[test]
    fn commands_become_registrations() {
        let (mut session, mut encoder) = (Session::default(), Encoder::new(Vec::new()));
        session.update_channels(&topics(), &mut encoder).unwrap();
        let mut send = |text: &str| session.receive_text(text, &mut encoder).unwrap();
        let subscribe = r#"{"op":"subscribe","subscriptions":[{"id":5,"channelId":1}]}"#;
        let expected = registration(name::SUBSCRIBE, "/robot1/scan", "sensor_msgs/LaserScan");
        assert_eq!(send(subscribe), [expected]);
        assert_eq!(send(subscribe), [], "it is subscribed");
        let unsubscribe = r#"{"op":"unsubscribe","subscriptionIds":[5,6]}"#;
        assert_eq!(send(unsubscribe), [registration(name::REMOVE_SUBSCRIBER, "/robot1/scan", "")]);
        let advertise = r#"{"op":"advertise","channels":[
            {"id":1,"topic":"/cmd_vel_1","encoding":"cdr","schemaName":"geometry_msgs/msg/Twist"},
            {"id":2,"topic":"/cmd_vel_2","encoding":"json","schemaName":"geometry_msgs/msg/Twist"}]}"#;
        assert_eq!(send(advertise), [registration(name::PUBLISH, "/cmd_vel_1", "geometry_msgs/Twist")]);
        let read = session.receive_binary(&[1, 1, 0, 0, 0, 9], &mut encoder).unwrap();
        assert_eq!(read, Some(("/cmd_vel_1", &[9_u8][..])));
        assert_eq!(session.receive_binary(&[1, 2, 0, 0, 0, 9], &mut encoder).unwrap(), None);
    }

    proptest! {
        #[test]
        fn any_text_is_a_command_or_refused(text in "\\PC{0,80}", depth in 0..2000_usize) {
            let (mut session, mut encoder) = (Session::default(), Encoder::new(Vec::new()));
            session.receive_text(&text, &mut encoder).unwrap();
            session.receive_text(&"[".repeat(depth), &mut encoder).unwrap();
        }
    }
}
