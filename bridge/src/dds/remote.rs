//! Readers and writers of other participants, and the topics and services of ROS nodes that they make up.

use crate::relay::RosGraph;
use ros2_client::dds::rustdds::policy::{Durability, Reliability};
use ros2_client::dds::rustdds::{DomainParticipantStatusEvent, EndpointDescription, GUID};
use std::collections::BTreeMap;

/// Readers and writers of other participants that are remembered: those of a few hundred nodes.
const REMOTE_MAX: usize = 16_384;
/// Topics of ROS nodes that are told to the bridge, and as many services.
const GRAPH_NAMES_MAX: usize = 2048;

/// The quality of service that a reader asks for; it must not ask for more than a writer offers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReaderQos {
    /// Whether lost messages are repaired.
    pub is_reliable: bool,
    /// Whether a late reader gets the newest messages (transient local).
    pub is_latched: bool,
}

/// A reader or writer of another participant.
pub struct RemoteEndpoint {
    /// The topic's or service's name on TCP.
    name: String,
    /// ROS type as `package/Type`, such as `std_msgs/String`.
    pub ros_type: String,
    role: Role,
}

/// What a reader or writer of another participant is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Role {
    Publisher(ReaderQos),
    Subscriber,
    ServiceServer,
}

impl RemoteEndpoint {
    /// Returns what a publisher offers; `None` if it is none.
    pub fn offer(&self) -> Option<ReaderQos> {
        match self.role {
            Role::Publisher(offer) => Some(offer),
            _ => None,
        }
    }
}

/// The readers and writers of other participants, by events: reading RustDDS's own table would wait for its discovery.
pub struct RemoteEndpoints {
    own: GUID,
    namespace: String,
    endpoints: BTreeMap<GUID, RemoteEndpoint>,
}

impl RemoteEndpoints {
    /// Creates an empty table. `own`: the identifier of this participant. `namespace` stands before all names.
    pub fn new(own: GUID, namespace: &str) -> Self {
        Self { own, namespace: namespace.to_owned(), endpoints: BTreeMap::new() }
    }

    /// Handles an event of DDS; returns whether the table has changed.
    pub fn apply_event(&mut self, event: &DomainParticipantStatusEvent) -> bool {
        use DomainParticipantStatusEvent as Event;
        let before = self.endpoints.len();
        match event {
            Event::WriterDetected { writer } => self.add(writer, true),
            Event::ReaderDetected { reader } => self.add(reader, false),
            Event::WriterLost { guid, .. } | Event::ReaderLost { guid, .. } => {
                drop(self.endpoints.remove(guid));
            }
            Event::ParticipantLost { id, .. } => self.endpoints.retain(|guid, _| guid.prefix != *id),
            _ => {}
        }
        self.endpoints.len() != before
    }

    /// Returns whether a reader or writer is known.
    pub fn contains(&self, guid: &GUID) -> bool {
        self.endpoints.contains_key(guid)
    }

    /// Returns the publishers of a topic.
    pub fn publishers(&self, topic: &str) -> impl Iterator<Item = (GUID, &RemoteEndpoint)> {
        let publishers = self.endpoints.iter().filter(|(_, endpoint)| endpoint.offer().is_some());
        publishers.filter(move |(_, writer)| writer.name == topic).map(|(guid, writer)| (*guid, writer))
    }

    fn add(&mut self, endpoint: &EndpointDescription, is_writer: bool) {
        if endpoint.guid.prefix == self.own.prefix || self.endpoints.len() >= REMOTE_MAX {
            return;
        }
        let (name, dds_type) = (&endpoint.topic_name, &endpoint.type_name);
        let offer = ReaderQos {
            is_reliable: matches!(endpoint.qos.reliability(), Some(Reliability::Reliable { .. })),
            is_latched: !matches!(endpoint.qos.durability(), None | Some(Durability::Volatile)),
        };
        let role = if is_writer { Role::Publisher(offer) } else { Role::Subscriber };
        let of_topic = self.ros_name(name, "rt", "").zip(ros_type(dds_type, "msg", "_"));
        // A service has a server if somebody reads its requests.
        let of_service = || self.ros_name(name, "rq", "Request").zip(ros_type(dds_type, "srv", "_Request_"));
        let found = of_topic.map(|names| (names, role));
        let found = found.or_else(|| Some((of_service().filter(|_| !is_writer)?, Role::ServiceServer)));
        if let Some(((name, ros_type), role)) = found {
            self.endpoints.insert(endpoint.guid, RemoteEndpoint { name, ros_type, role });
        }
    }

    /// Returns a name on TCP, or `None` if the name on DDS is another kind's or outside the namespace.
    fn ros_name(&self, dds_name: &str, prefix: &str, suffix: &str) -> Option<String> {
        let name = dds_name.strip_prefix(prefix)?.strip_prefix(&self.namespace)?.strip_suffix(suffix)?;
        (name.starts_with('/') && name.len() > 1).then(|| name.to_owned())
    }

    /// Returns the topics and services of ROS nodes.
    pub fn graph(&self) -> RosGraph {
        let mut graph = RosGraph::default();
        for RemoteEndpoint { name, ros_type, role } in self.endpoints.values() {
            if *role == Role::ServiceServer {
                if graph.services.len() < GRAPH_NAMES_MAX || graph.services.contains_key(name) {
                    add_type(graph.services.entry(name.clone()).or_default(), ros_type);
                }
                continue;
            }
            if graph.topics.len() >= GRAPH_NAMES_MAX && !graph.topics.contains_key(name) {
                continue;
            }
            let known = graph.topics.entry(name.clone()).or_default();
            match role {
                Role::Publisher(offer) => {
                    known.is_latched = (known.published.is_empty() || known.is_latched) && offer.is_latched;
                    add_type(&mut known.published, ros_type);
                }
                _ => add_type(&mut known.subscribed, ros_type),
            }
        }
        graph
    }
}

/// Returns `package/Type` of a type on DDS such as `std_msgs::msg::dds_::String_`.
fn ros_type(dds_type: &str, kind: &str, suffix: &str) -> Option<String> {
    let (package, class) = dds_type.split_once("::")?;
    let class = class.strip_prefix(kind)?.strip_prefix("::dds_::")?.strip_suffix(suffix)?;
    Some(format!("{package}/{class}"))
}

fn add_type(types: &mut Vec<String>, ros_type: &str) {
    if let Err(at) = types.binary_search_by(|known| known.as_str().cmp(ros_type)) {
        types.insert(at, ros_type.to_owned());
    }
}
