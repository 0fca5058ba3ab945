//! The client that receives, or sends, what is measured.

use bridge::command::{Registration, name};
use bridge::frame::{Parser, Side};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};

/// A blocking ros_tcp client.
pub struct Client {
    pub stream: TcpStream,
    parser: Parser,
}

impl Client {
    /// Connects with (command, topic, type) registrations, and waits until they are done.
    pub fn connect(address: SocketAddr, registrations: &[(&str, &str, &str)]) -> Self {
        let stream = TcpStream::connect(address).unwrap();
        let mut out = Vec::new();
        for (command, topic, class) in registrations {
            let (topic, message_name) = ((*topic).to_owned(), (*class).to_owned());
            let registration = Registration { topic, message_name, queue_size: 4096, latch: false };
            Side::Client.write_command(&mut out, command, &registration);
        }
        Side::Client.write_command(&mut out, name::TOPIC_LIST, &serde_json::json!({}));
        (&stream).write_all(&out).unwrap();
        let mut client = Self { stream, parser: Parser::new(64 << 20).keep(64 << 20) };
        while client.next(|name, _| name == name::TOPIC_LIST.as_bytes()) != Some(true) {}
        client
    }

    /// Returns what `see` makes of the next frame's name and payload, or `None` after the socket's read timeout.
    pub fn next<T>(&mut self, see: impl FnOnce(&[u8], &[u8]) -> T) -> Option<T> {
        loop {
            if let Some(frame) = self.parser.next_frame().unwrap() {
                return Some(see(frame.name, frame.payload));
            }
            match self.stream.read(self.parser.space()) {
                Ok(0) | Err(_) => return None,
                Ok(count) => self.parser.filled(count),
            }
        }
    }
}
