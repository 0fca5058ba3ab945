//! The readers and writers of topics that clients on TCP use, besides the fleet's, and the topics of ROS nodes.

use super::entities::{EndpointError, EntityFactory, RawReader};
use super::link::RosLink;
use super::topic_writer::{self, TopicWriter, WriteOutcome, latched_qos, stream_qos};
use crate::relay::{RosCommand, RosEvent, RosGraph};
use futures::StreamExt;
use msg::Monotonic;
use ros2_client::dds::rustdds::policy::{Durability, History, Reliability};
use ros2_client::dds::rustdds::{
    DomainParticipant, DomainParticipantStatusEvent, Duration, GUID, QosPolicies, QosPolicyBuilder,
    RTPSEntity,
};
use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;
use std::sync::Arc;
use tokio::task::{JoinHandle, spawn_local};

/// Messages that a reader keeps until they are taken.
const READER_DEPTH: i32 = 16;
/// Messages that a writer keeps for a reader that does not acknowledge.
const WRITER_DEPTH: usize = 64;
/// Names of topics that are relayed during one run. RustDDS keeps something of each name for ever.
const NAMES_MAX: usize = 4096;
/// Topics of ROS nodes that are told to the bridge.
const GRAPH_TOPICS_MAX: usize = 2048;

/// The quality of service that a reader asks for; it must not ask for more than a writer offers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct ReaderQos {
    is_reliable: bool,
    is_latched: bool,
}

/// A reader of one topic. Its task ends with it.
struct RelayReader {
    name: Arc<str>,
    message_type: String,
    qos: ReaderQos,
    reader: Rc<RawReader>,
    /// Writers on the topic whose type is another: RustDDS does not compare types.
    of_other_type: Rc<RefCell<BTreeSet<GUID>>>,
    task: JoinHandle<()>,
}

impl Drop for RelayReader {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// A writer of another participant.
struct RemoteWriter {
    guid: GUID,
    message_type: String,
    qos: ReaderQos,
}

/// The readers and writers of relayed topics.
pub struct TopicRelay {
    participant: DomainParticipant,
    factory: EntityFactory,
    link: Arc<RosLink>,
    readers: BTreeMap<Arc<str>, RelayReader>,
    writers: BTreeMap<Arc<str>, TopicWriter>,
    names: BTreeSet<Arc<str>>,
    remote_writers: BTreeMap<String, Vec<RemoteWriter>>,
    graph: RosGraph,
    has_graph_changed: bool,
    received: Rc<Cell<u64>>,
}

impl TopicRelay {
    /// Creates the relay without topics.
    pub fn new(participant: &DomainParticipant, factory: EntityFactory, link: Arc<RosLink>) -> Self {
        Self {
            participant: participant.clone(),
            factory,
            link,
            readers: BTreeMap::new(),
            writers: BTreeMap::new(),
            names: BTreeSet::new(),
            remote_writers: BTreeMap::new(),
            graph: RosGraph::default(),
            has_graph_changed: true,
            received: Rc::new(Cell::new(0)),
        }
    }

    /// Returns the identifiers of readers and writers.
    pub fn guids(&self) -> (Vec<GUID>, Vec<GUID>) {
        (
            self.readers.values().map(|reader| reader.reader.guid()).collect(),
            self.writers.values().map(TopicWriter::guid).collect(),
        )
    }

    /// Returns the number of readers of other participants, and the number of messages received.
    pub fn counts(&self) -> (usize, u64) {
        (self.writers.values().map(TopicWriter::readers).sum(), self.received.get())
    }

    /// Does what the bridge asks; returns what happened to a message, and whether readers or writers changed.
    pub fn apply(
        &mut self,
        command: RosCommand,
        now: Monotonic,
    ) -> Result<(Option<WriteOutcome>, bool), EndpointError> {
        match command {
            RosCommand::Publish { topic, payload } => {
                let writer = self.writers.get_mut(&topic);
                return Ok((writer.map(|writer| writer.write_bytes(now, payload)), false));
            }
            RosCommand::Subscribe { topic, message_type } => {
                self.check_name(&topic)?;
                let qos = self.matching_qos(&topic, &message_type);
                let reader = self.open_reader(&topic, message_type, qos)?;
                self.readers.insert(topic, reader);
            }
            RosCommand::Unsubscribe { topic } => drop(self.readers.remove(&topic)),
            RosCommand::Advertise { topic, message_type, latch } => {
                self.check_name(&topic)?;
                let qos = if latch { latched_qos() } else { stream_qos(WRITER_DEPTH) };
                let name = format!("{}{topic}", self.factory.namespace());
                // The old writer goes first: a reader must not get two.
                self.writers.remove(&topic);
                self.writers.insert(topic, self.factory.topic_writer(&name, &message_type, qos)?);
            }
            RosCommand::Unadvertise { topic } => drop(self.writers.remove(&topic)),
        }
        Ok((None, true))
    }

