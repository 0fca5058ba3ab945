//! The queue of frames for one client: bounded, drops the oldest first, keeps only the newest map.

mod pressure;

pub use pressure::BegunFrames;
use pressure::ReducedMap;

use super::buffers::{BufferPool, SharedFrame};
use super::link::{BulkBudget, Urgency};
use msg::Monotonic;
use ros_messages::cdr::Dialect;
use std::collections::VecDeque;
use std::io::{self, IoSlice};

/// Frames handed to the socket in one vectored write.
const FRAMES_PER_WRITE: usize = 64;
/// Bytes written for one client before other clients get their turn, so that a large map delays nobody else.
pub const BYTES_PER_TURN: usize = 1 << 20;
/// Notices (`__error`, `__warn`, `__log`) that may wait; more are dropped and counted.
const NOTICES_MAX: usize = 64;
/// Bytes of replies (service frames, topic lists) that may wait.
///
/// Replies are never dropped: a client that does not read them is disconnected. One reply that is longer may wait
/// alone.
const REPLY_BYTES_MAX: usize = 1 << 20;
/// Size of a page of memory: only pages of a buffer that were written count as used.
const PAGE_BYTES: usize = 4096;

/// What a frame has to do with a map, which a slow connection may get with larger cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MapRole {
    /// Nothing, or its cells are larger already.
    None,
    /// A whole map in this encoding: its cells may be made larger.
    Whole(Dialect),
    /// Changes of the map of this topic: a client whose map has larger cells cannot use them.
    UpdateOf(usize),
}

/// The kind of a waiting frame: it decides what happens when the queue is full.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameKind {
    /// Handshake, topic list or service frame: never dropped.
    Reply,
    /// Text for a person: a new one is dropped if [`NOTICES_MAX`] wait.
    Notice,
    /// A message of a topic: the newest `depth` messages of that topic wait.
    ///
    /// At depth 1 a newer message takes the queue position of the older one, so that a slow client still gets its
    /// map, and always the newest.
    Topic {
        /// The topic's index in the table of topics.
        id: usize,
        /// At least 1.
        depth: usize,
        /// Whether the frame counts against the byte limit. The fleet's own maps do not: all clients share them.
        counted: bool,
        /// When the frame is written, if several wait.
        urgency: Urgency,
        /// Whether the frame is worthless once it is older than [`LIVE_AGE_MAX`].
        expires: bool,
        /// What the frame has to do with maps.
        map: MapRole,
    },
}

impl FrameKind {
    fn urgency(self) -> Urgency {
        match self {
            Self::Reply | Self::Notice => Urgency::Live,
            Self::Topic { urgency, .. } => urgency,
        }
    }

    fn map(self) -> MapRole {
        match self {
            Self::Topic { map, .. } => map,
            _ => MapRole::None,
        }
    }
}

/// Returns the memory that a frame uses: buffers are larger than their frames, but untouched pages cost nothing.
pub(super) fn memory_bytes(frame: &SharedFrame) -> usize {
    frame.len().next_multiple_of(PAGE_BYTES).min(frame.capacity())
}

struct WaitingFrame {
    kind: FrameKind,
    frame: SharedFrame,
    /// When the frame was queued.
    at: Monotonic,
}

/// How far a flush got.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlushOutcome {
    /// No frame waits any more.
    Complete,
    /// The socket accepts no more bytes now.
    Blocked,
    /// The socket would accept more, but other clients are to be served first.
    TurnEnded,
}

/// More replies wait than the queue may hold: the client does not read what it asked for.
#[derive(Debug, PartialEq, Eq)]
pub struct Overflow;

/// Frames that wait for one client.
// More than 12 fields: the frames, their totals, and what the connection admits now.
pub struct OutgoingQueue {
    /// The frame that is being written, and how many of its bytes are. Once begun it must be written whole.
    writing: Option<(SharedFrame, usize)>,
    /// In the order in which they are written: by age; while the connection is slow, by urgency and then by age.
    frames: VecDeque<WaitingFrame>,
    /// The number of messages in `frames`, by topic.
    waiting_by_topic: Vec<u32>,
    notices: usize,
    reply_bytes: usize,
    topic_bytes: usize,
    /// The number of frames that make up `topic_bytes`.
    counted_frames: usize,
    topic_bytes_max: usize,
    dropped: u64,
    /// The bulk frames that may be begun in this call.
    budget: BulkBudget,
    /// The maps that were sent with larger cells.
    reduced: Vec<ReducedMap>,
    /// What was begun since it was asked for last.
    begun: BegunFrames,
    /// Whether urgent frames go before others: the connection takes less than is published.
    is_slow: bool,
    /// The time of the call.
    now: Monotonic,
}

