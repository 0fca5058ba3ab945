//! A map's channel as a queue in memory: messages with the tiles that changed, and requests for the whole map.

use super::{Network, Queue, Topic, VirtualClock};
use crate::channel::MAP_MESSAGES_MAX;
use crate::ports::{Clock, MAP_REQUEST_PERIOD, MessageSequencer, ReadMapPort, ReceiveCounts, WriteMapPort};
use msg::tiles::{PatchReceiver, PatchSender};
use msg::{MapTile, Message, Monotonic, PatchHeader, TileMap};
use std::cell::Cell;
use std::rc::Rc;

/// A message of a map's channel.
pub(super) struct PatchMessage {
    header: PatchHeader,
    tiles: Vec<MapTile>,
}

/// Writes a map's queue.
pub struct QueueMapWriter {
    pub(super) network: Rc<Network>,
    pub(super) topic: Rc<Topic<PatchMessage>>,
    pub(super) requests: Rc<Cell<bool>>,
    pub(super) stamper: MessageSequencer,
    pub(super) sender: PatchSender,
    pub(super) bytes: u64,
}

impl WriteMapPort for QueueMapWriter {
    type Listener = Rc<Cell<bool>>;

    fn send(&mut self, map: &TileMap) -> bool {
        if self.topic.requested.take() {
            self.sender.request_snapshot();
        }
        let now = self.network.clock.now();
        for _ in 0..MAP_MESSAGES_MAX {
            let Some(mut patch) = self.sender.next_patch(map) else { break };
            self.stamper.mark(patch.header.header_mut(), now);
            if self.network.faults().is_full(now) {
                self.sender.restart();
                break;
            }
            let tiles: Vec<MapTile> = patch.tiles.iter().map(|tile| **tile).collect();
            let bytes = [bytemuck::bytes_of(&patch.header), bytemuck::cast_slice(&tiles)].concat();
            self.bytes += bytes.len() as u64;
            self.network.sent.borrow_mut().push((self.topic.name.clone(), bytes));
            self.topic.publish(&self.network, Rc::new(PatchMessage { header: patch.header, tiles }));
        }
        !self.sender.has_pending(map)
    }

    fn requests(&self) -> &Rc<Cell<bool>> {
        &self.requests
    }

    fn bytes(&self) -> u64 {
        self.bytes
    }
}

impl Drop for QueueMapWriter {
    fn drop(&mut self) {
        self.topic.history.borrow_mut().clear();
    }
}

/// Reads a map's queue.
pub struct QueueMapReader {
    pub(super) clock: VirtualClock,
    pub(super) topic: Rc<Topic<PatchMessage>>,
    pub(super) queue: Rc<Queue<PatchMessage>>,
    pub(super) asked: Option<Monotonic>,
    pub(super) receive_counts: ReceiveCounts,
    pub(super) receiver: PatchReceiver,
}

impl ReadMapPort for QueueMapReader {
    fn poll(&mut self) -> bool {
        let now = self.clock.now();
        let mut new = false;
        while let Some(message) = self.queue.receive(now) {
            self.receive_counts.count(message.header.header());
            new |= self.receiver.receive(&message.header, &message.tiles);
        }
        let patient = |asked: Monotonic| now.since(asked) < MAP_REQUEST_PERIOD.as_nanos() as u64;
        if self.receiver.needs_snapshot() && !self.asked.is_some_and(patient) {
            self.asked = Some(now);
            self.topic.requested.set(true);
            if let Some(woken) = self.topic.request_listener.borrow().upgrade() {
                woken.set(true);
            }
        }
        new
    }

    fn map(&self) -> &TileMap {
        self.receiver.map()
    }

    fn receive_counts(&self) -> ReceiveCounts {
        self.receive_counts
    }
}
