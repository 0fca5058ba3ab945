//! The ros_tcp client: what Unity's connector does on the wire, without Unity. Connects, registers, keeps the
//! link alive, takes frames and says when each came, and comes back when the link is lost.
//!
//! [`Client`] reads, on one thread, stamping right after the system call that brought the bytes; [`Voice`] writes,
//! from any thread, each message as one frame in one write.

use bridge::command::{Handshake, Notice, Registration, TopicList, name};
use bridge::frame::{Frame, KEEPALIVE, Parser, Side};
use bridge::ros::{self, Message};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::io::{self, Read, Write};
use std::net::{Shutdown, TcpStream, ToSocketAddrs};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// The connector says something at least this often.
const KEEPALIVE_EVERY: Duration = Duration::from_secs(1);
/// The connector's pause between two attempts.
const RETRY_EVERY: Duration = Duration::from_secs(1);
const CONNECT_MAX: Duration = Duration::from_secs(1);
/// A peer that takes nothing for so long is as good as gone.
const WRITE_MAX: Duration = Duration::from_secs(1);
/// The largest message: a map of 4096 x 4096 cells and what stands around it.
const PAYLOAD_BYTES_MAX: usize = msg::grid::CELLS_MAX + 4096;
/// Topics one client can register.
const REGISTRATIONS_MAX: usize = 512;
/// Publishers' queue, as the connector asks for by default.
const QUEUE_SIZE: i64 = 10;
/// Reads in a row before the caller gets its turn.
const READS_MAX: usize = 64;

/// What comes in.
#[derive(Debug)]
pub enum Event<'a> {
    /// The handshake came: the link is up.
    Connected,
    /// The link is down, for this reason; the client keeps trying.
    Lost(String),
    /// The answer to [`Voice::ask_topics`], which is also asked at each connect.
    Topics(TopicList),
    /// Words from the server: the command (`__log`, `__warn`, `__error`) and the text.
    Notice(&'a str, String),
    /// A message on a subscribed topic.
    Message {
        /// Its topic.
        topic: &'a str,
        /// CDR.
        payload: &'a [u8],
        /// Right after the read that completed it.
        received: Instant,
    },
}

/// The side of the link that reads.
pub struct Client {
    address: String,
    voice: Voice,
    link: Option<Link>,
    retry_at: Instant,
}

/// One connection.
struct Link {
    stream: TcpStream,
    parser: Parser,
    greeted: bool,
}

/// The side of the link that writes. Clones share the link.
#[derive(Clone, Default)]
pub struct Voice {
    shared: Arc<Mutex<Shared>>,
}

#[derive(Default)]
struct Shared {
    stream: Option<TcpStream>,
    connections: u64,
    wrote: Option<Instant>,
    registrations: Vec<(&'static str, Registration)>,
    frame: Vec<u8>,
}

impl Client {
    /// For a server at `host:port`. Connects at the first [`Client::poll`].
    pub fn new(address: impl Into<String>) -> Self {
        Self { address: address.into(), voice: Voice::default(), link: None, retry_at: Instant::now() }
    }

    /// The link's other side.
    pub fn voice(&self) -> Voice {
        self.voice.clone()
    }

    /// Waits for the server until something came or `deadline`, and hands over all that came.
    pub fn poll(&mut self, deadline: Instant, on: &mut dyn FnMut(Event<'_>)) {
        let outcome = match &mut self.link {
            None => self.connect(deadline),
            Some(link) => self.voice.keep_alive().and_then(|()| link.listen(deadline, on)),
        };
        if let Err(why) = outcome {
            self.link = None;
            self.voice.lock().hang_up();
            self.retry_at = Instant::now() + RETRY_EVERY;
            on(Event::Lost(format!("{}: {why}", self.address)));
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
                    // Each message goes out at once, and a dead peer holds nobody up for long.
                    stream.set_nodelay(true)?;
                    stream.set_write_timeout(Some(WRITE_MAX))?;
                    self.voice.lock().introduce(stream.try_clone()?)?;
                    self.link = Some(Link { stream, parser: Parser::new(PAYLOAD_BYTES_MAX), greeted: false });
                    return Ok(());
                }
                Err(why) => last = why,
            }
        }
        Err(last)
    }
}

impl Link {
    fn listen(&mut self, deadline: Instant, on: &mut dyn FnMut(Event<'_>)) -> io::Result<()> {
        // Not longer than until the next keepalive may be due.
        let wait = deadline.saturating_duration_since(Instant::now()).min(KEEPALIVE_EVERY / 4);
        if !self.readable(wait)? {
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
                take(frame, received, &mut self.greeted, on)?;
            }
            if Instant::now() >= deadline || !self.readable(Duration::ZERO)? {
                return Ok(());
            }
        }
        Ok(())
    }

