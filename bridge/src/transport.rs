//! The interface through which the fleet's messages leave it.

use crate::fleet_topics::FleetMessage;

/// A transport of the fleet's messages: ros_tcp over TCP ([`crate::Bridge`]) or DDS ([`crate::dds::DdsEndpoint`]).
pub trait Transport {
    /// Publishes a message on its topics. Returns without waiting.
    fn publish(&self, message: FleetMessage<'_>);
}