    fn check_name(&mut self, topic: &Arc<str>) -> Result<(), EndpointError> {
        if self.names.len() >= NAMES_MAX && !self.names.contains(topic) {
            return Err(EndpointError::TooManyNames { name: topic.to_string(), limit: NAMES_MAX });
        }
        self.names.insert(topic.clone());
        Ok(())
    }

    /// Returns the most that every writer of the topic and type offers.
    fn matching_qos(&self, topic: &str, message_type: &str) -> ReaderQos {
        let writers = self.remote_writers.get(topic).into_iter().flatten();
        let mut offers =
            writers.filter(|writer| writer.message_type == message_type).map(|writer| writer.qos).peekable();
        let is_known = offers.peek().is_some();
        let least =
            offers.fold(ReaderQos { is_reliable: true, is_latched: true }, |least, offer| ReaderQos {
                is_reliable: least.is_reliable && offer.is_reliable,
                is_latched: least.is_latched && offer.is_latched,
            });
        ReaderQos { is_latched: least.is_latched && least.is_reliable && is_known, ..least }
    }

    fn open_reader(
        &self,
        topic: &Arc<str>,
        message_type: String,
        qos: ReaderQos,
    ) -> Result<RelayReader, EndpointError> {
        let name = format!("{}{topic}", self.factory.namespace());
        let reader = self.factory.relay_reader(&name, &message_type, qos.policies())?;
        let of_other_type = Rc::new(RefCell::new(self.writers_of_other_type(topic, &message_type)));
        let task = spawn_local(receive(
            reader.clone(),
            topic.clone(),
            self.participant.guid(),
            of_other_type.clone(),
            self.link.clone(),
            self.received.clone(),
        ));
        Ok(RelayReader { name: topic.clone(), message_type, qos, reader, of_other_type, task })
    }

    fn writers_of_other_type(&self, topic: &str, message_type: &str) -> BTreeSet<GUID> {
        let writers = self.remote_writers.get(topic).into_iter().flatten();
        writers.filter(|writer| writer.message_type != message_type).map(|writer| writer.guid).collect()
    }

    /// Handles an event of DDS; returns whether a writer was replaced.
    pub fn apply_event(&mut self, event: &DomainParticipantStatusEvent, now: Monotonic) -> bool {
        use DomainParticipantStatusEvent as Event;
        self.has_graph_changed |= matches!(
            event,
            Event::WriterDetected { .. }
                | Event::ReaderDetected { .. }
                | Event::WriterLost { .. }
                | Event::ReaderLost { .. }
                | Event::ParticipantLost { .. }
        );
        topic_writer::apply_event(self.writers.values_mut(), event, now)
    }

    /// Retries what could not be written and follows the ROS graph; returns whether readers or writers changed.
    pub fn tick(&mut self, now: Monotonic) -> bool {
        let mut has_changed = false;
        for writer in self.writers.values_mut() {
            has_changed |= writer.retry(now).unwrap_or(false);
        }
        if std::mem::take(&mut self.has_graph_changed) {
            self.update_graph();
            has_changed |= self.match_readers();
        }
        has_changed
    }