    fn readable(&self, wait: Duration) -> io::Result<bool> {
        let timeout = Timespec { tv_sec: wait.as_secs() as i64, tv_nsec: i64::from(wait.subsec_nanos()) };
        match poll(&mut [PollFd::new(&self.stream, PollFlags::IN)], Some(&timeout)) {
            Ok(ready) => Ok(ready > 0),
            Err(rustix::io::Errno::INTR) => Ok(false),
            Err(why) => Err(why.into()),
        }
    }
}

fn take(
    frame: Frame<'_>,
    received: Instant,
    greeted: &mut bool,
    on: &mut dyn FnMut(Event<'_>),
) -> io::Result<()> {
    let topic = core::str::from_utf8(frame.name).unwrap_or_default();
    if !*greeted {
        check_handshake(topic, frame.json()).map_err(io::Error::other)?;
        *greeted = true;
        on(Event::Connected);
        return Ok(());
    }
    match topic {
        // Keepalives, and names that are not text.
        "" => {}
        name::TOPIC_LIST => on(Event::Topics(body(frame.json()))),
        name::LOG | name::WARN | name::ERROR => on(Event::Notice(topic, body::<Notice>(frame.json()).text)),
        // Other commands concern services, of which this client has none.
        command if command.starts_with("__") => {}
        topic => on(Event::Message { topic, payload: frame.payload, received }),
    }
    Ok(())
}

/// As the connector reads: what is missing or odd becomes the default.
fn body<T: Default + serde::de::DeserializeOwned>(json: &[u8]) -> T {
    serde_json::from_slice(json).unwrap_or_default()
}

fn check_handshake(first: &str, json: &[u8]) -> Result<(), String> {
    if first != name::HANDSHAKE {
        return Err(format!(
            "its first frame is '{first}', expected '{}': no ros_tcp endpoint",
            name::HANDSHAKE
        ));
    }
    let handshake: Handshake = body(json);
    if !handshake.version.starts_with("v0.7.") {
        return Err(format!("the endpoint is of version '{}', expected v0.7", handshake.version));
    }
    let metadata: serde_json::Value = serde_json::from_str(&handshake.metadata).unwrap_or_default();
    match metadata["protocol"].as_str() {
        Some("ROS2") => Ok(()),
        other => Err(format!("the endpoint speaks {other:?}, expected ROS2")),
    }
}

impl Voice {
    /// Subscribes to a topic, now and after every reconnect.
    pub fn subscribe(&self, topic: &str, message_name: &str) {
        self.register(name::SUBSCRIBE, topic, message_name);
    }

    /// Announces messages on a topic, now and after every reconnect.
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

    /// Asks for the list of topics.
    pub fn ask_topics(&self) {
        self.lock().write(write_topic_list);
    }

    /// Writes a message on an advertised topic; false if the link is down.
    pub fn publish<M: Message>(&self, topic: &str, message: &M) -> bool {
        self.lock().write(|out| Side::Client.write_with(out, topic, |out| ros::encode(message, out)))
    }

    /// How often a connection was made.
    pub fn connections(&self) -> u64 {
        self.lock().connections
    }

    fn keep_alive(&self) -> io::Result<()> {
        let mut shared = self.lock();
        let quiet = shared.wrote.is_none_or(|at| at.elapsed() >= KEEPALIVE_EVERY);
        if quiet && !shared.write(|out| out.extend_from_slice(&KEEPALIVE)) {
            return Err(io::Error::new(io::ErrorKind::BrokenPipe, "the server takes nothing any more"));
        }
        Ok(())
    }

    fn lock(&self) -> MutexGuard<'_, Shared> {
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Shared {
    /// A keepalive, all registrations, and the question for the topics, as the connector begins.
    fn introduce(&mut self, stream: TcpStream) -> io::Result<()> {
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

    /// Whether it was written. A write that fails ends the connection: half a frame may be out.
    fn write(&mut self, fill: impl FnOnce(&mut Vec<u8>)) -> bool {
        let Some(stream) = &mut self.stream else { return false };
        self.frame.clear();
        fill(&mut self.frame);
        if stream.write_all(&self.frame).is_err() {
            self.hang_up();
            return false;
        }
        self.wrote = Some(Instant::now());
        true
    }

    fn hang_up(&mut self) {
        if let Some(stream) = self.stream.take() {
            // The reader wakes by it; if the peer is gone already, so be it.
            let _ = stream.shutdown(Shutdown::Both);
        }
    }
}

fn write_topic_list(out: &mut Vec<u8>) {
    Side::Client.write_command(out, name::TOPIC_LIST, &serde_json::json!({}));
}

/// The connector's bodies: a subscription has two fields, a publication four.
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
