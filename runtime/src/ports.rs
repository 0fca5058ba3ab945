//! Traits of the ports of a process's loop: channels to read and write, and a clock.
//!
//! Live, [`crate::shared_memory::Participant`] gives both on iceoryx2 and CLOCK_MONOTONIC; in lockstep,
//! the program gives them on queues in memory and virtual time. Its process loops are written once over these traits.

use crate::channel::{Channel, Undeclared};
use msg::{Header, Message, Monotonic, PatchHeader, TileMap};
use std::ops::Deref;
use std::time::Duration;

/// Pause between two batches of messages of one version of a map, so that readers keep up.
pub const MAP_PAUSE: Duration = Duration::from_millis(40);
/// Time after which a reader that waits for the whole map requests it again.
pub const MAP_REQUEST_PERIOD: Duration = Duration::from_millis(500);

/// Error of an operation on a channel.
#[derive(Debug, thiserror::Error)]
pub enum ChannelError {
    /// Shared memory refused an operation.
    #[error("shared memory: {what} `{name}`: {why}")]
    SharedMemory {
        /// Operation that failed, such as `cannot read channel`.
        what: &'static str,
        /// The channel, process or run that it was for.
        name: String,
        /// The cause, as iceoryx2 names it.
        why: String,
    },
    /// The fleet was started with another build of the program, whose messages may differ.
    #[error(
        "the fleet runs mr-slam {running}, and this is mr-slam {own}: their messages may differ; use the program that started the \
         fleet, or start the fleet again with this one"
    )]
    OtherBuild {
        /// Build of the launcher.
        running: String,
        /// Build of this program.
        own: &'static str,
    },
    /// The table of channels does not allow it.
    #[error(transparent)]
    Undeclared(#[from] Undeclared),
}

/// Memory and processor time that a process has used so far.
#[derive(Clone, Copy, Debug, Default)]
pub struct ProcessUsage {
    /// Process id of the operating system.
    pub pid: u32,
    /// Resident memory, bytes.
    pub memory_bytes: u64,
    /// Processor time, nanoseconds.
    pub cpu_ns: u64,
    /// How often the launcher started the process before.
    pub restarts: u64,
}

/// Clock of a process, and its use of the machine.
pub trait Clock: Clone + 'static {
    /// Returns the monotonic time, the same in every process of a run.
    fn now(&self) -> Monotonic;
    /// Returns what this process has used so far.
    fn usage(&self) -> ProcessUsage;
}

/// Writes one channel.
pub trait WritePort<T: Message> {
    /// Calls `fill` on a zeroed message and sends it. `fill` sets the stamp; the port sets `seq`, `incarnation` and `sent`.
    fn send_with(&mut self, fill: impl FnOnce(&mut T));
    /// Sends a copy of a message.
    fn send(&mut self, message: &T) {
        self.send_with(|slot| *slot = *message);
    }
    /// Delivers the history to late readers. Call it regularly on a channel that is rarely written.
    fn refresh(&self);
    /// Counts messages anew, as another writer would: the source of what it sends was started again.
    fn begin_anew(&mut self);
}

/// Reads one channel, oldest message first.
pub trait ReadPort<T: Message> {
    /// A message, borrowed from the channel.
    type Received: Deref<Target = T>;
    /// Returns the oldest message that was not read yet.
    fn receive(&mut self) -> Option<Self::Received>;
    /// Skips to the newest message that was not read yet, and returns it.
    fn newest(&mut self) -> Option<Self::Received> {
        let mut newest = None;
        while let Some(message) = self.receive() {
            newest = Some(message);
        }
        newest
    }
    /// Returns the counts of messages received and missed so far.
    fn receive_counts(&self) -> ReceiveCounts;
}

/// Writes a map's channel: the tiles that changed, and the whole map to readers that request it.
pub trait WriteMapPort {
    /// Listener that wakes the writer when a reader requests the whole map.
    type Listener: 'static;
    /// Sends the changed tiles of `map`, a bounded part at a time. Call it again after [`MAP_PAUSE`] while it returns
    /// false, and regularly otherwise, as readers may request the whole map.
    fn send(&mut self, map: &TileMap) -> bool;
    /// Returns the listener that wakes when a reader requests the whole map.
    fn requests(&self) -> &Self::Listener;
    /// Returns the number of bytes written so far.
    fn bytes(&self) -> u64;
}