impl OutgoingQueue {
    /// Creates an empty queue that holds at most `topic_bytes_max` bytes of topic messages.
    pub fn new(topic_bytes_max: usize) -> Self {
        Self {
            writing: None,
            frames: VecDeque::with_capacity(FRAMES_PER_WRITE),
            waiting_by_topic: Vec::new(),
            notices: 0,
            reply_bytes: 0,
            topic_bytes: 0,
            counted_frames: 0,
            topic_bytes_max,
            dropped: 0,
            budget: BulkBudget::UNLIMITED,
            reduced: Vec::new(),
            begun: BegunFrames::default(),
            is_slow: false,
            now: Monotonic(0),
        }
    }

    /// Creates a queue that holds one buffer of whole frames.
    pub fn with_frames(frames: SharedFrame) -> Self {
        Self { writing: Some((frames, 0)), ..Self::new(0) }
    }

    /// Returns how many messages were dropped or replaced by newer ones.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Returns the bytes that wait, of all kinds.
    pub fn bytes(&self) -> usize {
        let writing = self.writing.as_ref().map_or(0, |(frame, sent)| frame.len() - sent);
        writing + self.frames.iter().map(|waiting| waiting.frame.len()).sum::<usize>()
    }

    /// Returns whether pushing this frame would drop one.
    pub fn is_full(&self, kind: FrameKind, frame: &SharedFrame) -> bool {
        let bytes = memory_bytes(frame);
        match kind {
            FrameKind::Reply => self.reply_bytes > 0 && self.reply_bytes + bytes > REPLY_BYTES_MAX,
            FrameKind::Notice => self.notices >= NOTICES_MAX,
            FrameKind::Topic { id, depth, counted, .. } => {
                let waiting = self.waiting_by_topic.get(id).copied().unwrap_or(0) as usize;
                waiting >= depth || (counted && self.topic_bytes + bytes > self.topic_bytes_max)
            }
        }
    }

    /// Puts a frame at the end of the queue, or in the position of an older message of its topic.
    ///
    /// Fails if the frame is a reply and the client has left too many replies unread.
    pub fn push(
        &mut self,
        kind: FrameKind,
        frame: SharedFrame,
        pool: &mut BufferPool,
    ) -> Result<(), Overflow> {
        match kind {
            FrameKind::Reply if self.is_full(kind, &frame) => return Err(Overflow),
            FrameKind::Notice if self.is_full(kind, &frame) => {
                self.dropped += 1;
                pool.recycle(frame);
                return Ok(());
            }
            FrameKind::Topic { id, depth, .. } if self.waiting_of(id) >= depth => {
                if depth == 1 {
                    self.replace(id, kind, frame, pool);
                    self.trim(pool);
                    return Ok(());
                }
                self.drop_oldest(|kind| is_of_topic(kind, id), pool);
            }
            _ => {}
        }
        self.add_to_totals(kind, memory_bytes(&frame));
        let mut place = self.frames.len();
        while self.is_slow && place > 0 && self.frames[place - 1].kind.urgency() > kind.urgency() {
            place -= 1;
        }
        self.frames.insert(place, WaitingFrame { kind, frame, at: self.now });
        self.trim(pool);
        Ok(())
    }

    /// Drops the oldest messages until the byte limit holds. One message longer than the limit may wait alone.
    fn trim(&mut self, pool: &mut BufferPool) {
        while self.topic_bytes > self.topic_bytes_max && self.counted_frames > 1 {
            let is_counted = |kind| matches!(kind, FrameKind::Topic { counted: true, .. });
            let last = self.frames.iter().rev().find(|waiting| is_counted(waiting.kind));
            let Some(urgency) = last.map(|waiting| waiting.kind.urgency()) else { return };
            self.drop_oldest(|kind| is_counted(kind) && kind.urgency() == urgency, pool);
        }
    }

    /// Returns whether a frame can be written now.
    fn has_writable(&self) -> bool {
        self.writing.is_some() || self.frames.iter().any(|waiting| !waiting.is_held(self.budget))
    }

    fn waiting_of(&mut self, topic: usize) -> usize {
        if self.waiting_by_topic.len() <= topic {
            self.waiting_by_topic.resize(topic + 1, 0);
        }
        self.waiting_by_topic[topic] as usize
    }

    fn add_to_totals(&mut self, kind: FrameKind, bytes: usize) {
        match kind {
            FrameKind::Reply => self.reply_bytes += bytes,
            FrameKind::Notice => self.notices += 1,
            FrameKind::Topic { id, counted, .. } => {
                if let Some(depth) = self.waiting_by_topic.get_mut(id) {
                    *depth += 1;
                }
                if counted {
                    self.topic_bytes += bytes;
                    self.counted_frames += 1;
                }
            }
        }
    }

