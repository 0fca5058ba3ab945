//! Reads MCAP files from their beginning, without the chunks that are damaged, up to the place where a damaged file ends.

use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{McapError, parse_record};
use msg::Stamp;
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::io::Read;
use std::rc::Rc;

/// Longest record or chunk that is read, bytes, before and after it is decompressed: four maps of the largest size.
const RECORD_BYTES_MAX: usize = 256 << 20;
/// Most topics of a file.
const TOPICS_MAX: usize = 4096;
/// Bytes that are read from the file at once.
const READ_BYTES: usize = 64 << 10;
/// Damaged chunks whose times are named; more are counted.
const DAMAGED_NAMED_MAX: usize = 4;
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

/// Topics, types and metadata that were read so far.
#[derive(Default)]
struct Tables {
    types: HashMap<u16, Rc<str>>,
    channels: HashMap<u16, Channel>,
    metadata: BTreeMap<String, BTreeMap<String, String>>,
}

/// Chunks that cannot be used.
#[derive(Default)]
struct DamagedChunks {
    /// Times of the first ones in the file, nanoseconds, and why each cannot be used.
    named: Vec<([u64; 2], String)>,
    count: usize,
}

/// Reader of one file. It yields messages in the order of the file, but none of a chunk that is damaged.
pub struct RecordingReader<R> {
    input: R,
    reader: LinearReader,
    tables: Tables,
    /// Messages of the newest chunk.
    waiting: VecDeque<RecordedMessage>,
    damaged: DamagedChunks,
    /// Messages of topics that no readable part of the file names.
    of_unknown_topics: u64,
    /// Beginning of the first chunk, nanoseconds.
    begin: Option<u64>,
    records: u64,
    is_over: bool,
    /// Why the file ends before its index.
    end: Option<String>,
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
        let options =
            LinearReaderOptions::default().with_emit_chunks(true).with_record_length_limit(RECORD_BYTES_MAX);
        Self {
            input,
            reader: LinearReader::new_with_options(options),
            tables: Tables::default(),
            waiting: VecDeque::new(),
            damaged: DamagedChunks::default(),
            of_unknown_topics: 0,
            begin: None,
            records: 0,
            is_over: false,
            end: None,
        }
    }

    /// Returns the next message; `None` at the end, and where a damaged file ends: see [`RecordingReader::damage`].
    ///
    /// # Errors
    /// The file cannot be read, or is no MCAP.
    pub fn next_message(&mut self) -> Result<Option<RecordedMessage>, ReadError> {
        loop {
            if let Some(message) = self.waiting.pop_front() {
                return Ok(Some(message));
            }
            if self.is_over {
                return Ok(None);
            }
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
                    self.end = Some(why.to_string());
                }
            }
        }
    }

    /// Returns what of the file cannot be used and why, once the last message was read: it was cut off or damaged.
    pub fn damage(&self) -> Option<String> {
        let begin = self.begin.unwrap_or_default();
        let seconds = |at: u64| at.saturating_sub(begin) as f64 * 1e-9;
        let DamagedChunks { named, count } = &self.damaged;
        let mut damages: Vec<String> = Vec::new();
        for ([from, to], why) in named {
            damages.push(format!(
                "what was recorded from {:.1} s to {:.1} s after the beginning is damaged and left out ({why})",
                seconds(*from),
                seconds(*to)
            ));
        }
        if *count > named.len() {
            damages.push(format!("so are {} more parts", count - named.len()));
        }
        if self.of_unknown_topics > 0 {
            damages.push(format!(
                "{} messages are left out, whose topics no part that can be read names",
                self.of_unknown_topics
            ));
        }
        damages.extend(self.end.as_ref().map(|why| format!("{why}; used up to there")));
        (!damages.is_empty()).then(|| damages.join("; "))
    }

    /// Returns a metadata record that was read so far.
    pub fn metadata(&self, name: &str) -> Option<&BTreeMap<String, String>> {
        self.tables.metadata.get(name)
    }

    fn step(&mut self) -> Result<Step, McapError> {
        let (data, opcode) = match self.reader.next_event() {
            None => return Ok(Step::End),
            Some(Err(why)) => return Err(why),
            Some(Ok(LinearReadEvent::ReadRequest(bytes))) => return Ok(Step::Missing(bytes)),
            Some(Ok(LinearReadEvent::Record { data, opcode })) => (data, opcode),
        };
        self.records += 1;
        let header = match parse_record(opcode, data)? {
            Record::Chunk { header, .. } => header,
            record => return Ok(self.tables.take(record).map_or(Step::Other, Step::Message)),
        };
        self.begin.get_or_insert(header.message_start_time);
        let (records, damage) = records_of_chunk(data, true);
        let Some(why) = damage else {
            for record in records {
                match record {
                    Record::Message { ref header, .. }
                        if !self.tables.channels.contains_key(&header.channel_id) =>
                    {
                        self.of_unknown_topics += 1;
                    }
                    record => self.waiting.extend(self.tables.take(record)),
                }
            }
            return Ok(Step::Other);
        };
        self.damaged.add([header.message_start_time, header.message_end_time], &why);
        // Later chunks need the names of topics that are in this one alone.
        let (records, _) = records_of_chunk(data, false);
        records.into_iter().for_each(|record| self.tables.take_new_name(record));
        Ok(Step::Other)
    }
}

