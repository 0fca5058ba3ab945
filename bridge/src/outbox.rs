//! What waits for one client: bounded, oldest dropped first, newest map instead of all maps.

use crate::pool::{Bytes, Pool};
use std::collections::VecDeque;
use std::io::{self, IoSlice};

/// Frames handed to the socket in one call.
const FRAMES_PER_WRITE: usize = 64;
/// Bytes written for one client before others get their turn.
pub const BYTES_PER_TURN: usize = 1 << 20;
/// Notices (`__error`, `__warn`) that wait; more are counted as dropped.
const NOTICES_MAX: usize = 64;
/// Bytes of service frames and lists that may wait. They are never dropped: a client that does not read them
/// is let go. One that is longer may wait, alone.
const ANSWERS_BYTES_MAX: usize = 1 << 20;

/// What the system gives memory by.
const PAGE_BYTES: usize = 4096;

/// What kind of frame waits, which says what may happen to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lane {
    /// Handshake, topic list, service frames: never dropped.
    Answer,
    /// Text for a person: at most a few.
    Notice,
    /// A topic's message: at most `depth` of that topic wait, the newest. At depth 1 a newer one takes the
    /// place of the older, so that a slow client gets its map, always the newest, and not never.
    Topic {
        /// Which.
        id: usize,
        /// At least 1.
        depth: usize,
        /// Whether it counts against the byte limit. The fleet's own maps do not: all clients share them.
        counted: bool,
    },
}

/// The memory that a frame takes: buffers are larger than what is in them, but only pages that were written count.
fn cost(bytes: &Bytes) -> usize {
    bytes.len().next_multiple_of(PAGE_BYTES).min(bytes.capacity())
}

struct Waiting {
    lane: Lane,
    bytes: Bytes,
}

/// Whether a write got everything out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flushed {
    /// Nothing waits.
    All,
    /// The socket takes no more now.
    Blocked,
    /// More would go; others first.
    TurnOver,
}

/// The client does not read what it asked for and may not be dropped.
#[derive(Debug, PartialEq, Eq)]
pub struct Overflow;

/// Frames on their way to one client.
pub struct Outbox {
    /// The frame being written and how much of it is. Once begun it must go out whole.
    writing: Option<(Bytes, usize)>,
    queue: VecDeque<Waiting>,
    /// By topic, how many wait in `queue`.
    depths: Vec<u32>,
    notices: usize,
    answer_bytes: usize,
    topic_bytes: usize,
    /// How many make up `topic_bytes`.
    counted: usize,
    topic_bytes_max: usize,
    dropped: u64,
}

impl Outbox {
    /// At most `topic_bytes_max` of topics' messages wait.
    pub fn new(topic_bytes_max: usize) -> Self {
        Self {
            writing: None,
            queue: VecDeque::with_capacity(FRAMES_PER_WRITE),
            depths: Vec::new(),
            notices: 0,
            answer_bytes: 0,
            topic_bytes: 0,
            counted: 0,
            topic_bytes_max,
            dropped: 0,
        }
    }

    /// With one frame to write, or several in one piece.
    pub fn holding(bytes: Bytes) -> Self {
        Self { writing: Some((bytes, 0)), ..Self::new(0) }
    }

    /// Whether nothing waits.
    pub fn is_empty(&self) -> bool {
        self.writing.is_none() && self.queue.is_empty()
    }

    /// Messages dropped or replaced by newer ones since the start.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Bytes that wait, all lanes.
    pub fn bytes(&self) -> usize {
        let writing = self.writing.as_ref().map_or(0, |(bytes, sent)| bytes.len() - sent);
        writing + self.queue.iter().map(|waiting| waiting.bytes.len()).sum::<usize>()
    }

    /// Whether a further frame of this lane would push one out.
    pub fn is_full(&self, lane: Lane, bytes: &Bytes) -> bool {
        let bytes = cost(bytes);
        match lane {
            Lane::Answer => self.answer_bytes > 0 && self.answer_bytes + bytes > ANSWERS_BYTES_MAX,
            Lane::Notice => self.notices >= NOTICES_MAX,
            Lane::Topic { id, depth, counted } => {
                let waiting = self.depths.get(id).copied().unwrap_or(0) as usize;
                waiting >= depth || (counted && self.topic_bytes + bytes > self.topic_bytes_max)
            }
        }
    }

    /// Puts a frame at the end, or in the place of an older one.
    pub fn push(&mut self, lane: Lane, bytes: Bytes, pool: &mut Pool) -> Result<(), Overflow> {
        match lane {
            Lane::Answer if self.is_full(lane, &bytes) => return Err(Overflow),
            Lane::Notice if self.is_full(lane, &bytes) => {
                self.dropped += 1;
                pool.give_back(bytes);
                return Ok(());
            }
            Lane::Topic { id, depth, .. } if self.waiting(id) >= depth => {
                if depth == 1 {
                    self.replace(id, lane, bytes, pool);
                    self.trim(pool);
                    return Ok(());
                }
                self.drop_oldest(|lane| matches!(lane, Lane::Topic { id: other, .. } if other == id), pool);
            }
            _ => {}
        }
        self.account(lane, cost(&bytes), 1);
        self.queue.push_back(Waiting { lane, bytes });
        self.trim(pool);
        Ok(())
    }

