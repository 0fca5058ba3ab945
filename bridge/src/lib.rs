//! msg to ROS bytes and back; the ros_tcp protocol on TCP.
//!
//! ```text
//!   fleet ── scan(), transforms(), map() ... ──▶ Bridge ──▶ one outbox a client ──▶ sockets
//!   robots ◀── on_command(robot, VelocityCommand) ─────── Bridge ◀── frames ◀── serve(): one task a client
//! ```
//! [`Bridge`] is the hub, [`serve`] its TCP side, [`dds`] the door for ROS 2; [`frame`], [`command`] and [`ros`] are the wire, for clients too.

mod access;
mod board;
mod bridge;
pub mod cdr;
mod client;
pub mod command;
mod config;
pub mod dds;
mod drive;
pub mod frame;
mod hub;
mod inbox;
mod initial_pose;
mod inputs;
pub mod interfaces;
mod outbox;
mod outlet;
mod pool;
pub mod ros;
mod server;
mod services;
pub mod slam_services;
mod teleop;
mod topics;
pub mod world;

pub use board::Counters;
pub use bridge::{Bridge, ClientStatus, FIRST_SOURCE};
pub use config::{BridgeConfig, ConfigError, Permission};
pub use outlet::Outlet;
pub use server::serve;
