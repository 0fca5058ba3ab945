//! Connects the fleet to ROS: converts its messages to ROS messages, and serves the ros_tcp protocol and DDS.
//!
//! ```text
//!   fleet  ── FleetMessage ──▶ Bridge::publish ──▶ one queue for each client ──▶ sockets
//!   robots ◀── on_command ──── Bridge::receive ◀── frames ◀── serve(): one task for each client
//! ```
//! [`Bridge`] is the routing core and [`serve`] its TCP server; [`serve_page`] serves browsers, [`dds`] is the ROS 2
//! endpoint. [`frame`], [`command`]
//! and the crate [`ros_messages`] are the wire format, for clients too.

mod access;
mod actions;
mod battery;
mod bridge;
pub mod command;
mod command_queues;
mod config;
mod connection;
mod core;
pub mod dds;
mod drive;
mod fleet_topics;
pub mod frame;
mod input;
mod newest_stats;
mod page;
mod peer_address;
pub mod relay;
mod repeater;
mod room_offer;
mod router;
mod server;
mod services;
pub mod silence;
pub mod slam_services;
mod teleop;
mod transport;
pub mod world;

pub use access::{AddressListFull, drive_permission};
pub use battery::{BatteryLevel, BatteryStatus};
pub use bridge::{Bridge, ClientStatus};
pub use config::{
    ALLOCATOR_SETTINGS, BatteryConfig, BridgeConfig, ClientLimits, ConfigError, HttpsConfig, LimitsOfRobot,
    PageConfig, Permission, VelocityConfig,
};
pub use core::{ClientSelector, ConnectError, SelectorError};
pub use drive::velocity_gate;
pub use fleet_topics::{
    Delivery, FleetMessage, FleetPublisher, FleetTopic, OUTGOING_TOPICS, OutgoingTopic, RobotTransformPolicy,
    TopicSink,
};
pub use page::{
    PageContent, PageFile, PageListeners, ROOM_BYTES_MAX, SaveRoom, SaveTlx, TlsAcceptor, TlsError,
    TlxAnswer, TlxError, serve_page, tls_acceptor,
};
pub use peer_address::{
    ADDRESSES_MAX, PeerAddressError, PeerTextError, check_peer_address, parse_peer_address,
};
pub use room_offer::RoomOffer;
pub use ros_messages as ros;
pub use ros_messages::{OdometrySigmas, RobotNameError, RobotNames, cdr, interfaces};
pub use router::{ClientId, ConnectionEnded, Counters};
pub use server::{process_clock, serve, serve_clients};
pub use transport::Transport;
