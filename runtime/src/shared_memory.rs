//! The channels in shared memory: the only module (with those below it) that uses iceoryx2 or
//! unsafe code.
//!
//! A message is written in place into memory that every reader maps; nothing is copied on the
//! way. A reader does not trust the content, at no cost: any bits are a value of a
//! `Pod` type, and lengths are read through accessors that clamp them.

mod domain;
mod maps;

pub(crate) use domain::fleet_of_progress_file;
pub use domain::{Domain, DomainGuard, SHARED_MEMORY, create_ipc_folder, remove_leftovers};
pub use maps::{MapReader, MapWriter};

use crate::channel::{Channel, Direction, Opener};
use crate::clock::{SystemClock, now};
use crate::held_signals::HeldSignals;
use crate::layout;
use crate::ports::{ChannelError, MessageSequencer, Ports, ReadPort, ReceiveCounts, WritePort};
use bytemuck::{Pod, TransparentWrapper};
use iceoryx2::port::listener::Listener as IpcListener;
use iceoryx2::port::notifier::{Notifier, NotifierCreateError};
use iceoryx2::port::publisher::{Publisher, PublisherCreateError};
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;
use msg::{Message, Monotonic, PatchHeader, ROBOTS_MAX};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::cell::Cell;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, RawFd};
use std::time::Duration;
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;

/// Samples that one reader may hold at a time.
const BORROWED_MAX: usize = 2;
/// Processes that may open one channel at a time: all simulators a robot's true pose; telemetry, the launcher and tools are
/// added.
const PARTICIPANTS_MAX: usize = ROBOTS_MAX + 16;
/// Time in which every reader has looked at its channels: ten periods of the recorder, which looks least often.
const READERS_LOOK: Duration = Duration::from_millis(200);
/// Listeners that one thread may wait for: merge and telemetry have a few for each robot.
const LISTENERS_MAX: usize = 4 * ROBOTS_MAX;

fn failed<E: std::fmt::Debug>(what: &'static str, name: &str) -> impl FnOnce(E) -> ChannelError {
    move |why| ChannelError::SharedMemory { what, name: name.into(), why: format!("{why:?}") }
}

/// Has all descriptors but the standard streams closed in programs that this process starts: iceoryx2 opens its own so that
/// they would be inherited.
///
/// # Errors
/// The descriptors cannot be listed.
pub fn close_descriptors_on_exec() -> std::io::Result<()> {
    for entry in std::fs::read_dir("/proc/self/fd")? {
        let name = entry?.file_name();
        let Some(number) = name.to_str().and_then(|name| name.parse::<RawFd>().ok()) else { continue };
        if number > std::io::stderr().as_raw_fd() {
            // SAFETY: a flag is set, nothing is read or closed; a descriptor that was closed meanwhile is an error.
            let descriptor = unsafe { BorrowedFd::borrow_raw(number) };
            let _ = rustix::io::fcntl_setfd(descriptor, rustix::io::FdFlags::CLOEXEC);
        }
    }
    Ok(())
}

/// One thread's attachment to a run's shared memory. Ports stay on the thread that opened them.
pub struct Participant {
    node: iceoryx2::node::Node<ipc::Service>,
    opener: Opener,
    domain: Domain,
    run: u64,
}

impl Participant {
    /// Attaches to a run of this build. `name` is shown by iceoryx2's tools.
    pub fn open(domain: &Domain, opener: Opener, name: &str) -> Result<Self, ChannelError> {
        layout::check(domain.root())?;
        let _held = HeldSignals::hold();
        let node = NodeBuilder::new()
            .config(domain.config())
            .name(&name.try_into().map_err(failed("a process cannot be called", name))?)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>()
            .map_err(failed("cannot attach", name))?;
        Ok(Self { node, opener, domain: domain.clone(), run: now().0 })
    }

