//! The readers and writers of topics that clients on TCP use, besides the fleet's, and the topics of ROS nodes.

use super::entities::{EndpointError, EntityFactory, RawReader};
use super::newest::NewestSamples;
use super::queues::DdsQueues;
use super::remote::{ReaderQos, RemoteEndpoints};
use super::topic_writer::{self, TopicWriter, WriteOutcome, latched_qos, stream_qos};
use crate::relay::{RosCommand, RosEvent, RosGraph};
use futures::StreamExt;
use msg::Monotonic;
use ros2_client::dds::rustdds::policy::{Durability, History};
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

/// The readers and writers of relayed topics.
pub struct TopicRelay {
    participant: DomainParticipant,
    factory: EntityFactory,
    queues: Arc<DdsQueues>,
    readers: BTreeMap<Arc<str>, RelayReader>,
    writers: BTreeMap<Arc<str>, TopicWriter>,
    /// Every topic received since the start, with the newest message of each of its writers.
    names: BTreeMap<Arc<str>, NewestSamples>,
    remote: RemoteEndpoints,
    graph: RosGraph,
    has_graph_changed: bool,
    received: Rc<Cell<u64>>,
}

impl TopicRelay {
    /// Creates the relay without topics.
    pub fn new(participant: &DomainParticipant, factory: EntityFactory, queues: Arc<DdsQueues>) -> Self {
        Self {
            participant: participant.clone(),
            remote: RemoteEndpoints::new(participant.guid(), factory.namespace()),
            factory,
            queues,
            readers: BTreeMap::new(),
            writers: BTreeMap::new(),
            names: BTreeMap::new(),
            graph: RosGraph::default(),
            has_graph_changed: true,
            received: Rc::new(Cell::new(0)),
        }
    }

    /// Returns what creates readers and writers.
    pub fn factory(&self) -> &EntityFactory {
        &self.factory
    }

    /// Returns the identifiers of readers and writers.
    pub fn guids(&self) -> (Vec<GUID>, Vec<GUID>) {
        (
            self.readers.values().map(|reader| reader.reader.guid()).collect(),
            self.writers.values().filter_map(TopicWriter::guid).collect(),
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
                if let Some(newest) = self.names.get(&topic).filter(|_| qos.is_latched) {
                    // The new client has not had the newest message.
                    newest.clear();
                }
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
                // A reader that it would wait for in vain is closed by then: see `matching_qos`.
                let writer = self.factory.unopened_topic_writer(&name, &message_type, qos)?;
                self.writers.insert(topic, writer);
                self.match_readers();
            }
            RosCommand::Unadvertise { topic } => {
                drop(self.writers.remove(&topic));
                self.match_readers();
            }
            // Those of services are not for this relay.
            _ => return Ok((None, false)),
        }
        Ok((None, true))
    }

    fn check_name(&mut self, topic: &Arc<str>) -> Result<(), EndpointError> {
        if self.names.len() >= NAMES_MAX && !self.names.contains_key(topic) {
            return Err(EndpointError::TooManyNames { name: topic.to_string(), limit: NAMES_MAX });
        }
        self.names.entry(topic.clone()).or_default();
        Ok(())
    }

    /// Returns the most that every writer of the topic and type offers; best effort beside an own writer that would wait for the
    /// reader in vain.
    fn matching_qos(&self, topic: &str, message_type: &str) -> ReaderQos {
        if self.writers.contains_key(topic) && !self.factory.do_own_readers_acknowledge() {
            return ReaderQos { is_reliable: false, is_latched: false };
        }
        let of_type = self.remote.publishers(topic).filter(|(_, writer)| writer.ros_type == message_type);
        let mut offers = of_type.filter_map(|(_, writer)| writer.offer()).peekable();
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
        let reception = Reception {
            topic: topic.clone(),
            own: self.participant.guid(),
            of_other_type: of_other_type.clone(),
            newest: self.names.get(topic).cloned().unwrap_or_default(),
            queues: self.queues.clone(),
            received: self.received.clone(),
        };
        let task = spawn_local(reception.receive(reader.clone()));
        Ok(RelayReader { name: topic.clone(), message_type, qos, reader, of_other_type, task })
    }

    fn writers_of_other_type(&self, topic: &str, message_type: &str) -> BTreeSet<GUID> {
        let writers = self.remote.publishers(topic);
        writers.filter(|(_, writer)| writer.ros_type != message_type).map(|(guid, _)| guid).collect()
    }

    /// Handles an event of DDS; returns whether a writer was replaced.
    pub fn apply_event(&mut self, event: &DomainParticipantStatusEvent, now: Monotonic) -> bool {
        self.has_graph_changed |= self.remote.apply_event(event);
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

    /// Tells the bridge which topics and services other participants have, if that has changed.
    fn update_graph(&mut self) {
        for newest in self.names.values() {
            newest.retain(|guid| self.remote.contains(guid));
        }
        let graph = self.remote.graph();
        if graph != self.graph {
            self.queues.send_event(RosEvent::Graph(graph.clone()));
            self.graph = graph;
        }
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
        self.queues.send_event(RosEvent::Failure { topic, text: why.to_string() });
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

/// What the task of one reader needs.
struct Reception {
    topic: Arc<str>,
    own: GUID,
    of_other_type: Rc<RefCell<BTreeSet<GUID>>>,
    newest: NewestSamples,
    queues: Arc<DdsQueues>,
    received: Rc<Cell<u64>>,
}

impl Reception {
    /// Passes the messages of one reader to the bridge, but for those that the bridge itself has written.
    async fn receive(self, reader: Rc<RawReader>) {
        let mut samples = std::pin::pin!(reader.as_async_stream());
        while let Some(sample) = samples.next().await {
            let topic = self.topic.clone();
            let Ok(sample) = sample else {
                self.queues.send_event(RosEvent::OtherEncoding { topic });
                continue;
            };
            let writer = sample.writer_guid();
            let is_foreign = writer.prefix != self.own.prefix;
            if is_foreign && !self.of_other_type.borrow().contains(&writer) && self.newest.is_new(&sample) {
                self.received.set(self.received.get() + 1);
                self.queues.send_event(RosEvent::Message { topic, payload: sample.into_value().0 });
            }
        }
    }
}
