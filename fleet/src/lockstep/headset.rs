//! The headset of a fleet in lockstep in which the robots live: its application as a ros_tcp client of the bridge.

use super::client::Client;
use super::queues::Network;
use super::tcp::Port;
use crate::clock::Epoch;
use crate::ports::Clock;
use crate::process::Error;
use crate::run::Run;
use crate::world;
use headset::{CLOCK_AHEAD, HeadsetRobots};
use msg::Monotonic;
use sim::Simulator;
use std::net::SocketAddr;
use std::rc::Rc;
use std::time::Duration;

/// Time between two attempts to connect, as the connector waits.
const RETRY_PERIOD: Duration = Duration::from_secs(1);
/// Time for which a connection that takes no bytes is kept, as the application's sockets have it.
const BLOCKED_MAX: Duration = Duration::from_secs(10);
/// Address of the headset's client: the operator's, at another port.
const PEER: ([u8; 4], u16) = ([127, 0, 0, 1], 50_004);

/// The application, which ticks its robots in virtual time.
pub struct Headset {
    robots: HeadsetRobots,
    client: Client,
    network: Rc<Network>,
    retry_at: Monotonic,
    epoch: Epoch,
    /// Since when the link has taken no bytes.
    blocked_since: Option<Monotonic>,
    frames: Vec<u8>,
    /// Moment at which it acts next.
    pub due: Monotonic,
}

impl Headset {
    /// Creates the application, which connects at once.
    ///
    /// # Errors
    /// The room, or a robot's start in it, cannot be used.
    pub fn new(network: &Rc<Network>, port: &Rc<Port>, run: &Run) -> Result<Self, Error> {
        let mut robots = world::headset_robots(&run.config)?;
        robots.set_time(run.epoch.stamp(network.clock().now()) + CLOCK_AHEAD);
        Ok(Self {
            robots,
            client: Client::new(port, SocketAddr::from(PEER)),
            network: network.clone(),
            retry_at: Monotonic(0),
            epoch: run.epoch,
            blocked_since: None,
            frames: Vec::new(),
            due: Monotonic(0),
        })
    }

    /// Applies the velocities that have arrived, simulates one tick and sends its messages.
    pub fn step(&mut self) {
        let now = self.network.clock().now();
        self.due = self.due + Simulator::TICK;
        if !self.client.is_connected() && self.retry_at <= now {
            self.client.connect();
            self.retry_at = now + RETRY_PERIOD;
            // After a pause its time goes on as if it had not been held up.
            self.robots.set_time(self.epoch.stamp(now) + CLOCK_AHEAD);
            self.robots.register(&mut self.frames);
        }
        let robots = &mut self.robots;
        self.client.receive(|topic, payload| robots.receive(topic, payload));
        // A link that is too slow holds the application up, as a full socket does, until it gives the connection up.
        if self.client.is_blocked() {
            let since = *self.blocked_since.get_or_insert(now);
            if now.since(since) >= BLOCKED_MAX.as_nanos() as u64 {
                self.client.disconnect();
                self.blocked_since = None;
            }
            return;
        }
        if self.blocked_since.take().is_some() {
            self.robots.set_time(self.epoch.stamp(now) + CLOCK_AHEAD);
        }
        // While there is no connection the robots go on: what they send is lost.
        self.robots.tick(&mut self.frames);
        self.client.send_frames(&self.frames);
        self.frames.clear();
    }
}
