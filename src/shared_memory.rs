//! The channels in shared memory: iceoryx2 lives here (and for maps in `maps.rs` below) and nowhere
//! else, and so does unsafe code.
//!
//! A message is written in place into memory that every reader maps; nothing is copied on the
//! way. What a reader finds there is untrusted, which costs nothing: any bits are a value of a
//! `Pod` type, and lengths are read through accessors that clamp them.

mod maps;

pub use maps::{MapReader, MapWriter};

use crate::channel::Channel;
use crate::clock::now;
use bytemuck::{Pod, TransparentWrapper};
use iceoryx2::node::NodeView;
use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;
use msg::{Header, Message, Monotonic, ROBOTS_MAX};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::cell::Cell;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, RawFd};
use std::path::{Path as FsPath, PathBuf};
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;

/// Samples that one reader may hold at a time.
const BORROWED_MAX: usize = 2;
/// Processes that may open one channel at a time: a fleet of 16 is 35, and tools.
const NODES_MAX: usize = 64;
/// Bells that one process may listen to: merge and telemetry have a few for each robot.
const BELLS_MAX: usize = 4 * ROBOTS_MAX;

/// What went wrong between processes, and on which channel.
#[derive(Debug, thiserror::Error)]
#[error("shared memory: {what} `{name}`: {why}")]
pub struct ChannelError {
    what: &'static str,
    name: String,
    why: String,
}

fn failed<E: std::fmt::Debug>(what: &'static str, name: &str) -> impl FnOnce(E) -> ChannelError {
    move |why| ChannelError { what, name: name.into(), why: format!("{why:?}") }
}

/// One run's names in shared memory. Two runs on one machine never meet.
#[derive(Clone, Debug)]
pub struct Domain {
    config: Config,
    prefix: String,
    root: PathBuf,
}

impl Domain {
    /// `name`: letters, digits, `_`; unique on the machine (the launcher's process id is).
    pub fn new(name: &str) -> Result<Self, ChannelError> {
        let prefix = format!("mrslam_{name}_");
        // Short, because sockets live below it and their paths have 108 bytes.
        let root = std::env::temp_dir().join(format!("mrslam-{name}"));
        let mut config = Config::default();
        config.global.prefix =
            FileName::new(prefix.as_bytes()).map_err(failed("a run cannot be called", name))?;
        let root_bytes = root.as_os_str().as_encoded_bytes();
        config.global.set_root_path(&Path::new(root_bytes).map_err(failed("no folder", name))?);
        Ok(Self { config, prefix, root })
    }

    /// Removes what dead processes of this run left behind. Safe at any time.
    pub fn clean_up_after_the_dead(&self) {
        let _ = iceoryx2::node::Node::<ipc::Service>::list(&self.config, |state| {
            if let NodeState::Dead(dead) = state {
                let id = *dead.id();
                if let Err(why) = dead.try_remove_stale_resources() {
                    eprintln!("shared memory of the dead process {id:?} stays: {why:?}");
                }
            }
            CallbackProgression::Continue
        });
    }

    /// Removes every trace of the run. Only when none of its processes lives.
    pub fn remove(&self) {
        self.clean_up_after_the_dead();
        let _ = std::fs::remove_dir_all(&self.root);
        for entry in std::fs::read_dir("/dev/shm").into_iter().flatten().flatten() {
            if entry.file_name().to_string_lossy().starts_with(&self.prefix) {
                let _ = std::fs::remove_file(entry.path());
            }
        }
    }

    /// Where the run's sockets and service files live.
    pub fn root(&self) -> &FsPath {
        &self.root
    }
}

/// One process's presence in a run.
pub struct Node {
    node: iceoryx2::node::Node<ipc::Service>,
    run: u64,
}

impl Node {
    /// `name` is for people who look at the run with iceoryx2's tools.
    pub fn open(domain: &Domain, name: &str) -> Result<Self, ChannelError> {
        // iceoryx2 warns of every dead peer it meets; the launcher says that better.
        set_log_level(LogLevel::Error);
        let node = NodeBuilder::new()
            .config(&domain.config)
            .name(&name.try_into().map_err(failed("a process cannot be called", name))?)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>()
            .map_err(failed("cannot attach", name))?;
        Ok(Self { node, run: now().0 })
    }

    /// Tells this incarnation of the process from an earlier one.
    pub fn run(&self) -> u64 {
        self.run
    }

