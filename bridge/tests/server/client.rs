//! A minimal ros_tcp client for the tests.

use bridge::command::{Handshake, Notice, Registration, TopicList, name};
use bridge::frame::{Parser, Side};
use bridge::ros::{Message, decode, encode};
use serde::Serialize;
use std::net::SocketAddr;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;

/// A frame that has not come by then never comes: a test fails, and does not hang.
const WAIT_MAX: Duration = Duration::from_secs(20);

pub struct Client {
    pub stream: TcpStream,
    parser: Parser,
}

pub type Received = (String, Vec<u8>);

impl Client {
    /// Connects without reading anything.
    pub async fn connect_raw(address: SocketAddr) -> Self {
        let stream = TcpStream::connect(address).await.unwrap();
        stream.set_nodelay(true).unwrap();
        Self { stream, parser: Parser::new(64 << 20) }
    }

    /// Connects and reads the handshake.
    pub async fn connect(address: SocketAddr) -> Self {
        let mut client = Self::connect_raw(address).await;
        let (name, payload) = client.next().await.unwrap();
        assert_eq!(name, name::HANDSHAKE);
        serde_json::from_slice::<Handshake>(&payload).unwrap();
        client
    }

    pub async fn raw(&mut self, bytes: &[u8]) {
        let write = timeout(WAIT_MAX, self.stream.write_all(bytes)).await;
        write.unwrap_or_else(|_| panic!("the server took nothing for {WAIT_MAX:?}")).unwrap();
    }

    pub async fn command(&mut self, name: &str, body: &impl Serialize) {
        let mut out = Vec::new();
        Side::Client.write_command(&mut out, name, body);
        self.raw(&out).await;
    }

    pub async fn register(&mut self, command: &str, topic: &str, class: &str) {
        let (topic, message_name) = (topic.to_owned(), class.to_owned());
        self.command(command, &Registration { topic, message_name, queue_size: 10, latch: false }).await;
    }

    pub async fn subscribe(&mut self, topic: &str, class: &str) {
        self.register(name::SUBSCRIBE, topic, class).await;
    }

    pub async fn publish(&mut self, topic: &str, class: &str) {
        self.register(name::PUBLISH, topic, class).await;
    }

    pub async fn send<M: Message>(&mut self, topic: &str, message: &M) {
        let mut out = Vec::new();
        Side::Client.write_with(&mut out, topic, |out| encode(message, out));
        self.raw(&out).await;
    }

    pub async fn send_bytes(&mut self, topic: &str, payload: &[u8]) {
        let mut out = Vec::new();
        Side::Client.write(&mut out, topic, payload);
        self.raw(&out).await;
    }

    /// Returns the next frame, or `None` when the server has closed.
    pub async fn next(&mut self) -> Option<Received> {
        loop {
            if let Some(frame) = self.parser.next_frame().expect("the server's frames are valid") {
                let name = String::from_utf8(frame.name.to_vec()).unwrap();
                assert!(!frame.payload.ends_with(b"}\0"), "no NUL toward the client");
                return Some((name, frame.payload.to_vec()));
            }
            let read = timeout(WAIT_MAX, self.stream.read(self.parser.space())).await;
            let count = read.unwrap_or_else(|_| panic!("no frame came in {WAIT_MAX:?}")).ok()?;
            if count == 0 {
                return None;
            }
            self.parser.filled(count);
        }
    }

    /// Returns the next message of a topic; other frames are dropped.
    pub async fn message<M: Message>(&mut self, topic: &str) -> M {
        loop {
            let (name, payload) = self.next().await.unwrap();
            if name == topic {
                return decode(&payload).unwrap();
            }
        }
    }

    /// Returns the text of the next `__error`, `__warn` or `__log`.
    pub async fn notice(&mut self, kind: &str) -> String {
        loop {
            let (name, payload) = self.next().await.expect("a notice comes before the end");
            if name == kind {
                return serde_json::from_slice::<Notice>(&payload).unwrap().text;
            }
        }
    }

    pub async fn error(&mut self) -> String {
        self.notice(name::ERROR).await
    }

    /// Waits until the server has handled everything sent so far; returns the frames until then, and the topic list.
    pub async fn settle(&mut self) -> (Vec<Received>, TopicList) {
        self.command(name::TOPIC_LIST, &serde_json::json!({})).await;
        let mut before = Vec::new();
        loop {
            let (name, payload) = self.next().await.unwrap();
            if name == name::TOPIC_LIST {
                return (before, serde_json::from_slice(&payload).unwrap());
            }
            before.push((name, payload));
        }
    }

    /// Closes with a reset, as a crash does.
    pub fn abort(self) {
        socket2::SockRef::from(&self.stream).set_linger(Some(Duration::ZERO)).unwrap();
    }
}
