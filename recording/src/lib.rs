//! Recordings of a fleet: ROS 2 messages in MCAP files, as rosbag2 writes them, and their reading.
//!
//! [`RecordingWriter`] makes the bytes of a file; the caller writes them. [`RecordingReader`] reads such files and
//! those of rosbag2, up to the place where a broken one ends. [`bag`] finds the scans and the odometry of a robot in them.

pub mod bag;
pub mod fleet;
mod planar;
pub mod playback;
mod reader;
mod writer;

pub use reader::{ReadError, RecordedMessage, RecordingReader};
pub use writer::{Durability, RecordingWriter, TopicCount, TopicIndex, WriteError};

/// Name of the metadata record that says what a recording is of.
pub const METADATA: &str = "mr_slam";
/// Name of the metadata record with the number of messages of each topic, at the end of a file.
pub const COUNTS: &str = "mr_slam_counts";
