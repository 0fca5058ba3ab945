//! The ROS 2 endpoint, with the fleet's topics and all services on DDS under the names that ROS tools expect.
//!
//! ```text
//!   fleet ── FleetMessage ──▶ DdsEndpoint::publish ──▶ RustDDS ──▶ RViz, Nav2, rosbag ...
//!   Bridge::receive_ros ◀── RosEvent ◀── DdsQueues ◀── DdsEndpoint::serve ◀── RustDDS ◀── /cmd_vel_1, /plan ...
//!   Bridge::on_ros_command ── RosCommand ──▶ DdsQueues ──▶ DdsEndpoint::serve ──▶ RustDDS ──▶ /goal_pose ...
//! ```
//! It runs on a thread of its own, so that DDS never delays a headset on TCP. Messages are encoded by [`crate::ros`],
//! as for TCP, and handed to RustDDS as bytes.
//!
//! `ros2-client` provides the names, the types and the node graph. Readers and writers are RustDDS's own, because
//! ros2-client's encode every message anew, cannot limit what a writer keeps, and its node subscribes to `/clock`
//! with a type that is not ROS's.

mod endpoint;
mod entities;
mod graph;
mod inputs;
mod newest;
mod queues;
mod raw;
mod relay;
mod remote;
mod service_endpoint;
mod service_identity;
mod services;
mod topic_writer;
mod writers;

pub use crate::config::{
    DdsConfig, Discovery, DiscoveryError, DiscoveryVariables, OrEnvironment, VelocityMessage,
};
pub use crate::relay::ReceivedMessage;
pub use endpoint::{DdsCounters, DdsEndpoint};
pub use entities::EndpointError;
pub use queues::DdsQueues;
pub use raw::{CdrPassthrough, SerializedMessage};
