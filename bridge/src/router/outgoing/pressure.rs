//! What a queue gives up when its connection is slow, memory is short, or its client is dropped.

use super::super::link::{BulkBudget, LIVE_AGE_MAX};
use super::super::reduced_map::reduce_map;
use super::{
    BufferPool, FrameKind, MapRole, OutgoingQueue, Urgency, WaitingFrame, is_of_topic, memory_bytes,
};
use msg::Monotonic;
use std::rc::Rc;
use std::time::Duration;

/// A dropped client gets the rest of the frame that is being written up to this, bytes; more would take too long.
const LAST_FRAME_MAX: usize = 64 << 10;

/// A map with larger cells is sent again, with smaller ones, if it may be so many times as long.
const REDUCED_GAIN: usize = 2;

/// A map that was sent with larger cells because the connection is slow.
#[derive(Clone, Copy, Debug)]
pub(super) struct ReducedMap {
    /// The topic's index in the table of topics.
    pub topic: usize,
    /// When the whole map was queued.
    at: Monotonic,
    /// Bytes that the map was allowed.
    bytes: usize,
}

/// The frames whose writing was begun.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BegunFrames {
    /// Bytes of bulk frames.
    pub bulk_bytes: usize,
    /// The longest time that a live message had waited.
    pub live_wait: Duration,
}

impl WaitingFrame {
    /// Returns whether the frame may be begun, and takes its bytes from the budget if so.
    pub(super) fn is_admitted(&self, budget: &mut BulkBudget) -> bool {
        if self.kind.urgency() != Urgency::Bulk || budget.bytes == usize::MAX {
            return true;
        }
        if self.frame.len() <= budget.bytes {
            budget.bytes -= self.frame.len();
            return true;
        }
        let is_tried = budget.one_of_any_length && !matches!(self.kind.map(), MapRole::Whole(_));
        if is_tried {
            *budget = BulkBudget::NONE;
        }
        is_tried
    }

    /// Returns whether the frame must wait because it would delay live frames.
    pub(super) fn is_held(&self, mut budget: BulkBudget) -> bool {
        !self.is_admitted(&mut budget)
    }
}

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

    /// Sets the time of the next calls, the bulk frames that may be begun until then, and whether frames wait for the
    /// connection.
    pub fn set_link(&mut self, now: Monotonic, budget: BulkBudget, is_slow: bool) {
        (self.now, self.budget, self.is_slow) = (now, budget, is_slow);
    }

    /// Drops live messages that are too old: newer ones follow.
    pub fn drop_expired(&mut self, pool: &mut BufferPool) {
        let (now, age_max) = (self.now, LIVE_AGE_MAX.as_nanos() as u64);
        let is_expired = |waiting: &WaitingFrame| {
            matches!(waiting.kind, FrameKind::Topic { expires: true, .. }) && now.since(waiting.at) > age_max
        };
        while let Some(place) = self.frames.iter().position(is_expired) {
            self.remove(place, pool);
            self.dropped += 1;
        }
    }

    /// Queues one of the maps that are held back with larger cells, so that it fits: the map whose turn it is.
    pub fn reduce_held(&mut self, pool: &mut BufferPool) {
        let budget = self.budget;
        if !budget.reduces_maps {
            return;
        }
        let last = |id: usize| self.reduced.iter().find(|reduced| reduced.topic == id);
        let is_due = |waiting: &&WaitingFrame, id: usize| {
            waiting.is_held(budget)
                && last(id).is_none_or(|last| {
                    waiting.at > last.at || budget.bytes >= REDUCED_GAIN.saturating_mul(last.bytes)
                })
        };
        let maps = self.frames.iter().rev().filter_map(|waiting| match waiting.kind {
            FrameKind::Topic { id, map: MapRole::Whole(dialect), .. } if is_due(&waiting, id) => {
                Some((waiting, id, dialect))
            }
            _ => None,
        });
        let next = maps.min_by_key(|(_, id, _)| last(*id).map_or(Monotonic(0), |last| last.at));
        let Some((waiting, topic, dialect)) = next else { return };
        let (at, whole, kind) = (waiting.at, waiting.frame.clone(), waiting.kind);
        self.reduced.retain(|reduced| reduced.topic != topic);
        self.reduced.push(ReducedMap { topic, at, bytes: budget.bytes });
        let mut smaller = pool.acquire(budget.bytes);
        if reduce_map(&whole, dialect, budget.bytes, Rc::make_mut(&mut smaller)).is_none() {
            return pool.recycle(smaller);
        }
        let is_older = |waiting: &WaitingFrame| match waiting.kind.map() {
            MapRole::None => is_of_topic(waiting.kind, topic),
            MapRole::Whole(_) => false,
            MapRole::UpdateOf(map) => map == topic,
        };
        while let Some(place) = self.frames.iter().position(is_older) {
            self.remove(place, pool);
        }
        if let FrameKind::Topic { id, depth, expires, .. } = kind {
            // The budget bounds its share of the connection: scans, which may fill the rest, must not starve it.
            let urgency = Urgency::Ordinary;
            let kind = FrameKind::Topic { id, depth, counted: true, urgency, expires, map: MapRole::None };
            self.add_to_totals(kind, memory_bytes(&smaller));
            self.begun.bulk_bytes += smaller.len();
            let is_live = |waiting: &WaitingFrame| waiting.kind.urgency() == Urgency::Live;
            let place = self.frames.iter().take_while(|waiting| is_live(waiting)).count();
            self.frames.insert(place, WaitingFrame { kind, frame: smaller, at: self.now });
        }
    }

    /// Returns whether the newest map that was sent on a topic has larger cells.
    pub fn is_reduced(&self, topic: usize) -> bool {
        self.reduced.iter().any(|reduced| reduced.topic == topic)
    }

    /// Returns the number of topics whose newest map has larger cells.
    pub fn reduced_maps(&self) -> usize {
        self.reduced.len()
    }

    /// Records a frame whose writing begins.
    pub(super) fn record_begun(&mut self, next: &WaitingFrame) {
        if next.kind.urgency() == Urgency::Bulk {
            self.begun.bulk_bytes += next.frame.len();
        }
        match next.kind {
            FrameKind::Topic { id, map: MapRole::Whole(_), .. } => {
                self.reduced.retain(|reduced| reduced.topic != id)
            }
            FrameKind::Topic { expires: true, .. } => {
                let waited = Duration::from_nanos(self.now.since(next.at));
                self.begun.live_wait = self.begun.live_wait.max(waited);
            }
            _ => {}
        }
    }

    /// Returns what was begun since the last call.
    pub fn take_begun(&mut self) -> BegunFrames {
        std::mem::take(&mut self.begun)
    }

    /// Returns whether frames wait, those that are held back included.
    pub fn has_frames(&self) -> bool {
        self.writing.is_some() || !self.frames.is_empty()
    }

    /// Returns the bytes of the bulk frames that are held back now.
    pub fn held_back_bytes(&self) -> usize {
        self.frames
            .iter()
            .filter(|waiting| waiting.is_held(self.budget))
            .map(|waiting| waiting.frame.len())
            .sum()
    }
}
