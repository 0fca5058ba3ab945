//! The clients of the bridge: their state, what they may hold, and how they are dropped.

use super::Bridge;
use crate::core::{ClientSelector, ConnectError};
use crate::frame::IncompleteFrame;
use crate::router::{Client, ClientId, OutgoingQueue};
use crate::world::ClockEstimate;
use msg::{Monotonic, RobotId};
use serde::{Deserialize, Serialize};
use std::net::SocketAddr;

/// The state of one connection, for the operator's table and for JSON.
// More than 12 fields: one for each column of the operator's table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClientStatus {
    /// Number of the connection, counted from 1 since the bridge's start.
    pub number: u64,
    /// Address and port of the client.
    pub address: SocketAddr,
    /// Seconds since the client connected.
    pub connected_s: f64,
    /// Seconds since the client last sent a whole frame: Unity's connector sends at least once a second.
    pub silent_s: f64,
    /// Number of topics that are sent to the client.
    pub subscriptions: usize,
    /// Number of topics that the client may publish.
    pub publications: usize,
    /// Bytes that wait for the client.
    pub waiting_bytes: usize,
    /// Bytes per second that the connection takes, measured while frames wait for it; `None` if none ever did.
    pub link_bytes_per_s: Option<f64>,
    /// Bytes of maps and images that are held back, because they would delay transforms on this slow connection.
    pub held_back_bytes: usize,
    /// Topics whose newest map was sent with larger cells, for the same reason.
    pub reduced_maps: usize,
    /// The longest time that transforms and other live messages waited lately, in the bridge and in the kernel, seconds.
    pub live_delay_s: f64,
    /// Messages dropped or replaced because the client was slow.
    pub dropped: u64,
    /// Numbers of the robots whose lease the client holds now.
    pub drives: Vec<usize>,
    /// The client's clock, if it is the source of an external world.
    pub clock: Option<ClockEstimate>,
}

impl Bridge {
    /// Connects a part of this process as [`Self::connect`] does. It is never dropped for its silence, and keeps its services
    /// without sending anything.
    pub fn connect_permanent(&self, peer: SocketAddr) -> Result<ClientId, ConnectError> {
        self.update(|core| {
            let id = core.connect(peer, None)?;
            core.mark_permanent(id);
            Ok(id)
        })
    }

    /// Records an event for the operator's log.
    pub(crate) fn report_event(&self, event: String) {
        self.core.borrow_mut().report(event);
    }

    /// Takes what has happened for the operator's log.
    pub fn take_events(&self) -> Vec<String> {
        self.core.borrow_mut().take_events()
    }

    /// Disconnects the clients that a person names; returns how many there were.
    pub fn drop_clients(&self, which: ClientSelector) -> usize {
        self.update(|core| core.drop_clients(which))
    }

    /// Returns the bytes that are held for all clients together, at most `limits.held_bytes_max`.
    pub fn held_bytes(&self) -> usize {
        self.core.borrow_mut().router.held_bytes()
    }

    /// Returns the state of every connection.
    pub fn clients(&self, now: Monotonic) -> Vec<ClientStatus> {
        let core = self.core.borrow();
        let status = |client: &Client| ClientStatus {
            number: client.id.serial,
            address: client.peer,
            connected_s: now.since(client.input.connected_at) as f64 * 1e-9,
            silent_s: now.since(client.input.last_at) as f64 * 1e-9,
            subscriptions: client.subscriptions.len(),
            publications: client.publications.len(),
            waiting_bytes: client.outgoing.bytes(),
            link_bytes_per_s: client.link.bytes_per_s(),
            held_back_bytes: client.outgoing.held_back_bytes(),
            reduced_maps: client.outgoing.reduced_maps(),
            live_delay_s: client.live_delay.longest().as_secs_f64(),
            dropped: client.outgoing.dropped(),
            drives: core
                .fleet
                .robots()
                .filter(|robot| {
                    let holder = core.gate.drive().leaseholder(*robot, now);
                    holder.is_some_and(|holder| holder.client == Some(client.id))
                })
                .map(RobotId::number)
                .collect(),
            clock: core.world.as_ref().and_then(|world| world.clock_estimate(client.id.serial)),
        };
        core.router.clients().map(status).collect()
    }

    /// Returns all topics, sorted by name: name and type.
    pub(crate) fn topics(&self) -> Vec<(String, String)> {
        let core = self.core.borrow();
        core.router.topics.sorted().map(|topic| (topic.name.clone(), topic.message_type.clone())).collect()
    }

    /// Returns the services that clients can call, sorted by name: name and type.
    pub(crate) fn services(&self) -> Vec<(String, String)> {
        let core = self.core.borrow();
        let services = core.callable_services();
        services.into_iter().map(|(name, service_type)| (name.to_owned(), service_type.to_owned())).collect()
    }

    /// Decides whether the rest of a large frame is received; if not, the client is told why and the frame skipped.
    pub(crate) fn admit_large_frame(
        &self,
        id: ClientId,
        frame: IncompleteFrame<'_>,
        buffer_bytes: usize,
        now: Monotonic,
    ) -> bool {
        self.update(|core| core.admit_large_frame(id, frame, buffer_bytes, now))
    }

    /// Records that a client's large frame is complete, and its buffer given back.
    pub(crate) fn end_large_frame(&self, id: ClientId) {
        self.core.borrow_mut().end_large_frame(id);
    }

    /// Disconnects a client; the reason is the last of its frames, see [`Bridge::take_unsent`].
    pub(crate) fn drop_client(&self, id: ClientId, reason: String) {
        self.update(|core| core.drop_client(id, reason));
    }

    /// Takes what is left to send to a client that was dropped.
    pub(crate) fn take_unsent(&self, id: ClientId) -> Option<OutgoingQueue> {
        self.core.borrow_mut().take_unsent(id)
    }
}
