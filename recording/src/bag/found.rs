//! What a bag has: scans, odometry and transforms by topic, within limits.

use super::epochs::Timed;
use super::{BagScan, frame};
use crate::RecordedMessage;
use msg::{BEAMS_MAX, Pose2, Scan};
use ros_messages::cdr::{DecodeError, Reader};
use ros_messages::read::Transform;
use ros_messages::spatial_pose::{self, SpatialPose};
use ros_messages::{LaserScan, Message, Odometry, TfMessage, read};
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// Most scans of a bag: ten days at 40 Hz.
const SCANS_MAX: usize = 36_000_000;
/// Most bytes of ranges that are kept.
const RANGES_BYTES_MAX: usize = 8 << 30;
/// Most different transforms of a topic, frames of scans, and frames between sensor and base.
pub const FRAMES_MAX: usize = 4096;
/// Most topics with transforms.
const TF_TOPICS_MAX: usize = 256;
/// Most poses of odometry and transforms.
const POSES_MAX: usize = 50_000_000;
/// Fewest beams of a scan.
const BEAMS_MIN: usize = 2;
/// First bytes of a message that is compressed by itself; CDR begins with a zero.
const ZSTD_MAGIC: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];
/// Change of a mount that is an adjustment of the same one, metres and radians.
const MOUNT_CHANGE_M: f64 = 0.05;
const MOUNT_CHANGE_RAD: f64 = 0.05;

/// Odometry of one topic.
#[derive(Default)]
pub struct Poses {
    /// Frame of the robot's base.
    pub base_frame: String,
    pub poses: Vec<Timed<Pose2>>,
}

/// Transform between two frames.
pub struct Edge {
    /// The first one.
    pub first: SpatialPose,
    /// Whether a later one differs.
    pub changes: bool,
    /// All of them, in the plane.
    pub poses: Vec<Timed<Pose2>>,
}

/// Transforms of one topic, by parent and child.
pub type Edges = HashMap<(String, String), Edge>;

/// A scan before its odometry is known, with the number of its frame.
pub type RawScan = Timed<(usize, BagScan)>;

/// What is found in a bag, by topic.
#[derive(Default)]
pub struct Found {
    pub scans: BTreeMap<String, Vec<RawScan>>,
    /// Frames of the scans, each once.
    pub scan_frames: Vec<String>,
    pub odometry: BTreeMap<String, Poses>,
    pub transforms: BTreeMap<String, Edges>,
    pub topics: BTreeSet<String>,
    pub malformed: u64,
    pub too_many_beams: u64,
    pub compressed: u64,
    scan_count: usize,
    ranges_bytes: usize,
    pose_count: usize,
}

impl Found {
    /// Adds a message, or counts it as malformed.
    pub fn add(&mut self, message: &RecordedMessage, scan: &mut Scan) {
        if self.topics.len() < FRAMES_MAX {
            self.topics.insert(format!("{} ({})", message.topic, message.message_type));
        }
        if &*message.encoding != "cdr" {
            return;
        }
        if message.payload.starts_with(&ZSTD_MAGIC) {
            self.compressed += 1;
        } else if self.decode(message, scan).is_none() {
            self.malformed += 1;
        }
    }

    fn decode(&mut self, message: &RecordedMessage, scan: &mut Scan) -> Option<()> {
        match &*message.message_type {
            LaserScan::TYPE => self.add_scan(message, scan),
            Odometry::TYPE if self.pose_count < POSES_MAX => {
                let mut from = Reader::new(&message.payload).ok()?;
                let odometry = read::odometry(&mut from).ok()?;
                let value = spatial_pose::planar_pose(odometry.translation, odometry.rotation)?;
                let poses = self.odometry.entry(message.topic.to_string()).or_default();
                if poses.base_frame != odometry.child_frame_id {
                    poses.base_frame = odometry.child_frame_id.to_owned();
                }
                poses.poses.push(Timed { at: message.at, stamp: odometry.stamp, value });
                self.pose_count += 1;
                Some(())
            }
            TfMessage::TYPE => {
                let mut from = Reader::new(&message.payload).ok()?;
                let mut is_well_formed = true;
                let result = read::transforms(&mut from, |transform| {
                    is_well_formed &= self.add_transform(message, &transform).is_some();
                });
                result.ok().filter(|()| is_well_formed)
            }
            _ => Some(()),
        }
    }

