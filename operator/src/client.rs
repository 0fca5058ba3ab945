//! ros_tcp client that registers topics, keeps the connection alive and reconnects, as Unity's connector does.
//!
//! [`Client`] reads on one thread and stamps messages right after the system call that brought them.
//! [`ClientHandle`] writes from any thread, each message as one frame in one write.

use bridge::command::{Handshake, Notice, Registration, TopicList, name};
use bridge::frame::{KEEPALIVE, Parser, RosTcpFrame, Side};
use bridge::ros::{self, Message};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::io::{self, Read, Write};
use std::net::{Shutdown, TcpStream, ToSocketAddrs};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Longest time without a write: as often the connector sends a keepalive.
const KEEPALIVE_EVERY: Duration = Duration::from_secs(1);
/// Time between two attempts to connect, as the connector waits.
const RETRY_EVERY: Duration = Duration::from_secs(1);
/// Longest time of one attempt to connect: a bridge on the same network answers within milliseconds.
const CONNECT_MAX: Duration = Duration::from_secs(1);
/// Longest time of a write: a peer that takes nothing for so long is treated as gone.
const WRITE_MAX: Duration = Duration::from_secs(1);
/// Largest message, bytes: a map of 4096 x 4096 cells and its header.
const PAYLOAD_BYTES_MAX: usize = msg::grid::CELLS_MAX + MAP_HEADER_BYTES_MAX;
/// Bytes of a map message beside its cells, generously.
const MAP_HEADER_BYTES_MAX: usize = 4096;
/// Versions of the ros_tcp endpoint that this client understands.
const ENDPOINT_VERSION: &str = "v0.7.";
/// Most registrations of one client.
const REGISTRATIONS_MAX: usize = 512;
/// Queue of a publisher, messages: the connector's default.
const QUEUE_SIZE: i64 = 10;
/// Most reads of one poll, so that the caller gets its turn under any load.
const READS_MAX: usize = 64;

/// Event that a poll returns.
#[derive(Debug)]
pub enum Event<'a> {
    /// The handshake arrived: the connection is up.
    Connected,
    /// The connection is down for this reason; the client keeps trying.
    Disconnected(String),
    /// Answer to [`ClientHandle::request_topics`], which is also sent after each connect.
    Topics(TopicList),
    /// Text from the server, with its command (`__log`, `__warn` or `__error`).
    ServerText(&'a str, String),
    /// Message on a subscribed topic.
    Message {
        /// Topic of the message.
        topic: &'a str,
        /// Content of the message, CDR.
        payload: &'a [u8],
        /// Time right after the read that completed the message.
        received: Instant,
    },
}

/// Reading side of the connection.
pub struct Client {
    address: String,
    handle: ClientHandle,
    connection: Option<Connection>,
    retry_at: Instant,
}

/// One established connection.
struct Connection {
    stream: TcpStream,
    parser: Parser,
    handshake_done: bool,
}

/// Writing side of the connection; clones share it.
#[derive(Clone, Default)]
pub struct ClientHandle {
    shared: Arc<Mutex<Shared>>,
}

#[derive(Default)]
struct Shared {
    stream: Option<TcpStream>,
    connections: u64,
    last_write: Option<Instant>,
    registrations: Vec<(&'static str, Registration)>,
    frame: Vec<u8>,
}

impl Client {
    /// A client of the server at `host:port`. It connects at the first [`Client::poll`].
    pub fn new(address: impl Into<String>) -> Self {
        Self {
            address: address.into(),
            handle: ClientHandle::default(),
            connection: None,
            retry_at: Instant::now(),
        }
    }

    /// Writing side of this client's connection.
    pub fn handle(&self) -> ClientHandle {
        self.handle.clone()
    }

