//! Creates the DDS entities of the endpoint: topics with ROS names, readers and writers.

use super::inputs::InputTopic;
use super::raw::{CdrPassthrough, SerializedMessage};
use super::service_endpoint::ServiceTopicName;
use super::topic_writer::TopicWriter;
use crate::config::DdsConfig;
use ros2_client::dds::rustdds::dds::CreateError;
use ros2_client::dds::rustdds::no_key::{DataWriter, SimpleDataReader};
use ros2_client::dds::rustdds::policy::{Durability, History};
use ros2_client::dds::rustdds::{
    DomainParticipant, DomainParticipantBuilder, Duration, Publisher, QosPolicies, QosPolicyBuilder,
    Subscriber, Topic, TopicKind,
};
use ros2_client::{Name, NodeName};
use std::net::Ipv4Addr;
use std::rc::Rc;
use thiserror::Error;

/// Messages that an input topic keeps until they are taken.
const INPUT_DEPTH: i32 = 10;

/// A reader of undecoded messages.
pub type RawReader = SimpleDataReader<SerializedMessage, CdrPassthrough>;
/// A writer of encoded messages.
pub type RawWriter = DataWriter<SerializedMessage, CdrPassthrough>;

/// Why the ROS 2 endpoint cannot be opened.
#[derive(Debug, Error)]
pub enum EndpointError {
    /// DDS cannot join the domain.
    #[error("cannot open the ROS 2 endpoint: no DDS participant in domain {domain}: {source}")]
    Participant {
        /// The domain (ROS_DOMAIN_ID).
        domain: u16,
        /// Reason that DDS gives.
        source: CreateError,
    },
    /// The node's name or namespace is not a ROS name.
    #[error("cannot open the ROS 2 endpoint: node '{name}': {reason}; see bridge.dds.node and namespace")]
    NodeName {
        /// The node's name.
        name: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A topic's name is not a ROS name.
    #[error("cannot open the ROS 2 endpoint: topic {name}: {reason}; see bridge.dds.namespace")]
    TopicName {
        /// The topic's name.
        name: String,
        /// What is wrong with it.
        reason: String,
    },
    /// Too many names of topics were relayed since the start.
    #[error("topic {name} is not relayed: {limit} names were since the start; restart the bridge")]
    TooManyNames {
        /// The topic's name.
        name: String,
        /// Most names of one run.
        limit: usize,
    },
    /// DDS cannot create a topic, a reader or a writer.
    #[error("cannot open the ROS 2 endpoint: DDS cannot create {what}: {source}")]
    Entity {
        /// The topic or the kind of entity.
        what: String,
        /// Reason that DDS gives.
        source: CreateError,
    },
}

/// Returns a conversion of DDS's error into one that says what could not be created.
pub fn cannot_create(what: impl Into<String>) -> impl FnOnce(CreateError) -> EndpointError {
    |source| EndpointError::Entity { what: what.into(), source }
}

/// Joins the domain of the configuration.
pub fn join_domain(config: &DdsConfig) -> Result<DomainParticipant, EndpointError> {
    let mut builder = DomainParticipantBuilder::new(config.domain());
    if config.is_loopback_only() {
        builder = builder.with_only_networks([Ipv4Addr::LOCALHOST]);
    }
    builder.build().map_err(|source| EndpointError::Participant { domain: config.domain(), source })
}

/// Returns the name of the endpoint's ROS node.
pub fn node_name(config: &DdsConfig) -> Result<NodeName, EndpointError> {
    let namespace = if config.namespace.is_empty() { "/" } else { &config.namespace };
    NodeName::new(namespace, &config.node)
        .map_err(|reason| EndpointError::NodeName { name: config.node.clone(), reason: reason.to_string() })
}

/// Returns a type's name on DDS: `nav_msgs::msg::dds_::Path_` for `nav_msgs/Path` of the kind `msg`.
///
/// A type of an action has the kind in its name: `nav2_msgs/action/NavigateToPose_FeedbackMessage`.
pub fn dds_type(ros_type: &str, kind: &str, part: &str) -> String {
    let (package, class) = ros_type.split_once('/').unwrap_or(("", ros_type));
    let (kind, class) = class.split_once('/').unwrap_or((kind, class));
    format!("{package}::{kind}::dds_::{class}{part}_")
}

/// Creates topics, readers and writers of one participant.
pub struct EntityFactory {
    participant: DomainParticipant,
    publisher: Publisher,
    subscriber: Subscriber,
    node: NodeName,
    namespace: String,
    is_loopback_only: bool,
}

impl EntityFactory {
    /// Creates the factory with its DDS publisher and subscriber.
    pub fn new(
        participant: &DomainParticipant,
        node: NodeName,
        config: &DdsConfig,
    ) -> Result<Self, EndpointError> {
        let qos = QosPolicyBuilder::new().build();
        let publisher = participant.create_publisher(&qos).map_err(cannot_create("a publisher"))?;
        let subscriber = participant.create_subscriber(&qos).map_err(cannot_create("a subscriber"))?;
        let (participant, namespace) = (participant.clone(), config.namespace.clone());
        let is_loopback_only = config.is_loopback_only();
        Ok(Self { participant, publisher, subscriber, node, namespace, is_loopback_only })
    }

    /// Returns DDS's publisher, which owns the writers.
    pub fn publisher(&self) -> &Publisher {
        &self.publisher
    }

    /// Returns what stands before the names of all topics but the global ones.
    pub fn namespace(&self) -> &str {
        &self.namespace
    }

