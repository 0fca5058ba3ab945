//! Services on DDS: those that the bridge offers to ROS, and those of ROS nodes that clients call.
//!
//! A service has a topic of requests and one of replies, named as ROS 2 does. Requests and responses pass as bytes.

use super::entities::{EndpointError, EntityFactory};
use super::newest::NewestSamples;
use super::queues::DdsQueues;
use super::service_endpoint::{Client, SentCalls, Server, ServiceEndpoint, ServiceTopic};
use super::service_identity as identity;
use super::topic_writer::stream_qos;
use crate::relay::{RosCommand, RosEvent};
use futures::StreamExt;
use msg::Monotonic;
use ros2_client::dds::rustdds::{DomainParticipantStatusEvent, GUID, RTPSEntity};
use std::cell::Cell;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::rc::Rc;
use std::sync::Arc;
use tokio::task::spawn_local;

/// Requests or replies that a writer keeps for a reader that does not acknowledge.
const DEPTH: usize = 64;
/// Names of services that are exchanged during one run. RustDDS keeps something of each name for ever.
const NAMES_MAX: usize = 4096;

/// All services that the bridge offers to ROS, and those that it calls there.
pub struct ServiceRelay {
    own: GUID,
    queues: Arc<DdsQueues>,
    servers: BTreeMap<Arc<str>, Server>,
    clients: BTreeMap<Arc<str>, Client>,
    /// Every service since the start, with the newest request of each requester.
    names: BTreeMap<Arc<str>, NewestSamples>,
    received: Rc<Cell<u64>>,
}

