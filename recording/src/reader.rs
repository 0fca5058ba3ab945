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
/// Most messages of a chunk: more are no chunk of a recorder, and would need much more memory than they have bytes.
const CHUNK_MESSAGES_MAX: usize = 2_000_000;
/// Bytes before the content of a record: its opcode and length.
const RECORD_HEAD_BYTES: usize = 9;
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
    /// Messages of topics that no readable part of the file names.
    of_unknown_topics: u64,
}

/// Parts of a file that cannot be used.
#[derive(Default)]
struct Damage {
    /// Times of the first damaged chunks in the file, nanoseconds, if they can be read, and why each cannot be used.
    chunks: Vec<(Option<[u64; 2]>, String)>,
    chunk_count: usize,
    /// Records outside chunks that cannot be read.
    records: u64,
    /// Topics and types whose names were read from damaged chunks.
    names: u64,
    /// Why the file ends before its index.
    end: Option<String>,
}

/// Reader of one file. It yields messages in the order of the file, but none of a chunk that is damaged.
pub struct RecordingReader<R> {
    input: R,
    reader: LinearReader,
    tables: Tables,
    /// Messages of the newest chunk.
    waiting: VecDeque<RecordedMessage>,
    damage: Damage,
    /// Beginning of the first chunk that is whole, nanoseconds.
    begin: Option<u64>,
    records: u64,
    is_over: bool,
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
            damage: Damage::default(),
            begin: None,
            records: 0,
            is_over: false,
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
                    self.damage.end = Some(why.to_string());
                }
            }
        }
    }

    /// Returns what of the file cannot be used and why, once the last message was read: it was cut off or damaged.
    pub fn damage(&self) -> Option<String> {
        let Damage { chunks, chunk_count, records, names, end } = &self.damage;
        let begin = chunks.iter().filter_map(|(times, _)| Some(times.as_ref()?[0])).chain(self.begin).min();
        let seconds = |at: u64| at.saturating_sub(begin.unwrap_or_default()) as f64 * 1e-9;
        let chunk = |(times, why): &(Option<[u64; 2]>, String)| match times {
            Some([from, to]) => format!(
                "what was recorded from {:.1} s to {:.1} s after the beginning is damaged and left out ({why})",
                seconds(*from),
                seconds(*to)
            ),
            None => format!("a part is damaged and left out ({why})"),
        };
        let mut damages: Vec<String> = chunks.iter().map(chunk).collect();
        let counts = [
            ((chunk_count - chunks.len()) as u64, "more parts are damaged and left out"),
            (*records, "records cannot be read and are left out"),
            (
                self.tables.of_unknown_topics,
                "messages are left out, whose topics no part that can be read names",
            ),
            (*names, "names of topics and types are known from a damaged part alone"),
        ];
        damages.extend(
            counts.iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}")),
        );
        damages.extend(end.as_ref().map(|why| format!("{why}; used up to there")));
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
        if opcode == op::CHUNK {
            self.damage.take_chunk(data, &mut self.tables, &mut self.waiting, &mut self.begin);
            return Ok(Step::Other);
        }
        if !is_used(opcode) {
            return Ok(Step::Other);
        }
        match parse_record(opcode, data) {
            Ok(record) => Ok(self.tables.take(record).map_or(Step::Other, Step::Message)),
            Err(_) => {
                self.damage.records += 1;
                Ok(Step::Other)
            }
        }
    }
}

/// Whether records of this kind are looked at.
fn is_used(opcode: u8) -> bool {
    [op::SCHEMA, op::CHANNEL, op::MESSAGE, op::METADATA].contains(&opcode)
}

