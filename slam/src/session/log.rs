//! Session logs: the nodes that a back end received since its session was saved, in records to be appended to a file.
//!
//! ```text
//! magic 8 | version u32 | length of the content u32 | CRC-32 of the content u32 | content
//! ```
//!
//! The content is a [`LogRecord`] without its own checksum, encoded like a session. The version is the sessions'.
//!
//! The back end's result depends on its nodes alone, so that a session and the records after it give the pose graph of
//! the process that wrote them, bit for bit.

use super::{SessionError, SessionIdentity, VERSION, decode_whole, encode_after, word};
use crate::back_end::BackEnd;
use crate::front_end::FrontEndState;
use crate::node::{MapFrameUpdate, Node};
use crate::relocalize::LocalFrameEstimate;
use serde::{Deserialize, Serialize};

/// First bytes of a record.
const MAGIC: [u8; 8] = *b"MRSLOG\r\n";
/// Length of a record's head, bytes.
const HEAD: usize = 20;

/// Place in a chain of records: the newest one that a state has in it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LogPosition {
    /// Number of the record; 0 before the first.
    pub number: u64,
    /// Checksum of its content; 0 before the first.
    pub checksum: u32,
}

/// A node as the back end received it.
#[derive(Clone, Debug, Deserialize)]
pub struct LoggedNode {
    /// The node, with the front end's id.
    pub node: Node,
    /// Estimate of the map's pose in the front end's frame, with which an empty map begins.
    pub begins_at: Option<LocalFrameEstimate>,
}

/// One record of a log.
#[derive(Clone, Debug)]
pub struct LogRecord {
    /// Robot and run that it was made by.
    pub identity: SessionIdentity,
    /// Its place in the chain.
    pub position: LogPosition,
    /// Checksum of the record before it.
    pub previous: u32,
    /// Nodes since the record before, in order.
    pub nodes: Vec<LoggedNode>,
    /// State of the front end after exactly these nodes.
    pub front: FrontEndState,
}

/// Content of a record before its nodes.
#[derive(Serialize, Deserialize)]
struct RecordStart {
    identity: SessionIdentity,
    number: u64,
    /// Checksum of the record before.
    previous: u32,
}

/// Nodes that wait to be written as one record.
#[derive(Default)]
pub struct LogRecordBuilder {
    nodes: Vec<u8>,
    count: usize,
}

impl LogRecordBuilder {
    /// Adds a node that the back end is about to receive.
    pub fn add(&mut self, node: &Node, begins_at: Option<LocalFrameEstimate>) {
        // The fields of a `LoggedNode`.
        self.nodes = encode_after(std::mem::take(&mut self.nodes), &(node, begins_at));
        self.count += 1;
    }

    /// Returns whether no node waits.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Number of bytes that wait.
    pub fn len(&self) -> usize {
        self.nodes.len()
    }

    /// Drops the nodes that wait.
    pub fn clear(&mut self) {
        self.nodes.clear();
        self.count = 0;
    }

    /// Encodes the record after `newest`, with the nodes that wait and the state of the front end after them. `newest`
    /// becomes the record's place. No node waits afterwards.
    ///
    /// # Errors
    /// [`SessionError`] if the record could not be read back, as a value in it is not valid; `newest` is as before.
    pub fn encode(
        &mut self,
        identity: &SessionIdentity,
        newest: &mut LogPosition,
        front: &FrontEndState,
    ) -> Result<Vec<u8>, SessionError> {
        let mut bytes = Vec::with_capacity(HEAD + self.nodes.len());
        bytes.resize(HEAD, 0);
        let (identity, number, previous) = (*identity, newest.number + 1, newest.checksum);
        bytes = encode_after(bytes, &(RecordStart { identity, number, previous }, self.count));
        bytes.extend_from_slice(&self.nodes);
        bytes = encode_after(bytes, front);
        self.clear();
        let checksum = crc32fast::hash(&bytes[HEAD..]);
        // A restart would leave it out, and all records after it.
        LogRecord::decode_content(&bytes[HEAD..], checksum)?;
        let found = (bytes.len() - HEAD) as u64;
        let length = u32::try_from(found).map_err(|_| SessionError::TooLarge { found })?;
        bytes[..8].copy_from_slice(&MAGIC);
        bytes[8..12].copy_from_slice(&VERSION.to_le_bytes());
        bytes[12..16].copy_from_slice(&length.to_le_bytes());
        bytes[16..20].copy_from_slice(&checksum.to_le_bytes());
        *newest = LogPosition { number, checksum };
        Ok(bytes)
    }
}