impl ServiceRelay {
    /// Creates the relay without services. `own`: the identifier of this participant.
    pub fn new(own: GUID, queues: Arc<DdsQueues>) -> Self {
        let (servers, clients, names) = (BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
        Self { own, queues, servers, clients, names, received: Rc::default() }
    }

    /// Returns the identifiers of readers and writers.
    pub fn guids(&self) -> (Vec<GUID>, Vec<GUID>) {
        let clients = self.clients.values().map(|client| &client.endpoint);
        let endpoints = self.servers.values().map(|server| &server.endpoint).chain(clients);
        endpoints.map(|endpoint| (endpoint.reader.guid(), endpoint.writer.guid())).unzip()
    }

    /// Returns the number of requests and responses received.
    pub fn received(&self) -> u64 {
        self.received.get()
    }

    /// Does what the bridge asks; returns whether readers or writers changed.
    pub fn apply(
        &mut self,
        command: RosCommand,
        factory: &EntityFactory,
        now: Monotonic,
    ) -> Result<bool, EndpointError> {
        match command {
            RosCommand::OpenClient { service, service_type } => {
                self.check_name(&service)?;
                let client = self.open_client(factory, &service, &service_type)?;
                self.clients.insert(service, client);
            }
            RosCommand::CloseClient { service } => drop(self.clients.remove(&service)),
            RosCommand::OpenServer { service, service_type } => {
                self.check_name(&service)?;
                let server = self.open_server(factory, &service, &service_type)?;
                self.servers.insert(service, server);
            }
            RosCommand::CloseServer { service } => drop(self.servers.remove(&service)),
            RosCommand::Call { service, number, payload } => {
                if let Some(client) = self.clients.get_mut(&service) {
                    client.call(number, payload);
                }
                return Ok(false);
            }
            RosCommand::Cancel { service, number } => {
                if let Some(client) = self.clients.get_mut(&service) {
                    client.cancel(number);
                }
                return Ok(false);
            }
            RosCommand::Respond { service, request, payload } => {
                if let Some(server) = self.servers.get_mut(&service) {
                    server.respond(request, payload, now);
                }
                return Ok(false);
            }
            // Those of topics are not for this relay.
            _ => return Ok(false),
        }
        Ok(true)
    }

    fn check_name(&mut self, service: &Arc<str>) -> Result<(), EndpointError> {
        if self.names.len() >= NAMES_MAX && !self.names.contains_key(service) {
            return Err(EndpointError::TooManyNames { name: service.to_string(), limit: NAMES_MAX });
        }
        self.names.entry(service.clone()).or_default();
        Ok(())
    }

    fn open_server(
        &self,
        factory: &EntityFactory,
        service: &Arc<str>,
        service_type: &str,
    ) -> Result<Server, EndpointError> {
        let (requests, replies) =
            (ServiceTopic::requests(service, service_type), ServiceTopic::replies(service, service_type));
        let writer = factory.service_writer(&replies.name, replies.dds_type, &stream_qos(DEPTH))?;
        let reader = factory.service_reader(&requests.name, requests.dds_type, &stream_qos(DEPTH))?;
        let newest = self.names.get(service).cloned().unwrap_or_default();
        let (own, queues, received, service) =
            (self.own, self.queues.clone(), self.received.clone(), service.clone());
        let samples = reader.clone();
        let task = spawn_local(async move {
            let mut samples = std::pin::pin!(samples.as_async_stream());
            while let Some(sample) = samples.next().await {
                let Ok(sample) = sample else { continue };
                if sample.writer_guid().prefix == own.prefix || !newest.is_new(&sample) {
                    continue;
                }
                if let Some((id, payload)) = identity::read_request(sample) {
                    received.set(received.get() + 1);
                    queues.send_event(RosEvent::Request { service: service.clone(), id, payload });
                }
            }
        });
        let endpoint = ServiceEndpoint { reader, writer, remote: BTreeSet::new(), task };
        Ok(Server { endpoint, held: VecDeque::new() })
    }

    fn open_client(
        &self,
        factory: &EntityFactory,
        service: &Arc<str>,
        service_type: &str,
    ) -> Result<Client, EndpointError> {
        let (requests, replies) =
            (ServiceTopic::requests(service, service_type), ServiceTopic::replies(service, service_type));
        let reader = factory.service_reader(&replies.name, replies.dds_type, &stream_qos(DEPTH))?;
        let writer = factory.service_writer(&requests.name, requests.dds_type, &stream_qos(DEPTH))?;
        let sent = SentCalls::default();
        let (calls, queues, received, service) =
            (sent.clone(), self.queues.clone(), self.received.clone(), service.clone());
        let (samples, of_requests, of_replies) = (reader.clone(), writer.guid(), reader.guid());
        let task = spawn_local(async move {
            let mut samples = std::pin::pin!(samples.as_async_stream());
            while let Some(sample) = samples.next().await {
                let Ok(sample) = sample else { continue };
                let answered = identity::read_response(sample, &of_requests, &of_replies);
                let Some((request, payload)) = answered else { continue };
                // Of several servers' responses the first counts.
                if let Some(number) = { calls.borrow_mut().remove(&request) } {
                    received.set(received.get() + 1);
                    queues.send_event(RosEvent::Response { service: service.clone(), number, payload });
                }
            }
        });
        let endpoint = ServiceEndpoint { reader, writer, remote: BTreeSet::new(), task };
        Ok(Client { endpoint, sent, waiting: VecDeque::new() })
    }

    /// Handles an event of DDS: readers and writers of other participants come and go.
    pub fn apply_event(&mut self, event: &DomainParticipantStatusEvent, now: Monotonic) {
        use DomainParticipantStatusEvent as Event;
        for server in self.servers.values_mut() {
            if server.endpoint.apply_event(event) {
                server.send_held(now);
            }
        }
        for client in self.clients.values_mut() {
            if client.endpoint.apply_event(event) {
                client.send_waiting();
            }
        }
        match event {
            Event::WriterLost { guid, .. } => {
                self.names.values().for_each(|newest| newest.retain(|of| of != guid))
            }
            Event::ParticipantLost { id, .. } => {
                self.names.values().for_each(|newest| newest.retain(|of| of.prefix != *id));
            }
            _ => {}
        }
    }

    /// Drops replies that have waited too long for their reader.
    pub fn tick(&mut self, now: Monotonic) {
        for server in self.servers.values_mut().filter(|server| !server.held.is_empty()) {
            server.send_held(now);
        }
    }

    /// Tells the bridge why a service cannot be called or offered.
    pub fn report(&self, service: Arc<str>, why: &EndpointError) {
        self.queues.send_event(RosEvent::ServiceFailure { service, text: why.to_string() });
    }
}
