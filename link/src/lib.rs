//! Messages between a robot's machine and the base, and how they survive a link that fails.
//!
//! Nothing here knows a socket, a clock or a file: bytes and times come in as data. [`table`] says what leaves a machine
//! and how urgent it is; [`wire`] is the format; [`PartSender`] and [`PartReceiver`] carry a robot's map over a link that
//! comes and goes; [`Leadership`] decides which of two peers counts.
//!
//! A robot's map is a set of parts: tiles, submaps, the submaps' poses. A part is known by the hash of its content. The
//! base says which parts it holds, the robot sends the others, the smallest first, and the base acknowledges each. So
//! an outage costs what has changed meanwhile, and a new base gets the whole map in the same way.

pub mod content;
mod counters;
mod error;
pub mod leadership;
pub mod part;
mod reader;
mod receiver;
mod sender;
pub mod table;
pub mod wire;

pub use counters::ByteCounters;
pub use leadership::{Leadership, Verdict};
pub use part::{PartContent, PartError, PartKey};
pub use receiver::{PartChange, PartReceiver};
pub use sender::{PartSender, SenderConfig};
pub use table::{Direction, Kind, Priority};
pub use wire::{Envelope, Message, WireError};
