//! TCP in memory: connections of ros_tcp clients to the bridge of a fleet in lockstep.
//!
//! As live, the launcher holds the port, so that clients queue while no bridge runs; the connections end with the
//! bridge's process; and what a client does not read waits in the connection first and in the bridge then.

use super::queues::{MemoryPorts, Network};
use crate::ports::Clock;
use crate::process::ProcessLoop;
use crate::process::bridge::BridgeProcess;
use crate::process::control::files::ImmediateFiles;
use crate::storage::Storage;
use bridge::ClientId;
use bridge::frame::Parser;
use headset::wireless::{Link, LinkModel, SEGMENT_BYTES};
use msg::Monotonic;
use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::net::SocketAddr;
use std::rc::Rc;
use std::time::Duration;

/// Bytes to a client that wait in its connection before the bridge keeps the rest: about what the kernel holds.
pub(super) const CONNECTION_BYTES_MAX: usize = 256 << 10;

/// The TCP port, which the launcher holds.
pub struct Port {
    network: Rc<Network>,
    /// Connections that no bridge has accepted yet.
    backlog: RefCell<VecDeque<(SocketAddr, Rc<Connection>)>>,
    /// Link of each connection that is opened from now on, with the session's seed and the number of the next connection.
    link: Cell<Option<(Link, u64, u64)>>,
    /// Connections over a link whose bytes are under way.
    linked: RefCell<Vec<Rc<Connection>>>,
}

/// One connection. While the network is cut, nothing arrives at either end.
#[derive(Default)]
pub struct Connection {
    to_bridge: RefCell<Pipe>,
    to_client: RefCell<Pipe>,
    closed_by_client: Cell<bool>,
    closed_by_bridge: Cell<bool>,
}

/// Bytes in one direction of a connection.
#[derive(Default)]
struct Pipe {
    /// Bytes that have arrived.
    arrived: Vec<u8>,
    /// Segments on the link, with their arrivals; always empty without a link.
    under_way: VecDeque<(Monotonic, Vec<u8>)>,
    under_way_bytes: usize,
    link: Option<LinkModel>,
}

impl Pipe {
    fn over(link: Link, seed: u64, stream: u64) -> Self {
        Self { link: Some(LinkModel::new(link, seed, stream)), ..Self::default() }
    }

    /// Returns the number of bytes that the receiver has not taken.
    fn len(&self) -> usize {
        self.arrived.len() + self.under_way_bytes
    }

    fn send(&mut self, bytes: &[u8], now: Monotonic) {
        let Some(link) = &mut self.link else { return self.arrived.extend_from_slice(bytes) };
        for segment in bytes.chunks(SEGMENT_BYTES) {
            let arrival = link.arrival(Duration::from_nanos(now.0), segment.len());
            self.under_way.push_back((Monotonic(arrival.as_nanos() as u64), segment.to_vec()));
        }
        self.under_way_bytes += bytes.len();
    }

    /// Makes the segments that have arrived by now readable.
    fn deliver(&mut self, now: Monotonic) {
        while self.under_way.front().is_some_and(|(arrival, _)| *arrival <= now) {
            let Some((_, segment)) = self.under_way.pop_front() else { return };
            self.under_way_bytes -= segment.len();
            self.arrived.extend(segment);
        }
    }

    fn next_arrival(&self) -> Option<Monotonic> {
        self.under_way.front().map(|(arrival, _)| *arrival)
    }
}

impl Port {
    /// Creates a port without clients.
    pub fn new(network: &Rc<Network>) -> Rc<Self> {
        Rc::new(Self {
            network: network.clone(),
            backlog: RefCell::default(),
            link: Cell::default(),
            linked: RefCell::default(),
        })
    }

    /// Puts a link between the bridge and the clients that connect from now on.
    pub fn set_link(&self, link: Link, seed: u64) {
        self.link.set((!link.is_transparent()).then_some((link, seed, 0)));
    }

    /// Connects a client; the bridge accepts it when it runs.
    pub fn connect(&self, peer: SocketAddr) -> Rc<Connection> {
        let mut connection = Connection::default();
        if let Some((link, seed, number)) = self.link.get() {
            connection.to_bridge = Pipe::over(link, seed, 2 * number).into();
            connection.to_client = Pipe::over(link, seed, 2 * number + 1).into();
            // The next connection draws its own delays.
            self.link.set(Some((link, seed, number + 1)));
        }
        let connection = Rc::new(connection);
        if self.link.get().is_some() {
            self.linked.borrow_mut().push(connection.clone());
        }
        self.backlog.borrow_mut().push_back((peer, connection.clone()));
        connection
    }

    /// Makes what has arrived over links by now readable.
    pub fn deliver(&self) {
        let now = self.network.clock().now();
        self.linked.borrow_mut().retain(|connection| {
            connection.to_bridge.borrow_mut().deliver(now);
            connection.to_client.borrow_mut().deliver(now);
            !connection.closed_by_client.get() && !connection.closed_by_bridge.get()
        });
    }

    /// Returns when something arrives over a link next.
    pub fn next_arrival(&self) -> Option<Monotonic> {
        let linked = self.linked.borrow();
        let of_pipes = |connection: &Rc<Connection>| {
            [connection.to_bridge.borrow().next_arrival(), connection.to_client.borrow().next_arrival()]
        };
        linked.iter().flat_map(of_pipes).flatten().min()
    }