    /// Reads which topics other participants publish and subscribe to, and tells the bridge of a change.
    fn update_graph(&mut self) {
        let own = self.participant.guid().prefix;
        let mut graph = RosGraph::default();
        self.remote_writers.clear();
        for writer in self.participant.discovered_writers() {
            let data = &writer.publication_topic_data;
            let Some((name, message_type)) = self.ros_names(&data.topic_name, &data.type_name) else {
                continue;
            };
            if data.key.prefix == own || is_beyond_limit(&graph, &name) {
                continue;
            }
            let qos = ReaderQos {
                is_reliable: matches!(data.reliability, Some(Reliability::Reliable { .. })),
                is_latched: !matches!(data.durability, None | Some(Durability::Volatile)),
            };
            let topic = graph.topics.entry(name.clone()).or_default();
            topic.is_latched = (topic.published.is_empty() || topic.is_latched) && qos.is_latched;
            add_type(&mut topic.published, &message_type);
            let remote = RemoteWriter { guid: data.key, message_type, qos };
            self.remote_writers.entry(name).or_default().push(remote);
        }
        for reader in self.participant.discovered_readers() {
            let data = &reader.subscription_topic_data;
            let Some((name, message_type)) = self.ros_names(data.topic_name(), data.type_name()) else {
                continue;
            };
            if reader.reader_proxy.remote_reader_guid.prefix != own && !is_beyond_limit(&graph, &name) {
                add_type(&mut graph.topics.entry(name).or_default().subscribed, &message_type);
            }
        }
        if graph != self.graph {
            self.link.send_event(RosEvent::Graph(graph.clone()));
            self.graph = graph;
        }
    }

    /// Returns a topic's name on TCP and its ROS type, or `None` if it is not a topic in the namespace.
    fn ros_names(&self, dds_name: &str, dds_type: &str) -> Option<(String, String)> {
        let name = dds_name.strip_prefix("rt")?.strip_prefix(self.factory.namespace())?;
        let (package, class) = dds_type.split_once("::msg::dds_::")?;
        let class = class.strip_suffix('_')?;
        name.starts_with('/').then(|| (name.to_owned(), format!("{package}/{class}")))
    }

    /// Opens readers anew whose quality of service no longer matches; returns whether there were any.
    fn match_readers(&mut self) -> bool {
        let mut due = Vec::new();
        for reader in self.readers.values() {
            *reader.of_other_type.borrow_mut() =
                self.writers_of_other_type(&reader.name, &reader.message_type);
            let qos = self.matching_qos(&reader.name, &reader.message_type);
            if qos != reader.qos {
                due.push((reader.name.clone(), reader.message_type.clone(), qos));
            }
        }
        let has_changed = !due.is_empty();
        for (topic, message_type, qos) in due {
            // The old reader goes first: a message must not come twice.
            self.readers.remove(&topic);
            match self.open_reader(&topic, message_type, qos) {
                Ok(reader) => drop(self.readers.insert(topic, reader)),
                Err(why) => self.report(topic, &why),
            }
        }
        has_changed
    }

    /// Tells the bridge why a topic is not exchanged.
    pub fn report(&self, topic: Arc<str>, why: &EndpointError) {
        self.link.send_event(RosEvent::Failure { topic, text: why.to_string() });
    }
}

impl ReaderQos {
    fn policies(self) -> QosPolicies {
        let durability = if self.is_latched { Durability::TransientLocal } else { Durability::Volatile };
        let history = History::KeepLast { depth: READER_DEPTH };
        let qos = QosPolicyBuilder::new().durability(durability).history(history);
        if self.is_reliable { qos.reliable(Duration::ZERO) } else { qos.best_effort() }.build()
    }
}

fn is_beyond_limit(graph: &RosGraph, name: &str) -> bool {
    graph.topics.len() >= GRAPH_TOPICS_MAX && !graph.topics.contains_key(name)
}

fn add_type(types: &mut Vec<String>, message_type: &str) {
    if let Err(at) = types.binary_search_by(|known| known.as_str().cmp(message_type)) {
        types.insert(at, message_type.to_owned());
    }
}

/// Passes the messages of one reader to the bridge, but for those that the bridge itself has written.
async fn receive(
    reader: Rc<RawReader>,
    topic: Arc<str>,
    own: GUID,
    of_other_type: Rc<RefCell<BTreeSet<GUID>>>,
    link: Arc<RosLink>,
    received: Rc<Cell<u64>>,
) {
    let mut samples = std::pin::pin!(reader.as_async_stream());
    while let Some(sample) = samples.next().await {
        let Ok(sample) = sample else {
            link.send_event(RosEvent::OtherEncoding { topic: topic.clone() });
            continue;
        };
        let writer = sample.writer_guid();
        if writer.prefix == own.prefix || of_other_type.borrow().contains(&writer) {
            continue;
        }
        received.set(received.get() + 1);
        link.send_event(RosEvent::Message { topic: topic.clone(), payload: sample.into_value().0 });
    }
}