    /// Opens a channel to write.
    pub fn writer<T: Message>(&self, channel: &Channel<T>) -> Result<Writer<T>, ChannelError> {
        channel.check(self.opener, Direction::Write)?;
        let _held = HeldSignals::hold();
        let service = self.service(channel)?;
        let open = || {
            let publisher = service.publisher_builder().max_loaned_samples(1);
            publisher.backpressure_strategy(BackpressureStrategy::DiscardData).create()
        };
        let is_full = |why: &_| matches!(why, PublisherCreateError::ExceedsMaxSupportedPublishers);
        let publisher = self.domain.open_writer(is_full, open);
        let publisher = publisher.map_err(failed("cannot write channel", &channel.name))?;
        Ok(Writer { publisher, stamper: MessageSequencer::new(self.run), notifier: self.notifier(channel)? })
    }

    /// Opens a channel to read.
    pub fn reader<T: Message>(&self, channel: &Channel<T>) -> Result<Reader<T>, ChannelError> {
        channel.check(self.opener, Direction::Read)?;
        let _held = HeldSignals::hold();
        let subscriber = self
            .service(channel)?
            .subscriber_builder()
            .buffer_size(channel.row.depth)
            .create()
            .map_err(failed("cannot read channel", &channel.name))?;
        Ok(Reader { subscriber, receive_counts: ReceiveCounts::default() })
    }

    /// Opens or creates the channel. Both ends use the same settings, so either may come first.
    fn service<T: Message>(&self, channel: &Channel<T>) -> Result<Service<T>, ChannelError> {
        self.node
            .service_builder(&service_name(&channel.name)?)
            .publish_subscribe::<Shared<T>>()
            .max_publishers(channel.row.writers_max)
            .max_subscribers(channel.row.readers_max)
            .max_nodes(PARTICIPANTS_MAX)
            .history_size(channel.row.history)
            .subscriber_max_buffer_size(channel.row.depth)
            .subscriber_max_borrowed_samples(BORROWED_MAX)
            .open_or_create()
            .map_err(failed("cannot open channel", &channel.name))
    }

    /// Opens a listener that wakes its owner when the channel is written; only for channels that wake.
    pub fn listener<T: Message>(&self, channel: &Channel<T>) -> Result<Listener, ChannelError> {
        assert!(channel.row.wakes, "{} does not wake its readers", channel.name);
        let _held = HeldSignals::hold();
        let listener = self
            .event(channel)?
            .listener_builder()
            .create()
            .map_err(failed("cannot listen to", &channel.name))?;
        Ok(Listener::new(listener))
    }

    fn notifier<T: Message>(
        &self,
        channel: &Channel<T>,
    ) -> Result<Option<Notifier<ipc::Service>>, ChannelError> {
        if !channel.row.wakes {
            return Ok(None);
        }
        let event = self.event(channel)?;
        let is_full = |why: &_| matches!(why, NotifierCreateError::ExceedsMaxSupportedNotifiers);
        let notifier = self.domain.open_writer(is_full, || event.notifier_builder().create());
        Ok(Some(notifier.map_err(failed("cannot notify the readers of", &channel.name))?))
    }

    fn event<T: Message>(&self, channel: &Channel<T>) -> Result<EventService, ChannelError> {
        self.node
            .service_builder(&service_name(&channel.name)?)
            .event()
            .max_listeners(channel.row.readers_max)
            .max_notifiers(channel.row.writers_max)
            .max_nodes(PARTICIPANTS_MAX)
            .open_or_create()
            .map_err(failed("cannot open the event of", &channel.name))
    }
}

type Service<T> =
    iceoryx2::service::port_factory::publish_subscribe::PortFactory<ipc::Service, Shared<T>, ()>;
type EventService = iceoryx2::service::port_factory::event::PortFactory<ipc::Service>;

fn service_name(name: &str) -> Result<ServiceName, ChannelError> {
    name.try_into().map_err(failed("a channel cannot be called", name))
}

/// Writes one channel in shared memory.
pub struct Writer<T: Message> {
    publisher: Publisher<ipc::Service, Shared<T>, ()>,
    stamper: MessageSequencer,
    notifier: Option<Notifier<ipc::Service>>,
}

