//! Why a message of an external world is refused.

use super::{MountError, OutlierError, RobotTopic, SOURCE_TIMEOUT_S, ScanError, TransformError};
use ros_messages::cdr::DecodeError;
use thiserror::Error;

/// Why a message, or a part of one, is refused.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum WorldError {
    /// The payload is not the topic's message.
    #[error(transparent)]
    Payload(#[from] DecodeError),
    /// The scan's numbers are not accepted.
    #[error(transparent)]
    Scan(#[from] ScanError),
    /// The odometry's pose is not accepted.
    #[error(transparent)]
    Pose(#[from] TransformError),
    /// A transform is not accepted.
    #[error("{parent} -> {child}: {source}")]
    Transform {
        /// The parent frame in the message.
        parent: String,
        /// The child frame in the message.
        child: String,
        /// What is wrong with it.
        source: TransformError,
    },
    /// The robot's transforms put its LiDAR where it cannot map.
    #[error("{robot}: a scan is refused: the transform of its LiDAR `{frame}` {source}")]
    Mount {
        /// The robot whose scan it is.
        robot: msg::RobotId,
        /// The frame of the scan.
        frame: String,
        /// What is wrong with the mount.
        source: MountError,
    },
    /// The message's time agrees with no other message of its source.
    #[error(transparent)]
    Outlier(#[from] OutlierError),
    /// Another source sends this robot's data, or the clock.
    #[error("{what} has another source, which sent less than {SOURCE_TIMEOUT_S} s ago")]
    OtherSource {
        /// A robot, or the clock.
        what: String,
    },
    /// Two publishers on DDS send for one robot at once.
    #[error(
        "{robot}: its {} from two publishers at once and nothing of them is taken: two robots, or two drivers, have \
         one name. Give each robot a namespace of its own, or stop one of them", .topic.subject_and_verb()
    )]
    SeveralPublishers {
        /// The robot that they send for.
        robot: msg::RobotId,
        /// What they send.
        topic: RobotTopic,
    },
    /// The scans repeat one measurement while the robot moves.
    #[error(
        "{robot}: its scans repeat the same ranges while its odometry moves, and are refused until they change: its LiDAR or the \
         LiDAR's driver hangs"
    )]
    FrozenScans {
        /// The robot whose scans they are.
        robot: msg::RobotId,
    },
    /// The transform map -> odom belongs to SLAM (REP-105).
    #[error(
        "{parent} -> {child} is refused: SLAM owns map -> odom (REP-105); the rest of the message is taken"
    )]
    Correction {
        /// The parent frame in the message.
        parent: String,
        /// The child frame in the message.
        child: String,
    },
}
