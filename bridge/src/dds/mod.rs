//! The ROS 2 door: the fleet's topics on DDS, under the names ROS tools expect.
//!
//! ```text
//!   fleet ── scan(), transforms(), map() ... ──▶ Door ──▶ RustDDS ──▶ RViz, Nav2, rosbag ...
//!   Bridge ◀── Heard ◀── Door::serve() ◀── /cmd_vel_1, /robot2/cmd_vel ... ◀── RustDDS
//! ```
//! It lives on a thread of its own, so that nothing here delays the headset's door. Messages are encoded by
//! [`crate::ros`], as for TCP, and handed to RustDDS as they are.
//!
//! `ros2-client` gives the names, types and the node graph; readers and writers are RustDDS's own, because
//! ros2-client's encode every message anew, cannot limit what a writer keeps, and its node listens to `/clock`
//! with a type that is not ROS's.

mod config;
mod door;
mod graph;
mod heard;
mod outlet;
mod raw;
mod sender;
mod servers;

pub use config::DdsConfig;
pub use door::{Door, DoorCounters, DoorError};
pub use heard::Heard;
pub use raw::{Adapter, Raw};