/// Reads a map's channel and keeps the map.
pub trait ReadMapPort {
    /// Receives all waiting messages; returns true if there is a new version of the map.
    fn poll(&mut self) -> bool;
    /// Returns the newest complete version, which has no tiles before the first.
    fn map(&self) -> &TileMap;
    /// Returns the counts of messages received and missed so far.
    fn receive_counts(&self) -> ReceiveCounts;
}

/// Opens channels on behalf of one process, or one thread of it.
pub trait Ports {
    /// Clock by which the channels' messages are stamped.
    type Clock: Clock;
    /// Port that writes a channel.
    type Writer<T: Message>: WritePort<T> + 'static;
    /// Port that reads a channel.
    type Reader<T: Message>: ReadPort<T> + 'static;
    /// Port that wakes its owner when a channel is written.
    type Listener: 'static;
    /// Port that writes a map's channel.
    type MapWriter: WriteMapPort<Listener = Self::Listener>;
    /// Port that reads a map's channel.
    type MapReader: ReadMapPort + 'static;

    /// Returns the clock of the process.
    fn clock(&self) -> Self::Clock;
    /// Opens a channel to write.
    fn writer<T: Message>(&self, channel: &Channel<T>) -> Result<Self::Writer<T>, ChannelError>;
    /// Opens a channel to read.
    fn reader<T: Message>(&self, channel: &Channel<T>) -> Result<Self::Reader<T>, ChannelError>;
    /// Opens a listener that wakes its owner when the channel is written; only for channels that wake.
    fn listener<T: Message>(&self, channel: &Channel<T>) -> Result<Self::Listener, ChannelError>;
    /// Opens a map's channel to write.
    fn map_writer(&self, channel: &Channel<PatchHeader>) -> Result<Self::MapWriter, ChannelError>;
    /// Opens a map's channel to read.
    fn map_reader(&self, channel: &Channel<PatchHeader>) -> Result<Self::MapReader, ChannelError>;
}

/// Numbers and stamps a writer's messages.
#[derive(Clone, Debug)]
pub struct MessageSequencer {
    incarnation: u64,
    seq: u64,
}

/// What is added to an incarnation that begins anew: more than there are processes in lockstep, and than two processes' starts can lie
/// apart by, nanoseconds.
const INCARNATION_STEP: u64 = 1 << 56;

impl MessageSequencer {
    /// `incarnation` tells this process of the writer from an earlier one.
    pub fn new(incarnation: u64) -> Self {
        Self { incarnation, seq: 0 }
    }

    /// Fills in the header of the next message, which is sent now.
    pub fn mark(&mut self, header: &mut Header, now: Monotonic) {
        (header.incarnation, header.seq, header.sent) = (self.incarnation, self.seq, now);
        self.seq += 1;
    }

    /// Counts anew, as the sequencer of a writer that was started again.
    pub fn begin_anew(&mut self) {
        (self.incarnation, self.seq) = (self.incarnation.wrapping_add(INCARNATION_STEP), 0);
    }

    /// Skips a number, because its message was lost before it was sent.
    pub fn skip(&mut self) {
        self.seq += 1;
    }
}

/// Counts what a reader received and what it missed, by the numbers its writer gave.
#[derive(Clone, Copy, Debug, Default)]
pub struct ReceiveCounts {
    /// Messages received since the reader opened the channel.
    pub received: u64,
    /// Messages sent after this reader's first and never received.
    pub lost: u64,
    /// The writer's incarnations seen, less one.
    pub restarts: u64,
    incarnation: u64,
    next: u64,
}

impl ReceiveCounts {
    /// Counts a message that was received.
    pub fn count(&mut self, header: &Header) {
        if header.incarnation != self.incarnation {
            self.restarts += u64::from(self.received > 0);
            self.incarnation = header.incarnation;
        } else {
            self.lost += header.seq.saturating_sub(self.next);
        }
        self.next = header.seq.saturating_add(1);
        self.received += 1;
    }
}
