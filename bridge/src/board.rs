//! The switchboard: topics on one side, clients on the other, frames from one to many without a copy each.

use crate::cdr::Writer;
use crate::client::{Client, ClientId, Ended, Publication, Refusal};
use crate::command::{Notice, name};
use crate::frame::Side;
use crate::outbox::{Lane, Outbox};
use crate::pool::{Bytes, Pool};
use crate::topics::{Source, Subscriber, Topic, TopicId, Topics};
use serde::Serialize;
use std::net::SocketAddr;
use std::rc::Rc;
use std::time::Instant;
use tokio::net::TcpStream;
use tokio::sync::Notify;

/// What the bridge has counted since its start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Clients now.
    pub clients: u32,
    /// Connections accepted.
    pub accepted: u64,
    /// Frames put on their way, one for each client it is for.
    pub sent: u64,
    /// Frames received.
    pub received: u64,
    /// Messages dropped or replaced by newer ones because a client was slow.
    pub dropped: u64,
    /// Frames, commands and connections refused.
    pub refused: u64,
    /// Commands passed to robots.
    pub commands: u64,
}

/// Topics and clients.
pub struct Board {
    /// The table of topics.
    pub topics: Topics,
    /// What has been counted; `clients` and `dropped` are filled in by [`Board::counters`].
    pub counted: Counters,
    clients: Vec<Option<Client>>,
    dirty: Vec<usize>,
    pool: Pool,
    outbox_bytes_max: usize,
    latched_bytes: usize,
    latched_bytes_max: usize,
}

impl Board {
    /// Nobody there yet.
    pub fn new(topics: Topics, outbox_bytes_max: usize, latched_bytes_max: usize) -> Self {
        Self {
            topics,
            counted: Counters::default(),
            clients: Vec::new(),
            dirty: Vec::new(),
            pool: Pool::default(),
            outbox_bytes_max,
            latched_bytes: 0,
            latched_bytes_max,
        }
    }

    /// A new connection.
    pub fn attach(&mut self, stream: Rc<TcpStream>, peer: SocketAddr, wake: Rc<Notify>) -> ClientId {
        self.counted.accepted += 1;
        let slot = self.clients.iter().position(Option::is_none).unwrap_or_else(|| {
            self.clients.push(None);
            self.clients.len() - 1
        });
        let id = ClientId { slot, serial: self.counted.accepted };
        let outbox = Outbox::new(self.outbox_bytes_max);
        self.clients[slot] = Some(Client::new(id, peer, stream, wake, outbox));
        id
    }

    /// The connection is over; what has not been sent.
    pub fn detach(&mut self, id: ClientId) -> Option<Outbox> {
        self.client(id)?;
        let client = self.clients[id.slot].take()?;
        self.counted.dropped += client.outbox.dropped();
        for topic in client.subscriptions {
            self.unsubscribe(id.slot, topic, None);
        }
        for publication in client.publications {
            self.unpublish(id.slot, publication.topic);
        }
        Some(client.outbox)
    }

    /// `None` once it is gone.
    pub fn client(&self, id: ClientId) -> Option<&Client> {
        self.clients.get(id.slot)?.as_ref().filter(|client| client.id == id)
    }

    /// `None` once it is gone.
    pub fn client_mut(&mut self, id: ClientId) -> Option<&mut Client> {
        self.clients.get_mut(id.slot)?.as_mut().filter(|client| client.id == id)
    }

    /// All that are connected.
    pub fn clients(&self) -> impl Iterator<Item = &Client> {
        self.clients.iter().flatten()
    }

    /// What has been counted.
    pub fn counters(&self) -> Counters {
        let clients = self.clients().count() as u32;
        let dropped =
            self.counted.dropped + self.clients().map(|client| client.outbox.dropped()).sum::<u64>();
        Counters { clients, dropped, ..self.counted }
    }

    /// Sends a topic to a client from now on, and the latched message at once. `false` if it is so already.
    pub fn subscribe(&mut self, id: ClientId, topic: TopicId, bare: bool) -> bool {
        let subscriber = Subscriber { slot: id.slot, bare };
        let Some(entry) = self.topics.get_mut(topic) else { return false };
        if entry.subscribers.contains(&subscriber) {
            return false;
        }
        entry.subscribers.push(subscriber);
        let latched = entry.latched.clone();
        if let Some(client) = self.client_mut(id)
            && !client.subscriptions.contains(&topic)
        {
            client.subscriptions.push(topic);
        }
        if let Some(bytes) = latched {
            self.push_topic(topic, bytes, Some(subscriber));
        }
        true
    }

