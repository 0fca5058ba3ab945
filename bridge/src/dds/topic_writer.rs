//! The writer of one topic: it knows its readers, and for a latched topic the newest message.

use super::entities::RawWriter;
use super::raw::SerializedMessage;
use msg::Monotonic;
use ros_messages::cdr::Writer;
use ros2_client::dds::rustdds::bytes::Bytes;
use ros2_client::dds::rustdds::dds::{CreateResult, WriteError};
use ros2_client::dds::rustdds::policy::{Deadline, Durability, History, ResourceLimits};
use ros2_client::dds::rustdds::{
    DomainParticipantStatusEvent, Duration, GUID, Publisher, QosPolicies, QosPolicyBuilder, RTPSEntity,
    Timestamp, Topic,
};
use std::collections::BTreeSet;

/// A writer may wait for a reader that acknowledges nothing for this long; then a new writer serves the others. It is
/// longer than the largest map takes.
const BLOCKED_MAX: std::time::Duration = std::time::Duration::from_secs(10);
/// RustDDS repairs lost messages five times in this time, 8 times faster than without a deadline. It has no other
/// effect here.
const REPAIR_DEADLINE: Duration = Duration::from_millis(5);
/// Messages of a latched topic that wait for an own reader which never acknowledges, before a new writer is opened.
const OWN_READER_MESSAGES: i32 = 64;
/// The newest messages of a stream that are repaired for a reader that lost them.
const STREAM_HISTORY: i32 = 10;

/// Returns the quality of service of a stream.
///
/// `depth` messages wait for a reader that does not acknowledge. DDS drops a process that has stopped after 20 s, the
/// lease of its participant.
pub fn stream_qos(depth: usize) -> QosPolicies {
    QosPolicyBuilder::new()
        .reliable(Duration::ZERO)
        .durability(Durability::Volatile)
        .history(History::KeepLast { depth: STREAM_HISTORY })
        .resource_limits(limits(depth as i32))
        .build()
}

/// Returns the quality of service of a latched topic (transient local).
///
/// The newest message is kept for late readers; the next is written when all readers have the one before.
pub fn latched_qos() -> QosPolicies {
    latched_qos_with(1)
}

/// Returns the quality of service of a latched topic that the endpoint itself reads, and that seldom changes.
///
/// The next message is written at once: the own reader may never acknowledge
/// ([`EntityFactory::do_own_readers_acknowledge`](super::entities::EntityFactory::do_own_readers_acknowledge)).
pub fn latched_qos_beside_own_reader() -> QosPolicies {
    latched_qos_with(OWN_READER_MESSAGES)
}

/// A latched topic of which this many messages may wait for an acknowledgement.
fn latched_qos_with(messages: i32) -> QosPolicies {
    QosPolicyBuilder::new()
        .reliable(Duration::ZERO)
        .durability(Durability::TransientLocal)
        .history(History::KeepLast { depth: 1 })
        .deadline(Deadline(REPAIR_DEADLINE))
        .resource_limits(limits(messages))
        .build()
}

fn limits(samples: i32) -> ResourceLimits {
    ResourceLimits { max_samples: samples, max_instances: 1, max_samples_per_instance: samples }
}

/// Handles a reader of another participant that has come or gone; returns whether a writer was replaced.
pub fn apply_event<'a>(
    writers: impl Iterator<Item = &'a mut TopicWriter>,
    event: &DomainParticipantStatusEvent,
    now: Monotonic,
) -> bool {
    use DomainParticipantStatusEvent::{
        ParticipantDiscovered, ParticipantLost, ReaderLost, RemoteReaderMatched,
    };
    let mut replaced = false;
    for writer in writers {
        let result = match event {
            // The endpoint's own reader of a name that is command and state takes nothing.
            RemoteReaderMatched { local_writer, remote_reader }
                if writer.guid() == Some(*local_writer) && remote_reader.prefix != local_writer.prefix =>
            {
                writer.add_reader(*remote_reader, now)
            }
            // Its readers follow within milliseconds, and must find no old messages.
            ParticipantDiscovered { .. } => writer.drop_old_messages(),
            ReaderLost { guid, .. } => writer.remove_readers(|reader| reader == guid),
            ParticipantLost { id, .. } => writer.remove_readers(|reader| reader.prefix == *id),
            _ => Ok(false),
        };
        replaced |= result.unwrap_or(false);
    }
    replaced
}

/// What happened to a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WriteOutcome {
    /// It is written, or kept for late readers.
    Written,
    /// It is not needed: the topic has no reader.
    NoReader,
    /// It is dropped: a reader does not acknowledge.
    Dropped,
}

/// The newest message of a latched topic.
#[derive(Default)]
struct Latched {
    newest: Option<Bytes>,
    /// Whether the newest message is not written yet.
    is_due: bool,
    /// Messages that the present writer has written. RustDDS keeps old ones for seconds and would send them all.
    written: u64,
}

/// The writer of one topic.
pub struct TopicWriter {
    publisher: Publisher,
    topic: Topic,
    qos: QosPolicies,
    /// None if it is not opened yet, or RustDDS could not create it; it is tried with each tick.
    writer: Option<RawWriter>,
    readers: BTreeSet<GUID>,
    latched: Option<Latched>,
    blocked_since: Option<Monotonic>,
    /// Length of the last message, bytes: the size of the next buffer.
    last_bytes: usize,
}

impl TopicWriter {
    /// Creates the writer of a stream, or of a latched topic if the quality of service is transient local. It is on DDS from
    /// [`Self::open`] or the next [`Self::retry`] on.
    pub fn unopened(publisher: &Publisher, topic: Topic, qos: QosPolicies) -> Self {
        let is_latched = qos.durability() == Some(Durability::TransientLocal);
        Self {
            publisher: publisher.clone(),
            topic,
            qos,
            writer: None,
            readers: BTreeSet::new(),
            latched: is_latched.then(Latched::default),
            blocked_since: None,
            last_bytes: 0,
        }
    }