    /// Waits until something arrives or `deadline`, and passes all that arrived to `on_event`.
    pub fn poll(&mut self, deadline: Instant, on_event: &mut dyn FnMut(Event<'_>)) {
        let outcome = match &mut self.connection {
            None => self.connect(deadline),
            Some(connection) => {
                self.handle.keep_alive().and_then(|()| connection.receive(deadline, on_event))
            }
        };
        if let Err(why) = outcome {
            self.connection = None;
            self.handle.lock().close();
            self.retry_at = Instant::now() + RETRY_EVERY;
            on_event(Event::Disconnected(format!("{}: {why}", self.address)));
        }
    }

    fn connect(&mut self, deadline: Instant) -> io::Result<()> {
        let now = Instant::now();
        if now < self.retry_at {
            std::thread::sleep(self.retry_at.min(deadline).saturating_duration_since(now));
            return Ok(());
        }
        let mut last = io::Error::new(io::ErrorKind::NotFound, "the host has no address");
        for address in self.address.to_socket_addrs()? {
            match TcpStream::connect_timeout(&address, CONNECT_MAX) {
                Ok(stream) => {
                    // Each message is sent at once, and a dead peer blocks a write for a second at most.
                    stream.set_nodelay(true)?;
                    stream.set_write_timeout(Some(WRITE_MAX))?;
                    self.handle.lock().start_session(stream.try_clone()?)?;
                    let parser = Parser::new(PAYLOAD_BYTES_MAX);
                    self.connection = Some(Connection { stream, parser, handshake_done: false });
                    return Ok(());
                }
                Err(why) => last = why,
            }
        }
        Err(last)
    }
}

impl Connection {
    fn receive(&mut self, deadline: Instant, on_event: &mut dyn FnMut(Event<'_>)) -> io::Result<()> {
        // No longer than until the next keepalive may be due.
        let wait = deadline.saturating_duration_since(Instant::now()).min(KEEPALIVE_EVERY / 4);
        if !self.is_readable(wait)? {
            return Ok(());
        }
        for _ in 0..READS_MAX {
            let count = self.stream.read(self.parser.space())?;
            let received = Instant::now();
            if count == 0 {
                return Err(io::Error::new(io::ErrorKind::UnexpectedEof, "the server closed the connection"));
            }
            self.parser.filled(count);
            while let Some(frame) = self.parser.next_frame().map_err(io::Error::other)? {
                handle_frame(frame, received, &mut self.handshake_done, on_event)?;
            }
            if Instant::now() >= deadline || !self.is_readable(Duration::ZERO)? {
                return Ok(());
            }
        }
        Ok(())
    }

    fn is_readable(&self, wait: Duration) -> io::Result<bool> {
        let timeout = Timespec { tv_sec: wait.as_secs() as i64, tv_nsec: i64::from(wait.subsec_nanos()) };
        match poll(&mut [PollFd::new(&self.stream, PollFlags::IN)], Some(&timeout)) {
            Ok(ready) => Ok(ready > 0),
            Err(rustix::io::Errno::INTR) => Ok(false),
            Err(why) => Err(why.into()),
        }
    }
}

fn handle_frame(
    frame: RosTcpFrame<'_>,
    received: Instant,
    handshake_done: &mut bool,
    on_event: &mut dyn FnMut(Event<'_>),
) -> io::Result<()> {
    let topic = core::str::from_utf8(frame.name).unwrap_or_default();
    if !*handshake_done {
        check_handshake(topic, frame.json()).map_err(io::Error::other)?;
        *handshake_done = true;
        on_event(Event::Connected);
        return Ok(());
    }
    match topic {
        // A keepalive, or a name that is not text.
        "" => {}
        name::TOPIC_LIST => on_event(Event::Topics(json_body(frame.json()))),
        name::LOG | name::WARN | name::ERROR => {
            on_event(Event::ServerText(topic, json_body::<Notice>(frame.json()).text));
        }
        // The other commands concern services, which this client does not use.
        command if command.starts_with("__") => {}
        topic => on_event(Event::Message { topic, payload: frame.payload, received }),
    }
    Ok(())
}

/// Reads the body of a command as the connector does: missing or invalid fields get their defaults.
fn json_body<T: Default + serde::de::DeserializeOwned>(json: &[u8]) -> T {
    serde_json::from_slice(json).unwrap_or_default()
}

/// Reason why a server is not one that this client understands.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
enum HandshakeError {
    /// The first frame is another one.
    #[error(
        "its first frame is '{first}', expected '{}': no ros_tcp endpoint; check host and port",
        name::HANDSHAKE
    )]
    FirstFrame { first: String },
    /// The endpoint has another version.
    #[error("the endpoint is of version '{version}', expected {ENDPOINT_VERSION}*")]
    Version { version: String },
    /// The endpoint speaks ROS 1, or does not say what it speaks.
    #[error("the endpoint speaks {}, expected ROS2", protocol.as_deref().unwrap_or("no protocol that it names"))]
    Protocol { protocol: Option<String> },
}

fn check_handshake(first: &str, json: &[u8]) -> Result<(), HandshakeError> {
    if first != name::HANDSHAKE {
        return Err(HandshakeError::FirstFrame { first: first.to_owned() });
    }
    let handshake: Handshake = json_body(json);
    if !handshake.version.starts_with(ENDPOINT_VERSION) {
        return Err(HandshakeError::Version { version: handshake.version });
    }
    let metadata: serde_json::Value = serde_json::from_str(&handshake.metadata).unwrap_or_default();
    match metadata["protocol"].as_str() {
        Some("ROS2") => Ok(()),
        other => Err(HandshakeError::Protocol { protocol: other.map(str::to_owned) }),
    }
}

impl ClientHandle {
    /// Subscribes to a topic, now and after every reconnect.
    pub fn subscribe(&self, topic: &str, message_name: &str) {
        self.register(name::SUBSCRIBE, topic, message_name);
    }

