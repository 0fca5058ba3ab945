//! What a bag has: scans, odometry and transforms by topic, within limits.

use super::epochs::Timed;
use super::frames::is_odometry;
use super::{BagScan, frame};
use crate::RecordedMessage;
use msg::{BEAMS_MIN, Pose2, Scan};
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
/// First bytes of a message that is compressed by itself; CDR begins with a zero.
const ZSTD_MAGIC: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];
/// Change of a mount in space that is an adjustment of the same one, metres and radians.
const MOUNT_CHANGE_M: f64 = 0.05;
const MOUNT_CHANGE_RAD: f64 = 0.05;

/// Why a message cannot be used.
#[derive(Debug, thiserror::Error)]
enum MessageFault {
    #[error(transparent)]
    Decode(#[from] DecodeError),
    #[error("{field} is {found}; expected {expected}")]
    Number { field: &'static str, found: f64, expected: &'static str },
    #[error("a scan of {0} beams; expected 2 or more")]
    FewBeams(usize),
    #[error(
        "{of} has the position {position:?} and the rotation {rotation:?}; expected metres, and a quaternion x, y, z, w of length 1"
    )]
    Pose { of: String, position: [f64; 3], rotation: [f64; 4] },
    #[error("more than {FRAMES_MAX} frames of scans")]
    Frames,
}

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
    /// All of them, in the plane, where the transform may be odometry.
    pub poses: Vec<Timed<Pose2>>,
}

/// Transforms of one topic, by parent and child.
pub type Edges = HashMap<(String, String), Edge>;

/// A scan before its odometry is known, with the number of its frame.
pub type RawScan = Timed<(usize, BagScan)>;

/// Space that is left for what is kept of a bag.
struct Space {
    scans: usize,
    ranges_bytes: usize,
    poses: usize,
}

impl Default for Space {
    fn default() -> Self {
        Self { scans: SCANS_MAX, ranges_bytes: RANGES_BYTES_MAX, poses: POSES_MAX }
    }
}

impl Space {
    /// Takes the space of a scan with so many bytes of ranges; returns whether there is as much.
    fn take_scan(&mut self, bytes: usize) -> bool {
        let fits = self.scans > 0 && self.ranges_bytes >= bytes;
        if fits {
            (self.scans, self.ranges_bytes) = (self.scans - 1, self.ranges_bytes - bytes);
        }
        fits
    }

    /// Takes the space of a pose; returns whether there is one.
    fn take_pose(&mut self) -> bool {
        let fits = self.poses > 0;
        self.poses -= usize::from(fits);
        fits
    }
}

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
    /// What is wrong with the first malformed message.
    pub first_fault: Option<String>,
    pub too_many_beams: u64,
    pub compressed: u64,
    /// Messages and transforms for which there was no space.
    pub over_limit: u64,
    /// Frame of the odometry in transforms, if it is named.
    odom_frame: Option<String>,
    space: Space,
}

impl Found {
    /// Begins without messages. Of transforms all poses are kept from this frame, else from frames named `odom`.
    pub fn new(odom_frame: Option<String>) -> Self {
        Self { odom_frame, ..Self::default() }
    }

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
        } else if let Err(fault) = self.decode(message, scan) {
            self.malformed += 1;
            self.first_fault.get_or_insert_with(|| format!("{}: {fault}", message.topic));
        }
    }

    fn decode(&mut self, message: &RecordedMessage, scan: &mut Scan) -> Result<(), MessageFault> {
        match &*message.message_type {
            LaserScan::TYPE => self.add_scan(message, scan),
            Odometry::TYPE => {
                let mut from = Reader::new(&message.payload)?;
                let odometry = read::odometry(&mut from)?;
                let (position, rotation) = (odometry.translation, odometry.rotation);
                let value = spatial_pose::planar_pose(position, rotation)
                    .ok_or_else(|| MessageFault::Pose { of: "the pose".into(), position, rotation })?;
                if !self.space.take_pose() {
                    self.over_limit += 1;
                    return Ok(());
                }
                let poses = self.odometry.entry(message.topic.to_string()).or_default();
                if poses.base_frame != odometry.child_frame_id {
                    poses.base_frame = odometry.child_frame_id.to_owned();
                }
                poses.poses.push(Timed { at: message.at, stamp: odometry.stamp, value });
                Ok(())
            }
            TfMessage::TYPE => {
                let mut from = Reader::new(&message.payload)?;
                let mut first_fault = Ok(());
                read::transforms(&mut from, |transform| {
                    let added = self.add_transform(message, &transform);
                    if first_fault.is_ok() {
                        first_fault = added;
                    }
                })?;
                first_fault
            }
            _ => Ok(()),
        }
    }

    fn add_scan(&mut self, message: &RecordedMessage, scan: &mut Scan) -> Result<(), MessageFault> {
        let mut from = Reader::new(&message.payload)?;
        let scan_frame = match read::laser_scan(&mut from, scan) {
            Ok(name) => frame(name),
            Err(DecodeError::TooManyBeams { .. }) => {
                self.too_many_beams += 1;
                return Ok(());
            }
            Err(fault) => return Err(fault.into()),
        };
        let value = checked(scan)?;
        let known = self.scan_frames.iter().position(|known| *known == scan_frame);
        let frame_number = match known {
            Some(number) => number,
            None if self.scan_frames.len() < FRAMES_MAX => {
                self.scan_frames.push(scan_frame);
                self.scan_frames.len() - 1
            }
            None => return Err(MessageFault::Frames),
        };
        if !self.space.take_scan(size_of_val(scan.ranges_m())) {
            self.over_limit += 1;
            return Ok(());
        }
        let raw = Timed { at: message.at, stamp: value.stamp, value: (frame_number, value) };
        self.scans.entry(message.topic.to_string()).or_default().push(raw);
        Ok(())
    }

    fn add_transform(
        &mut self,
        message: &RecordedMessage,
        transform: &Transform<'_>,
    ) -> Result<(), MessageFault> {
        let Transform { frame_id, child_frame_id, translation: position, rotation, .. } = *transform;
        let pose = SpatialPose::checked(position, rotation).ok_or_else(|| MessageFault::Pose {
            of: format!("the transform {frame_id} -> {child_frame_id}"),
            position,
            rotation,
        })?;
        let is_known = self.transforms.contains_key(&*message.topic);
        if !is_known && self.transforms.len() >= TF_TOPICS_MAX {
            self.over_limit += 1;
            return Ok(());
        }
        let edges = self.transforms.entry(message.topic.to_string()).or_default();
        let key = (frame(transform.frame_id), frame(transform.child_frame_id));
        if !edges.contains_key(&key) && edges.len() >= FRAMES_MAX {
            self.over_limit += 1;
            return Ok(());
        }
        let may_be_odometry = is_odometry(&key.0, self.odom_frame.as_deref());
        let edge =
            edges.entry(key).or_insert_with(|| Edge { first: pose, changes: false, poses: Vec::new() });
        let (moved_m, turned_rad) = edge.first.distance(&pose);
        edge.changes |= moved_m > MOUNT_CHANGE_M || turned_rad > MOUNT_CHANGE_RAD;
        // A robot with an arm has many others.
        if may_be_odometry {
            if self.space.take_pose() {
                edge.poses.push(Timed { at: message.at, stamp: transform.stamp, value: pose.planar() });
            } else {
                self.over_limit += 1;
            }
        }
        Ok(())
    }
}

