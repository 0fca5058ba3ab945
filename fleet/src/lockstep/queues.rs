//! Channels as queues in memory, with the semantics of those in shared memory: depth, history, drop oldest, numbers.
//! The faults of a [`FaultPlan`] are injected between a message's writer and each reader.

mod maps;

pub use maps::{QueueMapReader, QueueMapWriter};

use super::faults::{Delivery, FaultPlan};
use crate::channel::{Channel, ChannelRow, Direction, Opener};
use crate::ports::{
    ChannelError, Clock, MessageSequencer, Ports, ProcessUsage, ReadPort, ReceiveCounts, WritePort,
};
use maps::PatchMessage;
use msg::tiles::{PatchReceiver, PatchSender};
use msg::{Message, Monotonic, PatchHeader};
use std::any::Any;
use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::rc::{Rc, Weak};

/// Callback for every message that is sent: the channel's name and the message's bytes.
pub type MessageObserver<'a> = &'a mut dyn FnMut(&str, &[u8]);

/// Virtual time, shared by all of a fleet.
#[derive(Clone, Debug, Default)]
pub struct VirtualClock {
    now: Rc<Cell<u64>>,
    /// Number of the incarnation, in place of the process id.
    incarnation: u64,
}

impl VirtualClock {
    /// Sets the time.
    pub fn set(&self, now: Monotonic) {
        self.now.set(now.0);
    }
}

impl Clock for VirtualClock {
    fn now(&self) -> Monotonic {
        Monotonic(self.now.get())
    }

    fn usage(&self) -> ProcessUsage {
        ProcessUsage { pid: self.incarnation as u32, ..ProcessUsage::default() }
    }
}

/// Openers of each channel, by the last part of the channel's name.
pub type Openings = BTreeSet<(String, Direction, Opener)>;

/// All channels of a fleet in lockstep.
pub struct Network {
    clock: VirtualClock,
    topics: RefCell<BTreeMap<String, Box<dyn Any>>>,
    /// Messages sent since they were taken last: name and bytes.
    sent: RefCell<Vec<(Rc<str>, Vec<u8>)>>,
    /// Moments at which a listener is to be notified of a message that comes late.
    late: RefCell<BTreeMap<u64, Vec<Weak<Cell<bool>>>>>,
    faults: RefCell<FaultPlan>,
    openings: RefCell<Openings>,
    incarnations: Cell<u64>,
    overflowed: Cell<u64>,
}

impl Network {
    /// Creates a network without channels.
    pub fn new(faults: FaultPlan) -> Rc<Self> {
        Rc::new(Self {
            clock: VirtualClock::default(),
            topics: RefCell::default(),
            sent: RefCell::default(),
            late: RefCell::default(),
            faults: RefCell::new(faults),
            openings: RefCell::default(),
            incarnations: Cell::new(0),
            overflowed: Cell::new(0),
        })
    }

    /// Returns the clock of the fleet.
    pub fn clock(&self) -> &VirtualClock {
        &self.clock
    }

    /// Returns the faults that are active now.
    pub fn faults(&self) -> std::cell::RefMut<'_, FaultPlan> {
        self.faults.borrow_mut()
    }

    /// Returns who has opened which channel so far.
    pub fn openings(&self) -> Openings {
        self.openings.borrow().clone()
    }

    /// Records a message that a client received on a topic, beside those of the channels.
    pub fn record(&self, client: &str, topic: &str, payload: &[u8]) {
        self.sent.borrow_mut().push((format!("{client}{topic}").into(), payload.to_vec()));
    }

    /// Records that a fault was injected now, or its consequence, beside the messages of the channels.
    pub fn record_event(&self, event: &str) {
        let now = self.clock.now().0.to_le_bytes();
        self.sent.borrow_mut().push((format!("fault/{event}").into(), now.to_vec()));
    }

    /// Passes on the messages that were sent since the last call.
    pub fn report_messages(&self, observer: MessageObserver<'_>) {
        for (name, bytes) in self.sent.take() {
            observer(&name, &bytes);
        }
    }

    /// Returns the next moment at which a late message arrives.
    pub fn next_arrival(&self) -> Option<Monotonic> {
        self.late.borrow().keys().next().map(|at| Monotonic(*at))
    }

    /// Notifies the listeners of messages that have arrived by now.
    pub fn notify_arrivals(&self) {
        let now = self.clock.now.get();
        let mut late = self.late.borrow_mut();
        while let Some(entry) = late.first_entry()
            && *entry.key() <= now
        {
            entry.remove().iter().filter_map(Weak::upgrade).for_each(|woken| woken.set(true));
        }
    }

    fn topic<M: 'static>(self: &Rc<Self>, name: &str, row: &'static ChannelRow) -> Rc<Topic<M>> {
        let mut topics = self.topics.borrow_mut();
        let topic = topics.entry(name.to_string()).or_insert_with(|| Box::new(Topic::<M>::new(name, row)));
        topic.downcast_ref::<Rc<Topic<M>>>().cloned().unwrap_or_else(|| Topic::new(name, row))
    }
}

