//! A WebSocket connection: the router's side of it, and the reader of what the browser sends.

use super::encoder::Encoder;
use crate::connection::Stream;
use crate::router::ClientSocket;
use msg::Monotonic;
use socket2::SockRef;
use std::cell::RefCell;
use std::io::{self, IoSlice, Read, Write};
use std::rc::Rc;
use tokio::sync::Notify;
use tungstenite::protocol::{Role, WebSocket, WebSocketConfig};
use tungstenite::{Error, Message};

/// The longest message of a browser, bytes. It sends commands, no maps.
pub const MESSAGE_BYTES_MAX: usize = 256 << 10;

/// A client's socket for the router: it takes ros_tcp frames, and sends messages of the Foxglove protocol.
pub(super) struct PageSocket<S> {
    /// The connection to the browser.
    pub stream: Rc<S>,
    /// Wakes the client's task.
    pub wake: Rc<Notify>,
    /// The monotonic time.
    pub clock: fn() -> Monotonic,
    /// The encoder, which the client's task uses too.
    pub encoder: Rc<RefCell<Encoder>>,
}

impl<S: Stream> ClientSocket for PageSocket<S> {
    fn now(&self) -> Monotonic {
        (self.clock)()
    }

    fn try_write(&self, slices: &[IoSlice<'_>]) -> io::Result<usize> {
        let mut encoder = self.encoder.borrow_mut();
        let result = encoder.write(slices, |slices| self.stream.try_write_vectored(slices));
        if encoder.has_waiting() {
            self.wake.notify_one();
        }
        result
    }

    fn set_send_buffer(&self, bytes: usize) {
        // It fails only on a connection that is closed, which the next write notices.
        let _ = SockRef::from(self.stream.tcp()).set_send_buffer_size(bytes);
    }

    fn wake(&self) {
        self.wake.notify_one();
    }

    /// Each write wakes the browser: one for all robots' messages of a moment costs both less, and delays no other client.
    fn gathers(&self) -> bool {
        true
    }

    fn takes_call_failures(&self) -> bool {
        true
    }
}

/// Bytes to and from the WebSocket library, which sees no socket.
#[derive(Debug, Default)]
struct Pipe {
    received: Vec<u8>,
    begin: usize,
    /// Frames that the library sends by itself: replies to pings and to a close.
    replies: Vec<u8>,
}

impl Read for Pipe {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let rest = &self.received[self.begin..];
        if rest.is_empty() {
            return Err(io::ErrorKind::WouldBlock.into());
        }
        let count = rest.len().min(out.len());
        out[..count].copy_from_slice(&rest[..count]);
        self.begin += count;
        Ok(count)
    }
}

impl Write for Pipe {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.replies.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Cuts a browser's bytes into messages.
pub struct MessageReader {
    socket: WebSocket<Pipe>,
}

impl MessageReader {
    /// Creates a reader for a connection whose handshake is done.
    pub fn new() -> Self {
        let config = WebSocketConfig::default()
            .max_message_size(Some(MESSAGE_BYTES_MAX))
            .max_frame_size(Some(MESSAGE_BYTES_MAX))
            .read_buffer_size(READ_BUFFER_BYTES);
        Self { socket: WebSocket::from_raw_socket(Pipe::default(), Role::Server, Some(config)) }
    }

    /// Adds received bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        let pipe = self.socket.get_mut();
        pipe.received.drain(..pipe.begin);
        pipe.begin = 0;
        pipe.received.extend_from_slice(bytes);
    }

    /// Returns the next message, or `None` if it needs more bytes. After an error the connection must be closed.
    pub fn next_message(&mut self) -> Result<Option<Message>, Error> {
        match self.socket.read() {
            Ok(message) => Ok(Some(message)),
            Err(Error::Io(error)) if error.kind() == io::ErrorKind::WouldBlock => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Prepares a ping, which browsers answer by themselves.
    pub fn ping(&mut self) -> Result<(), Error> {
        self.socket.send(Message::Ping(Default::default()))
    }

    /// Takes the frames that are to be sent: replies and pings.
    pub fn take_replies(&mut self) -> Vec<u8> {
        // The pipe takes everything; after a close nothing is to be sent.
        let _ = self.socket.flush();
        std::mem::take(&mut self.socket.get_mut().replies)
    }
}

/// Bytes that the library reads at a time.
const READ_BUFFER_BYTES: usize = 4096;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A browser's frame, which is masked.
    fn masked(payload: &[u8]) -> Vec<u8> {
        let mut browser = WebSocket::from_raw_socket(Pipe::default(), Role::Client, None);
        browser.send(Message::Binary(payload.to_vec().into())).unwrap();
        std::mem::take(&mut browser.get_mut().replies)
    }

    #[test]
    fn a_message_over_the_limit_ends_the_connection_before_it_is_held() {
        let mut reader = MessageReader::new();
        let frame = masked(&vec![0; MESSAGE_BYTES_MAX + 1]);
        reader.push(&frame[..20]);
        assert!(matches!(reader.next_message(), Err(Error::Capacity(_))));
    }

    #[test]
    fn an_unmasked_frame_ends_the_connection() {
        let mut reader = MessageReader::new();
        reader.push(&[0x82, 1, 0]);
        assert!(matches!(reader.next_message(), Err(Error::Protocol(_))));
    }

    proptest! {
        #[test]
        fn random_bytes_are_messages_or_an_error(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let mut reader = MessageReader::new();
            reader.push(&bytes);
            while let Ok(Some(_)) = reader.next_message() {}
            let _ = reader.take_replies();
        }

        #[test]
        fn messages_arrive_whole_however_they_are_cut(
            payloads in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..5000), 1..5),
            piece in 1..3000_usize,
        ) {
            let stream: Vec<u8> = payloads.iter().flat_map(|payload| masked(payload)).collect();
            let mut reader = MessageReader::new();
            let mut read = Vec::new();
            for part in stream.chunks(piece) {
                reader.push(part);
                while let Some(message) = reader.next_message().unwrap() {
                    read.push(message.into_data().to_vec());
                }
            }
            prop_assert_eq!(read, payloads);
        }
    }
}