    /// The channel's writer: one, where the table does not allow more.
    pub fn writer<T: Message>(&self, channel: &Channel<T>) -> Result<Writer<T>, ChannelError> {
        let publisher = self
            .service(channel)?
            .publisher_builder()
            .max_loaned_samples(1)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(failed("cannot write channel", &channel.name))?;
        Ok(Writer { publisher, stamper: Stamper::new(self.run), bell: self.notifier(channel)? })
    }

    /// A reader of the channel.
    pub fn reader<T: Message>(&self, channel: &Channel<T>) -> Result<Reader<T>, ChannelError> {
        let subscriber = self
            .service(channel)?
            .subscriber_builder()
            .buffer_size(channel.depth)
            .create()
            .map_err(failed("cannot read channel", &channel.name))?;
        Ok(Reader { subscriber, gaps: Gaps::default() })
    }

    /// Both ends open a channel with the same settings, whoever comes first.
    fn service<T: Message>(&self, channel: &Channel<T>) -> Result<Service<T>, ChannelError> {
        self.node
            .service_builder(&service_name(&channel.name)?)
            .publish_subscribe::<Shared<T>>()
            .max_publishers(channel.writers)
            .max_subscribers(channel.readers)
            .max_nodes(NODES_MAX)
            .history_size(channel.history)
            .subscriber_max_buffer_size(channel.depth)
            .subscriber_max_borrowed_samples(BORROWED_MAX)
            .open_or_create()
            .map_err(failed("cannot open channel", &channel.name))
    }

    /// Rings when the channel is written. Only for channels that wake.
    pub fn bell<T: Message>(&self, channel: &Channel<T>) -> Result<Bell, ChannelError> {
        assert!(channel.wakes, "{} does not wake its readers", channel.name);
        let listener = self
            .event(channel)?
            .listener_builder()
            .create()
            .map_err(failed("cannot listen to", &channel.name))?;
        Ok(Bell::new(listener))
    }

    fn notifier<T: Message>(
        &self,
        channel: &Channel<T>,
    ) -> Result<Option<Notifier<ipc::Service>>, ChannelError> {
        if !channel.wakes {
            return Ok(None);
        }
        let notifier = self.event(channel)?.notifier_builder().create();
        Ok(Some(notifier.map_err(failed("cannot ring", &channel.name))?))
    }

    fn event<T: Message>(&self, channel: &Channel<T>) -> Result<EventService, ChannelError> {
        self.node
            .service_builder(&service_name(&channel.name)?)
            .event()
            .max_listeners(channel.readers)
            .max_notifiers(channel.writers)
            .max_nodes(NODES_MAX)
            .open_or_create()
            .map_err(failed("cannot open the bell of", &channel.name))
    }
}

type Service<T> =
    iceoryx2::service::port_factory::publish_subscribe::PortFactory<ipc::Service, Shared<T>, ()>;
type EventService = iceoryx2::service::port_factory::event::PortFactory<ipc::Service>;

fn service_name(name: &str) -> Result<ServiceName, ChannelError> {
    name.try_into().map_err(failed("a channel cannot be called", name))
}

/// Numbers and times what a writer sends.
struct Stamper {
    run: u64,
    seq: u64,
}

impl Stamper {
    fn new(run: u64) -> Self {
        Self { run, seq: 0 }
    }

    fn mark(&mut self, header: &mut Header) {
        header.incarnation = self.run;
        header.seq = self.seq;
        header.sent = now();
        self.seq += 1;
    }
}

/// Counts what a reader got and what it missed, by the numbers its writer gave.
#[derive(Clone, Copy, Debug, Default)]
pub struct Gaps {
    /// Messages received.
    pub received: u64,
    /// Messages sent after this reader's first and never received.
    pub lost: u64,
    /// The writer's incarnations seen, less one.
    pub restarts: u64,
    run: u64,
    next: u64,
}

impl Gaps {
    fn count(&mut self, header: &Header) {
        if header.incarnation != self.run {
            self.restarts += u64::from(self.received > 0);
            self.run = header.incarnation;
        } else {
            self.lost += header.seq.saturating_sub(self.next);
        }
        self.next = header.seq.saturating_add(1);
        self.received += 1;
    }
}