/// One channel: its readers, its history and those that wait for its messages.
struct Topic<M> {
    name: Rc<str>,
    row: &'static ChannelRow,
    writers: Cell<usize>,
    history: RefCell<VecDeque<Rc<M>>>,
    queues: RefCell<Vec<Weak<Queue<M>>>>,
    listeners: RefCell<Vec<Weak<Cell<bool>>>>,
    /// A reader has asked for the whole map (map channels only).
    requested: Cell<bool>,
    request_listener: RefCell<Weak<Cell<bool>>>,
}

impl<M> Topic<M> {
    fn new(name: &str, row: &'static ChannelRow) -> Rc<Self> {
        Rc::new(Self {
            name: name.into(),
            row,
            writers: Cell::new(0),
            history: RefCell::default(),
            queues: RefCell::default(),
            listeners: RefCell::default(),
            requested: Cell::new(false),
            request_listener: RefCell::default(),
        })
    }

    /// Adds a reader's queue, with the history in it.
    fn subscribe(&self) -> Rc<Queue<M>> {
        let waiting = self.history.borrow().iter().map(|message| (Monotonic(0), message.clone())).collect();
        let queue = Rc::new(Queue { waiting: RefCell::new(waiting) });
        let mut queues = self.queues.borrow_mut();
        queues.retain(|queue| queue.strong_count() > 0);
        queues.push(Rc::downgrade(&queue));
        queue
    }

    fn listen(&self) -> Rc<Cell<bool>> {
        let woken = Rc::new(Cell::new(true));
        self.listeners.borrow_mut().push(Rc::downgrade(&woken));
        woken
    }

    /// Hands a message to every reader, as the active faults allow. A full queue drops its oldest message.
    fn publish(&self, network: &Network, message: Rc<M>) {
        let now = network.clock.now();
        let mut history = self.history.borrow_mut();
        history.push_back(message.clone());
        while history.len() > self.row.history {
            history.pop_front();
        }
        let mut latest = None;
        for queue in self.queues.borrow().iter().filter_map(Weak::upgrade) {
            let (copies, arrives) = match network.faults.borrow_mut().deliver(now) {
                Delivery::Lost => continue,
                Delivery::Copies(copies) => (copies, now),
                Delivery::Late(at) => (1, at),
            };
            latest = latest.max((arrives > now).then_some(arrives));
            let mut waiting = queue.waiting.borrow_mut();
            for _ in 0..copies {
                if waiting.len() == self.row.depth {
                    waiting.pop_front();
                    network.overflowed.set(network.overflowed.get() + 1);
                }
                waiting.push_back((arrives, message.clone()));
            }
        }
        let mut listeners = self.listeners.borrow_mut();
        listeners.retain(|listener| listener.strong_count() > 0);
        listeners.iter().filter_map(Weak::upgrade).for_each(|woken| woken.set(true));
        if let Some(at) = latest {
            network.late.borrow_mut().entry(at.0).or_default().extend(listeners.iter().cloned());
        }
    }
}

/// A reader's messages that were not read yet, and when each arrives.
struct Queue<M> {
    waiting: RefCell<VecDeque<(Monotonic, Rc<M>)>>,
}

impl<M> Queue<M> {
    fn receive(&self, now: Monotonic) -> Option<Rc<M>> {
        let mut waiting = self.waiting.borrow_mut();
        // Messages stay in order: all wait behind a late one.
        if waiting.front()?.0 > now {
            return None;
        }
        waiting.pop_front().map(|(_, message)| message)
    }
}

/// One process's ports, or one thread's.
#[derive(Clone)]
pub struct MemoryPorts {
    network: Rc<Network>,
    opener: Opener,
    incarnation: u64,
    /// The listeners that the process holds, for the scheduler.
    woken: Rc<RefCell<Vec<Weak<Cell<bool>>>>>,
}

impl MemoryPorts {
    /// Creates the ports of a new incarnation of a process.
    pub fn attach(network: &Rc<Network>, opener: Opener) -> Self {
        network.incarnations.set(network.incarnations.get() + 1);
        let incarnation = network.incarnations.get();
        Self { network: network.clone(), opener, incarnation, woken: Rc::default() }
    }

    /// Creates the ports of a reader that is no process of the fleet: the processes' numbers stay what they are.
    pub fn attach_observer(network: &Rc<Network>, opener: Opener) -> Self {
        Self { network: network.clone(), opener, incarnation: 0, woken: Rc::default() }
    }

    /// Takes the notifications that have come; returns true if there was one.
    pub fn take_notifications(&self) -> bool {
        let woken = self.woken.borrow();
        woken.iter().filter_map(Weak::upgrade).filter(|woken| woken.take()).count() > 0
    }

    /// Returns whether a notification has come.
    pub fn is_notified(&self) -> bool {
        self.woken.borrow().iter().filter_map(Weak::upgrade).any(|woken| woken.get())
    }

