//! One connection as the switchboard knows it: what it is sent, what it may send, what waits for it.

use crate::outbox::{Flushed, Lane, Outbox};
use crate::pool::{Bytes, Pool};
use crate::topics::TopicId;
use crate::world::SourceClock;
use msg::RobotId;
use std::net::SocketAddr;
use std::rc::Rc;
use std::time::{Duration, Instant};
use tokio::net::TcpStream;
use tokio::sync::Notify;

/// One connection, never confused with a later one in its place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ClientId {
    /// Where it is kept.
    pub slot: usize,
    /// Counts connections.
    pub serial: u64,
}

impl ClientId {
    /// All who drive over DDS: one driver among the clients, as one topic is in ROS whoever publishes on it.
    pub const DDS: Self = Self { slot: usize::MAX, serial: u64::MAX };
}

/// There is no such client any more, or its connection must end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ended;

/// A service frame that must come next on a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Expected {
    /// The request of the client's call with this number.
    Request(i64),
    /// The client's response to our call with this number.
    Response(i64),
}

/// Why a data frame was refused; the same reason is told once a second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// The topic was not registered for publication.
    Unregistered,
    /// The payload is not the message.
    Payload,
    /// The address may not.
    Permission,
    /// Another client drives.
    Held,
    /// The emergency stop is set.
    Stopped,
    /// The message says what it may not say.
    Content,
}

/// How often the same refusal of a data frame is told again.
const TOLD_AGAIN: Duration = Duration::from_secs(1);
/// Refusals remembered per client.
const TOLD_MAX: usize = 16;

/// A topic a client has registered to publish.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Publication {
    /// Which.
    pub topic: TopicId,
    /// It publishes TwistStamped where the topic is Twist.
    pub stamped: bool,
    /// It asked for latching.
    pub latch: bool,
}

/// One connected client.
pub struct Client {
    /// Which.
    pub id: ClientId,
    /// Its address.
    pub peer: SocketAddr,
    /// What it is sent.
    pub subscriptions: Vec<TopicId>,
    /// What it may send.
    pub publications: Vec<Publication>,
    /// The service frame that must come next.
    pub expected: Option<Expected>,
    /// The robot its thumb stick moves while its grip is held.
    pub gripped: Option<RobotId>,
    /// Its clock, if it tells of a world of its own.
    pub clock: Option<Box<SourceClock>>,
    stream: Rc<TcpStream>,
    wake: Rc<Notify>,
    /// What waits for it.
    pub outbox: Outbox,
    /// Frames wait that no turn has tried to write yet.
    pub dirty: bool,
    /// Its task waits for room in the socket and goes on writing then.
    pub waiting: bool,
    told: Vec<(Refusal, Option<TopicId>, Instant)>,
    /// Its connection must end: it is broken, or the client does not read the answers it asked for.
    pub lost: bool,
}

impl Client {
    /// Nothing registered, nothing waiting.
    pub fn new(
        id: ClientId,
        peer: SocketAddr,
        stream: Rc<TcpStream>,
        wake: Rc<Notify>,
        outbox: Outbox,
    ) -> Self {
        Self {
            id,
            peer,
            subscriptions: Vec::new(),
            publications: Vec::new(),
            expected: None,
            gripped: None,
            clock: None,
            stream,
            wake,
            outbox,
            dirty: false,
            waiting: false,
            told: Vec::new(),
            lost: false,
        }
    }

    /// Puts a frame on its way.
    pub fn push(&mut self, lane: Lane, bytes: Bytes, pool: &mut Pool) {
        if self.outbox.is_full(lane, &bytes) {
            // Perhaps only because this turn's frames have not been written yet.
            self.flush(pool);
        }
        if self.outbox.push(lane, bytes, pool).is_err() {
            self.lose();
        }
    }

    /// Straight to the socket, unless the client's task already waits for room in it.
    pub fn flush(&mut self, pool: &mut Pool) {
        if self.waiting {
            return;
        }
        match self.write(pool) {
            Ok(Flushed::All) => {}
            Ok(Flushed::Blocked | Flushed::TurnOver) => {
                self.waiting = true;
                self.wake.notify_one();
            }
            Err(_) => self.lose(),
        }
    }

    fn write(&mut self, pool: &mut Pool) -> std::io::Result<Flushed> {
        let stream = &self.stream;
        self.outbox.flush(|slices| stream.try_write_vectored(slices), pool)
    }

    fn lose(&mut self) {
        self.lost = true;
        self.wake.notify_one();
    }

    /// Whether this refusal has not been told within the last second.
    pub fn should_tell(&mut self, refusal: Refusal, topic: Option<TopicId>, now: Instant) -> bool {
        self.told.retain(|(.., at)| now.duration_since(*at) < TOLD_AGAIN);
        let told = self.told.iter().any(|(kind, of, _)| (*kind, *of) == (refusal, topic));
        if !told && self.told.len() < TOLD_MAX {
            self.told.push((refusal, topic, now));
        }
        !told
    }
}
