//! Makes the bytes of a recording: an MCAP file with ROS 2 messages in CDR.

use crate::counts::{Durability, PartCounts, TopicCount, TopicIndex};
use crate::rosbag2::{self, Bag, interface_name, offered_qos_profiles};
use crate::{COUNTS, METADATA};
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{Compression, McapError, WriteOptions};
use msg::Stamp;
use ros_messages::schema::schema;
use std::collections::BTreeMap;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};

/// Size of a chunk before compression, bytes. A chunk also ends at each [`RecordingWriter::flush`].
const CHUNK_BYTES: u64 = 1 << 20;

/// Reason why a message is not in a recording.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// No definition of the type is known.
    #[error("topic {topic}: no definition of the message type {message_type} is known")]
    UnknownType {
        /// Name of the topic.
        topic: String,
        /// Type as `package/Type`.
        message_type: String,
    },
    /// The container cannot hold it.
    #[error("cannot write MCAP: {0}")]
    Container(#[from] McapError),
}

/// Bytes that the container has written and nobody has taken.
#[derive(Clone, Default)]
struct Buffer(Arc<Mutex<Vec<u8>>>);

impl Buffer {
    /// The writer and the container have it in turns, in one thread.
    fn bytes(&self) -> std::sync::MutexGuard<'_, Vec<u8>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl io::Write for Buffer {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.bytes().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// One topic of a file.
struct Topic {
    channel: u16,
    count: TopicCount,
}

/// Bytes that are to be appended to the file, with the messages that can be read when they are there.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Part {
    /// Bytes of whole chunks.
    pub bytes: Vec<u8>,
    /// Messages of these chunks.
    pub counts: PartCounts,
}

/// Writer of one file.
pub struct RecordingWriter {
    container: mcap::Writer<NoSeek<Buffer>>,
    buffer: Buffer,
    topics: Vec<Topic>,
    /// Messages of the chunk that is not in the buffer yet.
    of_chunk: PartCounts,
    /// Messages of the chunks in the buffer.
    of_buffer: PartCounts,
}

impl RecordingWriter {
    /// Begins a file. `description` goes into the metadata record [`METADATA`]; rosbag2's own says how it reads the topics' policies.
    ///
    /// # Errors
    /// The container refuses the description.
    pub fn new(description: &BTreeMap<String, String>) -> Result<Self, WriteError> {
        let buffer = Buffer::default();
        let options = WriteOptions::new()
            .profile("ros2")
            .library(concat!("mr-slam ", env!("CARGO_PKG_VERSION")))
            .compression(Some(Compression::Zstd))
            // The fastest level, in this thread: the fleet needs the other cores.
            .compression_level(1)
            .compression_threads(0)
            .chunk_size(Some(CHUNK_BYTES))
            .disable_seeking(true);
        let mut container = mcap::Writer::with_options(NoSeek::new(buffer.clone()), options)?;
        container.write_metadata(&Metadata { name: METADATA.into(), metadata: description.clone() })?;
        let of_rosbag2 =
            BTreeMap::from([(rosbag2::SERIALIZED_METADATA.into(), Bag::default().description())]);
        container.write_metadata(&Metadata { name: rosbag2::METADATA.into(), metadata: of_rosbag2 })?;
        Ok(Self {
            container,
            buffer,
            topics: Vec::new(),
            of_chunk: PartCounts::default(),
            of_buffer: PartCounts::default(),
        })
    }

    /// Adds a topic of a type `package/Type`.
    ///
    /// # Errors
    /// The type has no known definition.
    pub fn add_topic(
        &mut self,
        topic: &str,
        message_type: &str,
        durability: Durability,
    ) -> Result<TopicIndex, WriteError> {
        let unknown =
            || WriteError::UnknownType { topic: topic.to_owned(), message_type: message_type.to_owned() };
        let definition = schema(message_type).ok_or_else(unknown)?;
        let id =
            self.container.add_schema(&interface_name(message_type), "ros2msg", definition.as_bytes())?;
        let qos = offered_qos_profiles(durability);
        let metadata = BTreeMap::from([("offered_qos_profiles".to_owned(), qos.to_owned())]);
        let channel = self.container.add_channel(id, topic, "cdr", &metadata)?;
        let count = TopicCount { topic: topic.to_owned(), ..TopicCount::default() };
        self.topics.push(Topic { channel, count });
        Ok(self.topics.len() - 1)
    }

    /// Writes a message that was sent at this time of the run. Times before 0 become 0, which MCAP begins with.
    ///
    /// # Errors
    /// The container refuses it. A topic that was not added is ignored.
    pub fn write(&mut self, topic: TopicIndex, at: Stamp, payload: &[u8]) -> Result<(), WriteError> {
        let Some(Topic { channel, count }) = self.topics.get_mut(topic) else { return Ok(()) };
        let stamp = Stamp(at.0.max(0));
        let at = stamp.0 as u64;
        let buffered = self.buffer.bytes().len();
        let header = MessageHeader {
            channel_id: *channel,
            sequence: count.messages as u32,
            log_time: at,
            publish_time: at,
        };
        self.container.write_to_known_channel(&header, payload)?;
        count.messages += 1;
        count.bytes += payload.len() as u64;
        // A chunk that is full ends before the message that comes next.
        if self.buffer.bytes().len() > buffered {
            self.of_buffer.append(&std::mem::take(&mut self.of_chunk));
        }
        self.of_chunk.add(topic, stamp, payload.len());
        Ok(())
    }

    /// Ends the chunk, so that all messages so far can be read when the bytes are on disk.
    ///
    /// # Errors
    /// The chunk cannot be compressed.
    pub fn flush(&mut self) -> Result<(), WriteError> {
        self.container.flush()?;
        self.of_buffer.append(&std::mem::take(&mut self.of_chunk));
        Ok(())
    }

    /// Returns what is to be appended to the file.
    pub fn take_part(&mut self) -> Part {
        let bytes = std::mem::take(&mut *self.buffer.bytes());
        Part { bytes, counts: std::mem::take(&mut self.of_buffer) }
    }

    /// Returns the number of messages that no part that was taken has.
    pub fn waiting_messages(&self) -> u64 {
        self.of_buffer.messages + self.of_chunk.messages
    }

    /// Returns the number of messages of each topic.
    pub fn counts(&self) -> impl Iterator<Item = &TopicCount> {
        self.topics.iter().map(|topic| &topic.count)
    }

    /// Ends the file with its index and counts, and returns its last bytes.
    ///
    /// # Errors
    /// The last chunk cannot be compressed.
    pub fn finish(mut self) -> Result<Vec<u8>, WriteError> {
        let counts = self.counts().map(|count| (count.topic.clone(), count.messages.to_string())).collect();
        self.container.write_metadata(&Metadata { name: COUNTS.into(), metadata: counts })?;
        self.container.finish()?;
        Ok(self.take_part().bytes)
    }
}
