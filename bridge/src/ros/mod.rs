//! ROS 2 messages as CDR.
//!
//! [`message`] has the messages as ROS means them, owned, for those who read them (an operator, a test, the
//! bridge's own inputs). [`write`] goes from the fleet's nouns straight into a buffer, for the hot path out.
//! [`names`] says what frames are called on the wire.

pub mod message;
pub mod names;
pub mod write;

pub use crate::cdr::DecodeError;
pub use message::{
    Bool, Clock, Empty, Float32MultiArray, Int32, LaserScan, Message, OccupancyGrid, Odometry, Text,
    TfMessage, TransformStamped, Twist, TwistStamped, decode, encode,
};
pub use names::{FrameNames, NameStyle};

#[cfg(test)]
mod tests;
