//! ROS 2 messages as CDR.
//!
//! [`message`] has the messages as ROS means them, owned, for those who read them (an operator, a test, the
//! bridge's own inputs). [`mod@write`] goes from the fleet's nouns straight into a buffer, for the hot path out;
//! [`read`] the other way, for the hot path in.
//! [`names`] says what frames are called on the wire.

pub mod joystick;
pub mod message;
pub mod names;
pub mod read;
pub mod write;

pub use crate::cdr::{DecodeError, Dialect};
pub use joystick::{HandInputs, Joy};
pub use message::{
    Bool, Clock, Empty, Float32MultiArray, Int32, LaserScan, Message, OccupancyGrid, Odometry,
    PoseWithCovarianceStamped, Text, TfMessage, TransformStamped, Twist, TwistStamped, decode, decode_as,
    encode, encode_as,
};
pub use names::{FrameNames, NameStyle};

#[cfg(test)]
mod tests;
