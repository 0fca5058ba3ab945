//! Recordings of a fleet: ROS 2 messages in MCAP files, as rosbag2 writes them, and their reading.
//!
//! [`RecordingWriter`] makes the bytes of a file; the caller writes them. [`RecordingReader`] reads such files and
//! those of rosbag2, without what is damaged. [`bag`] finds the scans and the odometry of a robot in them.
//!
//! ```
//! use msg::Stamp;
//! use recording::{Durability, RecordingReader, RecordingWriter};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let mut writer = RecordingWriter::new(&Default::default())?;
//! let topic = writer.add_topic("/chatter", "std_msgs/String", Durability::Volatile)?;
//! // CDR: encapsulation, length, text with its end.
//! let payload = [0, 1, 0, 0, 3, 0, 0, 0, b'h', b'i', 0];
//! writer.write(topic, Stamp::from_seconds(1.5), &payload)?;
//! let file = writer.finish()?;
//!
//! let mut reader = RecordingReader::new(&file[..]);
//! let message = reader.next_message()?.expect("one message");
//! assert_eq!((&*message.topic, &*message.message_type), ("/chatter", "std_msgs/String"));
//! assert_eq!((message.at, &message.payload[..]), (Stamp::from_seconds(1.5), &payload[..]));
//! assert!(reader.next_message()?.is_none() && reader.damage().is_none());
//! # Ok(())
//! # }
//! ```

pub mod bag;
mod counts;
pub mod fleet;
pub mod playback;
mod pose_at;
mod reader;
pub mod rosbag2;
mod scan_gaps;
mod writer;

pub use counts::{Durability, PartCounts, TopicCount, TopicIndex};
pub use reader::{ReadError, RecordedMessage, RecordingReader};
pub use scan_gaps::ScanGaps;
pub use writer::{Part, RecordingWriter, WriteError};

/// Name of the metadata record that says what a recording is of.
pub const METADATA: &str = "mr_slam";
/// Name of the metadata record with the number of messages of each topic, at the end of a file.
pub const COUNTS: &str = "mr_slam_counts";