    /// Registers as a publisher of a topic, now and after every reconnect.
    pub fn advertise<M: Message>(&self, topic: &str) {
        self.register(name::PUBLISH, topic, M::TYPE);
    }

    fn register(&self, command: &'static str, topic: &str, message_name: &str) {
        let registration = Registration {
            topic: topic.to_owned(),
            message_name: message_name.to_owned(),
            queue_size: if command == name::PUBLISH { QUEUE_SIZE } else { 0 },
            latch: false,
        };
        let mut shared = self.lock();
        let known = shared.registrations.iter().any(|(c, r)| *c == command && r.topic == topic);
        if known || shared.registrations.len() == REGISTRATIONS_MAX {
            return;
        }
        shared.write(|out| write_registration(out, command, &registration));
        shared.registrations.push((command, registration));
    }

    /// Requests the list of topics; it arrives as [`Event::Topics`].
    pub fn request_topics(&self) {
        self.lock().write(write_topic_list);
    }

    /// Publishes a message on an advertised topic. Returns false if the connection is down.
    pub fn publish<M: Message>(&self, topic: &str, message: &M) -> bool {
        self.lock().write(|out| Side::Client.write_with(out, topic, |out| ros::encode(message, out)))
    }

    /// Number of connections made so far.
    pub fn connections(&self) -> u64 {
        self.lock().connections
    }

    fn keep_alive(&self) -> io::Result<()> {
        let mut shared = self.lock();
        let is_due = shared.last_write.is_none_or(|at| at.elapsed() >= KEEPALIVE_EVERY);
        if is_due && !shared.write(|out| out.extend_from_slice(&KEEPALIVE)) {
            return Err(io::Error::new(io::ErrorKind::BrokenPipe, "the server accepts no data any more"));
        }
        Ok(())
    }

    fn lock(&self) -> MutexGuard<'_, Shared> {
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Shared {
    /// Sends a keepalive, all registrations and a request for the topics, as the connector does first.
    fn start_session(&mut self, stream: TcpStream) -> io::Result<()> {
        self.stream = Some(stream);
        self.connections += 1;
        let registrations = core::mem::take(&mut self.registrations);
        let written = self.write(|out| {
            out.extend_from_slice(&KEEPALIVE);
            registrations.iter().for_each(|(command, r)| write_registration(out, command, r));
            write_topic_list(out);
        });
        self.registrations = registrations;
        if written { Ok(()) } else { Err(io::ErrorKind::BrokenPipe.into()) }
    }

    /// Writes a frame and returns whether it was written. A failed write ends the connection, because half a frame
    /// may have been sent.
    fn write(&mut self, fill: impl FnOnce(&mut Vec<u8>)) -> bool {
        let Some(stream) = &mut self.stream else { return false };
        self.frame.clear();
        fill(&mut self.frame);
        if stream.write_all(&self.frame).is_err() {
            self.close();
            return false;
        }
        self.last_write = Some(Instant::now());
        true
    }

    fn close(&mut self) {
        if let Some(stream) = self.stream.take() {
            // It wakes the reader. An error means that the peer is gone already.
            let _ = stream.shutdown(Shutdown::Both);
        }
    }
}

fn write_topic_list(out: &mut Vec<u8>) {
    Side::Client.write_command(out, name::TOPIC_LIST, &serde_json::json!({}));
}

/// Writes the bodies that the connector writes: a subscription has two fields, a publication four.
fn write_registration(out: &mut Vec<u8>, command: &str, registration: &Registration) {
    let Registration { topic, message_name, .. } = registration;
    if command == name::PUBLISH {
        Side::Client.write_command(out, command, registration);
    } else {
        let body = serde_json::json!({ "topic": topic, "message_name": message_name });
        Side::Client.write_command(out, command, &body);
    }
}

#[cfg(test)]
mod tests;
