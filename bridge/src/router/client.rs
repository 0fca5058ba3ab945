//! One connected client, with its subscriptions, its publications and the frames that wait for it.

use super::buffers::{BufferPool, SharedFrame};
use super::link::{ConnectionRate, LiveDelay, SEND_BUFFER_FIRST};
use super::outgoing::{FlushOutcome, FrameKind, OutgoingQueue};
use super::topics::TopicId;
use msg::Monotonic;
use std::io::{self, IoSlice};
use std::net::SocketAddr;
use thiserror::Error;

/// Identifies one connection, and never a later one that uses the same slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ClientId {
    /// Index in the router's table of clients.
    pub(crate) slot: usize,
    /// Number of the connection, counted from 1.
    pub(crate) serial: u64,
}

impl ClientId {
    /// All participants on DDS: DDS does not name its publishers, so that together they are one driver.
    pub(crate) const DDS: Self = Self { slot: usize::MAX, serial: u64::MAX };
}

/// The connection is closed, or must be: it is broken, or the client does not read the replies that it asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("the connection is closed")]
pub struct ConnectionEnded;

/// The socket of a client, as the router sees it.
pub trait ClientSocket {
    /// Writes as many bytes as the socket accepts now; [`io::ErrorKind::WouldBlock`] if it accepts none.
    fn try_write(&self, slices: &[IoSlice<'_>]) -> io::Result<usize>;
    /// Sets how many bytes the kernel may hold for the connection, without what Linux adds for its own use.
    fn set_send_buffer(&self, bytes: usize);
    /// Returns the monotonic time.
    fn now(&self) -> Monotonic;
    /// Wakes the task that serves this client: frames wait for the socket, or the connection must end.
    fn wake(&self);
    /// Returns whether frames wait for a moment, so that those of several events are written together. The client's task writes
    /// them: [`TopicRouter::flush_client`](super::TopicRouter::flush_client).
    fn gathers(&self) -> bool {
        false
    }
    /// Returns whether a service call that fails is answered with [`crate::command::name::CALL_FAILURE`]: ros_tcp has no such frame.
    fn takes_call_failures(&self) -> bool {
        false
    }
}

/// The service frame that must come next on a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExpectedFrame {
    /// The request of the client's call with this number.
    Request(i64),
    /// The client's response to the bridge's call with this number.
    Response(i64),
}

/// The kind of a refused data frame; the client is told of the same kind once a second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RefusalKind {
    /// The client has not registered the topic for publication.
    NotRegistered,
    /// The payload is not the topic's message.
    Payload,
    /// The client's address has no permission.
    Permission,
    /// Another client drives the robot, or is the source of its data.
    OtherClient,
    /// The emergency stop is set.
    EmergencyStop,
    /// The message is well formed, but its values are not accepted.
    Content,
    /// The message is passed on, but not kept for late subscribers.
    NotLatched,
    /// The topic is passed on, but would be that of a robot which the fleet does not have.
    AbsentRobot,
}

/// The client is told of the same refusal again after this time, nanoseconds: 1 s.
const REFUSAL_REPEAT_NS: u64 = 1_000_000_000;
/// Recent refusals that are remembered for each client.
const REFUSALS_MAX: usize = 16;

/// A topic that a client has registered to publish.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Publication {
    /// The topic's index in the table of topics.
    pub topic: TopicId,
    /// Whether the client publishes TwistStamped on a topic of Twist.
    pub stamped: bool,
    /// Whether the client asked for its newest message to be kept for late subscribers.
    pub latch: bool,
}

/// A frame over [`crate::frame::IDLE_BYTES`] that is being received.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LargeFrame {
    /// Bytes that had arrived at the time `at`.
    pub arrived_bytes: usize,
    /// When the frame last made progress.
    pub at: Monotonic,
}

/// What a client has sent, and when.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InputState {
    /// When the client connected.
    pub connected_at: Monotonic,
    /// When the client last sent a whole frame, or made progress with a large one.
    pub last_at: Monotonic,
    /// Whether the client is a part of this process, which lives while the process does, whatever it sends.
    pub is_permanent: bool,
    /// The large frame that is being received.
    pub large_frame: Option<LargeFrame>,
    /// Size of the input buffer, bytes, if it has grown for a large frame.
    pub buffer_bytes: usize,
}

/// One connected client.
// More than 12 fields: what is sent, what is received, and the state of the connection.
pub struct Client {
    /// Identifies the connection.
    pub id: ClientId,
    /// The client's address.
    pub peer: SocketAddr,
    /// Topics that are sent to the client.
    pub subscriptions: Vec<TopicId>,
    /// Topics that the client may publish.
    pub publications: Vec<Publication>,
    /// The service frame that must come next from the client.
    pub expected: Option<ExpectedFrame>,
    /// Frames that wait for the client.
    pub outgoing: OutgoingQueue,
    /// The measured rate of the connection.
    pub link: ConnectionRate,
    /// The age of live messages when they leave.
    pub live_delay: LiveDelay,
    /// What the kernel may hold for the connection, bytes.
    send_buffer: usize,
    /// Subscriptions to live topics, which bulk frames must not delay.
    pub live_subscriptions: usize,
    /// When the client subscribed last, by its socket's clock.
    pub subscribed_at: Monotonic,
    /// What the client has sent.
    pub input: InputState,
    /// `None` for a client in this process, which takes its frames itself.
    socket: Option<Box<dyn ClientSocket>>,
    /// Frames wait that no flush has tried to write yet, or that are being gathered.
    pub needs_flush: bool,
    /// The client's task waits until the socket accepts bytes, and continues writing then.
    pub is_blocked: bool,
    /// The connection must end.
    pub has_failed: bool,
    recent_refusals: Vec<(RefusalKind, Option<TopicId>, Monotonic)>,
    /// Topics of which the client knows that they are not published in ROS.
    unrelayed: Vec<TopicId>,
}

