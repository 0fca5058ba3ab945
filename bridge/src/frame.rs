//! Frames of the ros_tcp protocol, and the parser that cuts a byte stream into them.
//!
//! A frame is `u32 name length, name, u32 payload length, payload`, little-endian. A name that begins with `__` is a
//! command with JSON as payload, an empty name is a keepalive, and any other name is a topic. Names and JSON from a
//! client end in one NUL, which counts in the length; those from the server have none.

use thiserror::Error;

/// The longest topic or command name, bytes.
pub const NAME_MAX: usize = 1024;
/// The frame that a client sends when it has sent nothing for a second: no name and no payload.
pub const KEEPALIVE: [u8; 8] = [0; 8];
/// Size of an idle parser's buffer, bytes: as much as one read returns.
pub(crate) const IDLE_BYTES: usize = 64 * 1024;
/// The largest growth of the buffer for one read while a long frame arrives, bytes.
const GROWTH_MAX: usize = 4 * 1024 * 1024;

/// The stream cannot be cut into frames any more: the connection must be closed.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum FrameError {
    /// A name is longer than [`NAME_MAX`]: usually the peer uses another protocol.
    #[error(
        "a frame announces a name of {announced} bytes, the limit is {NAME_MAX}: this port speaks ros_tcp"
    )]
    Name {
        /// Announced length, bytes.
        announced: u32,
    },
    /// A payload is longer than the limit.
    #[error("a frame for '{name}' announces {announced} bytes, the limit is {limit}")]
    Payload {
        /// Name of the frame.
        name: String,
        /// Announced length, bytes.
        announced: u32,
        /// The limit, bytes.
        limit: usize,
    },
}

/// One frame of the ros_tcp protocol, borrowed from its parser; no coordinate frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RosTcpFrame<'a> {
    /// The name without trailing NULs. It may be invalid UTF-8.
    pub name: &'a [u8],
    /// The payload as sent.
    pub payload: &'a [u8],
}

impl<'a> RosTcpFrame<'a> {
    /// Returns whether the frame is a keepalive: it has no name.
    pub fn is_keepalive(&self) -> bool {
        self.name.is_empty()
    }

    /// Returns the payload without trailing NULs: a command's JSON.
    pub fn json(&self) -> &'a [u8] {
        without_nuls(self.payload)
    }
}

fn without_nuls(bytes: &[u8]) -> &[u8] {
    let end = bytes.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
    &bytes[..end]
}

/// Cuts a byte stream into frames, whatever the sizes of its reads.
///
/// Its memory grows with the bytes that have arrived, never with an announced length, and at most to the longest
/// allowed frame.
/// ```
/// # use bridge::frame::{Parser, Side};
/// let mut sent = Vec::new();
/// Side::Client.write(&mut sent, "/a", b"hello");
/// let mut parser = Parser::new(1024);
/// parser.push(&sent);
/// let frame = parser.next_frame().unwrap().unwrap();
/// assert_eq!((frame.name, frame.payload), (&b"/a"[..], &b"hello"[..]));
/// ```
#[derive(Debug)]
pub struct Parser {
    buffer: Vec<u8>,
    begin: usize,
    end: usize,
    payload_max: usize,
    kept_bytes: usize,
    /// Bytes of a skipped frame that have not arrived yet.
    skipping: usize,
}

/// A frame that has not arrived whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IncompleteFrame<'a> {
    /// The name without trailing NULs.
    pub name: &'a [u8],
    /// Announced length of the payload, bytes.
    pub payload_bytes: usize,
    /// Length of the whole frame, bytes.
    pub frame_bytes: usize,
    /// Bytes of the whole frame that have arrived.
    pub arrived_bytes: usize,
}

impl Parser {
    /// Creates a parser that refuses payloads longer than `payload_max` bytes.
    pub fn new(payload_max: usize) -> Self {
        let buffer = vec![0; IDLE_BYTES];
        Self { buffer, begin: 0, end: 0, payload_max, kept_bytes: IDLE_BYTES, skipping: 0 }
    }

