//! Admission of clients and of large frames: what one client may take, and who makes room when places or memory are short.

use super::Core;
use super::ros_refusals::RosRefusals;
use crate::command::name;
use crate::frame::IncompleteFrame;
use crate::router::{
    BufferPool, Client, ClientId, ConnectionEnded, FlushOutcome, LargeFrame, OutgoingQueue, Source,
};
use crate::world::ClockOffset;
use msg::{Monotonic, RobotId};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::io::{IoSlice, Write};
use std::net::{IpAddr, SocketAddr};
use std::str::FromStr;
use std::time::Duration;
use thiserror::Error;

/// The longest payload on a topic that the fleet interprets, bytes: scans and transforms are far shorter.
const INPUT_BYTES_MAX: usize = 1 << 20;
/// A large frame that gains less than this in `frame_timeout_s` is given up, bytes.
const PROGRESS_BYTES: usize = 64 << 10;
/// Dropped clients whose last words wait to be sent; those of more are dropped too.
const LEAVING_MAX: usize = 64;

/// Why a client cannot connect.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ConnectError {
    /// As many clients are connected as may be.
    #[error("the bridge has {limit} clients, its limit (clients_max); disconnect one, or raise the limit")]
    TooManyClients {
        /// Most clients at a time (`clients_max`).
        limit: usize,
    },
    /// The address has as many connections as it may.
    #[error("{address} has {limit} connections, the limit of one address (limits.connections_per_address)")]
    TooManyOfAddress {
        /// The client's address.
        address: IpAddr,
        /// Most connections of one address at a time.
        limit: usize,
    },
}

/// The connections that a person names.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClientSelector {
    /// The connection of this number, as [`crate::ClientStatus::number`] has it.
    Number(u64),
    /// The connection from this address and port.
    Connection(SocketAddr),
    /// All connections from this address.
    Address(IpAddr),
}

/// The text names no connection.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("'{text}' is neither an address, as 192.168.1.20 or 192.168.1.20:5000, nor a connection's number")]
pub struct SelectorError {
    text: String,
}

impl FromStr for ClientSelector {
    type Err = SelectorError;

    fn from_str(text: &str) -> Result<Self, SelectorError> {
        let number = text.parse().map(Self::Number);
        let connection = || text.parse().map(Self::Connection);
        let address = || text.parse().map(Self::Address);
        let selector = number.ok().or_else(|| connection().ok()).or_else(|| address().ok());
        selector.ok_or_else(|| SelectorError { text: text.to_owned() })
    }
}

/// Why a large frame is not received.
#[derive(Debug, Error)]
enum FrameRefusal {
    #[error("a command of {announced} bytes, '{name}', is skipped: the limit is {limit}")]
    Command { name: String, announced: usize, limit: usize },
    #[error(
        "a frame of {announced} bytes for '{name}' is skipped: before the client has registered its topic or service, \
         the limit is {limit} (limits.unregistered_bytes_max)"
    )]
    Unregistered { name: String, announced: usize, limit: usize },
    #[error(
        "a frame of {announced} bytes for '{name}' is skipped: no message of this topic is over {limit} bytes"
    )]
    Input { name: String, announced: usize, limit: usize },
    #[error(
        "a frame of {announced} bytes for '{name}' is skipped: the bridge holds as much for its clients as it may \
         ({limit} bytes, limits.held_bytes_max); send it again later"
    )]
    Memory { name: String, announced: usize, limit: usize },
}

/// Events that wait for the operator's log; further ones are dropped.
const EVENTS_MAX: usize = 16;

/// The newest time that the bridge was called with, the clients that are being dropped, and what is to be told.
#[derive(Default)]
pub struct AdmissionState {
    now: Monotonic,
    /// What is left to send to clients that were dropped: the reason comes last.
    leaving: VecDeque<(ClientId, OutgoingQueue)>,
    /// What the operator's log is to say.
    events: Vec<String>,
    /// Refused messages from ROS 2, of which it says some.
    pub(super) ros_refusals: RosRefusals,
}

impl Core {
    /// Makes a place for a client at this address, or says why there is none.
    pub(super) fn make_place(&mut self, peer: SocketAddr) -> Result<(), ConnectError> {
        let address = peer.ip().to_canonical();
        let is_trusted = self.config.trust_loopback && address.is_loopback();
        let of_address = |client: &&Client| client.peer.ip().to_canonical() == address;
        let limit = self.config.limits.connections_per_address;
        if !is_trusted
            && self.router.clients().filter(of_address).count() >= limit
            && !self.drop_most_silent(of_address)
        {
            self.router.counted.refused += 1;
            return Err(ConnectError::TooManyOfAddress { address, limit });
        }
        let limit = self.config.clients_max;
        if self.router.clients().count() >= limit && !self.drop_most_silent(|_| true) {
            self.router.counted.refused += 1;
            return Err(ConnectError::TooManyClients { limit });
        }
        Ok(())
    }