impl Client {
    /// Creates a client without registrations.
    pub fn new(
        id: ClientId,
        peer: SocketAddr,
        socket: Option<Box<dyn ClientSocket>>,
        outgoing: OutgoingQueue,
    ) -> Self {
        // Until the connection's rate is known.
        socket.iter().for_each(|socket| socket.set_send_buffer(SEND_BUFFER_FIRST));
        Self {
            id,
            peer,
            subscriptions: Vec::new(),
            publications: Vec::new(),
            expected: None,
            outgoing,
            link: ConnectionRate::default(),
            live_delay: LiveDelay::default(),
            send_buffer: SEND_BUFFER_FIRST,
            live_subscriptions: 0,
            subscribed_at: Monotonic::default(),
            input: InputState::default(),
            socket,
            needs_flush: false,
            is_blocked: false,
            has_failed: false,
            recent_refusals: Vec::new(),
            unrelayed: Vec::new(),
        }
    }

    /// Returns whether the client has registered to publish a topic.
    pub fn publishes(&self, topic: TopicId) -> bool {
        self.publications.iter().any(|publication| publication.topic == topic)
    }

    /// Puts a frame into the client's queue. `now` is the time of the client's socket.
    pub fn push(&mut self, kind: FrameKind, frame: SharedFrame, now: Monotonic, pool: &mut BufferPool) {
        if self.outgoing.is_full(kind, &frame) {
            // The queue may be full only because this turn's frames have not been written yet.
            self.flush(now, pool);
        }
        self.update_time(now);
        if self.outgoing.push(kind, frame, pool).is_err() {
            self.fail();
        }
    }

    /// Returns whether the client is told of a failed service call as such.
    pub fn takes_call_failures(&self) -> bool {
        self.socket.as_ref().is_some_and(|socket| socket.takes_call_failures())
    }

    /// Returns whether frames wait for those of the next events, and for the client's task.
    pub fn gathers(&self) -> bool {
        !self.is_blocked && self.socket.as_ref().is_some_and(|socket| socket.gathers())
    }

    /// Returns the time of the client's socket, if it has one.
    pub fn socket_time(&self) -> Option<Monotonic> {
        self.socket.as_ref().map(|socket| socket.now())
    }

    /// Tells the queue the time, and which bulk frames may be begun now.
    fn update_time(&mut self, now: Monotonic) {
        if self.socket.is_none() {
            return;
        }
        let budget = match self.live_subscriptions {
            0 => ConnectionRate::budget_without_live_topics(self.subscribed_at, now),
            _ => self.link.bulk_budget(now),
        };
        self.outgoing.set_link(now, budget, self.is_blocked || self.link.is_slow());
    }

    /// Writes waiting frames to the socket, unless the client's task already waits for the socket.
    pub fn flush(&mut self, now: Monotonic, pool: &mut BufferPool) {
        if self.is_blocked || self.socket.is_none() {
            return;
        }
        self.update_time(now);
        self.outgoing.drop_expired(pool);
        self.outgoing.reduce_held(pool);
        let Some(socket) = &self.socket else { return };
        let mut written = 0;
        let result = self.outgoing.flush(
            |slices| {
                let count = socket.try_write(slices)?;
                written += count;
                Ok(count)
            },
            pool,
        );
        match result {
            Ok(outcome) => {
                self.is_blocked = outcome != FlushOutcome::Complete;
                self.record_written(written, now);
                if self.is_blocked {
                    self.wake();
                }
            }
            Err(_) => self.fail(),
        }
    }

    /// Measures the connection's rate, and fits the kernel's buffer to it.
    fn record_written(&mut self, written: usize, now: Monotonic) {
        let Some(socket) = &self.socket else { return };
        // Only a rate needs the time after the write.
        let now = if self.is_blocked || self.link.is_waiting() { socket.now() } else { now };
        self.link.record(written, self.is_blocked, now);
        let begun = self.outgoing.take_begun();
        if begun.bulk_bytes > 0 {
            self.link.record_bulk(begun.bulk_bytes, now);
        }
        self.live_delay.record(begun.live_wait + self.link.kernel_delay(), now);
        let send_buffer = self.link.send_buffer_bytes();
        if send_buffer != self.send_buffer {
            socket.set_send_buffer(send_buffer);
            self.send_buffer = send_buffer;
        }
    }

    /// Ends the connection, and drops what waits.
    pub fn fail(&mut self) {
        self.has_failed = true;
        self.outgoing.clear();
        self.wake();
    }

    /// Wakes the task that serves the client.
    pub fn wake(&self) {
        self.socket.iter().for_each(|socket| socket.wake());
    }

    /// Returns whether the client has not been told of this refusal within the last second, and records it.
    pub fn should_report(&mut self, kind: RefusalKind, topic: Option<TopicId>, now: Monotonic) -> bool {
        self.recent_refusals.retain(|(.., at)| now.since(*at) < REFUSAL_REPEAT_NS);
        let is_recent = self.recent_refusals.iter().any(|(known, of, _)| (*known, *of) == (kind, topic));
        if !is_recent && self.recent_refusals.len() < REFUSALS_MAX {
            self.recent_refusals.push((kind, topic, now));
        }
        !is_recent
    }

    /// Returns whether the client has not been told yet that a topic is not published in ROS, and records it.
    pub fn should_report_unrelayed(&mut self, topic: TopicId) -> bool {
        let is_new = !self.unrelayed.contains(&topic);
        if is_new {
            self.unrelayed.push(topic);
        }
        is_new
    }
}
