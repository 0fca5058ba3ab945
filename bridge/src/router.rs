//! Routes messages from one publisher to many clients: topics on one side, clients on the other.
//!
//! A message is encoded once for all of its subscribers, which share its frame.

mod buffers;
mod client;
mod link;
mod memory;
mod notices;
mod outgoing;
mod reduced_map;
mod topics;
mod writing;

pub use buffers::BufferPool;
pub use client::{
    Client, ClientId, ClientSocket, ConnectionEnded, ExpectedFrame, LargeFrame, Publication, RefusalKind,
};
#[cfg(test)]
pub use link::SEND_BUFFER_FIRST;
pub use outgoing::{FlushOutcome, FrameKind, OutgoingQueue};
pub use topics::{DEPTH_DEFAULT, Retention, Source, Topic, TopicError, TopicId, TopicTable};

use crate::config::BridgeConfig;
use crate::frame::{IDLE_BYTES, Side};
use buffers::SharedFrame;
use link::Urgency;
use memory::ClientByteBudget;
use outgoing::{MapRole, memory_bytes};
use ros_messages::cdr::{Dialect, Writer};
use ros_messages::{Message as _, OccupancyGrid, OccupancyGridUpdate};
use serde::Serialize;
use std::net::SocketAddr;
use std::rc::Rc;
use topics::Subscriber;

/// Room for a reply's first bytes: a topic list or a service frame of usual length.
const REPLY_BYTES: usize = 1024;

/// The lengths of a frame's name and payload, bytes.
const FRAME_LENGTHS_BYTES: usize = 8;

/// A topic with a longer frame is bulk from then on, bytes.
const ORDINARY_BYTES_MAX: usize = 16 << 10;

/// What the bridge has counted since its start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Clients that are connected now.
    pub clients: u32,
    /// Connections that were accepted.
    pub accepted: u64,
    /// Frames queued for clients, counted once for each client.
    pub sent: u64,
    /// Frames received from clients, and messages from DDS.
    pub received: u64,
    /// Messages dropped or replaced by newer ones because a client was slow.
    pub dropped: u64,
    /// Frames, commands and connections that were refused.
    pub refused: u64,
    /// Velocities passed to robots.
    pub commands: u64,
}

/// The topics, the clients and the frames between them.
pub struct TopicRouter {
    /// The table of topics.
    pub topics: TopicTable,
    /// Counters; [`TopicRouter::counters`] adds the clients that are connected.
    pub counted: Counters,
    clients: Vec<Option<Client>>,
    /// Slots of the clients with [`Client::needs_flush`].
    unflushed: Vec<usize>,
    pool: BufferPool,
    dialect: Dialect,
    queue_bytes_max: usize,
    /// Bytes of the latched messages on clients' topics.
    latched_bytes: usize,
    latched_bytes_max: usize,
    /// What is held for clients.
    pub memory: ClientByteBudget,
}

impl TopicRouter {
    /// Creates a router without clients.
    pub fn new(topics: TopicTable, config: &BridgeConfig) -> Self {
        Self {
            topics,
            counted: Counters::default(),
            clients: Vec::new(),
            unflushed: Vec::new(),
            pool: BufferPool::default(),
            dialect: config.payloads,
            queue_bytes_max: config.outbox_bytes_max,
            latched_bytes: 0,
            latched_bytes_max: config.latched_bytes_max,
            memory: ClientByteBudget::new(config.limits.held_bytes_max),
        }
    }

    /// Adds a client. Without a socket its frames wait for [`TopicRouter::take_outgoing`].
    pub fn connect(&mut self, peer: SocketAddr, socket: Option<Box<dyn ClientSocket>>) -> ClientId {
        self.counted.accepted += 1;
        let slot = self.clients.iter().position(Option::is_none).unwrap_or_else(|| {
            self.clients.push(None);
            self.clients.len() - 1
        });
        let id = ClientId { slot, serial: self.counted.accepted };
        let outgoing = OutgoingQueue::new(self.queue_bytes_max);
        self.clients[slot] = Some(Client::new(id, peer, socket, outgoing));
        id
    }

