//! Clients beside the operator in a fleet with faults: one that contends for a robot, and one without permission.

use super::client::Client;
use super::operator::velocity_topic;
use super::queues::Network;
use super::tcp::Port;
use crate::ports::Clock;
use bridge::ros;
use msg::{Monotonic, RobotId};
use std::rc::Rc;
use std::time::Duration;

/// Velocity of the client that contends for a robot, m/s and rad/s: by it, its commands are told from the operator's.
pub const CONTENDER_VELOCITY: [f64; 2] = [0.017, 0.333];
/// Velocity of the client without permission.
pub const INTRUDER_VELOCITY: [f64; 2] = [0.013, -0.444];
/// Address of the client that contends, and of the one without permission (an address for documentation, RFC 5737).
const CONTENDER_PEER: ([u8; 4], u16) = ([127, 0, 0, 1], 50_002);
const INTRUDER_PEER: ([u8; 4], u16) = ([192, 0, 2, 7], 50_003);
/// Period of their velocities, as a headset's stick is read.
const PERIOD: Duration = Duration::from_millis(50);

/// A client that publishes one velocity again and again.
pub struct Driver {
    client: Client,
    network: Rc<Network>,
    topics: Vec<String>,
    velocity: [f64; 2],
    /// It is connected and drives until then.
    pub until: Monotonic,
    /// Moment at which it acts next.
    pub due: Monotonic,
}

impl Driver {
    /// Creates the client that contends with the operator for a robot; it does not act before it is told to.
    pub fn contender(network: &Rc<Network>, port: &Rc<Port>) -> Self {
        Self::new(network, Client::new(port, CONTENDER_PEER.into()), CONTENDER_VELOCITY, Monotonic(u64::MAX))
    }

    /// Creates the client that drives all robots without permission, from the beginning to the end.
    pub fn intruder(network: &Rc<Network>, port: &Rc<Port>, robots: impl Iterator<Item = RobotId>) -> Self {
        let client = Client::new(port, INTRUDER_PEER.into());
        let mut intruder = Self::new(network, client, INTRUDER_VELOCITY, Monotonic(0));
        intruder.until = Monotonic(u64::MAX);
        intruder.topics = robots.map(velocity_topic).chain(["/cmd_vel".to_owned()]).collect();
        for topic in &intruder.topics {
            intruder.client.advertise::<ros::Twist>(topic);
        }
        intruder
    }

    fn new(network: &Rc<Network>, client: Client, velocity: [f64; 2], due: Monotonic) -> Self {
        let network = network.clone();
        Self { client, network, topics: Vec::new(), velocity, until: Monotonic(0), due }
    }

    /// Makes it drive a robot for a while.
    pub fn drive(&mut self, robot: RobotId, now: Monotonic, duration: Duration) {
        let topic = velocity_topic(robot);
        self.client.advertise::<ros::Twist>(&topic);
        (self.topics, self.until, self.due) = (vec![topic], now + duration, now);
    }

    /// Publishes its velocity, or leaves when its time is over.
    pub fn step(&mut self) {
        let now = self.network.clock().now();
        self.client.receive(|_, _| {});
        if now >= self.until {
            self.client.disconnect();
            self.network.record_event("contender_left");
            self.due = Monotonic(u64::MAX);
            return;
        }
        if !self.client.is_connected() {
            self.client.connect();
        }
        let [linear, angular] = self.velocity;
        let twist = ros::Twist { linear: [linear, 0.0, 0.0], angular: [0.0, 0.0, angular] };
        self.topics.iter().for_each(|topic| self.client.publish(topic, &twist));
        self.due = (self.due + PERIOD).max(now);
    }
}