/// Returns a scan whose numbers are a measurement's.
fn checked(scan: &Scan) -> Result<BagScan, MessageFault> {
    let (first, step) = (f64::from(scan.angle_min_rad), f64::from(scan.angle_increment_rad));
    let beams = scan.ranges_m().len();
    if beams < BEAMS_MIN {
        return Err(MessageFault::FewBeams(beams));
    }
    let span_rad = (step * (beams as f64 - 1.0)).abs();
    let numbers: [(&'static str, f64, bool, &'static str); 6] = [
        ("angle_min", first, first.is_finite(), "a finite number, radians"),
        (
            "angle_increment",
            step,
            step != 0.0 && span_rad <= std::f64::consts::TAU + step.abs(),
            "radians, not 0, all beams within one turn",
        ),
        ("range_min", scan.range_min_m.into(), scan.range_min_m >= 0.0, "0 or more, metres"),
        (
            "range_max",
            scan.range_max_m.into(),
            scan.range_max_m > scan.range_min_m,
            "more than range_min, metres",
        ),
        (
            "time_increment",
            scan.time_increment_s.into(),
            scan.time_increment_s.is_finite(),
            "a finite number, seconds",
        ),
        ("scan_time", scan.scan_time_s.into(), scan.scan_time_s.is_finite(), "a finite number, seconds"),
    ];
    if let Some((field, found, _, expected)) = numbers.into_iter().find(|(_, _, is_valid, _)| !is_valid) {
        return Err(MessageFault::Number { field, found, expected });
    }
    Ok(BagScan {
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

#[cfg(test)]
mod tests {
    use super::*;
    use msg::Stamp;
    use ros_messages::{TransformStamped, encode};
    use std::rc::Rc;

    fn message(topic: &str, message: &impl Message, message_type: &str) -> RecordedMessage {
        let mut payload = Vec::new();
        encode(message, &mut payload);
        let (encoding, at) = (Rc::from("cdr"), Stamp(0));
        RecordedMessage { topic: topic.into(), message_type: message_type.into(), encoding, at, payload }
    }

    fn transform(parent: &str, child: &str) -> TransformStamped {
        TransformStamped {
            stamp: Stamp(0),
            frame_id: parent.into(),
            child_frame_id: child.into(),
            translation: [0.0; 3],
            rotation: [0.0, 0.0, 0.0, 1.0],
        }
    }

    #[test]
    fn an_arm_takes_no_space_of_odometry_and_what_has_no_space_is_counted() {
        let space = Space { scans: 2, ranges_bytes: 1000, poses: 3 };
        let mut found = Found { space, ..Found::default() };
        let mut scan: Box<Scan> = bytemuck::allocation::zeroed_box();
        let moving =
            TfMessage { transforms: vec![transform("shoulder", "elbow"), transform("odom", "base_link")] };
        let scans = LaserScan {
            angle_min: -1.0,
            angle_increment: 0.01,
            range_max: 3.5,
            ranges: vec![1.5; 100],
            ..LaserScan::default()
        };
        for _ in 0..5 {
            found.add(&message("/tf", &moving, TfMessage::TYPE), &mut scan);
            found.add(&message("/scan", &scans, LaserScan::TYPE), &mut scan);
        }
        let poses = |parent: &str, child: &str| {
            found.transforms["/tf"][&(parent.to_owned(), child.to_owned())].poses.len()
        };
        assert_eq!((poses("shoulder", "elbow"), poses("odom", "base_link")), (0, 3));
        assert_eq!((found.scans["/scan"].len(), found.malformed), (2, 0));
        assert_eq!(found.over_limit, 2 + 3);
        found.add(
            &message(
                "/odom",
                &Odometry { orientation: [0.0, 0.0, 0.0, 1.0], ..Odometry::default() },
                Odometry::TYPE,
            ),
            &mut scan,
        );
        assert_eq!((found.over_limit, found.malformed, found.odometry.len()), (6, 0, 0));
    }
}