    /// Removes a client with its subscriptions and publications; returns its unsent frames.
    pub fn disconnect(&mut self, id: ClientId) -> Option<OutgoingQueue> {
        self.client(id)?;
        let client = self.clients[id.slot].take()?;
        self.counted.dropped += client.outgoing.dropped();
        self.release_input(&client);
        client.wake();
        for topic in client.subscriptions {
            self.unsubscribe(id.slot, topic, None);
        }
        for publication in client.publications {
            self.remove_publisher(id.slot, publication.topic);
        }
        Some(client.outgoing)
    }

    /// Returns a client, or `None` once it is disconnected.
    pub fn client(&self, id: ClientId) -> Option<&Client> {
        self.clients.get(id.slot)?.as_ref().filter(|client| client.id == id)
    }

    /// Returns a client, or `None` once it is disconnected.
    pub fn client_mut(&mut self, id: ClientId) -> Option<&mut Client> {
        self.clients.get_mut(id.slot)?.as_mut().filter(|client| client.id == id)
    }

    /// Returns all connected clients.
    pub fn clients(&self) -> impl Iterator<Item = &Client> {
        self.clients.iter().flatten()
    }

    /// Returns the counters, connected clients included.
    pub fn counters(&self) -> Counters {
        let clients = self.clients().count() as u32;
        let dropped =
            self.counted.dropped + self.clients().map(|client| client.outgoing.dropped()).sum::<u64>();
        Counters { clients, dropped, ..self.counted }
    }

    /// Subscribes a client to a topic and sends it the latched message; `false` if it was subscribed already.
    pub fn subscribe(&mut self, id: ClientId, topic: TopicId, without_slash: bool) -> bool {
        let subscriber = Subscriber { slot: id.slot, without_slash };
        let Some(entry) = self.topics.get_mut(topic) else { return false };
        if entry.subscribers.contains(&subscriber) {
            return false;
        }
        entry.subscribers.push(subscriber);
        let (latched, is_live) = (entry.latched.clone(), entry.urgency == Urgency::Live);
        if let Some(client) = self.client_mut(id)
            && !client.subscriptions.contains(&topic)
        {
            client.subscriptions.push(topic);
            client.live_subscriptions += usize::from(is_live);
            client.subscribed_at = client.socket_time().unwrap_or_default();
        }
        if let Some(frame) = latched {
            self.queue_frame(topic, frame, Some(subscriber));
        }
        true
    }

    /// Ends a subscription and removes its waiting messages. `without_slash` selects one spelling, `None` both.
    pub fn unsubscribe(&mut self, slot: usize, topic: TopicId, without_slash: Option<bool>) {
        let Some(entry) = self.topics.get_mut(topic) else { return };
        let is_live = entry.urgency == Urgency::Live;
        let stays = |subscriber: &Subscriber| {
            subscriber.slot != slot || without_slash.is_some_and(|which| subscriber.without_slash != which)
        };
        entry.subscribers.retain(stays);
        if entry.subscribers.iter().all(|subscriber| subscriber.slot != slot)
            && let Some(client) = self.clients.get_mut(slot).and_then(Option::as_mut)
        {
            let before = client.subscriptions.len();
            client.subscriptions.retain(|subscribed| *subscribed != topic);
            let is_removed = is_live && client.subscriptions.len() < before;
            client.live_subscriptions -= usize::from(is_removed);
            client.outgoing.remove_topic(topic, &mut self.pool);
        }
        self.remove_if_unused(topic);
    }

    /// Registers a client as publisher of a topic.
    pub fn add_publisher(&mut self, id: ClientId, publication: Publication, queue_size: i64) {
        self.topics.add_publisher(id, publication.topic, queue_size, publication.latch);
        let Some(client) = self.client_mut(id) else { return };
        client.publications.retain(|known| known.topic != publication.topic);
        client.publications.push(publication);
    }

    /// Removes a client from the publishers of a topic. The last one takes the latched message with it.
    pub fn remove_publisher(&mut self, slot: usize, topic: TopicId) {
        if let Some(client) = self.clients.get_mut(slot).and_then(Option::as_mut) {
            client.publications.retain(|known| known.topic != topic);
        }
        let Some(entry) = self.topics.get_mut(topic) else { return };
        entry.publishers.retain(|publisher| *publisher != slot);
        if entry.publishers.is_empty() && entry.source == Source::Clients {
            entry.retention.latch = false;
            if let Some(frame) = entry.latched.take() {
                self.latched_bytes -= frame.len();
                self.pool.recycle(frame);
            }
        }
        self.remove_if_unused(topic);
    }