impl<T: Message> Writer<T> {
    /// Sends what `fill` makes of an all-zero message, in place. It need not fill in more of the
    /// header than the stamp. A message that cannot be sent is lost and its number left out.
    pub fn send_with(&mut self, fill: impl FnOnce(&mut T)) {
        let Ok(mut sample) = self.publisher.loan_uninit() else {
            self.stamper.skip();
            return;
        };
        let slot = sample.payload_mut().as_mut_ptr();
        // SAFETY: the slot is ours until it is sent, large enough and aligned for the type; all
        // zero is a value of a `Pod` type, so that after the call it is initialised.
        let (message, sample) = unsafe {
            slot.write_bytes(0, 1);
            (&mut (*slot).0, sample.assume_init())
        };
        fill(message);
        self.stamper.mark(message.header_mut(), now());
        let _ = sample.send();
        if let Some(notifier) = &self.notifier {
            let _ = notifier.notify();
        }
    }

    /// Sends a copy of a message.
    pub fn send(&mut self, message: &T) {
        self.send_with(|slot| *slot = *message);
    }

    /// Delivers the history to late readers. Call it regularly on a channel that is rarely written.
    pub fn refresh(&self) {
        let _ = self.publisher.update_connections();
    }
}

impl<T: Message> WritePort<T> for Writer<T> {
    fn send_with(&mut self, fill: impl FnOnce(&mut T)) {
        Writer::send_with(self, fill);
    }
    fn refresh(&self) {
        Writer::refresh(self);
    }
    fn begin_anew(&mut self) {
        self.stamper.begin_anew();
    }
}

/// Reads one channel in shared memory.
pub struct Reader<T: Message> {
    subscriber: Subscriber<ipc::Service, Shared<T>, ()>,
    receive_counts: ReceiveCounts,
}

impl<T: Message> Reader<T> {
    /// Returns the oldest message not yet read. It is borrowed from shared memory: drop it soon.
    pub fn receive(&mut self) -> Option<Received<T>> {
        let sample = self.subscriber.receive().ok()??;
        self.receive_counts.count(sample.payload().0.header());
        Some(Received(sample))
    }

    /// Skips to the newest message that was not read yet, and returns it.
    pub fn newest(&mut self) -> Option<Received<T>> {
        ReadPort::newest(self)
    }

    /// Returns the counts of messages received and missed so far.
    pub fn receive_counts(&self) -> ReceiveCounts {
        self.receive_counts
    }
}

impl<T: Message> ReadPort<T> for Reader<T> {
    type Received = Received<T>;
    fn receive(&mut self) -> Option<Received<T>> {
        Reader::receive(self)
    }
    fn receive_counts(&self) -> ReceiveCounts {
        self.receive_counts
    }
}

impl Ports for Participant {
    type Clock = SystemClock;
    type Writer<T: Message> = Writer<T>;
    type Reader<T: Message> = Reader<T>;
    type Listener = Listener;
    type MapWriter = MapWriter;
    type MapReader = MapReader;

    fn clock(&self) -> SystemClock {
        SystemClock
    }
    fn writer<T: Message>(&self, channel: &Channel<T>) -> Result<Writer<T>, ChannelError> {
        Participant::writer(self, channel)
    }
    fn reader<T: Message>(&self, channel: &Channel<T>) -> Result<Reader<T>, ChannelError> {
        Participant::reader(self, channel)
    }
    fn listener<T: Message>(&self, channel: &Channel<T>) -> Result<Listener, ChannelError> {
        Participant::listener(self, channel)
    }
    fn map_writer(&self, channel: &Channel<PatchHeader>) -> Result<MapWriter, ChannelError> {
        Participant::map_writer(self, channel)
    }
    fn map_reader(&self, channel: &Channel<PatchHeader>) -> Result<MapReader, ChannelError> {
        Participant::map_reader(self, channel)
    }
}