    /// No longer; `bare` says which spelling, `None` both. What waits of it is forgotten.
    pub fn unsubscribe(&mut self, slot: usize, topic: TopicId, bare: Option<bool>) {
        let Some(entry) = self.topics.get_mut(topic) else { return };
        entry.subscribers.retain(|s| s.slot != slot || bare.is_some_and(|bare| s.bare != bare));
        if entry.subscribers.iter().all(|s| s.slot != slot)
            && let Some(client) = self.clients.get_mut(slot).and_then(Option::as_mut)
        {
            client.subscriptions.retain(|subscribed| *subscribed != topic);
            client.outbox.forget(topic, &mut self.pool);
        }
        self.sweep(topic);
    }

    /// A client may publish a topic from now on.
    pub fn publish(&mut self, id: ClientId, publication: Publication, queue_size: i64) {
        let Some(topic) = self.topics.get_mut(publication.topic) else { return };
        if !topic.publishers.contains(&id.slot) {
            topic.publishers.push(id.slot);
        }
        if topic.source == Source::Clients {
            topic.deepen(queue_size);
            topic.latch |= publication.latch;
        }
        let Some(client) = self.client_mut(id) else { return };
        client.publications.retain(|known| known.topic != publication.topic);
        client.publications.push(publication);
    }

    /// No longer. A client's latched message goes with its last publisher.
    pub fn unpublish(&mut self, slot: usize, topic: TopicId) {
        if let Some(client) = self.clients.get_mut(slot).and_then(Option::as_mut) {
            client.publications.retain(|known| known.topic != topic);
        }
        let Some(entry) = self.topics.get_mut(topic) else { return };
        entry.publishers.retain(|publisher| *publisher != slot);
        if entry.publishers.is_empty() && entry.source == Source::Clients {
            entry.latch = false;
            if let Some(bytes) = entry.latched.take() {
                self.latched_bytes -= bytes.len();
                self.pool.give_back(bytes);
            }
        }
        self.sweep(topic);
    }

    fn sweep(&mut self, topic: TopicId) {
        if let Some(bytes) = self.topics.sweep(topic) {
            self.latched_bytes -= bytes.len();
            self.pool.give_back(bytes);
        }
    }

