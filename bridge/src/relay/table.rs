//! The topics and services that are exchanged with ROS now, and the commands to the endpoint that wait.

use super::{RosCommand, RosGraph, RosRequestId, ServiceExchange};
use crate::router::{ClientId, Topic, TopicId};
use msg::Monotonic;
use ros_messages::interfaces;
use ros_messages::{Message, encode};
use ros2_client::dds::rustdds::bytes::Bytes;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;
use thiserror::Error;

/// A subscription gets this time until its client is told that nobody publishes the topic: discovery on DDS takes up
/// to two seconds, and clients register one after the other.
const PUBLISHER_GRACE: Duration = Duration::from_secs(3);
/// Subscriptions of all clients that wait for a publisher's first sign; clients of further ones are not told.
const UNPUBLISHED_MAX: usize = 4096;

/// Too many topics are exchanged with ROS.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error(
    "'{name}' is not exchanged with ROS 2: {limit} topics are, the limit (bridge.dds.relayed_topics_max)"
)]
pub struct TooManyTopics {
    name: String,
    limit: usize,
}

/// A subscription to a topic without a known publisher.
#[derive(Clone, Debug)]
pub struct Unpublished {
    /// The client that has subscribed.
    pub client: ClientId,
    /// The topic's name.
    pub topic: String,
    due: Monotonic,
}

/// One topic that is exchanged with ROS.
#[derive(Debug)]
struct RelayedTopic {
    name: Arc<str>,
    is_subscribed: bool,
    /// Whether the topic is announced, and as latched.
    advertised: Option<bool>,
    /// Whether the clients were told that ROS has another type, or another encoding.
    is_mismatch_reported: bool,
}

/// The topics that are exchanged with ROS.
#[derive(Debug)]
pub struct RelayTable {
    /// Whether there is a ROS 2 endpoint.
    is_open: bool,
    topics: BTreeMap<TopicId, RelayedTopic>,
    topics_max: usize,
    graph: RosGraph,
    /// Commands that the caller of the bridge has not taken yet: those of one event.
    commands: VecDeque<RosCommand>,
    unpublished: VecDeque<Unpublished>,
    /// Topics and services that every client may exchange with ROS, with leading slash.
    open_names: Vec<String>,
    services: ServiceExchange,
}

impl RelayTable {
    /// Creates an empty table for at most `topics_max` topics and `services_max` services of clients. Nothing is
    /// exchanged until it is opened.
    ///
    /// Every client may publish, offer or call the names in `open_names` in ROS.
    pub fn new(topics_max: usize, services_max: usize, open_names: &[String]) -> Self {
        Self {
            is_open: false,
            topics: BTreeMap::new(),
            topics_max,
            graph: RosGraph::default(),
            commands: VecDeque::new(),
            unpublished: VecDeque::new(),
            open_names: open_names.iter().filter_map(|name| interfaces::resolve_name(name).ok()).collect(),
            services: ServiceExchange::new(services_max),
        }
    }

    /// Begins the exchange: from now on commands are queued.
    pub fn open(&mut self) {
        self.is_open = true;
    }

    /// Returns whether there is a ROS 2 endpoint.
    pub fn has_endpoint(&self) -> bool {
        self.is_open
    }

    /// Returns the topics of ROS nodes.
    pub fn graph(&self) -> &RosGraph {
        &self.graph
    }

    /// Replaces the topics of ROS nodes.
    pub fn set_graph(&mut self, graph: RosGraph) {
        self.graph = graph;
    }

    /// Publishes the newest state of a topic of the fleet that the core alone knows, in ROS 2's encoding.
    pub fn publish_state(&mut self, name: &str, message: &impl Message) {
        if self.is_open {
            let mut payload = Vec::new();
            encode(message, &mut payload);
            self.commands.push_back(RosCommand::Publish { topic: name.into(), payload: payload.into() });
        }
    }

    /// Returns whether a command for the endpoint waits.
    pub fn has_command(&self) -> bool {
        !self.commands.is_empty()
    }

    /// Takes the oldest command for the endpoint.
    pub fn next_command(&mut self) -> Option<RosCommand> {
        self.commands.pop_front()
    }

    /// Returns whether every client may exchange a topic or service with ROS.
    pub fn is_public_name(&self, name: &str) -> bool {
        self.open_names.iter().any(|open| open == name)
    }

    /// Returns the services that are exchanged.
    pub fn services(&self) -> &ServiceExchange {
        &self.services
    }

    /// Replaces the services of clients that shall be called in ROS and offered to it.
    pub fn update_services(&mut self, called: BTreeMap<&str, &str>, offered: BTreeMap<&str, &str>) {
        self.services.update(called, offered, &mut self.commands);
    }

    /// Offers a service of the fleet to ROS.
    pub fn offer_fleet_service(&mut self, name: &str, service_type: &str) {
        let service_type = service_type.to_owned();
        self.commands.push_back(RosCommand::OpenServer { service: name.into(), service_type });
    }

    /// Offers a service of the fleet to ROS no longer.
    pub fn withdraw_fleet_service(&mut self, name: &str) {
        self.commands.push_back(RosCommand::CloseServer { service: name.into() });
    }

    /// Ends the announcement of a topic that the core alone publishes.
    pub fn unadvertise_fleet_topic(&mut self, name: &str) {
        self.commands.push_back(RosCommand::Unadvertise { topic: name.into() });
    }

