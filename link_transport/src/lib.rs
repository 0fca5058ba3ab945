//! How the messages of the crate `link` travel between machines: endpoints, keys, and sessions of Zenoh.
//!
//! Sessions need the feature `zenoh`, which takes long to compile. Endpoints and keys do not.

mod connection_log;
mod endpoint;
pub mod keys;
#[cfg(feature = "zenoh")]
mod session;

pub use connection_log::ConnectionLog;
pub use endpoint::{Endpoint, EndpointError, Protocol};
#[cfg(feature = "zenoh")]
pub use session::{Router, SessionConfig, SessionError, SessionRole, ZenohTransport};

use link::Kind;

/// Carries messages between machines. It may lose them, and drops rather than waits.
pub trait Transport {
    /// Sends a message of or to the robot of this index.
    fn send(&mut self, robot: usize, kind: Kind, bytes: &[u8]);
    /// Returns the oldest message that was received, and its robot's index.
    fn receive(&mut self) -> Option<(usize, Vec<u8>)>;
    /// Takes a name under which a machine has sent that is none of the robots'; at a base without keys alone.
    fn receive_unknown_name(&mut self) -> Option<String> {
        None
    }
}