    /// Drops the client that has been silent longest, if it has been so for `silence_s`; returns whether there was one.
    fn drop_most_silent(&mut self, is_candidate: impl Fn(&&Client) -> bool) -> bool {
        let candidates =
            self.router.clients().filter(|client| !client.input.is_permanent).filter(is_candidate);
        let Some(client) = candidates.min_by_key(|client| client.input.last_at) else { return false };
        let (id, silent) = (client.id, self.silence_of(client));
        if silent < self.config.limits.silence() {
            return false;
        }
        self.drop_client(id, silence_reason(silent, "and its place was needed"));
        true
    }

    /// Returns for how long a client has sent nothing; zero for a part of this process.
    pub fn silence_of(&self, client: &Client) -> Duration {
        if client.input.is_permanent {
            return Duration::ZERO;
        }
        Duration::from_nanos(self.admission.now.since(client.input.last_at))
    }

    /// Returns the clients that have sent something within `silence_s`.
    pub(super) fn living_clients(&self) -> Vec<ClientId> {
        let is_alive = |client: &&Client| self.silence_of(client) < self.config.limits.silence();
        self.router.clients().filter(is_alive).map(|client| client.id).collect()
    }

    /// Records the time of the call; a client that is being served was heard then.
    pub(super) fn record_received(&mut self, id: Option<ClientId>, now: Monotonic) {
        self.admission.now = self.admission.now.max(now);
        if let Some(client) = id.and_then(|id| self.router.client_mut(id)) {
            client.input.last_at = now;
        }
    }

    /// Records that a client is a part of this process, which is never dropped for its silence.
    pub fn mark_permanent(&mut self, id: ClientId) {
        if let Some(client) = self.router.client_mut(id) {
            client.input.is_permanent = true;
        }
    }

    /// Sets when a client connected: about now.
    pub(super) fn record_connected(&mut self, id: ClientId) {
        let now = self.admission.now;
        if let Some(client) = self.router.client_mut(id) {
            (client.input.connected_at, client.input.last_at) = (now, now);
        }
    }

    /// Decides whether the rest of a large frame is received; if not, the client is told why, and must skip it.
    ///
    /// `buffer_bytes` is the size that the client's input buffer needs now.
    pub fn admit_large_frame(
        &mut self,
        id: ClientId,
        frame: IncompleteFrame<'_>,
        buffer_bytes: usize,
        now: Monotonic,
    ) -> bool {
        let Some(client) = self.router.client_mut(id) else { return false };
        let mut admitted = true;
        match &mut client.input.large_frame {
            Some(large) if frame.arrived_bytes >= large.arrived_bytes + PROGRESS_BYTES => {
                *large = LargeFrame { arrived_bytes: frame.arrived_bytes, at: now };
                client.input.last_at = now;
            }
            Some(_) => {}
            None => {
                client.input.large_frame = Some(LargeFrame { arrived_bytes: frame.arrived_bytes, at: now });
                admitted = self.check_large_frame(id, frame);
            }
        }
        if admitted && !self.router.hold_input(id, buffer_bytes) {
            admitted = false;
            self.refuse_for_memory(id, frame);
        }
        if !admitted {
            self.end_large_frame(id);
        }
        admitted
    }

    /// Records that a client's large frame is complete or skipped, and its buffer given back.
    pub fn end_large_frame(&mut self, id: ClientId) {
        self.router.hold_input(id, 0);
        if let Some(client) = self.router.client_mut(id) {
            client.input.large_frame = None;
        }
    }

    fn refuse_for_memory(&mut self, id: ClientId, frame: IncompleteFrame<'_>) {
        let (name, announced) = (String::from_utf8_lossy(frame.name).into_owned(), frame.payload_bytes);
        let limit = self.config.limits.held_bytes_max;
        self.router.refuse(id, FrameRefusal::Memory { name, announced, limit }.to_string());
    }

    /// Refuses a large frame by what its sender has registered, and one that could not be passed on.
    fn check_large_frame(&mut self, id: ClientId, frame: IncompleteFrame<'_>) -> bool {
        let Some(client) = self.router.client(id) else { return false };
        let announced = frame.payload_bytes;
        let (name, unregistered) =
            (String::from_utf8_lossy(frame.name).into_owned(), self.config.limits.unregistered_bytes_max);
        let topic = self.router.topics.find(&name).filter(|topic| client.publishes(*topic));
        let source = topic.and_then(|topic| self.router.topics.get(topic)).map(|topic| topic.source);
        let is_service = client.expected.is_some() && self.services.is_registered(id);
        let refusal = match source {
            _ if name.starts_with("__") && announced > unregistered => {
                FrameRefusal::Command { name, announced, limit: unregistered }
            }
            None if !is_service && announced > unregistered => {
                FrameRefusal::Unregistered { name, announced, limit: unregistered }
            }
            Some(Source::Input(_)) if announced > INPUT_BYTES_MAX => {
                FrameRefusal::Input { name, announced, limit: INPUT_BYTES_MAX }
            }
            // A message is held twice while it is passed on.
            _ if !self.router.can_hold(2 * announced) => {
                self.refuse_for_memory(id, frame);
                return false;
            }
            _ => return true,
        };
        self.router.refuse(id, refusal.to_string());
        false
    }