    /// Announces a topic to ROS that the core alone publishes.
    pub fn advertise_fleet_topic(&mut self, name: &str, message_type: String, latch: bool) {
        self.commands.push_back(RosCommand::Advertise { topic: name.into(), message_type, latch });
    }

    /// Publishes a message on a topic that the core alone publishes, in ROS 2's encoding.
    pub fn publish_fleet_topic(&mut self, name: &str, payload: Vec<u8>) {
        if self.is_open {
            self.commands.push_back(RosCommand::Publish { topic: name.into(), payload: payload.into() });
        }
    }

    /// Calls a service of a ROS node.
    pub fn call_service(&mut self, name: &str, number: i64, payload: &[u8]) {
        let payload = Bytes::copy_from_slice(payload);
        self.commands.push_back(RosCommand::Call { service: name.into(), number, payload });
    }

    /// Withdraws a call of a ROS node's service, if it has not been sent.
    pub fn cancel_call(&mut self, name: &str, number: i64) {
        self.commands.push_back(RosCommand::Cancel { service: name.into(), number });
    }

    /// Answers a ROS node's request.
    pub fn respond(&mut self, name: &str, request: RosRequestId, payload: &[u8]) {
        let payload = Bytes::copy_from_slice(payload);
        self.commands.push_back(RosCommand::Respond { service: name.into(), request, payload });
    }

    fn find_or_add(&mut self, id: TopicId, topic: &Topic) -> Result<&mut RelayedTopic, TooManyTopics> {
        if !self.topics.contains_key(&id) && self.topics.len() >= self.topics_max {
            return Err(TooManyTopics { name: topic.name.clone(), limit: self.topics_max });
        }
        Ok(self.topics.entry(id).or_insert_with(|| RelayedTopic {
            name: topic.name.as_str().into(),
            is_subscribed: false,
            advertised: None,
            is_mismatch_reported: false,
        }))
    }

    /// Receives a topic from ROS, if it is not received yet.
    pub fn subscribe(&mut self, id: TopicId, topic: &Topic) -> Result<(), TooManyTopics> {
        if !self.is_open {
            return Ok(());
        }
        let relayed = self.find_or_add(id, topic)?;
        if !std::mem::replace(&mut relayed.is_subscribed, true) {
            let (topic, message_type) = (relayed.name.clone(), topic.message_type.clone());
            self.commands.push_back(RosCommand::Subscribe { topic, message_type });
        }
        Ok(())
    }

    /// Announces a topic to ROS, if it is not announced so yet.
    pub fn advertise(&mut self, id: TopicId, topic: &Topic) -> Result<(), TooManyTopics> {
        if !self.is_open {
            return Ok(());
        }
        let latch = topic.retention.latch;
        let relayed = self.find_or_add(id, topic)?;
        if relayed.advertised != Some(latch) {
            relayed.advertised = Some(latch);
            let (topic, message_type) = (relayed.name.clone(), topic.message_type.clone());
            self.commands.push_back(RosCommand::Advertise { topic, message_type, latch });
        }
        Ok(())
    }

    /// Publishes a message in ROS, if the topic is announced there.
    pub fn publish(&mut self, id: TopicId, payload: &[u8]) {
        if let Some(relayed) = self.topics.get(&id).filter(|relayed| relayed.advertised.is_some()) {
            let (topic, payload) = (relayed.name.clone(), Bytes::copy_from_slice(payload));
            self.commands.push_back(RosCommand::Publish { topic, payload });
        }
    }

    /// Ends the exchange of topics that no client uses any more. `find` returns a topic that still exists.
    pub fn remove_unused<'a>(&mut self, find: impl Fn(TopicId) -> Option<&'a Topic>) {
        let commands = &mut self.commands;
        self.topics.retain(|id, relayed| {
            let topic = find(*id).filter(|topic| *topic.name == *relayed.name);
            if relayed.is_subscribed && topic.is_none_or(|topic| topic.subscribers.is_empty()) {
                relayed.is_subscribed = false;
                commands.push_back(RosCommand::Unsubscribe { topic: relayed.name.clone() });
            }
            if relayed.advertised.is_some() && topic.is_none_or(|topic| topic.publishers.is_empty()) {
                relayed.advertised = None;
                commands.push_back(RosCommand::Unadvertise { topic: relayed.name.clone() });
            }
            relayed.is_subscribed || relayed.advertised.is_some()
        });
    }

    /// Returns the topics that are exchanged.
    pub fn topics(&self) -> impl Iterator<Item = TopicId> + '_ {
        self.topics.keys().copied()
    }

    /// Returns whether the clients of a topic must still be told of a mismatch, and records that they are.
    pub fn should_report_mismatch(&mut self, id: TopicId) -> bool {
        self.topics
            .get_mut(&id)
            .is_some_and(|relayed| !std::mem::replace(&mut relayed.is_mismatch_reported, true))
    }

    /// Begins to wait for a publisher of a client's subscription.
    pub fn expect_publisher(&mut self, client: ClientId, topic: String, now: Monotonic) {
        if self.unpublished.len() < UNPUBLISHED_MAX {
            self.unpublished.push_back(Unpublished { client, topic, due: now + PUBLISHER_GRACE });
        }
    }

    /// Removes and returns a subscription that has waited long enough.
    pub fn next_unpublished(&mut self, now: Monotonic) -> Option<Unpublished> {
        let is_due = self.unpublished.front().is_some_and(|waiting| now >= waiting.due);
        is_due.then(|| self.unpublished.pop_front())?
    }
}
