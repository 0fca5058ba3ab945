//! The interface through which the fleet's messages leave it.

use crate::bridge::Bridge;
use crate::fleet_topics::FleetMessage;

/// A transport of the fleet's messages: ros_tcp over TCP ([`Bridge`]) or DDS ([`crate::dds::DdsEndpoint`]).
pub trait Transport {
    /// Publishes a message on its topics. Returns without waiting.
    fn publish(&self, message: FleetMessage<'_>);
}

impl Transport for Bridge {
    fn publish(&self, message: FleetMessage<'_>) {
        self.publish(message);
    }
}