    fn open<T>(&self, channel: &Channel<T>, direction: Direction) -> Result<(), ChannelError> {
        channel.check(self.opener, direction)?;
        self.network.openings.borrow_mut().insert((channel.name.clone(), direction, self.opener));
        Ok(())
    }

    fn hold(&self, woken: Rc<Cell<bool>>) -> Rc<Cell<bool>> {
        self.woken.borrow_mut().push(Rc::downgrade(&woken));
        woken
    }

    fn topic<M: 'static, T>(&self, channel: &Channel<T>) -> Rc<Topic<M>> {
        self.network.topic(&channel.name, channel.row)
    }
}

impl Ports for MemoryPorts {
    type Clock = VirtualClock;
    type Writer<T: Message> = QueueWriter<T>;
    type Reader<T: Message> = QueueReader<T>;
    type Listener = Rc<Cell<bool>>;
    type MapWriter = QueueMapWriter;
    type MapReader = QueueMapReader;

    fn clock(&self) -> VirtualClock {
        VirtualClock { now: self.network.clock.now.clone(), incarnation: self.incarnation }
    }

    fn writer<T: Message>(&self, channel: &Channel<T>) -> Result<QueueWriter<T>, ChannelError> {
        self.open(channel, Direction::Write)?;
        let stamper = MessageSequencer::new(self.incarnation);
        Ok(QueueWriter { network: self.network.clone(), topic: self.topic(channel), stamper }.opened())
    }

    fn reader<T: Message>(&self, channel: &Channel<T>) -> Result<QueueReader<T>, ChannelError> {
        self.open(channel, Direction::Read)?;
        let queue = self.topic(channel).subscribe();
        Ok(QueueReader { clock: self.clock(), queue, receive_counts: ReceiveCounts::default() })
    }

    fn listener<T: Message>(&self, channel: &Channel<T>) -> Result<Rc<Cell<bool>>, ChannelError> {
        // A map's channel holds messages with tiles.
        Ok(self.hold(if T::NAME == PatchHeader::NAME {
            self.topic::<PatchMessage, T>(channel).listen()
        } else {
            self.topic::<T, T>(channel).listen()
        }))
    }

    fn map_writer(&self, channel: &Channel<PatchHeader>) -> Result<QueueMapWriter, ChannelError> {
        self.open(channel, Direction::Write)?;
        let topic: Rc<Topic<PatchMessage>> = self.topic(channel);
        let requests = self.hold(Rc::new(Cell::new(false)));
        *topic.request_listener.borrow_mut() = Rc::downgrade(&requests);
        let stamper = MessageSequencer::new(self.incarnation);
        let network = self.network.clone();
        Ok(QueueMapWriter { network, topic, requests, stamper, sender: PatchSender::default(), bytes: 0 })
    }

    fn map_reader(&self, channel: &Channel<PatchHeader>) -> Result<QueueMapReader, ChannelError> {
        self.open(channel, Direction::Read)?;
        let topic: Rc<Topic<PatchMessage>> = self.topic(channel);
        Ok(QueueMapReader {
            clock: self.clock(),
            queue: topic.subscribe(),
            topic,
            asked: None,
            receive_counts: ReceiveCounts::default(),
            receiver: PatchReceiver::default(),
        })
    }
}

/// Writes a queue.
pub struct QueueWriter<T> {
    network: Rc<Network>,
    topic: Rc<Topic<T>>,
    stamper: MessageSequencer,
}

impl<T> QueueWriter<T> {
    fn opened(self) -> Self {
        self.topic.writers.set(self.topic.writers.get() + 1);
        self
    }
}

impl<T> Drop for QueueWriter<T> {
    fn drop(&mut self) {
        // The history lies in the writer's memory.
        self.topic.writers.set(self.topic.writers.get() - 1);
        self.topic.history.borrow_mut().clear();
    }
}

impl<T: Message> WritePort<T> for QueueWriter<T> {
    fn send_with(&mut self, fill: impl FnOnce(&mut T)) {
        let now = self.network.clock.now();
        if self.network.faults().is_full(now) {
            self.stamper.skip();
            return;
        }
        let mut message: Box<T> = bytemuck::allocation::zeroed_box();
        fill(&mut message);
        self.stamper.mark(message.header_mut(), now);
        let bytes = bytemuck::bytes_of(&*message).to_vec();
        self.network.sent.borrow_mut().push((self.topic.name.clone(), bytes));
        self.topic.publish(&self.network, Rc::from(message));
    }

    fn refresh(&self) {}

    fn begin_anew(&mut self) {
        self.stamper.begin_anew();
    }
}

/// Reads a queue.
pub struct QueueReader<T> {
    clock: VirtualClock,
    queue: Rc<Queue<T>>,
    receive_counts: ReceiveCounts,
}

impl<T: Message> ReadPort<T> for QueueReader<T> {
    type Received = Rc<T>;

    fn receive(&mut self) -> Option<Rc<T>> {
        let message = self.queue.receive(self.clock.now())?;
        self.receive_counts.count(message.header());
        Some(message)
    }

    fn receive_counts(&self) -> ReceiveCounts {
        self.receive_counts
    }
}
