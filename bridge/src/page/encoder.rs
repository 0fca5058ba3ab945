//! Rewrites a client's stream of ros_tcp frames as messages of the Foxglove protocol.
//!
//! The router writes frames into it as into a socket. A payload is passed on as it is: of a large one nothing is copied.

mod bytes;

use super::protocol::{
    CallId, ENCODING, MESSAGE_DATA, MESSAGE_HEADER_BYTES, SERVICE_RESPONSE, ServerCommand, StatusLevel,
};
use crate::command::{Call, CallFailure, Notice, name};
use crate::frame::NAME_MAX;
use bytes::{length_at, pass_on, push_frame_header, stamp_at};
use ros_messages::schema::stamp_offset;
use std::collections::BTreeMap;
use std::io::{self, IoSlice};

/// Payloads up to this are copied next to their headers, bytes: one system call writes many of them.
const COPIED_MAX: usize = 4096;
/// What has been encoded is written when it is this long, bytes. What waits here cannot be replaced by newer messages.
const ENCODED_MAX: usize = 16 << 10;
/// Text for one client that waits for the end of a message, bytes: lists of topics, replies to pings.
const TEXT_MAX: usize = 4 << 20;
/// The longest command (`__log`, `__warn`, `__error`, `__response`, `__call_failure`) that is passed on, bytes.
const COMMAND_MAX: usize = 64 << 10;
/// Bytes before the payload of [`SERVICE_RESPONSE`]: kind, service, call, length of the encoding's name, and the name.
const RESPONSE_HEADER_BYTES: usize = 1 + 4 + 4 + 4 + ENCODING.len();
/// Bytes of CDR's encapsulation header.
const ENCAPSULATION_BYTES: usize = 4;
/// First byte of a WebSocket frame that is a whole message: final, text (RFC 6455, 5.2).
const TEXT_FRAME: u8 = 0x81;
/// First byte of a WebSocket frame that is a whole message: final, binary.
const BINARY_FRAME: u8 = 0x82;

/// A subscription of the client.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Subscription {
    /// The client's number.
    id: u32,
    /// Where a message's stamp is, bytes after the encapsulation header.
    stamp_offset: Option<usize>,
}

/// What a message is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Receiver {
    /// Subscription whose messages it carries.
    Subscription(Subscription),
    /// A call, whose response it is.
    Call(CallId),
}

/// A command of ros_tcp that the client is told of in its own protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Command {
    /// Text for a person.
    Notice(StatusLevel),
    /// The next frame is a service's response.
    Response,
    /// A call failed.
    CallFailure,
}

impl Command {
    /// Returns the command of this name, if the client is told of it.
    fn named(name: &str) -> Option<Self> {
        Some(match name {
            name::LOG => Self::Notice(StatusLevel::Info),
            name::WARN => Self::Notice(StatusLevel::Warning),
            name::ERROR => Self::Notice(StatusLevel::Error),
            name::RESPONSE => Self::Response,
            name::CALL_FAILURE => Self::CallFailure,
            _ => return None,
        })
    }
}

/// The part of a ros_tcp frame that comes next.
#[derive(Debug)]
enum Part {
    /// Lengths and name; they are collected.
    Header,
    /// The payload of a message, of which nothing is encoded yet.
    Begin { receiver: Receiver, payload_bytes: usize },
    /// The rest of a payload that is passed on.
    Payload { rest: usize },
    /// The rest of a command's JSON, which is collected.
    Command { command: Command, rest: usize, text: Vec<u8> },
    /// The rest of a payload that is left out.
    Skip { rest: usize },
}

/// The encoder of one connection.
#[derive(Debug)]
pub struct Encoder {
    part: Part,
    /// Lengths and name of the frame that comes next, as far as they are here.
    header: Vec<u8>,
    subscriptions: BTreeMap<String, Subscription>,
    /// The call whose response the next frame is.
    response_to: Option<CallId>,
    /// Encoded bytes that the socket has not taken yet.
    encoded: Vec<u8>,
    /// WebSocket frames that are sent when no message is begun.
    texts: Vec<u8>,
    /// The newest stamp of a message, nanoseconds: the time of messages without one.
    newest_ns: u64,
}

impl Encoder {
    /// Creates an encoder that sends `first` before anything else.
    pub fn new(first: Vec<u8>) -> Self {
        Self {
            part: Part::Header,
            header: Vec::new(),
            subscriptions: BTreeMap::new(),
            response_to: None,
            encoded: first,
            texts: Vec::new(),
            newest_ns: 0,
        }
    }

    /// Begins a subscription, or gives it another number.
    pub fn subscribe(&mut self, topic: &str, message_type: &str, id: u32) {
        let subscription = Subscription { id, stamp_offset: stamp_offset(message_type) };
        self.subscriptions.insert(topic.to_owned(), subscription);
    }

    /// Ends the subscription of this number, and returns its topic.
    pub fn unsubscribe(&mut self, id: u32) -> Option<String> {
        let (topic, _) = self.subscriptions.iter().find(|(_, known)| known.id == id)?;
        let topic = topic.clone();
        self.subscriptions.remove(&topic);
        Some(topic)
    }