    /// Back under the byte limit. One message longer than the limit may wait, alone.
    fn trim(&mut self, pool: &mut Pool) {
        while self.topic_bytes > self.topic_bytes_max && self.counted > 1 {
            self.drop_oldest(|lane| matches!(lane, Lane::Topic { counted: true, .. }), pool);
        }
    }

    fn waiting(&mut self, id: usize) -> usize {
        if self.depths.len() <= id {
            self.depths.resize(id + 1, 0);
        }
        self.depths[id] as usize
    }

    fn account(&mut self, lane: Lane, bytes: usize, sign: i64) {
        let shift = |total: &mut usize, by: usize| {
            *total = if sign > 0 { *total + by } else { total.saturating_sub(by) };
        };
        match lane {
            Lane::Answer => shift(&mut self.answer_bytes, bytes),
            Lane::Notice => shift(&mut self.notices, 1),
            Lane::Topic { id, counted, .. } => {
                if let Some(depth) = self.depths.get_mut(id) {
                    *depth = if sign > 0 { *depth + 1 } else { depth.saturating_sub(1) };
                }
                if counted {
                    shift(&mut self.topic_bytes, bytes);
                    shift(&mut self.counted, 1);
                }
            }
        }
    }

    fn replace(&mut self, id: usize, lane: Lane, bytes: Bytes, pool: &mut Pool) {
        let place =
            self.queue.iter().position(|w| matches!(w.lane, Lane::Topic { id: other, .. } if other == id));
        let Some(place) = place else { return };
        let (old_lane, old_cost) = (self.queue[place].lane, cost(&self.queue[place].bytes));
        self.account(old_lane, old_cost, -1);
        self.account(lane, cost(&bytes), 1);
        let old = std::mem::replace(&mut self.queue[place], Waiting { lane, bytes });
        pool.give_back(old.bytes);
        self.dropped += 1;
    }

    fn drop_oldest(&mut self, which: impl Fn(Lane) -> bool, pool: &mut Pool) {
        let place = self.queue.iter().position(|waiting| which(waiting.lane));
        if let Some(old) = place.and_then(|place| self.queue.remove(place)) {
            self.account(old.lane, cost(&old.bytes), -1);
            pool.give_back(old.bytes);
            self.dropped += 1;
        }
    }

    /// Forgets what waits of a topic, for a client that no longer wants it.
    pub fn forget(&mut self, topic: usize, pool: &mut Pool) {
        let of_topic = |lane: Lane| matches!(lane, Lane::Topic { id, .. } if id == topic);
        while let Some(place) = self.queue.iter().position(|waiting| of_topic(waiting.lane)) {
            if let Some(old) = self.queue.remove(place) {
                self.account(old.lane, cost(&old.bytes), -1);
                pool.give_back(old.bytes);
            }
        }
    }

    /// Writes until all is out, the socket blocks, or the turn is over. `write` is a vectored write.
    pub fn flush(
        &mut self,
        mut write: impl FnMut(&[IoSlice<'_>]) -> io::Result<usize>,
        pool: &mut Pool,
    ) -> io::Result<Flushed> {
        let mut turn = 0;
        while !self.is_empty() {
            if turn >= BYTES_PER_TURN {
                return Ok(Flushed::TurnOver);
            }
            let sent = match self.write_once(&mut write) {
                Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
                Ok(sent) => sent,
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(Flushed::Blocked),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                Err(error) => return Err(error),
            };
            turn += sent;
            self.advance(sent, pool);
        }
        Ok(Flushed::All)
    }

    fn write_once(&self, write: &mut impl FnMut(&[IoSlice<'_>]) -> io::Result<usize>) -> io::Result<usize> {
        let mut slices = [IoSlice::new(&[]); FRAMES_PER_WRITE];
        let (mut count, mut total) = (0, 0);
        let begun = self.writing.as_ref().map(|(bytes, sent)| &bytes[*sent..]);
        for frame in begun.into_iter().chain(self.queue.iter().map(|waiting| waiting.bytes.as_slice())) {
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

    /// Takes out what the socket has taken; a frame it took in part becomes the one being written.
    fn advance(&mut self, mut sent: usize, pool: &mut Pool) {
        while sent > 0 {
            if self.writing.is_none() {
                let Some(next) = self.queue.pop_front() else { return };
                self.account(next.lane, cost(&next.bytes), -1);
                self.writing = Some((next.bytes, 0));
            }
            let Some((bytes, begun)) = &mut self.writing else { return };
            let step = sent.min(bytes.len() - *begun);
            *begun += step;
            sent -= step;
            if *begun == bytes.len()
                && let Some((bytes, _)) = self.writing.take()
            {
                pool.give_back(bytes);
            }
        }
    }
}

#[cfg(test)]
mod tests;
