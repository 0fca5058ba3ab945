//! A headset of which the network and the robots are simulated, as in the MR-SLAM paper: its application simulates the robots,
//! and speaks ros_tcp to the bridge over a wireless link.
//!
//! [`HeadsetRobots`] and [`wireless::LinkModel`] are pure: times and frames in, frames and arrivals out. [`live`] and
//! [`wireless::proxy`] have the sockets.

pub mod live;
mod robots;
pub mod wireless;

pub use robots::{CLOCK_AHEAD, HeadsetRobots};
