//! Readers and writers of one service on DDS: a server's or a client's, with the requests and replies that wait.

use super::entities::{RawReader, RawWriter, dds_type};
use super::raw::SerializedMessage;
use super::service_identity::{self as identity, RequestNumber};
use crate::relay::{IDENTIFIED_BYTES_MAX, RosRequestId};
use msg::Monotonic;
use ros2_client::dds::rustdds::bytes::Bytes;
use ros2_client::dds::rustdds::{
    DomainParticipantStatusEvent, GUID, RTPSEntity, SampleIdentity, SequenceNumber, Timestamp,
    WriteOptionsBuilder,
};
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::rc::Rc;
use std::time::Duration;
use tokio::task::JoinHandle;

/// Requests of one service that wait until a server is found, and requests that wait for their response.
const REQUESTS_MAX: usize = 256;
/// Replies of one service that wait until the requester's reader is found.
const HELD_MAX: usize = 64;
/// A reply waits for this time: discovery of a reader takes less after its participant's request was received.
const HOLD: Duration = Duration::from_secs(2);

/// The readers and writers of one service. Its task ends with it.
pub struct ServiceEndpoint {
    /// Reader of requests, or of replies.
    pub reader: Rc<RawReader>,
    /// Writer of replies, or of requests.
    pub writer: RawWriter,
    /// Readers and writers of other participants that are matched.
    pub remote: BTreeSet<GUID>,
    /// Task that reads.
    pub task: JoinHandle<()>,
}

impl Drop for ServiceEndpoint {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl ServiceEndpoint {
    /// Handles readers and writers of other participants that have come or gone; returns whether one has come.
    pub fn apply_event(&mut self, event: &DomainParticipantStatusEvent) -> bool {
        use DomainParticipantStatusEvent as Event;
        match event {
            Event::RemoteReaderMatched { local_writer, remote_reader }
                if *local_writer == self.writer.guid() =>
            {
                self.remote.insert(*remote_reader)
            }
            Event::RemoteWriterMatched { local_reader, remote_writer }
                if *local_reader == self.reader.guid() =>
            {
                self.remote.insert(*remote_writer)
            }
            Event::ReaderLost { guid, .. } | Event::WriterLost { guid, .. } => {
                self.remote.remove(guid);
                false
            }
            Event::ParticipantLost { id, .. } => {
                self.remote.retain(|guid| guid.prefix != *id);
                false
            }
            _ => false,
        }
    }
}

/// A service that is offered to ROS.
pub struct Server {
    /// Reader of requests and writer of replies.
    pub endpoint: ServiceEndpoint,
    /// Replies whose requester's reader is not known yet, and until when each waits.
    pub held: VecDeque<(Monotonic, RosRequestId, Bytes)>,
}

impl Server {
    /// Sends a reply, or holds it until the requester's reader is found. One that is too long is not sent.
    pub fn respond(&mut self, id: RosRequestId, payload: Bytes, now: Monotonic) {
        if !id.can_carry(payload.len()) {
            return;
        }
        if self.has_reader(&id) {
            return self.send(&id, payload);
        }
        if self.held.len() >= HELD_MAX {
            self.held.pop_front();
        }
        self.held.push_back((now + HOLD, id, payload));
    }

    fn has_reader(&self, id: &RosRequestId) -> bool {
        let is_requesters = |guid: &GUID| {
            guid.entity_id.kind().is_reader() && guid.to_bytes().starts_with(identity::participant(id))
        };
        self.endpoint.remote.iter().any(is_requesters)
    }

    fn send(&self, id: &RosRequestId, payload: Bytes) {
        let (payload, beside) = identity::write_response(id, payload);
        let options = WriteOptionsBuilder::new().source_timestamp(Timestamp::now());
        let options = options.related_sample_identity_opt(beside).build();
        // The write fails only if the requester reads none of its replies.
        let _ = self.endpoint.writer.write_with_options(SerializedMessage(payload), options);
    }

