//! Simulation of one robot in a room: velocity commands in; scans, odometry, transforms and ground truth out.
//!
//! ```text
//!   VelocityCommand ─────▶ Limits ─▶ Body (rapier3d) ─┬─▶ GroundTruth
//!   peers' GroundTruth ─▶ Peers ──────▲               ├─▶ WheelOdometry ─▶ Odometry, Transforms
//!   MovingObjects ─────▶ MovingBodies ▲               │
//!   Room ─────────────────────────────┴───────────────┴─▶ Lidar (parry3d) ─▶ Scan
//! ```
//!
//! The robot is a TurtleBot3 Burger with ROBOTIS's published dimensions ([`burger`]). One [`Simulator`]
//! simulates one robot. An [`ObjectSimulator`] simulates what moves in the room of all of them. The other robots of the fleet are mirrored from their [`msg::GroundTruth`].
//! The crate uses no clock, file, thread or socket. The same inputs and seed give the same bytes.

mod body;
pub mod burger;
mod config;
mod lidar;
mod moving;
mod moving_bodies;
mod noise;
mod odometry;
mod peers;
mod room;
mod simulator;

pub use config::{ConfigError, HeadingSource, LidarConfig, Limits, MovingConfig, NoiseConfig, SimConfig};
pub use moving::ObjectSimulator;
pub use room::{
    AccessorError, AnchorError, EntityError, Furniture, GltfError, MapError, MeshError, MrukError, ObjError,
    PolygonError, Room, RoomError, RoomKind, SceneError, StartError,
};
pub use simulator::{Simulator, StepOutput, transforms_of};