/// Writes one channel.
pub struct Writer<T: Message> {
    publisher: Publisher<ipc::Service, Shared<T>, ()>,
    stamper: Stamper,
    bell: Option<Notifier<ipc::Service>>,
}

impl<T: Message> Writer<T> {
    /// Sends what `fill` makes of an all-zero message, in place. It need not fill in more of the
    /// header than the stamp. A message that cannot be sent is lost and its number left out.
    pub fn send_with(&mut self, fill: impl FnOnce(&mut T)) {
        let Ok(mut sample) = self.publisher.loan_uninit() else {
            self.stamper.seq += 1;
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
        self.stamper.mark(message.header_mut());
        let _ = sample.send();
        self.ring();
    }

    /// Sends a copy.
    pub fn send(&mut self, message: &T) {
        self.send_with(|slot| *slot = *message);
    }

    /// Lets late readers have the history. Call it now and then where nothing is sent for long.
    pub fn refresh(&self) {
        let _ = self.publisher.update_connections();
    }

    fn ring(&self) {
        if let Some(bell) = &self.bell {
            let _ = bell.notify();
        }
    }
}

/// Reads one channel.
pub struct Reader<T: Message> {
    subscriber: Subscriber<ipc::Service, Shared<T>, ()>,
    gaps: Gaps,
}

impl<T: Message> Reader<T> {
    /// The oldest message not yet read. It is borrowed from shared memory: drop it soon.
    pub fn receive(&mut self) -> Option<Received<T>> {
        let sample = self.subscriber.receive().ok()??;
        self.gaps.count(sample.payload().0.header());
        Some(Received(sample))
    }

    /// Reads on to the newest message, if there is one.
    pub fn newest(&mut self) -> Option<Received<T>> {
        let mut newest = None;
        while let Some(message) = self.receive() {
            newest = Some(message);
        }
        newest
    }

    /// What was received and missed so far.
    pub fn gaps(&self) -> Gaps {
        self.gaps
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

/// Rings when a channel is written.
pub struct Bell {
    listener: Listener<ipc::Service>,
    rang: Cell<bool>,
}

impl Bell {
    fn new(listener: Listener<ipc::Service>) -> Self {
        Self { listener, rang: Cell::new(false) }
    }

    /// Makes it silent until the next ring. Do it before reading the channel.
    pub fn silence(&self) {
        // One call takes all rings that have come, whatever their number.
        let _ = self.listener.try_wait(|_| self.rang.set(true));
    }

    /// Silences it. True if it has rung since the last time, or been silenced by [`wait`] for it.
    pub fn take(&self) -> bool {
        self.silence();
        self.rang.take()
    }

    /// For a tokio task to wait for. Inside a runtime only.
    pub fn into_async(self) -> std::io::Result<AsyncFd<Self>> {
        // SAFETY: the bell owns its descriptor, always gives the same one, and keeps it open as
        // long as it lives; the `AsyncFd` owns the bell.
        unsafe { AsyncFd::register_with_interest(self, Interest::READABLE) }.map_err(std::io::Error::from)
    }
}

impl AsFd for Bell {
    fn as_fd(&self) -> BorrowedFd<'_> {
        // SAFETY: the listener owns the descriptor and keeps it open as long as it lives, and the
        // result cannot outlive the borrow of the listener.
        unsafe { BorrowedFd::borrow_raw(self.listener.file_descriptor().native_handle()) }
    }
}

impl AsRawFd for Bell {
    fn as_raw_fd(&self) -> RawFd {
        self.as_fd().as_raw_fd()
    }
}

/// Waits until a bell rings or the moment `until` comes; bells that rang are silenced.
/// True if one rang. A signal ends the wait early, as if the moment had come.
pub fn wait(bells: &[&Bell], until: Monotonic) -> bool {
    let left = until.since(now());
    let timeout = Timespec { tv_sec: (left / 1_000_000_000) as i64, tv_nsec: (left % 1_000_000_000) as _ };
    let mut fds: heapless::Vec<PollFd<'_>, BELLS_MAX> =
        bells.iter().take(BELLS_MAX).map(|bell| PollFd::new(*bell, PollFlags::IN)).collect();
    if !matches!(poll(&mut fds, Some(&timeout)), Ok(1..)) {
        return false;
    }
    for (fd, bell) in fds.iter().zip(bells) {
        if fd.revents().contains(PollFlags::IN) {
            bell.silence();
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