    fn add_scan(&mut self, message: &RecordedMessage, scan: &mut Scan) -> Option<()> {
        let mut from = Reader::new(&message.payload).ok()?;
        let scan_frame = match read::laser_scan(&mut from, scan) {
            Ok(name) => frame(name),
            Err(DecodeError::TooManyBeams { .. }) => {
                self.too_many_beams += 1;
                return Some(());
            }
            Err(_) => return None,
        };
        let bytes = size_of_val(scan.ranges_m());
        if self.scan_count >= SCANS_MAX || self.ranges_bytes + bytes > RANGES_BYTES_MAX {
            return Some(());
        }
        let value = checked(scan)?;
        let known = self.scan_frames.iter().position(|known| *known == scan_frame);
        let frame_number = match known {
            Some(number) => number,
            None if self.scan_frames.len() < FRAMES_MAX => {
                self.scan_frames.push(scan_frame);
                self.scan_frames.len() - 1
            }
            None => return None,
        };
        (self.scan_count, self.ranges_bytes) = (self.scan_count + 1, self.ranges_bytes + bytes);
        let raw = Timed { at: message.at, stamp: value.stamp, value: (frame_number, value) };
        self.scans.entry(message.topic.to_string()).or_default().push(raw);
        Some(())
    }

    fn add_transform(&mut self, message: &RecordedMessage, transform: &Transform<'_>) -> Option<()> {
        let pose = SpatialPose::checked(transform.translation, transform.rotation)?;
        let is_known = self.transforms.contains_key(&*message.topic);
        if self.pose_count >= POSES_MAX || (!is_known && self.transforms.len() >= TF_TOPICS_MAX) {
            return Some(());
        }
        let edges = self.transforms.entry(message.topic.to_string()).or_default();
        let key = (frame(transform.frame_id), frame(transform.child_frame_id));
        if !edges.contains_key(&key) && edges.len() >= FRAMES_MAX {
            return Some(());
        }
        self.pose_count += 1;
        let edge =
            edges.entry(key).or_insert_with(|| Edge { first: pose, changes: false, poses: Vec::new() });
        let value = pose.planar();
        let change = edge.first.planar().between(value);
        edge.changes |= change.x_m.hypot(change.y_m) > MOUNT_CHANGE_M
            || change.yaw_rad.sin().atan2(change.yaw_rad.cos()).abs() > MOUNT_CHANGE_RAD;
        edge.poses.push(Timed { at: message.at, stamp: transform.stamp, value });
        Some(())
    }
}

/// Returns a scan whose numbers are a measurement's.
fn checked(scan: &Scan) -> Option<BagScan> {
    let (first, step) = (f64::from(scan.angle_min_rad), f64::from(scan.angle_increment_rad));
    let beams = scan.ranges_m().len();
    let spans_a_turn_at_most = first.is_finite()
        && step != 0.0
        && (step * (beams as f64 - 1.0)).abs() <= std::f64::consts::TAU + step.abs();
    let has_range = scan.range_min_m >= 0.0 && scan.range_max_m > scan.range_min_m;
    let has_times = scan.time_increment_s.is_finite() && scan.scan_time_s.is_finite();
    let is_scan = (BEAMS_MIN..=BEAMS_MAX).contains(&beams) && spans_a_turn_at_most && has_range && has_times;
    is_scan.then(|| BagScan {
        stamp: scan.header.stamp,
        odom_from_base: Pose2::IDENTITY,
        world_from_base: None,
        angle_min_rad: first,
        angle_increment_rad: step,
        time_increment_s: scan.time_increment_s,
        scan_time_s: scan.scan_time_s,
        range_min_m: scan.range_min_m,
        range_max_m: scan.range_max_m,
        ranges_m: scan.ranges_m().to_vec(),
    })
}
