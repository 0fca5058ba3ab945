//! One topic out: a writer, who reads it, and for states the newest message.

use super::raw::{Adapter, Raw};
use crate::cdr::Writer;
use ros2_client::dds::rustdds::bytes::Bytes;
use ros2_client::dds::rustdds::dds::{CreateResult, WriteError};
use ros2_client::dds::rustdds::no_key::DataWriter;
use ros2_client::dds::rustdds::policy::{Deadline, Durability, History, ResourceLimits};
use ros2_client::dds::rustdds::{
    Duration, GUID, Publisher, QosPolicies, QosPolicyBuilder, RTPSEntity, Timestamp, Topic,
};
use std::collections::BTreeSet;
use std::time::Instant;

/// How long a writer may wait for a reader that takes nothing, before the others are served by a new writer.
/// Longer than the largest map takes.
const STUCK_MAX: std::time::Duration = std::time::Duration::from_secs(10);
/// RustDDS repairs a reader's losses five times in this: 8 times faster than without. It promises nothing here.
const REPAIR_DEADLINE: Duration = Duration::from_millis(5);

/// Streams: the newest few are repaired, and as many wait for a reader that does not acknowledge as are sent
/// in half a minute; a process that has stopped is given up after 20 s (its participant's lease).
pub fn stream_qos(window: i32) -> QosPolicies {
    QosPolicyBuilder::new()
        .reliable(Duration::ZERO)
        .durability(Durability::Volatile)
        .history(History::KeepLast { depth: 10 })
        .resource_limits(limits(window))
        .build()
}

/// States: the newest is kept for late comers. The next is written when all have taken the one before.
pub fn state_qos() -> QosPolicies {
    QosPolicyBuilder::new()
        .reliable(Duration::ZERO)
        .durability(Durability::TransientLocal)
        .history(History::KeepLast { depth: 1 })
        .deadline(Deadline(REPAIR_DEADLINE))
        .resource_limits(limits(1))
        .build()
}

fn limits(samples: i32) -> ResourceLimits {
    ResourceLimits { max_samples: samples, max_instances: 1, max_samples_per_instance: samples }
}

/// What became of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sent {
    /// On its way, or kept for whoever comes.
    Yes,
    /// Nobody wants it.
    Unwanted,
    /// Dropped: a reader does not acknowledge.
    Dropped,
}

/// The newest message of a state, and what the present writer knows of it.
#[derive(Default)]
struct State {
    newest: Option<Bytes>,
    /// The newest has not been written yet.
    due: bool,
    /// Messages written by the present writer. RustDDS keeps old ones for seconds and would tell them all.
    written: u64,
}

/// One topic.
pub struct Sender {
    publisher: Publisher,
    topic: Topic,
    qos: QosPolicies,
    writer: DataWriter<Raw, Adapter>,
    readers: BTreeSet<GUID>,
    state: Option<State>,
    stuck: Option<Instant>,
    typical: usize,
}

impl Sender {
    /// A stream or, if the quality of service is durable, a state.
    pub fn new(publisher: &Publisher, topic: Topic, qos: QosPolicies) -> CreateResult<Self> {
        let writer = publisher.create_datawriter_no_key(&topic, Some(qos.clone()))?;
        let durable = qos.durability() == Some(Durability::TransientLocal);
        let state = durable.then(State::default);
        let publisher = publisher.clone();
        Ok(Self { publisher, topic, qos, writer, readers: BTreeSet::new(), state, stuck: None, typical: 0 })
    }

    /// The present writer.
    pub fn guid(&self) -> GUID {
        self.writer.guid()
    }

    /// How many readers there are.
    pub fn readers(&self) -> usize {
        self.readers.len()
    }

    /// Whether a message would be sent or kept.
    pub fn wanted(&self) -> bool {
        self.state.is_some() || !self.readers.is_empty()
    }

    /// Encodes a message if it is wanted, and sends it.
    pub fn send(&mut self, now: Instant, message: impl FnOnce(&mut Writer<'_>)) -> Sent {
        if !self.wanted() {
            return Sent::Unwanted;
        }
        let mut bytes = Vec::with_capacity(self.typical);
        message(&mut Writer::new(&mut bytes));
        self.typical = bytes.len();
        self.send_bytes(now, bytes.into())
    }

    /// A message that is encoded already.
    pub fn send_bytes(&mut self, now: Instant, bytes: Bytes) -> Sent {
        let Some(state) = &mut self.state else {
            return if self.readers.is_empty() { Sent::Unwanted } else { self.write(now, bytes) };
        };
        state.newest = Some(bytes);
        state.due = true;
        self.catch_up(now);
        Sent::Yes
    }

    /// The newest message of a state.
    pub fn newest(&self) -> Option<Bytes> {
        self.state.as_ref()?.newest.clone()
    }

    /// Writes a state's newest message if somebody is there and the one before has been taken.
    pub fn catch_up(&mut self, now: Instant) {
        let Some(state) = &self.state else { return };
        let Some(bytes) = state.newest.clone().filter(|_| state.due && !self.readers.is_empty()) else {
            return;
        };
        if self.write(now, bytes) == Sent::Yes
            && let Some(state) = &mut self.state
        {
            state.due = false;
            state.written += 1;
        }
    }

    fn write(&mut self, now: Instant, bytes: Bytes) -> Sent {
        match self.writer.write(Raw(bytes), Some(Timestamp::now())) {
            Ok(()) => {
                self.stuck = None;
                Sent::Yes
            }
            Err(WriteError::WouldBlock { .. }) => {
                self.stuck.get_or_insert(now);
                Sent::Dropped
            }
            Err(_) => Sent::Dropped,
        }
    }

    /// A reader has come. Whether the writer had to be renewed.
    pub fn matched(&mut self, reader: GUID, now: Instant) -> CreateResult<bool> {
        let new = self.readers.insert(reader);
        let Some(state) = &self.state else { return Ok(false) };
        // RustDDS tells it what it keeps: right if that is one message, the newest; wrong if there are more.
        let stale = new && state.written > 1;
        if stale {
            self.renew()?;
        }
        self.catch_up(now);
        Ok(stale)
    }

    /// Readers have gone. Whether the writer had to be renewed.
    pub fn lost(&mut self, gone: impl Fn(&GUID) -> bool) -> CreateResult<bool> {
        let before = self.readers.len();
        self.readers.retain(|reader| !gone(reader));
        let deserted = before > 0 && self.readers.is_empty();
        // With nobody to acknowledge, RustDDS would keep all it was ever given.
        let keeps = deserted && self.state.as_ref().is_some_and(|state| state.written > 0);
        if keeps {
            self.renew()?;
        }
        Ok(keeps)
    }

    /// Frees healthy readers from one that has taken nothing for long. Whether the writer had to be renewed.
    pub fn unstick(&mut self, now: Instant) -> CreateResult<bool> {
        let stuck = self.stuck.is_some_and(|since| now >= since + STUCK_MAX);
        if stuck {
            self.renew()?;
        }
        self.catch_up(now);
        Ok(stuck)
    }

    /// A new writer that knows nothing of the past; its readers are matched anew.
    fn renew(&mut self) -> CreateResult<()> {
        self.writer = self.publisher.create_datawriter_no_key(&self.topic, Some(self.qos.clone()))?;
        self.readers.clear();
        self.stuck = None;
        if let Some(state) = &mut self.state {
            state.due = state.newest.is_some();
            state.written = 0;
        }
        Ok(())
    }
}