/// Returns the records of a chunk up to what cannot be read, and why that cannot. If it is to be `checked` there are none where its checksum is
/// wrong: what that covers may be wrong anywhere.
fn records_of_chunk(chunk: &[u8], checked: bool) -> (Vec<Record<'static>>, Option<McapError>) {
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(checked)
        .with_record_length_limit(RECORD_BYTES_MAX);
    let mut reader = LinearReader::new_with_options(options);
    let input = [&[op::CHUNK], &(chunk.len() as u64).to_le_bytes()[..], chunk].concat();
    let mut rest = &input[..];
    let mut records = Vec::new();
    while let Some(event) = reader.next_event() {
        match event {
            Ok(LinearReadEvent::ReadRequest(bytes)) => {
                let next = rest.split_off(..bytes.min(rest.len())).unwrap_or_default();
                reader.insert(next.len()).copy_from_slice(next);
                reader.notify_read(next.len());
            }
            Ok(LinearReadEvent::Record { data, opcode }) => match parse_record(opcode, data) {
                Ok(record) => records.push(record.into_owned()),
                Err(why) => return (records, Some(why)),
            },
            Err(why) => return (records, Some(why)),
        }
    }
    (records, None)
}

impl DamagedChunks {
    fn add(&mut self, times: [u64; 2], why: &McapError) {
        self.count += 1;
        if self.named.len() < DAMAGED_NAMED_MAX {
            self.named.push((times, why.to_string()));
        }
    }
}

impl Tables {
    /// Takes the name of a topic or a type from a damaged chunk, if none is known under its number: a name from elsewhere counts more.
    fn take_new_name(&mut self, record: Record<'_>) {
        let is_new = match &record {
            Record::Schema { header, .. } => !self.types.contains_key(&header.id),
            Record::Channel(channel) => !self.channels.contains_key(&channel.id),
            _ => false,
        };
        if is_new {
            self.take(record);
        }
    }

    /// Takes a record; returns the message, if it is one of a known topic.
    fn take(&mut self, record: Record<'_>) -> Option<RecordedMessage> {
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
                let channel = self.channels.get(&header.channel_id)?;
                return Some(RecordedMessage {
                    topic: channel.topic.clone(),
                    message_type: channel.message_type.clone(),
                    encoding: channel.encoding.clone(),
                    at: Stamp(i64::try_from(header.log_time).unwrap_or(i64::MAX)),
                    payload: data.into_owned(),
                });
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
        None
    }
}