    /// Keeps up to `bytes` of a buffer that has grown, for a client that reads many large frames: allocating memory
    /// for a map of 16 MB takes longer than reading it. By default a buffer is shrunk as soon as it is empty.
    pub fn keep(self, bytes: usize) -> Self {
        Self { kept_bytes: bytes, ..self }
    }

    /// Returns the space for the stream's next bytes, which is never empty. Call [`Parser::filled`] after the read.
    ///
    /// Take all frames before asking for space again, or the buffer grows.
    pub fn space(&mut self) -> &mut [u8] {
        self.release();
        if self.begin != self.end {
            self.make_room();
        }
        &mut self.buffer[self.end..]
    }

    /// Gives back the memory of a buffer that has grown, if little of it is used.
    pub fn release(&mut self) {
        if self.begin == self.end {
            (self.begin, self.end) = (0, 0);
        }
        if self.is_oversized() {
            self.buffer.copy_within(self.begin..self.end, 0);
            (self.begin, self.end) = (0, self.end - self.begin);
            self.buffer.truncate(IDLE_BYTES);
            self.buffer.shrink_to_fit();
        }
    }

    fn is_oversized(&self) -> bool {
        self.buffer.len() > self.kept_bytes && self.pending() <= IDLE_BYTES
    }

    /// Returns the space that the rest of an incomplete frame needs, or a large part of it, bytes.
    fn wanted(&self) -> usize {
        let have = self.end - self.begin;
        let rest = self.announced().unwrap_or(0).saturating_sub(have).max(1);
        rest.min(have.max(IDLE_BYTES)).min(GROWTH_MAX)
    }

    /// Returns the size that the buffer will have after [`Parser::space`], bytes.
    pub fn next_size(&self) -> usize {
        let (have, want) = (self.pending(), self.wanted());
        let (size, end) =
            if self.is_oversized() { (IDLE_BYTES, have) } else { (self.buffer.len(), self.end) };
        if have == 0 || size - end >= want { size } else { size.max(have + want) }
    }

    /// Makes space for the rest of an incomplete frame, or for a large part of it.
    fn make_room(&mut self) {
        let (have, want) = (self.end - self.begin, self.wanted());
        if self.buffer.len() - self.end >= want {
            return;
        }
        self.buffer.copy_within(self.begin..self.end, 0);
        (self.begin, self.end) = (0, have);
        if self.buffer.len() < have + want {
            self.buffer.reserve_exact(have + want - self.buffer.len());
            self.buffer.resize(have + want, 0);
        }
    }

    /// Adds the first `count` bytes of [`Parser::space`] to the stream.
    pub fn filled(&mut self, count: usize) {
        self.end = (self.end + count).min(self.buffer.len());
        let skipped = self.skipping.min(self.end - self.begin);
        self.begin += skipped;
        self.skipping -= skipped;
    }

