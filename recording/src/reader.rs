//! Reads MCAP files from their beginning, up to the place where a broken one ends.

use mcap::records::Record;
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{McapError, parse_record};
use msg::Stamp;
use std::collections::{BTreeMap, HashMap};
use std::io::Read;
use std::rc::Rc;

/// Longest record or chunk that is read, bytes: four maps of the largest size.
const RECORD_BYTES_MAX: usize = 256 << 20;
/// Most topics of a file.
const TOPICS_MAX: usize = 4096;
/// Bytes that are read from the file at once.
const READ_BYTES: usize = 64 << 10;
/// Longest metadata record that is kept, bytes.
const METADATA_BYTES_MAX: usize = 1 << 20;

/// Reason why a file cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The system cannot read the file.
    #[error("cannot read: {0}")]
    Io(#[from] std::io::Error),
    /// The file is no MCAP, or its beginning is damaged.
    #[error("not an MCAP file: {0}")]
    NoMcap(McapError),
}

/// A message as a file has it.
#[derive(Clone, Debug)]
pub struct RecordedMessage {
    /// Name of the topic.
    pub topic: Rc<str>,
    /// Type as `package/Type`; empty if the file does not say.
    pub message_type: Rc<str>,
    /// Encoding of the payload, such as `cdr`.
    pub encoding: Rc<str>,
    /// When it was recorded, nanoseconds.
    pub at: Stamp,
    /// The message as it was encoded.
    pub payload: Vec<u8>,
}

/// A topic of the file.
struct Channel {
    topic: Rc<str>,
    encoding: Rc<str>,
    message_type: Rc<str>,
}

/// Reader of one file. It yields messages in the order of the file.
pub struct RecordingReader<R> {
    input: R,
    reader: LinearReader,
    types: HashMap<u16, Rc<str>>,
    channels: HashMap<u16, Channel>,
    metadata: BTreeMap<String, BTreeMap<String, String>>,
    records: u64,
    is_over: bool,
    broken: Option<String>,
}

/// What the next step of reading gave.
enum Step {
    Message(RecordedMessage),
    Other,
    Missing(usize),
    End,
}

impl<R: Read> RecordingReader<R> {
    /// Begins to read.
    pub fn new(input: R) -> Self {
        let options = LinearReaderOptions::default()
            .with_validate_chunk_crcs(true)
            .with_record_length_limit(RECORD_BYTES_MAX);
        Self {
            input,
            reader: LinearReader::new_with_options(options),
            types: HashMap::new(),
            channels: HashMap::new(),
            metadata: BTreeMap::new(),
            records: 0,
            is_over: false,
            broken: None,
        }
    }

    /// Returns the next message; `None` at the end, and where a broken file ends: see [`RecordingReader::broken`].
    ///
    /// # Errors
    /// The file cannot be read, or is no MCAP.
    pub fn next_message(&mut self) -> Result<Option<RecordedMessage>, ReadError> {
        while !self.is_over {
            match self.step() {
                Ok(Step::Message(message)) => return Ok(Some(message)),
                Ok(Step::Other) => {}
                Ok(Step::Missing(bytes)) => {
                    let wished = bytes.clamp(1, READ_BYTES);
                    let read = self.input.read(self.reader.insert(wished))?;
                    self.reader.notify_read(read);
                }
                Ok(Step::End) => self.is_over = true,
                Err(why) => {
                    self.is_over = true;
                    if self.records == 0 {
                        return Err(ReadError::NoMcap(why));
                    }
                    self.broken = Some(why.to_string());
                }
            }
        }
        Ok(None)
    }

    /// Returns why the file ends before its index, once the last message was read: it was cut off or damaged.
    pub fn broken(&self) -> Option<&str> {
        self.broken.as_deref()
    }

    /// Returns a metadata record that was read so far.
    pub fn metadata(&self, name: &str) -> Option<&BTreeMap<String, String>> {
        self.metadata.get(name)
    }

    fn step(&mut self) -> Result<Step, McapError> {
        let record = match self.reader.next_event() {
            None => return Ok(Step::End),
            Some(Err(why)) => return Err(why),
            Some(Ok(LinearReadEvent::ReadRequest(bytes))) => return Ok(Step::Missing(bytes)),
            Some(Ok(LinearReadEvent::Record { data, opcode })) => parse_record(opcode, data)?,
        };
        self.records += 1;
        match record {
            Record::Schema { header, .. } if self.types.len() < TOPICS_MAX => {
                let name = header.name.replacen("/msg/", "/", 1);
                self.types.insert(header.id, name.into());
            }
            Record::Channel(channel) if self.channels.len() < TOPICS_MAX => {
                let message_type = self.types.get(&channel.schema_id).cloned().unwrap_or_else(|| "".into());
                let (topic, encoding) = (channel.topic.into(), channel.message_encoding.into());
                self.channels.insert(channel.id, Channel { topic, encoding, message_type });
            }
            Record::Message { header, data } => {
                let Some(channel) = self.channels.get(&header.channel_id) else { return Ok(Step::Other) };
                return Ok(Step::Message(RecordedMessage {
                    topic: channel.topic.clone(),
                    message_type: channel.message_type.clone(),
                    encoding: channel.encoding.clone(),
                    at: Stamp(i64::try_from(header.log_time).unwrap_or(i64::MAX)),
                    payload: data.into_owned(),
                }));
            }
            Record::Metadata(metadata) => {
                let size =
                    metadata.metadata.iter().map(|(key, value)| key.len() + value.len()).sum::<usize>();
                if size <= METADATA_BYTES_MAX && self.metadata.len() < TOPICS_MAX {
                    self.metadata.insert(metadata.name, metadata.metadata);
                }
            }
            _ => {}
        }
        Ok(Step::Other)
    }
}