    /// Returns the time.
    pub fn now(&self) -> Monotonic {
        self.network.clock().now()
    }

    /// Returns whether bytes pass between clients and the bridge now.
    pub fn is_open(&self) -> bool {
        !self.network.faults().is_cut(self.network.clock().now())
    }
}

impl Connection {
    /// Sends bytes to the bridge.
    pub fn write(&self, bytes: &[u8], now: Monotonic) {
        self.to_bridge.borrow_mut().send(bytes, now);
    }

    /// Returns the number of bytes to the bridge that it has not taken.
    pub fn waiting_bytes(&self) -> usize {
        self.to_bridge.borrow().len()
    }

    /// Takes the bytes that have arrived at the client.
    pub fn read(&self) -> Vec<u8> {
        std::mem::take(&mut self.to_client.borrow_mut().arrived)
    }

    /// Closes it at the client's end.
    pub fn close(&self) {
        self.closed_by_client.set(true);
    }

    /// Returns whether the bridge has closed it or has died.
    pub fn is_closed_by_bridge(&self) -> bool {
        self.closed_by_bridge.get()
    }
}

/// A client as the bridge's process sees it.
struct Session {
    id: ClientId,
    connection: Rc<Connection>,
    parser: Parser,
    /// Whether the connection held too much to take more from the bridge.
    blocked: bool,
}

impl Session {
    fn has_input(&self) -> bool {
        let Connection { to_bridge, to_client, closed_by_client, .. } = &*self.connection;
        let has_room = to_client.borrow().len() < CONNECTION_BYTES_MAX;
        !to_bridge.borrow().arrived.is_empty() || closed_by_client.get() || (self.blocked && has_room)
    }
}

/// The bridge's process with its clients on connections in memory.
pub struct BridgeServer<S: Storage> {
    /// The process that runs live, without its sockets.
    pub process: BridgeProcess<MemoryPorts, ImmediateFiles<S>>,
    port: Rc<Port>,
    sessions: Vec<Session>,
    frame_bytes_max: usize,
}

impl<S: Storage> BridgeServer<S> {
    /// Serves the port with a process whose frames have at most `frame_bytes_max` bytes.
    pub fn new(
        process: BridgeProcess<MemoryPorts, ImmediateFiles<S>>,
        port: Rc<Port>,
        frame_bytes_max: usize,
    ) -> Self {
        Self { process, port, sessions: Vec::new(), frame_bytes_max }
    }

    /// Returns whether something has come from a client.
    pub fn has_input(&self) -> bool {
        let is_waiting =
            !self.port.backlog.borrow().is_empty() || self.sessions.iter().any(Session::has_input);
        is_waiting && self.port.is_open()
    }

    fn accept(&mut self) {
        while let Some((peer, connection)) = { self.port.backlog.borrow_mut().pop_front() } {
            match self.process.bridge.connect(peer) {
                Ok(id) => {
                    let parser = Parser::new(self.frame_bytes_max);
                    self.sessions.push(Session { id, connection, parser, blocked: false });
                }
                Err(_) => connection.closed_by_bridge.set(true),
            }
        }
    }

    /// Reads what has come from the clients.
    fn receive(&mut self, now: Monotonic) {
        let bridge = &self.process.bridge;
        self.sessions.retain_mut(|session| {
            session.parser.push(&std::mem::take(&mut session.connection.to_bridge.borrow_mut().arrived));
            let is_valid = loop {
                match session.parser.next_frame() {
                    Ok(Some(frame)) => bridge.receive(session.id, frame, now),
                    Ok(None) => break true,
                    Err(_) => break false,
                }
            };
            let stays = is_valid && !session.connection.closed_by_client.get();
            if !stays {
                bridge.disconnect(session.id);
                session.connection.closed_by_bridge.set(true);
            }
            stays
        });
    }

    /// Writes the frames that wait for the clients.
    fn send(&mut self, now: Monotonic) {
        let bridge = &self.process.bridge;
        self.sessions.retain_mut(|session| {
            let mut to_client = session.connection.to_client.borrow_mut();
            session.blocked = to_client.len() >= CONNECTION_BYTES_MAX;
            let mut outgoing = Vec::new();
            let stays = session.blocked || bridge.take_outgoing(session.id, &mut outgoing).is_ok();
            to_client.send(&outgoing, now);
            if !stays {
                bridge.disconnect(session.id);
                session.connection.closed_by_bridge.set(true);
            }
            stays
        });
    }
}

impl<S: Storage> ProcessLoop for BridgeServer<S> {
    fn step(&mut self) -> Monotonic {
        if self.port.is_open() {
            self.accept();
            self.receive(self.port.network.clock().now());
        }
        let due = self.process.step();
        if self.port.is_open() {
            self.send(self.port.network.clock().now());
        }
        due
    }
}

impl<S: Storage> Drop for BridgeServer<S> {
    fn drop(&mut self) {
        // The connections of a process end with it.
        self.sessions.iter().for_each(|session| session.connection.closed_by_bridge.set(true));
    }
}