/// Records of a log file, up to its end or to the first that is not whole.
#[derive(Clone, Debug, Default)]
pub struct LogContents {
    /// The records, and where in the file each ends, bytes.
    pub records: Vec<(LogRecord, u64)>,
    /// Bytes of whole records, and why what follows is none; `None` if nothing follows.
    pub incomplete_tail: Option<(u64, SessionError)>,
}

impl LogContents {
    /// Decodes a file. Whatever follows the last whole record is cut off: a process was killed while it wrote it.
    pub fn decode(bytes: &[u8]) -> Self {
        let mut contents = Self::default();
        let mut end = 0;
        while end < bytes.len() {
            match take_record(&bytes[end..]) {
                Ok((record, length)) => {
                    end += length;
                    contents.records.push((record, end as u64));
                }
                Err(why) => {
                    contents.incomplete_tail = Some((end as u64, why));
                    break;
                }
            }
        }
        contents
    }
}

/// Decodes the first record, and returns its length in bytes.
fn take_record(bytes: &[u8]) -> Result<(LogRecord, usize), SessionError> {
    let Some((head, rest)) = bytes.split_first_chunk::<HEAD>() else {
        return Err(SessionError::Ends { what: "a record's head" });
    };
    if !head.starts_with(&MAGIC) {
        return Err(SessionError::Magic);
    }
    let (version, length, expected) = (word(head, 8), word(head, 12) as usize, word(head, 16));
    if version != VERSION {
        return Err(SessionError::Version { found: version });
    }
    let content = rest.get(..length).ok_or(SessionError::Ends { what: "a record" })?;
    let checksum = crc32fast::hash(content);
    if checksum != expected {
        return Err(SessionError::Checksum { found: checksum, expected });
    }
    Ok((LogRecord::decode_content(content, checksum)?, HEAD + length))
}

impl LogRecord {
    /// Decodes a record's content, whose checksum is `checksum`. Every value is checked.
    ///
    /// # Errors
    /// [`SessionError`] if a value is missing or not valid.
    pub fn decode_content(content: &[u8], checksum: u32) -> Result<Self, SessionError> {
        let (RecordStart { identity, number, previous }, nodes, front) = decode_whole(content)?;
        let record = Self { identity, position: LogPosition { number, checksum }, previous, nodes, front };
        record.validate()?;
        Ok(record)
    }
}

/// Returns the records that continue `newest`, in order: each follows from the one before.
pub fn continuation(newest: LogPosition, records: Vec<LogRecord>) -> Vec<LogRecord> {
    let (mut newest, mut records) = (newest, records);
    let mut chain = Vec::new();
    records.sort_by_key(|record| record.position.number);
    for record in records {
        if record.position.number == newest.number + 1 && record.previous == newest.checksum {
            newest = record.position;
            chain.push(record);
        }
    }
    chain
}

impl BackEnd {
    /// Receives the nodes of records once more. Returns the front end's state after the last record, with the frame updates
    /// that it has yet to apply; `None` without records, or if its local map names nodes that are not there.
    pub fn replay(&mut self, records: Vec<LogRecord>) -> Option<FrontEndState> {
        let mut frame_updates: Vec<MapFrameUpdate> = Vec::new();
        let mut front = None;
        for record in records {
            for LoggedNode { node, begins_at } in record.nodes {
                if begins_at.is_some() {
                    self.start_relocalization(begins_at);
                }
                frame_updates.push(self.add_node(node));
            }
            front = Some(record.front);
        }
        let mut front = front.filter(|front| {
            let referenced = [front.reference_count, front.local_maps[0], front.local_maps[1]];
            referenced.iter().all(|count| *count as usize <= self.nodes().len())
        })?;
        // The front end had not received the newest when it reported its state.
        let newest_known = front.frame_updates.last().map(|frame_update| frame_update.cause_node);
        let unknown = |frame_update: &MapFrameUpdate| {
            frame_update.effective_from_node >= front.next_node
                && newest_known.is_none_or(|known| frame_update.cause_node > known)
        };
        front.frame_updates.extend(frame_updates.into_iter().filter(unknown).collect::<Vec<_>>());
        Some(front)
    }
}
