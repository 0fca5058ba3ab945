//! What both ends of a link have: a session, the peer's newest sending time, and counters.

use crate::counters::ByteCounters;
use crate::table::Kind;
use crate::wire::{Envelope, Message, WireError};
use msg::Monotonic;
use std::time::Duration;

/// Period of signs of life, poses and transforms: a velocity may answer a message that is 0.5 s old.
pub const STATE_PERIOD: Duration = Duration::from_millis(200);

/// One end of the link to one peer: adds session and times to messages, and counts bytes.
#[derive(Debug)]
pub struct Peer {
    /// Session of this end: a random number that it keeps until its process ends.
    pub session: u64,
    /// Address of the session of the peer that counts; 0 before there is one.
    pub to: u32,
    /// Sending time of the peer's newest message, on its clock.
    pub heard: Monotonic,
    /// Bytes sent to the peer.
    pub sent: ByteCounters,
    /// Bytes received from the peer.
    pub received: ByteCounters,
}

impl Peer {
    /// Creates an end that has heard nothing.
    pub fn new(session: u64) -> Self {
        let (sent, received) = (ByteCounters::default(), ByteCounters::default());
        Self { session, to: 0, heard: Monotonic(0), sent, received }
    }

    /// Encodes and counts a message, and hands it to `send`.
    pub fn send(&mut self, message: Message, now: Monotonic, send: &mut impl FnMut(Kind, &[u8])) {
        let kind = message.kind();
        let envelope =
            Envelope { session: self.session, to: self.to, sent: now, answers: self.heard, message };
        let bytes = envelope.to_bytes();
        self.sent.add(kind, bytes.len());
        send(kind, &bytes);
    }

    /// Decodes and counts a message.
    pub fn read(&mut self, bytes: &[u8]) -> Result<Envelope, WireError> {
        let envelope = Envelope::from_bytes(bytes)?;
        self.received.add(envelope.message.kind(), bytes.len());
        Ok(envelope)
    }
}

/// Admits events at a rate whose mean is bounded although they come a little early or late.
#[derive(Clone, Copy, Debug, Default)]
pub struct RateLimit {
    due: Monotonic,
}

impl RateLimit {
    /// Returns whether an event is admitted now, and counts it if so.
    pub fn admits(&mut self, now: Monotonic, period: Duration) -> bool {
        let is_admitted = now + period / 4 >= self.due;
        if is_admitted {
            // From when it was due, unless that is long ago.
            self.due = self.due.max(now) + period;
        }
        is_admitted
    }
}

/// Something that is due once a period.
#[derive(Clone, Copy, Debug)]
pub struct Timer {
    due: Monotonic,
    period: Duration,
}

impl Timer {
    /// Creates a timer that is due at once.
    pub fn new(period: Duration) -> Self {
        Self { due: Monotonic(0), period }
    }

    /// Returns whether a period has passed since the last time that it returned true.
    pub fn is_due(&mut self, now: Monotonic) -> bool {
        let is_due = now >= self.due;
        if is_due {
            self.due = now + self.period;
        }
        is_due
    }
}