/// A message in shared memory.
pub struct Received<T: Message>(iceoryx2::sample::Sample<ipc::Service, Shared<T>, ()>);

impl<T: Message> std::ops::Deref for Received<T> {
    type Target = T;
    fn deref(&self) -> &T {
        &self.0.payload().0
    }
}

/// Wakes its owner when a channel is written.
pub struct Listener {
    listener: IpcListener<ipc::Service>,
    woken: Cell<bool>,
}

impl Listener {
    fn new(listener: IpcListener<ipc::Service>) -> Self {
        Self { listener, woken: Cell::new(false) }
    }

    /// Takes all notifications that have come, until the next one. Do it before reading the channel.
    pub fn drain(&self) {
        // One call takes all notifications, whatever their number.
        let _ = self.listener.try_wait(|_| self.woken.set(true));
    }

    /// Drains it; returns true if a notification has come since the last call, even if [`wait`] drained it.
    pub fn take(&self) -> bool {
        self.drain();
        self.woken.take()
    }

    /// Converts it for a tokio task to wait for; only inside a runtime.
    pub fn into_async(self) -> std::io::Result<AsyncFd<Self>> {
        // SAFETY: the listener owns its descriptor, always gives the same one, and keeps it open as
        // long as it lives; the `AsyncFd` owns the listener.
        unsafe { AsyncFd::register_with_interest(self, Interest::READABLE) }.map_err(std::io::Error::from)
    }
}

impl AsFd for Listener {
    fn as_fd(&self) -> BorrowedFd<'_> {
        // SAFETY: the listener owns the descriptor and keeps it open as long as it lives, and the
        // result cannot outlive the borrow of the listener.
        unsafe { BorrowedFd::borrow_raw(self.listener.file_descriptor().native_handle()) }
    }
}

impl AsRawFd for Listener {
    fn as_raw_fd(&self) -> RawFd {
        self.as_fd().as_raw_fd()
    }
}

/// Waits until every reader has had the time to look at its channels. A program that ends after a few messages calls it before it
/// closes its writers: iceoryx2 takes away what a writer has sent if it is closed before a reader has looked once.
pub fn let_readers_look() {
    std::thread::sleep(READERS_LOOK);
}

/// Waits until one of `listeners` is notified or the moment `until` comes; those notified are drained.
/// Returns true if one was. A signal ends the wait early, as if the moment had come.
pub fn wait<'a>(listeners: impl IntoIterator<Item = &'a Listener>, until: Monotonic) -> bool {
    let left = until.since(now());
    let timeout = Timespec { tv_sec: (left / 1_000_000_000) as i64, tv_nsec: (left % 1_000_000_000) as _ };
    let listeners: heapless::Vec<&Listener, LISTENERS_MAX> =
        listeners.into_iter().take(LISTENERS_MAX).collect();
    let mut fds: heapless::Vec<PollFd<'_>, LISTENERS_MAX> =
        listeners.iter().map(|listener| PollFd::new(*listener, PollFlags::IN)).collect();
    if !matches!(poll(&mut fds, Some(&timeout)), Ok(1..)) {
        return false;
    }
    for (fd, listener) in fds.iter().zip(&listeners) {
        if fd.revents().contains(PollFlags::IN) {
            listener.drain();
        }
    }
    true
}

/// A message as it lies in shared memory.
#[repr(transparent)]
#[derive(Clone, Copy)]
struct Shared<T>(T);

impl<T> std::fmt::Debug for Shared<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(std::any::type_name::<T>())
    }
}

impl<T: Pod> Default for Shared<T> {
    fn default() -> Self {
        Self(T::zeroed())
    }
}

// SAFETY: `Shared` is `repr(transparent)` over its one field.
unsafe impl<T> TransparentWrapper<T> for Shared<T> {}

// SAFETY: `Pod` types hold no pointer, reference or handle, have no padding and one layout
// (`repr(C)`); both ends run the same binary.
unsafe impl<T: Pod> ZeroCopySend for Shared<T> {}