    fn subtract_from_totals(&mut self, kind: FrameKind, bytes: usize) {
        match kind {
            FrameKind::Reply => self.reply_bytes = self.reply_bytes.saturating_sub(bytes),
            FrameKind::Notice => self.notices = self.notices.saturating_sub(1),
            FrameKind::Topic { id, counted, .. } => {
                if let Some(depth) = self.waiting_by_topic.get_mut(id) {
                    *depth = depth.saturating_sub(1);
                }
                if counted {
                    self.topic_bytes = self.topic_bytes.saturating_sub(bytes);
                    self.counted_frames = self.counted_frames.saturating_sub(1);
                }
            }
        }
    }

    fn replace(&mut self, topic: usize, kind: FrameKind, frame: SharedFrame, pool: &mut BufferPool) {
        let Some(place) = self.frames.iter().position(|waiting| is_of_topic(waiting.kind, topic)) else {
            return;
        };
        let new_bytes = memory_bytes(&frame);
        let old = std::mem::replace(&mut self.frames[place], WaitingFrame { kind, frame, at: self.now });
        self.subtract_from_totals(old.kind, memory_bytes(&old.frame));
        self.add_to_totals(kind, new_bytes);
        pool.recycle(old.frame);
        self.dropped += 1;
    }

    fn drop_oldest(&mut self, is_wanted: impl Fn(FrameKind) -> bool, pool: &mut BufferPool) {
        if let Some(place) = self.frames.iter().position(|waiting| is_wanted(waiting.kind)) {
            self.remove(place, pool);
            self.dropped += 1;
        }
    }

    fn remove(&mut self, place: usize, pool: &mut BufferPool) {
        if let Some(old) = self.frames.remove(place) {
            self.subtract_from_totals(old.kind, memory_bytes(&old.frame));
            pool.recycle(old.frame);
        }
    }

    /// Removes the waiting messages of a topic that the client no longer subscribes to.
    pub fn remove_topic(&mut self, topic: usize, pool: &mut BufferPool) {
        self.reduced.retain(|reduced| reduced.topic != topic);
        while let Some(place) = self.frames.iter().position(|waiting| is_of_topic(waiting.kind, topic)) {
            self.remove(place, pool);
        }
    }

    /// Writes until the queue is empty, the socket blocks, or the turn is over. `write` is a vectored write.
    pub fn flush(
        &mut self,
        mut write: impl FnMut(&[IoSlice<'_>]) -> io::Result<usize>,
        pool: &mut BufferPool,
    ) -> io::Result<FlushOutcome> {
        let mut written_in_turn = 0;
        while self.has_writable() {
            if written_in_turn >= BYTES_PER_TURN {
                return Ok(FlushOutcome::TurnEnded);
            }
            let written = match self.write_once(&mut write) {
                Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
                Ok(written) => written,
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(FlushOutcome::Blocked),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                Err(error) => return Err(error),
            };
            written_in_turn += written;
            self.advance(written, pool);
        }
        Ok(FlushOutcome::Complete)
    }

    fn write_once(&self, write: &mut impl FnMut(&[IoSlice<'_>]) -> io::Result<usize>) -> io::Result<usize> {
        let mut slices = [IoSlice::new(&[]); FRAMES_PER_WRITE];
        let (mut count, mut total) = (0, 0);
        let begun = self.writing.as_ref().map(|(frame, written)| &frame[*written..]);
        let mut budget = self.budget;
        let writable = self.frames.iter().filter(|waiting| waiting.is_admitted(&mut budget));
        for frame in begun.into_iter().chain(writable.map(|waiting| waiting.frame.as_slice())) {
            if count == FRAMES_PER_WRITE || total >= BYTES_PER_TURN {
                break;
            }
            let part = &frame[..frame.len().min(BYTES_PER_TURN)];
            slices[count] = IoSlice::new(part);
            count += 1;
            total += part.len();
            if part.len() < frame.len() {
                break;
            }
        }
        write(&slices[..count])
    }

    /// Removes `written` bytes from the front; a frame of which only a part was written is continued later.
    fn advance(&mut self, mut written: usize, pool: &mut BufferPool) {
        while written > 0 {
            if self.writing.is_none() {
                let budget = &mut self.budget;
                let place = self.frames.iter().position(|waiting| waiting.is_admitted(budget));
                let Some(next) = place.and_then(|place| self.frames.remove(place)) else { return };
                self.subtract_from_totals(next.kind, memory_bytes(&next.frame));
                self.record_begun(&next);
                self.writing = Some((next.frame, 0));
            }
            let Some((frame, begun)) = &mut self.writing else { return };
            let step = written.min(frame.len() - *begun);
            *begun += step;
            written -= step;
            if *begun == frame.len()
                && let Some((frame, _)) = self.writing.take()
            {
                pool.recycle(frame);
            }
        }
    }
}

fn is_of_topic(kind: FrameKind, topic: usize) -> bool {
    matches!(kind, FrameKind::Topic { id, .. } if id == topic)
}

#[cfg(test)]
mod tests;
