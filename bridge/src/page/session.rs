//! What one browser has subscribed to and publishes: commands of the Foxglove protocol become ros_tcp frames.

mod services;

use super::encoder::Encoder;
use super::protocol::{
    BinaryError, CLOCK_PARAMETER, Channel, ClientChannel, ClientCommand, ClientMessage, ENCODING,
    FLEET_PARAMETER, Parameter, ParameterValue, SCHEMA_ENCODING, ServerCommand, StatusLevel, Subscription,
    TIME_PARAMETER, message_type, schema_name,
};
use crate::bridge::FleetStatus;
use crate::command::{Registration, name};
use msg::Monotonic;
use ros_messages::schema::schema;
use services::ServiceTable;
use std::collections::BTreeMap;
use std::io;
use std::time::Duration;
use thiserror::Error;

/// Topics that one browser may publish.
const PUBLICATIONS_MAX: usize = 256;
/// A command that says when it was sent is refused after so long: what it should begin is no longer wanted.
const LATE: Duration = Duration::from_secs(1);
/// A client is told of late commands once in this time: a driver sends 20 velocities a second.
const LATE_NOTICE_PERIOD: Duration = Duration::from_secs(1);
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
    #[error("the bridge offers subscriptions, publications, services and reading of parameters only")]
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
    /// The message was on its way for too long.
    #[error("'{topic}' came {age_s:.1} s late and was not carried out: send it again")]
    Late {
        /// Name of the topic.
        topic: String,
        /// Time since the client sent it, seconds.
        age_s: f64,
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

/// What a binary message is for.
#[derive(Debug, PartialEq, Eq)]
pub enum ClientData<'a> {
    /// A message on a topic of the client.
    Message {
        /// The topic's name.
        topic: &'a str,
        /// Message in its encoding.
        payload: &'a [u8],
    },
    /// A call of a service.
    Call {
        /// Commands that come before the request.
        commands: Vec<OwnedFrame>,
        /// The service's name.
        service: &'a str,
        /// Request in its encoding.
        payload: &'a [u8],
    },
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
    services: ServiceTable,
    /// Topics that the client publishes, by its numbers.
    publications: BTreeMap<u32, TopicName>,
    /// Whether the client wants to know the state of the fleet.
    wants_status: bool,
    /// The state that the client knows.
    known_status: Option<FleetStatus>,
    /// The request for parameters that [`Session::answer_request`] answers.
    request: Option<ParameterRequest>,
    /// When the client may be told of a late command again.
    late_notice_due: Option<Monotonic>,
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

    /// Tells the client which services have come and gone since the last call.
    pub fn update_services(
        &mut self,
        services: &[(String, String)],
        encoder: &mut Encoder,
    ) -> io::Result<()> {
        self.services.update(services, encoder)
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
        now: Monotonic,
        encoder: &mut Encoder,
    ) -> io::Result<()> {
        let Some(ParameterRequest { names, id }) = self.request.take() else { return Ok(()) };
        let is_wanted = |name: &str| names.is_empty() || names.iter().any(|wanted| wanted == name);
        let status = is_wanted(FLEET_PARAMETER).then(status);
        let fleet = status.as_ref().map(|status| (FLEET_PARAMETER, ParameterValue::Fleet(status)));
        let time = is_wanted(TIME_PARAMETER).then_some((TIME_PARAMETER, ParameterValue::Time(run_time_s)));
        let clock_s = now.0 as f64 * 1e-9;
        let clock = is_wanted(CLOCK_PARAMETER).then_some((CLOCK_PARAMETER, ParameterValue::Time(clock_s)));
        let values =
            fleet.into_iter().chain(time).chain(clock).map(|(name, value)| Parameter { name, value });
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

    /// Reads a binary message. What is refused, the client is told; of late commands, once a second.
    pub fn receive_binary<'a>(
        &'a mut self,
        bytes: &'a [u8],
        now: Monotonic,
        encoder: &mut Encoder,
    ) -> io::Result<Option<ClientData<'a>>> {
        match ClientMessage::parse(bytes) {
            Err(error) => refuse(&error.into(), encoder).map(|()| None),
            Ok(ClientMessage::Call { id, encoding, payload }) => match self.services.begin_call(id, encoding)
            {
                Ok((service, commands)) => Ok(Some(ClientData::Call { commands, service, payload })),
                Err(error) => encoder.send_call_failure(id, &error.to_string()).map(|()| None),
            },
            Ok(ClientMessage::Publish { channel, sent, payload }) => {
                let Some((topic, _)) = self.publications.get(&channel) else {
                    return refuse(&SessionError::NoSuchChannel(channel.into()), encoder).map(|()| None);
                };
                let age = sent.map_or(Duration::ZERO, |sent| Duration::from_nanos(now.since(sent)));
                if age <= LATE {
                    return Ok(Some(ClientData::Message { topic, payload }));
                }
                if self.late_notice_due.is_none_or(|due| now >= due) {
                    self.late_notice_due = Some(now + LATE_NOTICE_PERIOD);
                    refuse(&SessionError::Late { topic: topic.clone(), age_s: age.as_secs_f64() }, encoder)?;
                }
                Ok(None)
            }
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
        // A client may publish on a topic by several channels.
        let other = self.publications.values().find(|(other, _)| *other == topic);
        Ok(match other {
            Some((topic, message_type)) => registration(name::PUBLISH, topic, message_type),
            None => registration(name::REMOVE_PUBLISHER, &topic, ""),
        })
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
mod tests;
