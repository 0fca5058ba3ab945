//! What a queue gives up when its connection is slow, memory is short, or its client is dropped.

use super::super::link::LIVE_AGE_MAX;
use super::{BufferPool, FrameKind, OutgoingQueue, Urgency, WaitingFrame, memory_bytes};
use msg::Monotonic;

/// A dropped client gets the rest of the frame that is being written up to this, bytes; more would take too long.
const LAST_FRAME_MAX: usize = 64 << 10;

impl OutgoingQueue {
    /// Returns the address and the memory of each frame that is held.
    pub fn frames_held(&self) -> impl Iterator<Item = (usize, usize)> {
        let writing = self.writing.as_ref().map(|(frame, _)| frame);
        let all = writing.into_iter().chain(self.frames.iter().map(|waiting| &waiting.frame));
        all.map(|frame| (frame.as_ptr() as usize, memory_bytes(frame)))
    }

    /// Returns the memory of the frames that are held, bytes.
    pub fn memory_held(&self) -> usize {
        self.frames_held().map(|(_, bytes)| bytes).sum()
    }

    /// Drops the oldest messages of topics until at most so many bytes are held; `false` if there is none to drop.
    pub fn drop_oldest_until(&mut self, bytes: usize, pool: &mut BufferPool) -> bool {
        let (before, mut held) = (self.frames.len(), self.memory_held());
        while held > bytes {
            let is_topic = |waiting: &&WaitingFrame| matches!(waiting.kind, FrameKind::Topic { .. });
            let last = self.frames.iter().rev().find(is_topic).map(|waiting| waiting.kind.urgency());
            let is_last = |waiting: &WaitingFrame| is_topic(&waiting) && Some(waiting.kind.urgency()) == last;
            let Some(place) = self.frames.iter().position(is_last) else { break };
            held -= memory_bytes(&self.frames[place].frame);
            self.remove(place, pool);
            self.dropped += 1;
        }
        self.frames.len() < before
    }

    /// Removes the messages of topics. If a large frame is being written, it removes everything: no reason can follow it.
    pub fn keep_last_words(&mut self) {
        let rest = self.writing.as_ref().map_or(0, |(frame, written)| frame.len() - written);
        if rest > LAST_FRAME_MAX {
            return self.clear();
        }
        self.frames.retain(|waiting| !matches!(waiting.kind, FrameKind::Topic { .. }));
    }

    /// Removes everything: the connection ends.
    pub fn clear(&mut self) {
        *self = Self { dropped: self.dropped, ..Self::new(self.topic_bytes_max) };
    }

    /// Sets the time of the next calls, the longest bulk frame that is written until then, and whether frames wait for
    /// the connection.
    pub fn set_link(&mut self, now: Monotonic, bulk_bytes_max: usize, is_slow: bool) {
        (self.now, self.bulk_bytes_max, self.is_slow) = (now, bulk_bytes_max, is_slow);
    }

    /// Drops live messages that are too old: newer ones follow.
    pub fn drop_expired(&mut self, pool: &mut BufferPool) {
        let (now, age_max) = (self.now, LIVE_AGE_MAX.as_nanos() as u64);
        let is_expired = |waiting: &WaitingFrame| {
            matches!(waiting.kind, FrameKind::Topic { expires: true, .. }) && now.since(waiting.at) > age_max
        };
        let mut place = 0;
        while place < self.frames.len() && self.frames[place].kind.urgency() != Urgency::Bulk {
            if is_expired(&self.frames[place]) {
                self.remove(place, pool);
                self.dropped += 1;
            } else {
                place += 1;
            }
        }
    }

    /// Returns the bytes of the bulk frames that are held back now.
    pub fn held_back_bytes(&self) -> usize {
        self.frames
            .iter()
            .filter(|waiting| waiting.is_held(self.bulk_bytes_max))
            .map(|waiting| waiting.frame.len())
            .sum()
    }
}
