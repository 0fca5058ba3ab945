//! The interface through which the fleet's messages leave it.

use crate::bridge::Bridge;
use crate::fleet_topics::{FleetMessage, FleetTopic};
use msg::RobotId;

/// A transport of the fleet's messages: ros_tcp over TCP ([`crate::Bridge`]) or DDS ([`crate::dds::DdsEndpoint`]).
pub trait Transport {
    /// Publishes a message on its topics. Returns without waiting.
    fn publish(&self, message: FleetMessage<'_>);
    /// Returns whether somebody receives a robot's topic now.
    fn has_subscriber(&self, topic: FleetTopic, robot: RobotId) -> bool;
}

impl Transport for Bridge {
    fn publish(&self, message: FleetMessage<'_>) {
        self.publish(message);
    }

    fn has_subscriber(&self, topic: FleetTopic, robot: RobotId) -> bool {
        self.is_subscribed(topic, robot)
    }
}
