//! Reasons why a bag cannot be used, and what to do about each.

use crate::ReadError;
use msg::BEAMS_MAX;
use ros_messages::spatial_pose::TILT_MAX_DEG;

/// Reason why a bag cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum BagError {
    /// The file cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// What is needed is not in the parts that can be read.
    #[error("{error}; the file is damaged: {why}")]
    Damaged {
        /// What is missing.
        error: Box<BagError>,
        /// What is left out of it.
        why: String,
    },
    /// What is needed may be in messages that cannot be used.
    #[error("{error}; {count} messages cannot be decoded or are no measurement, the first on {first_fault}")]
    Malformed {
        /// What is missing.
        error: Box<BagError>,
        /// Number of these messages.
        count: u64,
        /// What is wrong with the first of them, with its topic.
        first_fault: String,
    },
    /// What is needed may be in messages for which there was no space.
    #[error(
        "{error}; {count} messages and transforms are more than is kept of a bag; cut it, or leave out topics"
    )]
    OverLimit {
        /// What is missing.
        error: Box<BagError>,
        /// Number of these messages.
        count: u64,
    },
    /// There is no scan.
    #[error(
        "the bag has no sensor_msgs/LaserScan{} in CDR{}; it has {}",
        on_topic(.wished), of_too_many_beams(*.too_many_beams), list(.topics)
    )]
    NoScan {
        /// Topic that was named.
        wished: Option<String>,
        /// Number of scans with too many beams.
        too_many_beams: u64,
        /// Topics of the bag with their types.
        topics: Vec<String>,
    },
    /// Each message is compressed by itself.
    #[error(
        "the bag's messages are compressed one by one (rosbag2's compression_mode MESSAGE), which is not supported: \
         expected none or compressed chunks; convert it with `ros2 bag convert` to storage_id mcap without compression_mode"
    )]
    CompressedMessages,
    /// Several topics have scans.
    #[error("the bag has scans on {}; name one with --scan-topic", list(.0))]
    SeveralScans(Vec<String>),
    /// Two scanners sent scans under one name.
    #[error(
        "the scans on {scan_topic} with the frame `{scan_frame}` are of two scanners in turns ({changes} changes): expected those of \
         one robot; record each robot's scans on a topic of its own"
    )]
    SeveralScanners {
        /// Topic of the scans.
        scan_topic: String,
        /// Frame of these scans.
        scan_frame: String,
        /// How often the scans change from one to the other.
        changes: usize,
    },
    /// Two robots sent odometry under one name.
    #[error(
        "the odometry of `{base_frame}` jumps to another place and back {changes} times: it is of two robots in turns; expected one \
         robot's; name its own topic with --odom-topic or its own frame with --odom-frame, or record each robot with frames of its own"
    )]
    SeveralRobots {
        /// Frame of the base.
        base_frame: String,
        /// How often the poses change from one to the other.
        changes: usize,
    },
    /// There is no odometry.
    #[error(
        "the bag has no odometry for {scan_topic}: expected one nav_msgs/Odometry of the same robot, or a transform from one frame \
         `odom` (--odom-frame) in its namespace; it has odometry on {}, and transforms that change are {}; name one \
         with --odom-topic or --odom-frame, or use --no-odometry",
        list(.topics), list(.transforms)
    )]
    NoOdometry {
        /// Topic of the scans.
        scan_topic: String,
        /// Topics with odometry.
        topics: Vec<String>,
        /// Transforms that change, as `parent -> child`.
        transforms: Vec<String>,
    },
    /// The topic that was named has no true poses.
    #[error("the bag has no nav_msgs/Odometry on {wished}; it has it on {}; name one with --truth-topic", list(.topics))]
    NoTruth {
        /// Topic that was named.
        wished: String,
        /// Topics with odometry.
        topics: Vec<String>,
    },
    /// No transform says where the scanner is.
    #[error(
        "no transform of the robot of {scan_topic} leads from `{scan_frame}` to `{base_frame}`; give the scanner's pose with \
         --scanner X,Y,YAW"
    )]
    NoScanner {
        /// Topic of the scans.
        scan_topic: String,
        /// Frame of the scans.
        scan_frame: String,
        /// Frame of the robot's base.
        base_frame: String,
    },
    /// The scanner does not measure in the plane.
    #[error(
        "the transforms tilt the scanner `{scan_frame}` by {tilt_deg:.0} degrees against `{base_frame}`; expected a horizontal \
         scanner, upright or upside down within {TILT_MAX_DEG} degrees; if the transform is wrong, give the pose with --scanner X,Y,YAW"
    )]
    Tilted {
        /// Frame of the scans.
        scan_frame: String,
        /// Frame of the robot's base.
        base_frame: String,
        /// Angle between the planes, degrees.
        tilt_deg: f64,
    },
    /// The scanner moves on the robot, or two robots have the same frames.
    #[error(
        "the transform from `{parent}` to `{child}` changes, by which the scanner is mounted: expected a fixed scanner, and one robot on \
         one topic; give the scanner's pose with --scanner X,Y,YAW"
    )]
    Moving {
        /// Frame in which the other one moves.
        parent: String,
        /// Frame on the way to the scanner.
        child: String,
    },
    /// Scans and poses have different clocks.
    #[error(
        "the stamps of {scan_topic} go back {scan_steps} times by more than a second, those of {poses} {steps} times: expected one \
         clock of both; cut the bag there, or use --no-odometry"
    )]
    Clocks {
        /// Topic of the scans.
        scan_topic: String,
        /// Number of steps of their clock.
        scan_steps: usize,
        /// What else has stamps.
        poses: String,
        /// Number of steps of its clock.
        steps: usize,
    },
}

impl BagError {
    /// Returns the topics of which one would have to be named, where the bag has scans on several.
    pub fn scan_topics(&self) -> Option<&[String]> {
        match self {
            Self::SeveralScans(topics) => Some(topics),
            Self::Damaged { error, .. } | Self::Malformed { error, .. } | Self::OverLimit { error, .. } => {
                error.scan_topics()
            }
            _ => None,
        }
    }
}

fn on_topic(wished: &Option<String>) -> String {
    wished.as_ref().map_or(String::new(), |topic| format!(" on {topic}"))
}

fn of_too_many_beams(scans: u64) -> String {
    match scans {
        0 => String::new(),
        1 => format!(" (1 scan with more than {BEAMS_MAX} beams, which is the limit)"),
        _ => format!(" ({scans} scans with more than {BEAMS_MAX} beams, which is the limit)"),
    }
}

fn list(names: &[String]) -> String {
    if names.is_empty() { "none".into() } else { names.join(", ") }
}