/// Passes the records of a chunk on, with their opcodes, until one cannot be read. If it is to be `checked` there are none where its checksum
/// is wrong: what that covers may be wrong anywhere.
fn for_each_record(
    chunk: &[u8],
    checked: bool,
    mut take: impl FnMut(u8, &[u8]) -> Result<(), McapError>,
) -> Result<(), McapError> {
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(checked)
        .with_record_length_limit(RECORD_BYTES_MAX);
    let mut reader = LinearReader::new_with_options(options);
    let input = [&[op::CHUNK], &(chunk.len() as u64).to_le_bytes()[..], chunk].concat();
    let mut rest = &input[..];
    let mut bytes = 0;
    while let Some(event) = reader.next_event() {
        match event? {
            LinearReadEvent::ReadRequest(wished) => {
                let next = rest.split_off(..wished.min(rest.len())).unwrap_or_default();
                reader.insert(next.len()).copy_from_slice(next);
                reader.notify_read(next.len());
            }
            LinearReadEvent::Record { data, opcode } => {
                bytes += RECORD_HEAD_BYTES + data.len();
                if bytes > RECORD_BYTES_MAX {
                    return Err(McapError::ChunkTooLarge(bytes as u64));
                }
                take(opcode, data)?;
            }
        }
    }
    Ok(())
}

/// Adds the messages of a chunk to those that wait. After an error some of them may be there.
fn take_messages(
    chunk: &[u8],
    uncompressed_bytes: u64,
    tables: &mut Tables,
    waiting: &mut VecDeque<RecordedMessage>,
) -> Result<(), McapError> {
    if uncompressed_bytes > RECORD_BYTES_MAX as u64 {
        return Err(McapError::ChunkTooLarge(uncompressed_bytes));
    }
    let most = waiting.len() + CHUNK_MESSAGES_MAX;
    for_each_record(chunk, true, |opcode, data| {
        if is_used(opcode) {
            waiting.extend(tables.take(parse_record(opcode, data)?));
        }
        if waiting.len() > most { Err(McapError::ChunkTooLarge(uncompressed_bytes)) } else { Ok(()) }
    })
}

impl Damage {
    /// Takes the messages of a chunk if none of it is damaged; else notes that.
    fn take_chunk(
        &mut self,
        chunk: &[u8],
        tables: &mut Tables,
        waiting: &mut VecDeque<RecordedMessage>,
        begin: &mut Option<u64>,
    ) {
        let header = match parse_record(op::CHUNK, chunk) {
            Ok(Record::Chunk { header, .. }) => header,
            Ok(_) => return,
            Err(why) => return self.add_chunk(None, &why),
        };
        let before = waiting.len();
        match take_messages(chunk, header.uncompressed_size, tables, waiting) {
            Ok(()) => {
                begin.get_or_insert(header.message_start_time);
            }
            Err(why) => {
                waiting.truncate(before);
                self.add_chunk(Some([header.message_start_time, header.message_end_time]), &why);
                self.names += tables.take_new_names(chunk);
            }
        }
    }

    fn add_chunk(&mut self, times: Option<[u64; 2]>, why: &McapError) {
        self.chunk_count += 1;
        if self.chunks.len() < DAMAGED_NAMED_MAX {
            self.chunks.push((times, why.to_string()));
        }
    }
}

impl Tables {
    /// Takes the names of topics and types from a damaged chunk, which later chunks may need, where nothing is known under their numbers and
    /// the chunk has one name for each; returns how many.
    fn take_new_names(&mut self, chunk: &[u8]) -> u64 {
        let mut names: BTreeMap<(u8, u16), Option<Record<'static>>> = BTreeMap::new();
        // What can be read before the damage counts.
        let _ = for_each_record(chunk, false, |opcode, data| {
            if ![op::SCHEMA, op::CHANNEL].contains(&opcode) || names.len() > TOPICS_MAX {
                return Ok(());
            }
            let record = parse_record(opcode, data)?.into_owned();
            let number = match &record {
                Record::Schema { header, .. } if !self.types.contains_key(&header.id) => header.id,
                Record::Channel(channel) if !self.channels.contains_key(&channel.id) => channel.id,
                _ => return Ok(()),
            };
            let mut record = Some(record);
            names.entry((opcode, number)).and_modify(|known| *known = None).or_insert_with(|| record.take());
            Ok(())
        });
        // Types first: a topic has its type's name.
        let records: Vec<Record<'_>> = names.into_values().flatten().collect();
        let count = records.len() as u64;
        for record in records {
            self.take(record);
        }
        count
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
                let Some(channel) = self.channels.get(&header.channel_id) else {
                    self.of_unknown_topics += 1;
                    return None;
                };
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
