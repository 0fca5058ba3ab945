//! A client in the test's own process: it sends frames to a bridge without sockets and reads its answers.

use bridge::command::{Notice, Registration, name};
use bridge::frame::{Parser, Side};
use bridge::ros::{Message, decode, encode};
use bridge::{Bridge, ClientId};
use msg::Monotonic;

/// The longest frame of these tests, bytes.
const FRAME_BYTES_MAX: usize = 1 << 20;

/// One client of a bridge.
pub struct LocalClient<'a> {
    bridge: &'a Bridge,
    id: ClientId,
}

impl<'a> LocalClient<'a> {
    /// Connects a client on loopback.
    pub fn connect(bridge: &'a Bridge) -> Self {
        Self { bridge, id: bridge.connect(([127, 0, 0, 1], 1).into()).unwrap() }
    }

    /// Subscribes to a topic.
    pub fn subscribe<M: Message>(&self, topic: &str) {
        self.register(name::SUBSCRIBE, topic, M::TYPE);
    }

    /// Registers as publisher of a topic.
    pub fn publish<M: Message>(&self, topic: &str) {
        self.register(name::PUBLISH, topic, M::TYPE);
    }

    /// Registers as publisher of a topic whose newest message late subscribers get.
    pub fn publish_latched<M: Message>(&self, topic: &str) {
        let (topic, message_name) = (topic.to_owned(), M::TYPE.to_owned());
        self.command(
            name::PUBLISH,
            &Registration { topic, message_name, latch: true, ..Registration::default() },
        );
    }

    fn register(&self, command: &str, topic: &str, message_type: &str) {
        let registration = Registration {
            topic: topic.to_owned(),
            message_name: message_type.to_owned(),
            ..Registration::default()
        };
        self.command(command, &registration);
    }

    fn command(&self, command: &str, registration: &Registration) {
        let mut bytes = Vec::new();
        Side::Client.write_command(&mut bytes, command, registration);
        self.receive(&bytes, Monotonic(0));
    }

    /// Sends a message at a time.
    pub fn send<M: Message>(&self, topic: &str, message: &M, now: Monotonic) {
        let mut bytes = Vec::new();
        Side::Client.write_with(&mut bytes, topic, |out| encode(message, out));
        self.receive(&bytes, now);
    }

    fn receive(&self, bytes: &[u8], now: Monotonic) {
        let mut parser = Parser::new(FRAME_BYTES_MAX);
        parser.push(bytes);
        while let Some(frame) = parser.next_frame().unwrap() {
            self.bridge.receive(self.id, frame, now);
        }
    }

    /// Takes the frames that wait: name and payload.
    pub fn take_frames(&self) -> Vec<(String, Vec<u8>)> {
        let mut bytes = Vec::new();
        self.bridge.take_outgoing(self.id, &mut bytes).unwrap();
        let mut parser = Parser::new(FRAME_BYTES_MAX);
        parser.push(&bytes);
        let mut frames = Vec::new();
        while let Some(frame) = parser.next_frame().unwrap() {
            frames.push((String::from_utf8(frame.name.to_vec()).unwrap(), frame.payload.to_vec()));
        }
        frames
    }

    /// Takes all frames that wait and returns the messages of one topic among them. Fails on an error notice.
    pub fn take<M: Message>(&self, topic: &str) -> Vec<M> {
        let frames = self.take_frames();
        for (name, payload) in &frames {
            let text = || serde_json::from_slice::<Notice>(payload).unwrap().text;
            assert!(name != name::ERROR, "{}", text());
        }
        let of_topic = frames.iter().filter(|(name, _)| name == topic);
        of_topic.map(|(_, payload)| decode(payload).unwrap()).collect()
    }
}
