//! System commands that register topics and services, and the list of topics.

use super::Core;
use super::absent_robots::TopicUse;
use crate::access::{Action, PermissionError};
use crate::command::{Call, Registration, TopicList, name};
use crate::frame::RosTcpFrame;
use crate::input::InputPurpose;
use crate::router::{ClientId, DEPTH_DEFAULT, ExpectedFrame, Publication, Source, TopicError, TopicId};
use crate::services::ServiceError;
use crate::slam_services::NamedService;
use msg::Monotonic;
use ros_messages::interfaces::{self, Kind, NameError, TypeError};
use ros_messages::{Message, Twist, TwistStamped};
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use thiserror::Error;

/// Commands that carry a [`Registration`].
const REGISTRATIONS: [&str; 8] = [
    name::SUBSCRIBE,
    name::PUBLISH,
    name::ROS_SERVICE,
    name::UNITY_SERVICE,
    name::REMOVE_SUBSCRIBER,
    name::REMOVE_PUBLISHER,
    name::REMOVE_ROS_SERVICE,
    name::REMOVE_UNITY_SERVICE,
];

/// Why a system command is refused.
#[derive(Debug, Error)]
pub enum RegistrationError {
    /// The payload is not the command's JSON.
    #[error("its JSON is not valid: {0}")]
    Json(#[from] serde_json::Error),
    /// There is no such command.
    #[error("unknown command; there are {}", REGISTRATIONS.join(", "))]
    UnknownCommand,
    /// The topic's or service's name is not a ROS name.
    #[error(transparent)]
    Name(#[from] NameError),
    /// The type is not known.
    #[error("{source} (for '{topic}')")]
    Type {
        /// What is wrong with the type.
        source: TypeError,
        /// The topic's or service's name.
        topic: String,
    },
    /// The topic has another type, or there are too many topics.
    #[error(transparent)]
    Topic(#[from] TopicError),
    /// Only the fleet publishes the topic.
    #[error("'{name}' is published by the fleet; choose another name")]
    FleetTopic {
        /// The topic's name.
        name: String,
    },
    /// There is no topic to remove the client from.
    #[error("there is no topic '{name}'")]
    NoSuchTopic {
        /// The topic's name.
        name: String,
    },
    /// The service has another type, or there are too many services.
    #[error(transparent)]
    Service(#[from] ServiceError),
    /// The client uses as many topics of clients, or services, as one client may.
    #[error("'{name}' would be one {kind} too many for one client: the limit is {limit} (limits.{key})")]
    Quota {
        /// The topic's or service's name.
        name: String,
        /// `topic` or `service`.
        kind: &'static str,
        /// The limit of one client.
        limit: usize,
        /// The limit's key in the fleet file.
        key: &'static str,
    },
    /// The client's address has no permission.
    #[error(transparent)]
    Permission(#[from] PermissionError),
}

impl Core {
    /// Handles a frame whose name begins with `__`.
    pub(super) fn receive_system_command(
        &mut self,
        id: ClientId,
        command: &str,
        frame: RosTcpFrame<'_>,
        now: Monotonic,
    ) {
        let result = match command {
            name::TOPIC_LIST => {
                self.send_topic_list(id);
                Ok(())
            }
            name::REQUEST => {
                parse(frame).map(|Call { srv_id }| self.expect(id, ExpectedFrame::Request(srv_id)))
            }
            name::RESPONSE => {
                parse(frame).map(|Call { srv_id }| self.expect(id, ExpectedFrame::Response(srv_id)))
            }
            _ => parse(frame).and_then(|registration| self.register(id, command, &registration, now)),
        };
        self.remove_unused_relays();
        if let Err(error) = result {
            self.router.refuse(id, format!("{command}: {error}"));
        }
    }

    fn expect(&mut self, id: ClientId, expected: ExpectedFrame) {
        if let Some(client) = self.router.client_mut(id) {
            client.expected = Some(expected);
        }
    }

    fn register(
        &mut self,
        id: ClientId,
        command: &str,
        registration: &Registration,
        now: Monotonic,
    ) -> Result<(), RegistrationError> {
        if !REGISTRATIONS.contains(&command) {
            return Err(RegistrationError::UnknownCommand);
        }
        let topic = interfaces::resolve_name(&registration.topic)?;
        match command {
            name::SUBSCRIBE => self.subscribe(id, topic, registration, now)?,
            name::PUBLISH => self.register_publisher(id, topic, registration, now)?,
            name::ROS_SERVICE | name::UNITY_SERVICE => {
                self.register_service(id, command, topic, registration)?
            }
            name::REMOVE_ROS_SERVICE | name::REMOVE_UNITY_SERVICE => self.remove_service(id, command, &topic),
            name::REMOVE_SUBSCRIBER => {
                let topic = self.find_topic(topic)?;
                self.router.unsubscribe(id.slot, topic, Some(is_without_slash(registration)));
            }
            _ => {
                let topic = self.find_topic(topic)?;
                self.router.remove_publisher(id.slot, topic);
            }
        }
        Ok(())
    }

    /// Registers a client as caller or provider of a service.
    fn register_service(
        &mut self,
        id: ClientId,
        command: &str,
        name: String,
        registration: &Registration,
    ) -> Result<(), RegistrationError> {
        let service_type = self.resolve_type(Kind::Service, registration)?;
        self.check_service_quota(id, &name)?;
        if command == name::UNITY_SERVICE {
            self.check_service_is_free(&name)?;
            let living = self.living_clients();
            let is_alive = |owner| living.contains(&owner);
            let result = self.services.register_provider(id, &name, &service_type, is_alive);
            self.update_services();
            result?;
            self.report_unoffered(id, &name);
            return Ok(());
        }
        if let Some((_, NamedService { service_type: existing, .. })) = self.offered.slam.find(&name)
            && existing != service_type
        {
            let existing = existing.to_owned();
            return Err(ServiceError::OtherType { name, existing, requested: service_type }.into());
        }
        self.services.register_caller(id, &name, &service_type)?;
        self.update_services();
        Ok(())
    }

    fn remove_service(&mut self, id: ClientId, command: &str, name: &str) {
        if command == name::REMOVE_ROS_SERVICE {
            self.services.remove_caller(id, name);
        } else {
            for call in self.services.remove_provider(id, name) {
                self.fail_call(&call, "the client no longer offers it");
            }
        }
        self.update_services();
    }

    /// Refuses a topic that would be one too many for one client. The fleet's own topics do not count.
    fn check_topic_quota(&self, id: ClientId, name: &str) -> Result<(), RegistrationError> {
        let (limit, key) = (self.config.limits.topics_per_client, "topics_per_client");
        let Some(client) = self.router.client(id) else { return Ok(()) };
        let is_clients = |topic: &TopicId| {
            self.router.topics.get(*topic).is_some_and(|topic| topic.source == Source::Clients)
        };
        let is_used = |topic: TopicId| client.subscriptions.contains(&topic) || client.publishes(topic);
        let known = self.router.topics.find(name);
        if known.is_some_and(|topic| !is_clients(&topic) || is_used(topic)) {
            return Ok(());
        }
        let published = client.publications.iter().map(|publication| publication.topic);
        let only_published = published.filter(|topic| !client.subscriptions.contains(topic));
        let count = client.subscriptions.iter().copied().chain(only_published).filter(is_clients).count();
        if count < limit {
            return Ok(());
        }
        Err(RegistrationError::Quota { name: name.to_owned(), kind: "topic", limit, key })
    }

    /// Refuses a service that would be one too many for one client.
    fn check_service_quota(&self, id: ClientId, name: &str) -> Result<(), RegistrationError> {
        let (limit, key) = (self.config.limits.services_per_client, "services_per_client");
        if self.services.count_others(id, name) < limit {
            return Ok(());
        }
        Err(RegistrationError::Quota { name: name.to_owned(), kind: "service", limit, key })
    }

    /// Returns a type that is known here, or that the topic has in ROS.
    fn resolve_type(&self, kind: Kind, registration: &Registration) -> Result<String, RegistrationError> {
        let Registration { topic, message_name, .. } = registration;
        let is_in_ros = |message_name: &str| {
            let (Ok(name), graph) = (interfaces::resolve_name(topic), self.relay.graph()) else {
                return false;
            };
            match kind {
                Kind::Message => {
                    graph.topics.get(&name).is_some_and(|of| of.types().any(|it| it == message_name))
                }
                Kind::Service => {
                    graph.services.get(&name).is_some_and(|of| of.iter().any(|it| it == message_name))
                }
            }
        };
        match interfaces::resolve(kind, message_name, &self.config.message_packages) {
            Err(_) if is_in_ros(message_name) => Ok(message_name.clone()),
            result => {
                result.map_err(|source| RegistrationError::Type { source, topic: registration.topic.clone() })
            }
        }
    }

    fn find_topic(&self, name: String) -> Result<TopicId, RegistrationError> {
        self.router.topics.find(&name).ok_or(RegistrationError::NoSuchTopic { name })
    }

    fn subscribe(
        &mut self,
        id: ClientId,
        name: String,
        registration: &Registration,
        now: Monotonic,
    ) -> Result<(), RegistrationError> {
        let message_type = self.resolve_type(Kind::Message, registration)?;
        if let Some(client) = self.router.client(id) {
            self.access.check(Action::Watch, client.peer.ip())?;
        }
        self.check_topic_quota(id, &name)?;
        let topic = self.router.topics.find_or_add(name, &message_type)?;
        if self.router.subscribe(id, topic, is_without_slash(registration)) {
            self.fleet.subscribed(&mut self.router, topic);
            self.stop_new_listener(topic);
            self.relay_subscription(id, topic, now);
            self.warn_of_absent_robot(id, topic, TopicUse::Subscribe, now);
        }
        Ok(())
    }

    /// Sends zeros to a robot of an external world that begins to listen, unless somebody drives it.
    fn stop_new_listener(&mut self, topic: TopicId) {
        let selected = self.gate.drive().selected();
        if self.world.is_some()
            && let Some(robot) = self.fleet.robot_of_velocity_topic(topic, selected)
        {
            self.gate.repeat_stop(robot);
            self.send_velocities();
        }
    }

    fn register_publisher(
        &mut self,
        id: ClientId,
        name: String,
        registration: &Registration,
        now: Monotonic,
    ) -> Result<(), RegistrationError> {
        let message_type = self.resolve_type(Kind::Message, registration)?;
        let stamped = message_type == TwistStamped::TYPE && self.accepts_stamped(&name);
        self.check_topic_quota(id, &name)?;
        let topic =
            self.router.topics.find_or_add(name, if stamped { Twist::TYPE } else { &message_type })?;
        let Some(entry) = self.router.topics.get(topic) else { return Ok(()) };
        if entry.source == Source::Fleet {
            return Err(RegistrationError::FleetTopic { name: entry.name.clone() });
        }
        let Registration { topic: spelled, queue_size, .. } = registration;
        if *queue_size < 0 {
            let text =
                format!("__publish: '{spelled}': queue_size is {queue_size}, taken as {DEPTH_DEFAULT}");
            self.router.send_notice(id, name::WARN, text);
        }
        let publication = Publication { topic, stamped, latch: registration.latch };
        self.router.add_publisher(id, publication, *queue_size);
        self.warn_of_absent_robot(id, topic, TopicUse::Publish, now);
        self.relay_publication(id, topic);
        Ok(())
    }

    /// Returns whether clients may publish TwistStamped on this topic, as ROS 2 drivers do from Jazzy on.
    fn accepts_stamped(&self, name: &str) -> bool {
        let topic = self.router.topics.find(name).and_then(|id| self.router.topics.get(id));
        topic.is_some_and(|topic| {
            matches!(topic.source, Source::Input(InputPurpose::Command(_) | InputPurpose::SelectedCommand))
        })
    }

    /// Sends the list of topics: those of the bridge, and those of ROS nodes.
    fn send_topic_list(&mut self, id: ClientId) {
        let ours = self.router.topics.sorted().map(|topic| (topic.name.clone(), topic.message_type.clone()));
        let mut all: BTreeMap<String, String> = ours.collect();
        for (name, topic) in &self.relay.graph().topics {
            if let Some(message_type) = topic.types().next() {
                all.entry(name.clone()).or_insert_with(|| message_type.to_owned());
            }
        }
        let (topics, types) = all.into_iter().unzip();
        self.router.send_command(id, name::TOPIC_LIST, &TopicList { topics, types });
    }
}

/// Unity projects often leave out the leading slash, and then know the topic only without it.
fn is_without_slash(registration: &Registration) -> bool {
    !registration.topic.starts_with('/')
}

fn parse<T: DeserializeOwned>(frame: RosTcpFrame<'_>) -> Result<T, RegistrationError> {
    Ok(serde_json::from_slice(frame.json())?)
}
