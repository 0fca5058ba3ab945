//! Memory that the bridge holds for all clients together, and what gives way when it reaches its limit.

use super::{Client, ClientId, TopicRouter};
use crate::frame::IDLE_BYTES;
use msg::Monotonic;
use std::time::Duration;

/// The share of the limit that is left free after messages had to give way: a counting of all bytes lasts until then.
const FREED_SHARE: usize = 8;
/// Buffers that nobody needed for so long are given back to the system.
const RELEASE_PERIOD: Duration = Duration::from_secs(5);

/// The bytes that are held for clients, and their limit.
///
/// Bytes of waiting frames are counted now and then: between two counts they grow by the frames that are created.
#[derive(Debug)]
pub struct ClientByteBudget {
    limit: usize,
    /// Bytes of clients' input buffers that have grown.
    input: usize,
    /// Bytes of all frames that waited, of latched messages and of free buffers, at the last count.
    counted: usize,
    /// Bytes of the frames created since the last count.
    created: usize,
    /// Address and size of each waiting frame, while they are counted.
    frames: Vec<(usize, usize)>,
    released: Monotonic,
}

impl ClientByteBudget {
    /// Creates an account of at most `limit` bytes.
    pub fn new(limit: usize) -> Self {
        Self { limit, input: 0, counted: 0, created: 0, frames: Vec::new(), released: Monotonic::default() }
    }

    /// Records that a frame of so many bytes was created, or is held by clients alone from now on.
    pub fn add_created(&mut self, bytes: usize) {
        self.created += bytes;
    }

    /// Returns an upper bound of the bytes that are held.
    fn held_at_most(&self) -> usize {
        self.input + self.counted + self.created
    }
}

impl TopicRouter {
    /// Counts the bytes that are held for clients.
    ///
    /// A frame that waits for several clients counts once, and the fleet's newest messages do not: they are kept for
    /// late subscribers in any case.
    pub fn held_bytes(&mut self) -> usize {
        let mut frames = std::mem::take(&mut self.memory.frames);
        frames.clear();
        for client in self.clients.iter().flatten() {
            frames.extend(client.outgoing.frames_held());
        }
        if !frames.is_empty() {
            frames.sort_unstable();
            frames.dedup();
            for latched in self.topics.latched() {
                if let Ok(place) = frames.binary_search_by_key(&(latched.as_ptr() as usize), |(at, _)| *at) {
                    frames[place].1 = 0;
                }
            }
        }
        let waiting: usize = frames.iter().map(|(_, bytes)| bytes).sum();
        self.memory.counted = waiting + self.latched_bytes + self.pool.free_bytes();
        self.memory.created = 0;
        self.memory.frames = frames;
        self.memory.held_at_most()
    }

    /// Returns whether so many more bytes can be held, once free buffers are given back.
    pub fn can_hold(&mut self, bytes: usize) -> bool {
        let limit = self.memory.limit;
        if self.memory.held_at_most() + bytes <= limit || self.held_bytes() + bytes <= limit {
            return true;
        }
        self.pool.release_all();
        self.held_bytes() + bytes <= limit
    }

    /// Records the size of a client's input buffer; `false` if so many bytes cannot be held.
    pub fn hold_input(&mut self, id: ClientId, buffer_bytes: usize) -> bool {
        let bytes = if buffer_bytes <= IDLE_BYTES { 0 } else { buffer_bytes };
        let Some(before) = self.client(id).map(|client| client.input.buffer_bytes) else { return bytes == 0 };
        if bytes > before && !self.can_hold(bytes - before) {
            return false;
        }
        if let Some(client) = self.client_mut(id) {
            client.input.buffer_bytes = bytes;
        }
        self.memory.input = self.memory.input + bytes - before;
        true
    }

    /// Drops waiting messages if the limit is exceeded, of the client first that has most of them waiting.
    ///
    /// A client that has nothing to drop, but does not read a large frame that is being written, is disconnected.
    pub(super) fn enforce_memory(&mut self) {
        let limit = self.memory.limit;
        if self.memory.held_at_most() <= limit || self.held_bytes() <= limit {
            return;
        }
        self.pool.release_all();
        let target = limit - limit / FREED_SHARE;
        // Each step halves what waits for one client, or ends a client.
        while self.held_bytes() > target {
            let Self { clients, pool, .. } = &mut *self;
            let largest = clients.iter_mut().flatten().filter(|client| !client.has_failed);
            let Some(client) = largest.max_by_key(|client| client.outgoing.memory_held()) else { return };
            match client.outgoing.memory_held() {
                0 => return,
                held if !client.outgoing.drop_oldest_until(held / 2, pool) => client.fail(),
                _ => {}
            }
            self.pool.release_all();
        }
    }

    /// Gives back buffers that were not needed lately.
    pub fn release_unused(&mut self, now: Monotonic) {
        if now.since(self.memory.released) >= RELEASE_PERIOD.as_nanos() as u64 {
            self.memory.released = now;
            self.pool.release_unused();
        }
    }

    /// Ends the account of a client that has left.
    pub(super) fn release_input(&mut self, client: &Client) {
        self.memory.input -= client.input.buffer_bytes;
    }
}