    /// Sends the held replies whose reader is found, and drops those that have waited too long.
    pub fn send_held(&mut self, now: Monotonic) {
        for (until, id, payload) in std::mem::take(&mut self.held) {
            if self.has_reader(&id) {
                self.send(&id, payload);
            } else if now < until {
                self.held.push_back((until, id, payload));
            }
        }
    }
}

/// The bridge's numbers of the calls whose requests were sent.
pub type SentCalls = Rc<RefCell<BTreeMap<RequestNumber, i64>>>;

/// A service of ROS nodes that clients call.
pub struct Client {
    /// Reader of replies and writer of requests.
    pub endpoint: ServiceEndpoint,
    /// Calls whose response has not come.
    pub sent: SentCalls,
    /// Requests that wait until a server is found: the bridge's number of the call, and the payload.
    pub waiting: VecDeque<(i64, Bytes)>,
}

impl Client {
    /// Sends a request, or lets it wait until a server is found.
    pub fn call(&mut self, number: i64, payload: Bytes) {
        if self.waiting.len() >= REQUESTS_MAX {
            self.waiting.pop_front();
        }
        self.waiting.push_back((number, payload));
        self.send_waiting();
    }

    /// Sends the requests that wait, if a server is found: its reader and its writer.
    pub fn send_waiting(&mut self) {
        let remote = &self.endpoint.remote;
        let is_server = |reader: &&GUID| {
            let has_writer = |of: &GUID| of.prefix == reader.prefix && of.entity_id.kind().is_writer();
            reader.entity_id.kind().is_reader() && remote.iter().any(has_writer)
        };
        let Some(server) = remote.iter().find(is_server).copied() else { return };
        for (number, payload) in std::mem::take(&mut self.waiting) {
            self.send(identity::is_cyclone(&server), number, payload);
        }
    }

    fn send(&self, is_cyclone: bool, number: i64, payload: Bytes) {
        let ServiceEndpoint { reader, writer, .. } = &self.endpoint;
        let options = WriteOptionsBuilder::new().source_timestamp(Timestamp::now());
        let (payload, options) = if is_cyclone {
            (identity::write_cyclone_request(&writer.guid(), number, &payload), options)
        } else {
            let named =
                SampleIdentity { writer_guid: reader.guid(), sequence_number: SequenceNumber::UNKNOWN };
            let named = (payload.len() <= IDENTIFIED_BYTES_MAX).then_some(named);
            (payload, options.related_sample_identity_opt(named))
        };
        // A request that cannot be written gets no response: the call fails when its time is over.
        if let Ok(sample) = writer.write_with_options(SerializedMessage(payload), options.build()) {
            let request = match is_cyclone {
                true => RequestNumber::InPayload(number),
                false => RequestNumber::Sample(sample.sequence_number.into()),
            };
            let sent = &mut *self.sent.borrow_mut();
            if sent.len() >= REQUESTS_MAX {
                sent.pop_first();
            }
            sent.insert(request, number);
        }
    }

    /// Withdraws a request that waits, and ignores the response to one that was sent.
    pub fn cancel(&mut self, number: i64) {
        self.waiting.retain(|(waiting, _)| *waiting != number);
        self.sent.borrow_mut().retain(|_, sent| *sent != number);
    }
}

/// One of the two topics of a service, by its names on DDS but for the namespace.
pub struct ServiceTopic {
    /// Name on DDS.
    pub name: ServiceTopicName,
    /// Type on DDS, such as `std_srvs::srv::dds_::Empty_Request_`.
    pub dds_type: String,
}

/// Name of a service's topic: prefix, service, suffix.
pub struct ServiceTopicName {
    /// `rq` or `rr`.
    pub prefix: &'static str,
    /// The service's name with leading slash.
    pub service: String,
    /// `Request` or `Reply`.
    pub suffix: &'static str,
}

impl ServiceTopic {
    /// Returns the topic of requests.
    pub fn requests(service: &str, service_type: &str) -> Self {
        let name = ServiceTopicName { prefix: "rq", service: service.to_owned(), suffix: "Request" };
        Self { name, dds_type: dds_type(service_type, "srv", "_Request") }
    }

    /// Returns the topic of replies.
    pub fn replies(service: &str, service_type: &str) -> Self {
        let name = ServiceTopicName { prefix: "rr", service: service.to_owned(), suffix: "Reply" };
        Self { name, dds_type: dds_type(service_type, "srv", "_Response") }
    }
}
