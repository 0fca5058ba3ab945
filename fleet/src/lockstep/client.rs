//! A ros_tcp client of a fleet in lockstep.

use super::tcp::{CONNECTION_BYTES_MAX, Connection, Port};
use bridge::command::{Registration, name};
use bridge::frame::{Parser, Side};
use bridge::ros::{self, Message};
use std::net::SocketAddr;
use std::rc::Rc;

/// Largest message, bytes: a map of 4096 x 4096 cells and its header.
const PAYLOAD_BYTES_MAX: usize = msg::grid::CELLS_MAX + (4 << 10);

/// Client with its registrations, which it repeats on each connection.
pub struct Client {
    port: Rc<Port>,
    peer: SocketAddr,
    connection: Option<(Rc<Connection>, Parser)>,
    registrations: Vec<(&'static str, Registration)>,
}

impl Client {
    /// Creates a client at an address; it is not connected yet.
    pub(super) fn new(port: &Rc<Port>, peer: SocketAddr) -> Self {
        Self { port: port.clone(), peer, connection: None, registrations: Vec::new() }
    }

    /// Registers a topic that the client wants to receive.
    pub fn subscribe(&mut self, topic: &str, message_type: &str) {
        self.register(name::SUBSCRIBE, topic, message_type);
    }

    /// Registers a topic that the client publishes.
    pub fn advertise<M: Message>(&mut self, topic: &str) {
        self.register(name::PUBLISH, topic, M::TYPE);
    }

    fn register(&mut self, command: &'static str, topic: &str, message_type: &str) {
        let registration = Registration {
            topic: topic.into(),
            message_name: message_type.into(),
            ..Registration::default()
        };
        if let Some((connection, _)) = &self.connection {
            let mut bytes = Vec::new();
            Side::Client.write_command(&mut bytes, command, &registration);
            connection.write(&bytes, self.port.now());
        }
        self.registrations.push((command, registration));
    }

    /// Returns whether the connection is open.
    pub fn is_connected(&self) -> bool {
        self.connection.as_ref().is_some_and(|(connection, _)| !connection.is_closed_by_bridge())
    }

    /// Connects, and registers the topics.
    pub fn connect(&mut self) {
        let connection = self.port.connect(self.peer);
        let mut bytes = Vec::new();
        for (command, registration) in &self.registrations {
            Side::Client.write_command(&mut bytes, command, registration);
        }
        connection.write(&bytes, self.port.now());
        self.connection = Some((connection, Parser::new(PAYLOAD_BYTES_MAX).keep(PAYLOAD_BYTES_MAX)));
    }

    /// Closes the connection.
    pub fn disconnect(&mut self) {
        if let Some((connection, _)) = self.connection.take() {
            connection.close();
        }
    }

    /// Publishes a message; it is lost if there is no connection.
    pub fn publish(&self, topic: &str, message: &impl Message) {
        if let Some((connection, _)) = &self.connection {
            let mut bytes = Vec::new();
            Side::Client.write_with(&mut bytes, topic, |out| ros::encode(message, out));
            connection.write(&bytes, self.port.now());
        }
    }

    /// Sends frames as they are; they are lost if there is no connection.
    pub fn send_frames(&self, frames: &[u8]) {
        if let Some((connection, _)) = &self.connection {
            connection.write(frames, self.port.now());
        }
    }

    /// Whether so many bytes wait for the bridge that a socket would take no more.
    pub fn is_blocked(&self) -> bool {
        self.connection
            .as_ref()
            .is_some_and(|(connection, _)| connection.waiting_bytes() >= CONNECTION_BYTES_MAX)
    }

    /// Passes on the messages that have arrived: topic and CDR. Notices of the bridge are left out.
    pub fn receive(&mut self, mut on_message: impl FnMut(&str, &[u8])) {
        if !self.port.is_open() {
            return;
        }
        let Some((connection, parser)) = &mut self.connection else { return };
        parser.push(&connection.read());
        let is_valid = loop {
            match parser.next_frame() {
                Ok(Some(frame)) => match std::str::from_utf8(frame.name) {
                    Ok(topic) if !topic.starts_with("__") => on_message(topic, frame.payload),
                    _ => {}
                },
                Ok(None) => break true,
                Err(_) => break false,
            }
        };
        // What follows cannot be read: a client on a socket closes its connection too.
        if !is_valid {
            self.disconnect();
        }
    }
}