    fn remove_if_unused(&mut self, topic: TopicId) {
        if let Some(frame) = self.topics.remove_if_unused(topic) {
            self.latched_bytes -= frame.len();
            self.pool.recycle(frame);
        }
    }

    /// Encodes a message once, if anybody needs it, and queues it for all subscribers.
    pub fn publish(&mut self, topic: TopicId, encode: impl FnOnce(&mut Writer<'_>)) {
        let dialect = self.dialect;
        self.publish_with(topic, |out| encode(&mut Writer::with(dialect, out)));
    }

    /// Queues a payload that is encoded already for all subscribers. One that cannot be held is dropped.
    pub fn forward(&mut self, topic: TopicId, payload: &[u8]) {
        if payload.len() > IDLE_BYTES && !self.can_hold(payload.len()) {
            self.counted.dropped += 1;
            return;
        }
        if let Some(topic) = self.topics.get_mut(topic) {
            topic.last_frame_bytes = FRAME_LENGTHS_BYTES + topic.name.len() + payload.len();
        }
        self.publish_with(topic, |out| out.extend_from_slice(payload));
    }

    /// Queues the newest message of a latched topic for the subscribers of another one. Without them it costs nothing.
    pub fn publish_copy(&mut self, topic: TopicId, latched_of: TopicId) {
        let is_wanted = self.topics.get(topic).is_some_and(|topic| !topic.subscribers.is_empty());
        let Some(source) = self.topics.get(latched_of).filter(|_| is_wanted) else { return };
        let Some(frame) = source.latched.clone() else { return };
        let payload_begin = FRAME_LENGTHS_BYTES + source.name.len();
        self.forward(topic, &frame[payload_begin..]);
    }

    fn publish_with(&mut self, id: TopicId, payload: impl FnOnce(&mut Vec<u8>)) {
        let Some(topic) = self.topics.get_mut(id) else { return };
        if !topic.retention.latch && topic.subscribers.is_empty() {
            return;
        }
        let mut frame = self.pool.acquire(topic.last_frame_bytes);
        // The buffer has no other holder yet, so that this makes no copy.
        Side::Server.write_with(Rc::make_mut(&mut frame), &topic.name, payload);
        topic.last_frame_bytes = frame.len();
        if frame.len() > ORDINARY_BYTES_MAX && topic.urgency == Urgency::Ordinary {
            topic.urgency = Urgency::Bulk;
        }
        let is_held = !topic.subscribers.is_empty();
        self.memory.add_created(if is_held { memory_bytes(&frame) } else { 0 });
        if topic.retention.latch {
            self.latch(id, &frame);
        }
        self.queue_frame(id, frame, None);
        self.enforce_memory();
    }

    /// Keeps the newest message for late subscribers. On clients' topics the total of bytes is limited: one beyond it leaves
    /// the message before.
    fn latch(&mut self, id: TopicId, frame: &SharedFrame) {
        if !self.has_room_to_latch(id, frame.len()) {
            return;
        }
        let Some(topic) = self.topics.get_mut(id) else { return };
        let is_clients = topic.source == Source::Clients;
        if let Some(old) = topic.latched.take() {
            self.latched_bytes -= if is_clients { old.len() } else { 0 };
            // Clients that are still writing it hold it from now on.
            let is_held = Rc::strong_count(&old) > 1;
            self.memory.add_created(if is_held { memory_bytes(&old) } else { 0 });
            self.pool.recycle(old);
        }
        topic.latched = Some(frame.clone());
        self.latched_bytes += if is_clients { frame.len() } else { 0 };
    }

    /// Returns whether a frame could be the latched one of a topic. The one that it replaces makes room.
    fn has_room_to_latch(&self, id: TopicId, frame_bytes: usize) -> bool {
        let Some(topic) = self.topics.get(id).filter(|topic| topic.source == Source::Clients) else {
            return true;
        };
        let replaced = topic.latched.as_ref().map_or(0, |frame| frame.len());
        self.latched_bytes - replaced + frame_bytes <= self.latched_bytes_max
    }

    /// Returns whether late subscribers do not get a client's payload although its topic is latched (`latched_bytes_max`).
    pub fn is_too_large_to_latch(&self, id: TopicId, payload_bytes: usize) -> bool {
        let Some(topic) = self.topics.get(id).filter(|topic| topic.retention.latch) else { return false };
        !self.has_room_to_latch(id, FRAME_LENGTHS_BYTES + topic.name.len() + payload_bytes)
    }

    /// Queues a topic's frame for one subscriber, or for all.
    fn queue_frame(&mut self, id: TopicId, frame: SharedFrame, only: Option<Subscriber>) {
        let Some(topic) = self.topics.get(id) else { return };
        let depth = topic.retention.depth;
        // All clients share the fleet's newest map and states, so that slow clients cost no memory for them.
        let counted = !(topic.source == Source::Fleet && depth == 1);
        let (urgency, latch) = (topic.urgency, topic.retention.latch);
        let expires = urgency == Urgency::Live && topic.source != Source::Clients && !latch;
        let map = self.map_role(topic);
        let kind = FrameKind::Topic { id, depth, counted, urgency, expires, map };
        let now = self.time();
        let mut renamed: Option<SharedFrame> = None;
        let all = topic.subscribers.iter().filter(|_| only.is_none());
        for subscriber in all.chain(&only) {
            let Some(client) = self.clients.get_mut(subscriber.slot).and_then(Option::as_mut) else {
                continue;
            };
            // Changes count whole cells: a client whose map has larger ones cannot use them.
            if matches!(map, MapRole::UpdateOf(map) if client.outgoing.is_reduced(map)) {
                continue;
            }
            let own = match subscriber.without_slash {
                false => frame.clone(),
                true => renamed
                    .get_or_insert_with(|| {
                        self.memory.add_created(memory_bytes(&frame));
                        without_slash(&frame, topic, &mut self.pool)
                    })
                    .clone(),
            };
            client.push(kind, own, now, &mut self.pool);
            mark_unflushed(&mut self.unflushed, client);
            self.counted.sent += 1;
        }
        renamed.into_iter().for_each(|frame| self.pool.recycle(frame));
        self.pool.recycle(frame);
    }

    /// Sends one client a command with its JSON.
    pub fn send_command(&mut self, id: ClientId, name: &str, body: &impl Serialize) {
        self.send_frames(id, FrameKind::Reply, |out| Side::Server.write_command(out, name, body));
    }

    /// Sends one client whole frames that must stay adjacent on its connection.
    pub fn send_frames(&mut self, id: ClientId, kind: FrameKind, write: impl FnOnce(&mut Vec<u8>)) {
        let now = self.time();
        let Some(client) = self.clients.get_mut(id.slot).and_then(Option::as_mut).filter(|c| c.id == id)
        else {
            return;
        };
        let mut frames = self.pool.acquire(REPLY_BYTES);
        write(Rc::make_mut(&mut frames));
        self.memory.add_created(memory_bytes(&frames));
        client.push(kind, frames, now, &mut self.pool);
        mark_unflushed(&mut self.unflushed, client);
        self.counted.sent += 1;
        self.enforce_memory();
    }

    /// Returns what a topic has to do with maps: `/map_updates` has the changes of `/map`.
    fn map_role(&self, topic: &Topic) -> MapRole {
        match topic.message_type.as_str() {
            OccupancyGrid::TYPE => MapRole::Whole(self.dialect),
            OccupancyGridUpdate::TYPE => {
                let map = topic.name.strip_suffix("_updates").and_then(|map| self.topics.find(map));
                map.map_or(MapRole::None, MapRole::UpdateOf)
            }
            _ => MapRole::None,
        }
    }
}

fn mark_unflushed(unflushed: &mut Vec<usize>, client: &mut Client) {
    if !client.needs_flush {
        client.needs_flush = true;
        unflushed.push(client.id.slot);
    }
}

/// Returns the same frame for a subscriber that knows the topic without its slash.
fn without_slash(frame: &SharedFrame, topic: &Topic, pool: &mut BufferPool) -> SharedFrame {
    let payload = &frame[8 + topic.name.len()..];
    let mut renamed = pool.acquire(frame.len());
    Side::Server.write(Rc::make_mut(&mut renamed), topic.name.trim_start_matches('/'), payload);
    renamed
}