    /// Drops clients whose large frame has stopped, and those that have been silent for long; gives back memory.
    pub(super) fn enforce_limits(&mut self, now: Monotonic) {
        self.record_received(None, now);
        let (stalled, silent_max) =
            (self.config.limits.frame_timeout().as_nanos() as u64, self.config.limits.silence_max());
        let is_stalled =
            |client: &Client| client.input.large_frame.is_some_and(|large| now.since(large.at) >= stalled);
        loop {
            let found = self.router.clients().find(|client| is_stalled(client)).map(|client| client.id);
            let Some(id) = found else { break };
            let seconds = self.config.limits.frame_timeout_s;
            let text = format!("a frame stopped in its middle for {seconds} s (limits.frame_timeout_s)");
            self.drop_client(id, text);
        }
        loop {
            let mut silences = self.router.clients().map(|client| (client.id, self.silence_of(client)));
            let found = silences.find(|(_, silent)| *silent >= silent_max);
            drop(silences);
            let Some((id, silent)) = found else { break };
            self.drop_client(id, silence_reason(silent, "which is the limit (limits.silence_max_s)"));
        }
        self.router.release_unused(now);
    }

    /// Tells a client and the operator that the client's clock was found to be set, by the scans of this robot.
    pub(super) fn report_clock_step(&mut self, id: ClientId, robot: Option<RobotId>, step_s: f64) {
        let text = |whose: &str, stamps: &str| {
            format!(
                "{whose} clock was set by {step_s:+.3} s: several messages agree; its stamps are {stamps}"
            )
        };
        let Some(client) = self.router.client(id) else {
            let whose = robot.map_or("the robots'".into(), |robot| format!("{robot}'s"));
            return self.report(text(&format!("ROS 2: {whose}"), "taken as they are, as before"));
        };
        // A fixed offset is added as before; a measured one is measured anew.
        let stamps = match self.config.clock_offset {
            ClockOffset::Measured => "converted anew",
            ClockOffset::Fixed(_) => "converted by the configured offset, as before",
        };
        let source = format!("the source {}: its", client.peer);
        self.router.send_notice(id, name::WARN, text("your", stamps));
        self.report(text(&source, stamps));
    }

    /// Records an event for the operator's log.
    pub(crate) fn report(&mut self, event: String) {
        if self.admission.events.len() < EVENTS_MAX {
            self.admission.events.push(event);
        }
    }

    /// Takes the events for the operator's log.
    pub fn take_events(&mut self) -> Vec<String> {
        std::mem::take(&mut self.admission.events)
    }

    /// Drops the clients that a person names; returns how many there were.
    pub fn drop_clients(&mut self, which: ClientSelector) -> usize {
        let is_named = |client: &&Client| match which {
            ClientSelector::Number(number) => client.id.serial == number,
            ClientSelector::Connection(peer) => client.peer == peer,
            ClientSelector::Address(address) => client.peer.ip().to_canonical() == address.to_canonical(),
        };
        let named: Vec<ClientId> = self.router.clients().filter(is_named).map(|client| client.id).collect();
        named.iter().for_each(|id| self.drop_client(*id, "the operator has closed this connection".into()));
        named.len()
    }

    /// Disconnects a client and leaves the reason as its last frame, for [`Core::take_unsent`].
    pub fn drop_client(&mut self, id: ClientId, reason: String) {
        self.router.refuse(id, reason);
        let Some(mut unsent) = self.disconnect(id) else { return };
        unsent.keep_last_words();
        if self.admission.leaving.len() == LEAVING_MAX {
            self.admission.leaving.pop_front();
        }
        self.admission.leaving.push_back((id, unsent));
    }

    /// Appends the frames that wait for a client of this process to `out`; those of a dropped client once.
    pub fn take_outgoing(&mut self, id: ClientId, out: &mut Vec<u8>) -> Result<(), ConnectionEnded> {
        let Some(mut unsent) = self.take_unsent(id) else { return self.router.take_outgoing(id, out) };
        let mut write = |slices: &[IoSlice<'_>]| out.write_vectored(slices);
        let mut pool = BufferPool::default();
        while unsent.flush(&mut write, &mut pool).map_err(|_| ConnectionEnded)? != FlushOutcome::Complete {}
        Ok(())
    }

    /// Takes what is left to send to a client that was dropped.
    pub fn take_unsent(&mut self, id: ClientId) -> Option<OutgoingQueue> {
        let place = self.admission.leaving.iter().position(|(of, _)| *of == id)?;
        self.admission.leaving.remove(place).map(|(_, unsent)| unsent)
    }
}

fn silence_reason(silent: Duration, why: &str) -> String {
    format!("the connection is closed: it sent nothing for {:.0} s, {why}", silent.as_secs_f64())
}