    /// Returns whether the client is subscribed to a topic, and whether another topic has this number.
    pub fn is_taken(&self, topic: &str, id: u32) -> bool {
        self.subscriptions.contains_key(topic) || self.subscriptions.values().any(|known| known.id == id)
    }

    /// Queues a text message; fails if the client leaves too much unread.
    pub fn send(&mut self, command: &ServerCommand<'_>) -> io::Result<()> {
        let text = serde_json::to_vec(command)?;
        let mut frame = Vec::with_capacity(text.len() + 10);
        push_frame_header(&mut frame, TEXT_FRAME, text.len());
        frame.extend_from_slice(&text);
        self.send_frames(&frame)
    }

    /// Queues whole WebSocket frames; fails if the client leaves too much unread.
    pub fn send_frames(&mut self, frames: &[u8]) -> io::Result<()> {
        if self.encoded.len() + self.texts.len() + frames.len() > TEXT_MAX {
            return Err(io::Error::other("the client reads nothing"));
        }
        self.texts.extend_from_slice(frames);
        self.take_texts();
        Ok(())
    }

    /// Moves waiting texts to the encoded bytes, if no message is begun.
    fn take_texts(&mut self) {
        let is_between = !matches!(self.part, Part::Payload { .. });
        if is_between && !self.texts.is_empty() {
            self.encoded.append(&mut self.texts);
        }
    }

    /// Returns whether encoded bytes wait for the socket.
    pub fn has_waiting(&self) -> bool {
        !self.encoded.is_empty()
    }