    /// Returns the frame that has not arrived whole, once its name and length have.
    pub fn incomplete(&self) -> Option<IncompleteFrame<'_>> {
        let whole = self.announced()?;
        let name_bytes = self.length_at(0)? as usize;
        let name = self.begin + 4..self.begin + 4 + name_bytes;
        Some(IncompleteFrame {
            name: without_nuls(&self.buffer[name]),
            payload_bytes: whole - 8 - name_bytes,
            frame_bytes: whole,
            arrived_bytes: self.pending(),
        })
    }

    /// Drops the incomplete frame: what has arrived of it now, and the rest as it arrives.
    pub fn skip_frame(&mut self) {
        if let Some(whole) = self.announced() {
            self.skipping = whole.saturating_sub(self.pending());
            self.begin = (self.begin + whole).min(self.end);
            self.release();
        }
    }

    /// Appends bytes of the stream that are in memory already.
    pub fn push(&mut self, mut bytes: &[u8]) {
        while !bytes.is_empty() {
            let space = self.space();
            let count = bytes.len().min(space.len());
            space[..count].copy_from_slice(&bytes[..count]);
            self.filled(count);
            bytes = &bytes[count..];
        }
    }

    /// Returns the number of bytes that are not part of a returned frame yet.
    pub fn pending(&self) -> usize {
        self.end - self.begin
    }

    /// Returns the size of the buffer, bytes.
    pub fn capacity(&self) -> usize {
        self.buffer.capacity()
    }

    fn length_at(&self, offset: usize) -> Option<u32> {
        let bytes = self.buffer[self.begin..self.end].get(offset..offset + 4)?;
        bytes.try_into().ok().map(u32::from_le_bytes)
    }

    /// Returns the whole length of the incomplete frame, once it is known.
    fn announced(&self) -> Option<usize> {
        let name = self.length_at(0)? as usize;
        if name > NAME_MAX {
            return None;
        }
        let payload = self.length_at(4 + name)? as usize;
        Some(8 + name + payload)
    }

    /// Returns the next whole frame, or `None` if it needs more bytes.
    pub fn next_frame(&mut self) -> Result<Option<RosTcpFrame<'_>>, FrameError> {
        let Some(name_announced) = self.length_at(0) else { return Ok(None) };
        let name_length = name_announced as usize;
        if name_length > NAME_MAX {
            return Err(FrameError::Name { announced: name_announced });
        }
        let Some(announced) = self.length_at(4 + name_length) else { return Ok(None) };
        let name = self.begin + 4..self.begin + 4 + name_length;
        if announced as usize > self.payload_max {
            let name = String::from_utf8_lossy(without_nuls(&self.buffer[name])).into_owned();
            return Err(FrameError::Payload { name, announced, limit: self.payload_max });
        }
        let payload = name.end + 4..name.end + 4 + announced as usize;
        if payload.end > self.end {
            return Ok(None);
        }
        self.begin = payload.end;
        Ok(Some(RosTcpFrame { name: without_nuls(&self.buffer[name]), payload: &self.buffer[payload] }))
    }
}

/// The side that writes a frame: clients end names and JSON with a NUL, the server must not.
///
/// ```
/// use bridge::frame::Side;
/// use bridge::ros::{Twist, encode};
/// let mut bytes = Vec::new();
/// Side::Client.write_with(&mut bytes, "/cmd_vel", |out| encode(&Twist::default(), out));
/// // Length and name with its NUL, length of the payload, 4 bytes of encapsulation header, 6 doubles.
/// assert_eq!(bytes.len(), 4 + 9 + 4 + 4 + 6 * 8);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// A client, such as a headset's application.
    Client,
    /// The server: the bridge.
    Server,
}

impl Side {
    /// Appends a frame of a topic.
    pub fn write(self, out: &mut Vec<u8>, name: &str, payload: &[u8]) {
        self.write_with(out, name, |out| out.extend_from_slice(payload));
    }

    /// Appends a frame whose payload `fill` appends.
    pub fn write_with(self, out: &mut Vec<u8>, name: &str, fill: impl FnOnce(&mut Vec<u8>)) {
        let nul: &[u8] = if self == Self::Client { b"\0" } else { b"" };
        out.extend_from_slice(&length(name.len() + nul.len()));
        out.extend_from_slice(name.as_bytes());
        out.extend_from_slice(nul);
        let place = out.len();
        out.extend_from_slice(&[0; 4]);
        fill(out);
        let payload = length(out.len() - place - 4);
        out[place..place + 4].copy_from_slice(&payload);
    }

    /// Appends a command (`__subscribe`, `__error`, ...) with its JSON.
    pub fn write_command(self, out: &mut Vec<u8>, name: &str, body: &impl serde::Serialize) {
        self.write_with(out, name, |out| {
            // Bodies are structs of strings and numbers, which serialize without errors.
            if serde_json::to_writer(&mut *out, body).is_ok() && self == Self::Client {
                out.push(0);
            }
        });
    }
}

/// Encodes a length. The configuration limits payloads far below `u32::MAX`.
fn length(bytes: usize) -> [u8; 4] {
    u32::try_from(bytes).unwrap_or(u32::MAX).to_le_bytes()
}

#[cfg(test)]
mod tests;
