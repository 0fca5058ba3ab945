//! Messages between a robot's machine and the base, and how they survive a link that fails.
//!
//! Nothing here knows a socket, a clock or a file: bytes and times come in as data. [`table`] says what leaves a machine
//! and how urgent it is; [`wire`] is the format. [`RobotEnd`] and [`BaseEnd`] are the two ends of a robot's link: messages and
//! times in, messages and events out. [`PartSender`] and [`PartReceiver`] carry a robot's map over a link that comes and goes;
//! [`Leadership`] decides which of two peers counts, and [`StopFollower`] what a robot owes to the base's emergency stop.
//!
//! A robot's map is a set of parts: tiles, submaps, the submaps' poses. A part is known by the hash of its content. The
//! base says which parts it holds, the robot sends the others, the smallest first, and the base acknowledges each. So
//! an outage costs what has changed meanwhile, and a new base gets the whole map in the same way.

mod base;
mod battery;
pub mod content;
mod counters;
mod error;
pub mod leadership;
mod map_frame;
pub mod part;
mod peer;
mod reader;
mod receipts;
mod receiver;
mod robot;
pub mod scan;
mod scan_throttle;
mod sender;
mod series;
mod size;
mod stop;
pub mod table;
mod unknown_robots;
mod velocity_admission;
pub mod wire;

pub use base::{BaseEnd, BaseEvent, Hold};
pub use counters::ByteCounters;
pub use leadership::{Leadership, PeerDecision};
pub use map_frame::run_and_frame;
pub use part::{PartContent, PartError, PartKey};
pub use peer::STATE_PERIOD;
pub use receiver::{PartChange, PartReceiver};
pub use robot::{LocalControl, RobotEnd, RobotEvent};
pub use scan::{DecimatedScan, ScanRate};
pub use sender::{PartSender, SenderConfig};
pub use stop::{StopFollower, StopRequest};
pub use table::{Direction, Kind, Priority};
pub use unknown_robots::{UNKNOWN_NAMES_MAX, UnknownRobots, unknown_robot_text};
pub use wire::{Envelope, Message, WireError};

#[cfg(test)]
mod testing;