    /// Writes what is encoded; [`io::ErrorKind::WouldBlock`] if the socket does not take all of it.
    pub fn flush(&mut self, write: &mut impl FnMut(&[IoSlice<'_>]) -> io::Result<usize>) -> io::Result<()> {
        while !self.encoded.is_empty() {
            match write(&[IoSlice::new(&self.encoded)])? {
                0 => return Err(io::ErrorKind::WriteZero.into()),
                written => drop(self.encoded.drain(..written)),
            }
        }
        Ok(())
    }

    /// Takes bytes of the ros_tcp stream, and returns how many; [`io::ErrorKind::WouldBlock`] if the socket takes none.
    pub fn write(
        &mut self,
        slices: &[IoSlice<'_>],
        mut write: impl FnMut(&[IoSlice<'_>]) -> io::Result<usize>,
    ) -> io::Result<usize> {
        self.take_texts();
        self.flush(&mut write)?;
        let mut taken = 0;
        for slice in slices {
            let mut rest: &[u8] = slice;
            while !rest.is_empty() {
                match self.take(rest, &mut write) {
                    Ok(count) => {
                        taken += count;
                        rest = &rest[count..];
                    }
                    Err(error) if error.kind() == io::ErrorKind::WouldBlock && taken > 0 => return Ok(taken),
                    Err(error) => return Err(error),
                }
            }
        }
        match self.flush(&mut write) {
            // It is written when the socket takes bytes again.
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(taken),
            result => result.map(|()| taken),
        }
    }

    /// Takes some of the next bytes of the stream, at least one.
    fn take(
        &mut self,
        bytes: &[u8],
        write: &mut impl FnMut(&[IoSlice<'_>]) -> io::Result<usize>,
    ) -> io::Result<usize> {
        if self.encoded.len() >= ENCODED_MAX {
            self.flush(write)?;
        }
        let taken = match &mut self.part {
            Part::Header => self.take_header(bytes),
            Part::Begin { .. } => self.begin(bytes),
            Part::Payload { rest } => {
                let part = &bytes[..bytes.len().min(*rest)];
                let taken = pass_on(&mut self.encoded, part, write)?;
                *rest -= taken;
                taken
            }
            Part::Command { rest, text, .. } => {
                let taken = bytes.len().min(*rest);
                text.extend_from_slice(&bytes[..taken]);
                *rest -= taken;
                taken
            }
            Part::Skip { rest } => {
                let taken = bytes.len().min(*rest);
                *rest -= taken;
                taken
            }
        };
        self.end_frame()?;
        Ok(taken)
    }

    /// Returns to the header of the next frame if this one is complete.
    fn end_frame(&mut self) -> io::Result<()> {
        let is_complete = match &self.part {
            Part::Header | Part::Begin { .. } => false,
            Part::Payload { rest } | Part::Skip { rest } | Part::Command { rest, .. } => *rest == 0,
        };
        if !is_complete {
            return Ok(());
        }
        if let Part::Command { command, text, .. } = std::mem::replace(&mut self.part, Part::Header) {
            self.apply_command(command, &text)?;
        }
        self.take_texts();
        Ok(())
    }

    /// Tells the client of a command. What is not a command's JSON is left out.
    fn apply_command(&mut self, command: Command, json: &[u8]) -> io::Result<()> {
        match command {
            Command::Notice(level) => match serde_json::from_slice::<Notice>(json) {
                Ok(notice) => self.send(&ServerCommand::Status { level, message: &notice.text }),
                Err(_) => Ok(()),
            },
            Command::Response => {
                let call: Option<Call> = serde_json::from_slice(json).ok();
                self.response_to = call.map(|call| CallId::of_number(call.srv_id));
                Ok(())
            }
            Command::CallFailure => match serde_json::from_slice::<CallFailure>(json) {
                Ok(failure) => self.send_call_failure(CallId::of_number(failure.srv_id), &failure.text),
                Err(_) => Ok(()),
            },
        }
    }

    /// Tells the client that a call gets no response.
    pub fn send_call_failure(&mut self, id: CallId, message: &str) -> io::Result<()> {
        self.send(&ServerCommand::ServiceCallFailure { service_id: id.service, call_id: id.call, message })
    }

    /// Collects the frame's lengths and name.
    fn take_header(&mut self, bytes: &[u8]) -> usize {
        let begun = self.header.len();
        let name_bytes = |header: &[u8]| length_at(header, 0).unwrap_or(0).min(NAME_MAX);
        let mut taken = 0;
        for wanted in [4, usize::MAX] {
            let wanted = wanted.min(8 + name_bytes(&self.header));
            let count = wanted.saturating_sub(self.header.len()).min(bytes.len() - taken);
            self.header.extend_from_slice(&bytes[taken..taken + count]);
            taken += count;
        }
        debug_assert!(self.header.len() > begun);
        let name_bytes = name_bytes(&self.header);
        if self.header.len() == 8 + name_bytes {
            let payload_bytes = length_at(&self.header, 4 + name_bytes).unwrap_or(0);
            self.part = self.part_after_header(name_bytes, payload_bytes);
            self.header.clear();
        }
        taken
    }

    fn part_after_header(&mut self, name_bytes: usize, payload_bytes: usize) -> Part {
        let response_to = self.response_to.take();
        if payload_bytes == 0 {
            // Nothing follows; a message without a payload has not even its encapsulation header.
            return Part::Header;
        }
        let name = std::str::from_utf8(&self.header[4..4 + name_bytes]).unwrap_or("");
        let subscription = || self.subscriptions.get(name).copied().map(Receiver::Subscription);
        match (response_to, Command::named(name)) {
            (Some(call), _) => Part::Begin { receiver: Receiver::Call(call), payload_bytes },
            (None, Some(command)) if payload_bytes <= COMMAND_MAX => {
                Part::Command { command, rest: payload_bytes, text: Vec::with_capacity(payload_bytes) }
            }
            (None, Some(_)) => Part::Skip { rest: payload_bytes },
            (None, None) => match subscription() {
                Some(receiver) => Part::Begin { receiver, payload_bytes },
                None => Part::Skip { rest: payload_bytes },
            },
        }
    }

    /// Encodes the message's header, and takes the payload too if it is short.
    fn begin(&mut self, bytes: &[u8]) -> usize {
        let Part::Begin { receiver, payload_bytes } = self.part else { return 0 };
        match receiver {
            Receiver::Subscription(subscription) => {
                self.push_message_header(subscription, payload_bytes, bytes)
            }
            Receiver::Call(call) => self.push_response_header(call, payload_bytes),
        }
        // A part of a long payload is copied too, so that at least one byte is taken.
        let taken = payload_bytes.min(bytes.len()).min(COPIED_MAX);
        self.encoded.extend_from_slice(&bytes[..taken]);
        self.part = Part::Payload { rest: payload_bytes - taken };
        taken
    }

    /// Appends what stands before a message on a topic, of which `bytes` come next.
    fn push_message_header(&mut self, subscription: Subscription, payload_bytes: usize, bytes: &[u8]) {
        let stamp =
            subscription.stamp_offset.and_then(|offset| stamp_at(bytes, ENCAPSULATION_BYTES + offset));
        self.newest_ns = stamp.map_or(self.newest_ns, |stamp| self.newest_ns.max(stamp));
        push_frame_header(&mut self.encoded, BINARY_FRAME, MESSAGE_HEADER_BYTES + payload_bytes);
        self.encoded.push(MESSAGE_DATA);
        self.encoded.extend_from_slice(&subscription.id.to_le_bytes());
        self.encoded.extend_from_slice(&stamp.unwrap_or(self.newest_ns).to_le_bytes());
    }

    /// Appends what stands before a service's response.
    fn push_response_header(&mut self, call: CallId, payload_bytes: usize) {
        push_frame_header(&mut self.encoded, BINARY_FRAME, RESPONSE_HEADER_BYTES + payload_bytes);
        self.encoded.push(SERVICE_RESPONSE);
        for number in [call.service, call.call, ENCODING.len() as u32] {
            self.encoded.extend_from_slice(&number.to_le_bytes());
        }
        self.encoded.extend_from_slice(ENCODING.as_bytes());
    }
}

#[cfg(test)]
mod tests;