    /// Returns whether a reliable reader acknowledges what a writer of the same participant sends.
    ///
    /// RustDDS 0.15 sends to a loopback address only if its participant was heard from one, and a participant does not hear
    /// itself. On loopback alone a reliable writer waits in vain for a reader that was there before it, and nobody gets its
    /// messages meanwhile. It does not know one that is opened later.
    pub fn do_own_readers_acknowledge(&self) -> bool {
        !self.is_loopback_only
    }

    /// Creates a topic by its ROS name and `package/Type`.
    fn topic(&self, name: &str, message_type: &str, qos: &QosPolicies) -> Result<Topic, EndpointError> {
        let ros_name = Name::parse(name).map_err(|reason| EndpointError::TopicName {
            name: name.to_owned(),
            reason: reason.to_string(),
        })?;
        let dds_name = ros_name.to_dds_name("rt", &self.node, "");
        self.dds_topic(&dds_name, dds_type(message_type, "msg", ""), qos)
    }

    /// Creates a topic by its name and type on DDS.
    fn dds_topic(&self, name: &str, dds_type: String, qos: &QosPolicies) -> Result<Topic, EndpointError> {
        let topic = self.participant.create_topic(name.to_owned(), dds_type, qos, TopicKind::NoKey);
        topic.map_err(cannot_create(name))
    }

    /// Creates the writer of a topic of the fleet.
    pub fn topic_writer(
        &self,
        name: &str,
        message_type: &str,
        qos: QosPolicies,
    ) -> Result<TopicWriter, EndpointError> {
        let mut writer = self.unopened_topic_writer(name, message_type, qos)?;
        writer.open().map_err(cannot_create(name))?;
        Ok(writer)
    }

    /// Creates the writer of a topic that is on DDS from the next tick on.
    pub fn unopened_topic_writer(
        &self,
        name: &str,
        message_type: &str,
        qos: QosPolicies,
    ) -> Result<TopicWriter, EndpointError> {
        let topic = self.topic(name, message_type, &qos)?;
        Ok(TopicWriter::unopened(&self.publisher, topic, qos))
    }

    /// Creates the reader of an input topic.
    pub fn input_reader(&self, input: &InputTopic) -> Result<Rc<RawReader>, EndpointError> {
        let history = History::KeepLast { depth: INPUT_DEPTH };
        let durability = if input.is_latched() { Durability::TransientLocal } else { Durability::Volatile };
        let qos = QosPolicyBuilder::new().durability(durability).history(history);
        // Best-effort readers accept best-effort and reliable writers; a single event must be reliable.
        let qos = if input.is_stream() { qos.best_effort() } else { qos.reliable(Duration::ZERO) }.build();
        let namespace = if input.is_global() { "" } else { &self.namespace };
        let name = format!("{namespace}{}", input.name);
        let topic = self.topic(&name, input.message_type, &qos)?;
        let reader = self.subscriber.create_simple_datareader_no_key(&topic, Some(qos));
        reader.map(Rc::new).map_err(cannot_create(name))
    }

    /// Creates the reader of a topic that clients subscribed to.
    pub fn relay_reader(
        &self,
        name: &str,
        message_type: &str,
        qos: QosPolicies,
    ) -> Result<Rc<RawReader>, EndpointError> {
        let topic = self.topic(name, message_type, &qos)?;
        let reader = self.subscriber.create_simple_datareader_no_key(&topic, Some(qos));
        reader.map(Rc::new).map_err(cannot_create(name))
    }

    /// Creates the reader of one of a service's topics. `dds_type` is DDS's.
    pub fn service_reader(
        &self,
        name: &ServiceTopicName,
        dds_type: String,
        qos: &QosPolicies,
    ) -> Result<Rc<RawReader>, EndpointError> {
        let name = self.dds_name(name);
        let topic = self.dds_topic(&name, dds_type, qos)?;
        let reader = self.subscriber.create_simple_datareader_no_key(&topic, Some(qos.clone()));
        reader.map(Rc::new).map_err(cannot_create(name))
    }

    /// Creates the writer of one of a service's topics. `dds_type` is DDS's.
    pub fn service_writer(
        &self,
        name: &ServiceTopicName,
        dds_type: String,
        qos: &QosPolicies,
    ) -> Result<RawWriter, EndpointError> {
        let name = self.dds_name(name);
        let topic = self.dds_topic(&name, dds_type, qos)?;
        let writer = self.publisher.create_datawriter_no_key(&topic, Some(qos.clone()));
        writer.map_err(cannot_create(name))
    }

    fn dds_name(&self, name: &ServiceTopicName) -> String {
        let ServiceTopicName { prefix, service, suffix } = name;
        format!("{prefix}{}{service}{suffix}", self.namespace)
    }
}

#[cfg(test)]
mod tests {
    use super::dds_type;

    #[test]
    fn types_of_actions_have_their_own_kind() {
        assert_eq!(dds_type("nav_msgs/Path", "msg", ""), "nav_msgs::msg::dds_::Path_");
        assert_eq!(dds_type("std_srvs/Empty", "srv", "_Request"), "std_srvs::srv::dds_::Empty_Request_");
        let send_goal = "nav2_msgs/action/NavigateToPose_SendGoal";
        let expected = "nav2_msgs::action::dds_::NavigateToPose_SendGoal_Request_";
        assert_eq!(dds_type(send_goal, "srv", "_Request"), expected);
    }
}