    /// Returns the identifier of the present writer.
    pub fn guid(&self) -> Option<GUID> {
        self.writer.as_ref().map(RTPSEntity::guid)
    }

    /// Returns the number of readers.
    pub fn readers(&self) -> usize {
        self.readers.len()
    }

    /// Encodes a message and writes it, if it is needed.
    pub fn write(&mut self, now: Monotonic, encode: impl FnOnce(&mut Writer<'_>)) -> WriteOutcome {
        let is_needed = self.latched.is_some() || !self.readers.is_empty();
        if !is_needed {
            return WriteOutcome::NoReader;
        }
        let mut bytes = Vec::with_capacity(self.last_bytes);
        encode(&mut Writer::new(&mut bytes));
        self.last_bytes = bytes.len();
        self.write_bytes(now, bytes.into())
    }

    /// Writes a message that is encoded already.
    pub fn write_bytes(&mut self, now: Monotonic, bytes: Bytes) -> WriteOutcome {
        let Some(latched) = &mut self.latched else {
            return if self.readers.is_empty() { WriteOutcome::NoReader } else { self.write_now(now, bytes) };
        };
        latched.newest = Some(bytes);
        latched.is_due = true;
        self.write_latched(now);
        WriteOutcome::Written
    }

    /// Returns the newest message of a latched topic.
    pub fn newest(&self) -> Option<Bytes> {
        self.latched.as_ref()?.newest.clone()
    }

    /// Writes the newest message of a latched topic, if there is a reader, and all have taken those before or these may wait.
    fn write_latched(&mut self, now: Monotonic) {
        let Some(latched) = &self.latched else { return };
        let messages_max = self.qos.resource_limits().map_or(1, |limits| limits.max_samples);
        let is_full = messages_max > 1 && latched.written >= messages_max as u64;
        if latched.is_due && is_full {
            // The readers are matched with the new one, which then writes the message. One that cannot be created is tried again.
            let _ = self.open();
            return;
        }
        let Some(bytes) = latched.newest.clone().filter(|_| latched.is_due && !self.readers.is_empty())
        else {
            return;
        };
        if self.write_now(now, bytes) == WriteOutcome::Written
            && let Some(latched) = &mut self.latched
        {
            latched.is_due = false;
            latched.written += 1;
        }
    }

    fn write_now(&mut self, now: Monotonic, bytes: Bytes) -> WriteOutcome {
        let Some(writer) = &self.writer else { return WriteOutcome::Dropped };
        match writer.write(SerializedMessage(bytes), Some(Timestamp::now())) {
            Ok(()) => {
                self.blocked_since = None;
                WriteOutcome::Written
            }
            Err(WriteError::WouldBlock { .. }) => {
                self.blocked_since.get_or_insert(now);
                WriteOutcome::Dropped
            }
            Err(_) => WriteOutcome::Dropped,
        }
    }

    /// Adds a reader; returns whether the writer was replaced.
    pub fn add_reader(&mut self, reader: GUID, now: Monotonic) -> CreateResult<bool> {
        let is_new = self.readers.insert(reader);
        let Some(latched) = &self.latched else { return Ok(false) };
        // A reader of a participant that was known before: its request for old messages may come before this.
        let must_replace = is_new && latched.written > 1;
        if must_replace {
            self.open()?;
        }
        self.write_latched(now);
        Ok(must_replace)
    }

    /// Replaces a writer that keeps more than the newest message; returns whether it did.
    ///
    /// RustDDS keeps old messages of a latched topic for 6 s. It sends all that it keeps to a new reader, 5 ms after the
    /// reader's request: a writer that is replaced only when the reader is matched may have sent them on a busy machine.
    fn drop_old_messages(&mut self) -> CreateResult<bool> {
        let must_replace = self.latched.as_ref().is_some_and(|latched| latched.written > 1);
        if must_replace {
            self.open()?;
        }
        Ok(must_replace)
    }

    /// Removes readers; returns whether the writer was replaced.
    pub fn remove_readers(&mut self, is_lost: impl Fn(&GUID) -> bool) -> CreateResult<bool> {
        let before = self.readers.len();
        self.readers.retain(|reader| !is_lost(reader));
        let has_lost_last = before > 0 && self.readers.is_empty();
        // Without a reader that acknowledges, RustDDS would keep every message.
        let must_replace = has_lost_last && self.latched.as_ref().is_some_and(|latched| latched.written > 0);
        if must_replace {
            self.open()?;
        }
        Ok(must_replace)
    }

    /// Retries a latched message, and replaces a writer that a reader has blocked for long or that could not be
    /// created; returns whether it did.
    pub fn retry(&mut self, now: Monotonic) -> CreateResult<bool> {
        let is_stuck = self.blocked_since.is_some_and(|since| now >= since + BLOCKED_MAX);
        let must_replace = is_stuck || self.writer.is_none();
        if must_replace {
            self.open()?;
        }
        self.write_latched(now);
        Ok(must_replace)
    }

    /// Opens a new writer without old messages, in place of the one before; DDS matches the readers with it anew.
    ///
    /// The old one is dropped first: a writer takes up to 11 ms to create, in which the old one would send its messages.
    pub fn open(&mut self) -> CreateResult<()> {
        self.writer = None;
        self.readers.clear();
        self.blocked_since = None;
        if let Some(latched) = &mut self.latched {
            latched.is_due = latched.newest.is_some();
            latched.written = 0;
        }
        self.writer = Some(self.publisher.create_datawriter_no_key(&self.topic, Some(self.qos.clone()))?);
        Ok(())
    }
}
