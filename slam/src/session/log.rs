//! Session logs: the nodes that a back end received since its session was saved, in records to be appended to a file.
//!
//! ```text
//! magic 8 | length of the content u32 | CRC-32 of the content u32 | content
//! content: identity | number u64 | checksum of the record before u64 | count u64 | nodes | state of the front end
//! ```
//!
//! The back end's result depends on its nodes alone, so that a session and the records after it give the pose graph of
//! the process that wrote them, bit for bit.

use super::bytes::{In, Out};
use super::records::{put_front, put_identity, put_log_node, take_front, take_identity, take_log_node};
use super::{Identity, SessionError};
use crate::back_end::BackEnd;
use crate::front_end::FrontEndState;
use crate::node::{Node, Revision};
use crate::relocalize::PoseEstimate;

/// First bytes of a record.
const MAGIC: [u8; 8] = *b"MRSLOG\r\n";
/// Length of a record's head, bytes.
const HEAD: usize = 16;
/// Nodes of one record; a front end makes a few in the time of one.
const NODES_MAX: usize = 4096;

/// Place in a chain of records: the newest one that a state has in it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LogPosition {
    /// Number of the record; 0 before the first.
    pub number: u64,
    /// Checksum of its content; 0 before the first.
    pub checksum: u32,
}

/// A node as the back end received it.
#[derive(Clone, Debug)]
pub struct LoggedNode {
    /// The node, with the front end's id.
    pub node: Node,
    /// Estimate of the map's pose in the front end's frame, with which an empty map begins.
    pub begins_at: Option<PoseEstimate>,
}

/// One record of a log.
#[derive(Clone, Debug)]
pub struct LogRecord {
    /// Robot and run that it was made by.
    pub identity: Identity,
    /// Its place in the chain.
    pub position: LogPosition,
    /// Checksum of the record before it.
    pub previous: u32,
    /// Nodes since the record before, in order.
    pub nodes: Vec<LoggedNode>,
    /// State of the front end after exactly these nodes.
    pub front: FrontEndState,
}

/// Nodes that wait to be written as one record.
#[derive(Default)]
pub struct LogRecordBuilder {
    nodes: Out,
    count: u64,
}

impl LogRecordBuilder {
    /// Adds a node that the back end is about to receive.
    pub fn add(&mut self, node: &Node, begins_at: Option<PoseEstimate>) {
        put_log_node(&mut self.nodes, node, begins_at);
        self.count += 1;
    }

    /// Returns whether no node waits.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Number of bytes that wait.
    pub fn len(&self) -> usize {
        self.nodes.bytes.len()
    }

    /// Drops the nodes that wait.
    pub fn clear(&mut self) {
        self.nodes.bytes.clear();
        self.count = 0;
    }

    /// Encodes the record after `newest`, with the nodes that wait and the state of the front end after them. `newest`
    /// becomes the record's place.
    pub fn encode(
        &mut self,
        identity: &Identity,
        newest: &mut LogPosition,
        front: &FrontEndState,
    ) -> Vec<u8> {
        let mut out = Out::default();
        out.bytes.reserve(HEAD + self.nodes.bytes.len());
        out.bytes.resize(HEAD, 0);
        put_identity(&mut out, identity);
        out.put(&[newest.number + 1, u64::from(newest.checksum), self.count]);
        out.bytes.extend_from_slice(&self.nodes.bytes);
        put_front(&mut out, front);
        self.clear();
        let mut bytes = out.bytes;
        let checksum = crc32fast::hash(&bytes[HEAD..]);
        let length = (bytes.len() - HEAD) as u32;
        bytes[..8].copy_from_slice(&MAGIC);
        bytes[8..12].copy_from_slice(&length.to_le_bytes());
        bytes[12..16].copy_from_slice(&checksum.to_le_bytes());
        *newest = LogPosition { number: newest.number + 1, checksum };
        bytes
    }
}

/// Records of a log file, up to its end or to the first that is not whole.
#[derive(Clone, Debug, Default)]
pub struct LogContents {
    /// The records, and where in the file each ends, bytes.
    pub records: Vec<(LogRecord, u64)>,
    /// Bytes of whole records, and why what follows is none; `None` if nothing follows.
    pub torn: Option<(u64, SessionError)>,
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
                    contents.torn = Some((end as u64, why));
                    break;
                }
            }
        }
        contents
    }
}

/// Decodes the first record, and returns its length in bytes.
fn take_record(bytes: &[u8]) -> Result<(LogRecord, usize), SessionError> {
    let Some((head, rest)) = bytes.split_at_checked(HEAD) else {
        return Err(SessionError::Ends { what: "a record's head" });
    };
    if !head.starts_with(&MAGIC) {
        return Err(SessionError::Magic);
    }
    let mut head = In::new(&head[MAGIC.len()..]);
    let length = head.take::<u32>("a record's head")? as usize;
    let expected: u32 = head.take("a record's head")?;
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
        let mut from = In::new(content);
        let identity = take_identity(&mut from)?;
        let [number, previous]: [u64; 2] = from.take("a record's number")?;
        let count = from.count(NODES_MAX, "nodes of a record")?;
        let mut nodes = Vec::new();
        for _ in 0..count {
            let (node, begins_at) = take_log_node(&mut from)?;
            nodes.push(LoggedNode { node, begins_at });
        }
        // How many nodes the map has is known when the record is applied.
        let front = take_front(&mut from, usize::MAX)?;
        if !from.is_empty() {
            return Err(SessionError::Value { what: "length (something follows a record's content)" });
        }
        let previous = u32::try_from(previous)
            .map_err(|_| SessionError::Value { what: "checksum of the record before" })?;
        Ok(Self { identity, position: LogPosition { number, checksum }, previous, nodes, front })
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
    /// Receives the nodes of records once more. Returns the front end's state after the last record, with the revisions
    /// that it has yet to apply; `None` without records, or if its local map names nodes that are not there.
    pub fn replay(&mut self, records: Vec<LogRecord>) -> Option<FrontEndState> {
        let mut revisions: Vec<Revision> = Vec::new();
        let mut front = None;
        for record in records {
            for LoggedNode { node, begins_at } in record.nodes {
                if begins_at.is_some() {
                    self.start_relocalization(begins_at);
                }
                revisions.push(self.add_node(node));
            }
            front = Some(record.front);
        }
        let mut front = front.filter(|front| {
            let referenced = [front.recent, front.local_maps[0], front.local_maps[1]];
            referenced.iter().all(|count| *count as usize <= self.nodes().len())
        })?;
        // The front end had not received the newest when it reported its state.
        let newest_known = front.waiting.last().map_or(0, |revision| revision.effective_from);
        let unknown = |revision: &Revision| {
            revision.effective_from >= front.next_node && revision.effective_from > newest_known
        };
        front.waiting.extend(revisions.into_iter().filter(unknown).collect::<Vec<_>>());
        Some(front)
    }
}