    /// Encodes a message once, if anybody wants it, and puts it on its way to all who do.
    pub fn send(&mut self, topic: TopicId, message: impl FnOnce(&mut Writer<'_>)) {
        self.send_with(topic, |out| message(&mut Writer::new(out)));
    }

    /// The same with a payload that is there already.
    pub fn relay(&mut self, topic: TopicId, payload: &[u8]) {
        if let Some(topic) = self.topics.get_mut(topic) {
            topic.typical = 8 + topic.name.len() + payload.len();
        }
        self.send_with(topic, |out| out.extend_from_slice(payload));
    }

    fn send_with(&mut self, id: TopicId, payload: impl FnOnce(&mut Vec<u8>)) {
        let Some(topic) = self.topics.get_mut(id) else { return };
        if !topic.latch && topic.subscribers.is_empty() {
            return;
        }
        let mut bytes = self.pool.take(topic.typical);
        // Nobody else holds it yet, so this makes no copy.
        Side::Server.write_with(Rc::make_mut(&mut bytes), &topic.name, payload);
        topic.typical = bytes.len();
        if topic.latch {
            self.latch(id, &bytes);
        }
        self.push_topic(id, bytes, None);
    }

    /// Keeps the newest message for late subscribers, as far as clients' latched messages have room.
    fn latch(&mut self, id: TopicId, bytes: &Bytes) {
        let Some(topic) = self.topics.get_mut(id) else { return };
        let of_clients = topic.source == Source::Clients;
        if let Some(old) = topic.latched.take() {
            self.latched_bytes -= if of_clients { old.len() } else { 0 };
            self.pool.give_back(old);
        }
        let fits = self.latched_bytes + bytes.len() <= self.latched_bytes_max;
        if !of_clients || fits {
            topic.latched = Some(bytes.clone());
            self.latched_bytes += if of_clients { bytes.len() } else { 0 };
        }
    }

    /// Puts a topic's frame on its way to one subscriber, or to all.
    fn push_topic(&mut self, id: TopicId, bytes: Bytes, only: Option<Subscriber>) {
        let Some(topic) = self.topics.get(id) else { return };
        // The fleet's newest maps and states are held once for all clients, whoever is slow.
        let counted = !(topic.source == Source::Fleet && topic.depth == 1);
        let lane = Lane::Topic { id, depth: topic.depth, counted };
        let mut bare: Option<Bytes> = None;
        let all = topic.subscribers.iter().filter(|_| only.is_none());
        for subscriber in all.chain(&only) {
            let Some(client) = self.clients.get_mut(subscriber.slot).and_then(Option::as_mut) else {
                continue;
            };
            let frame = match subscriber.bare {
                false => bytes.clone(),
                true => bare.get_or_insert_with(|| without_slash(&bytes, topic, &mut self.pool)).clone(),
            };
            client.push(lane, frame, &mut self.pool);
            mark(&mut self.dirty, client);
            self.counted.sent += 1;
        }
        bare.into_iter().for_each(|frame| self.pool.give_back(frame));
        self.pool.give_back(bytes);
    }

    /// Sends one client a command with its JSON.
    pub fn command(&mut self, id: ClientId, name: &str, body: &impl Serialize) {
        self.answer(id, Lane::Answer, |out| Side::Server.write_command(out, name, body));
    }

    /// Sends one client whole frames that belong together.
    pub fn answer(&mut self, id: ClientId, lane: Lane, frames: impl FnOnce(&mut Vec<u8>)) {
        let Some(client) = self.clients.get_mut(id.slot).and_then(Option::as_mut).filter(|c| c.id == id)
        else {
            return;
        };
        let mut bytes = self.pool.take(1024);
        frames(Rc::make_mut(&mut bytes));
        client.push(lane, bytes, &mut self.pool);
        mark(&mut self.dirty, client);
        self.counted.sent += 1;
    }

    /// Tells one client that something it sent was refused, and counts it.
    pub fn refuse(&mut self, id: ClientId, text: String) {
        self.counted.refused += 1;
        self.notice(id, name::ERROR, text);
    }

    /// The same for a data frame, of which there may be many: told once a second.
    pub fn refuse_data(
        &mut self,
        id: ClientId,
        why: Refusal,
        topic: Option<TopicId>,
        now: Instant,
        text: String,
    ) {
        self.counted.refused += 1;
        let tell = self.client_mut(id).is_some_and(|client| client.should_tell(why, topic, now));
        if tell {
            self.notice(id, name::ERROR, text);
        }
    }

    /// Text for a person at one client: [`name::LOG`], [`name::WARN`] or [`name::ERROR`].
    pub fn notice(&mut self, id: ClientId, kind: &str, text: String) {
        self.answer(id, Lane::Notice, |out| Side::Server.write_command(out, kind, &Notice { text }));
    }

    /// Hands what waits to the sockets.
    pub fn flush(&mut self) {
        while let Some(slot) = self.dirty.pop() {
            let Some(client) = self.clients.get_mut(slot).and_then(Option::as_mut) else { continue };
            client.dirty = false;
            client.flush(&mut self.pool);
        }
    }

    /// Whether a client's frames wait for room in its socket.
    pub fn waits(&self, id: ClientId) -> Result<bool, Ended> {
        let client = self.client(id).filter(|client| !client.lost).ok_or(Ended)?;
        Ok(client.waiting)
    }

    /// Writes on for one client whose socket has room again; whether more waits.
    pub fn flush_one(&mut self, id: ClientId) -> bool {
        let Some(client) = self.clients.get_mut(id.slot).and_then(Option::as_mut).filter(|c| c.id == id)
        else {
            return false;
        };
        client.waiting = false;
        client.flush(&mut self.pool);
        client.waiting
    }
}

fn mark(dirty: &mut Vec<usize>, client: &mut Client) {
    if !client.dirty {
        client.dirty = true;
        dirty.push(client.id.slot);
    }
}

/// The same frame for one who knows the topic without its slash.
fn without_slash(bytes: &Bytes, topic: &Topic, pool: &mut Pool) -> Bytes {
    let payload = &bytes[8 + topic.name.len()..];
    let mut bare = pool.take(bytes.len());
    Side::Server.write(Rc::make_mut(&mut bare), topic.name.trim_start_matches('/'), payload);
    bare
}
