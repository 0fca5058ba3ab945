//! Format of a message between machines: a head of fixed size, then a body by its kind. Little-endian.
//!
//! Reading checks every length and count, and returns an error for bytes that are no message.

use crate::battery::{read_battery, write_battery};
pub use crate::error::{VERSION, WireError};
use crate::part::{KEY_BYTES, PartKey};
use crate::reader::Reader;
pub use crate::receipts::{COMPLETE, Receipt};
use crate::receipts::{RECEIPT_BYTES, read_receipts, write_receipts};
use crate::scan::{DecimatedScan, ScanRate};
pub use crate::size::{HEAD_BYTES, MESSAGE_MAX};
use crate::table::Kind;
use msg::{
    Battery, Header, Monotonic, Pose2, PoseEstimate, RobotFrameTransform, Stamp, TRANSFORMS_MAX, Transforms,
    VelocityCommand,
};

/// Number of bytes of a chunk before its content.
const CHUNK_HEAD: usize = KEY_BYTES + 16;
/// Largest piece of a part in one message, bytes.
pub const CHUNK_BYTES_MAX: usize = MESSAGE_MAX - HEAD_BYTES - CHUNK_HEAD;
/// Largest number of parts in one message.
pub const RECEIPTS_MAX: usize = (MESSAGE_MAX - HEAD_BYTES - 8) / RECEIPT_BYTES;
/// Largest number of pages of a list of parts.
pub const PAGES_MAX: u16 = 64;

/// A message with its sender's session and times.
#[derive(Clone, Debug, PartialEq)]
pub struct Envelope {
    /// Session of the sender: a random number that it keeps until its process ends.
    pub session: u64,
    /// [`address`] of the session of the peer that the sender has accepted and answers; 0: none yet.
    pub to: u32,
    /// Time of sending, on the sender's clock.
    pub sent: Monotonic,
    /// Time of sending of the newest message that the sender got from this peer, on the peer's clock; 0: none yet.
    pub answers: Monotonic,
    /// Content of the message.
    pub message: Message,
}

/// Content of a message.
#[derive(Clone, Debug, PartialEq)]
pub enum Message {
    /// Sign of life of a robot.
    RobotState(RobotState),
    /// Pose in the robot's map. Of its header only the stamp is sent.
    PoseEstimate(PoseEstimate),
    /// Frames of the robot. Of its header only the stamp is sent.
    Transforms(Box<Transforms>),
    /// State of the robot's battery. Of its header nothing is sent.
    Battery(Battery),
    /// Piece of a part of the map.
    Chunk(Chunk),
    /// Scan with few beams. Of its header only the stamp is sent.
    Scan(Box<DecimatedScan>),
    /// Sign of life of the base.
    BaseState(BaseState),
    /// Velocity for the robot. Of its header nothing is sent: the robot stamps it.
    Velocity(VelocityCommand),
    /// Page of the list of parts that the base holds.
    Held(HeldPage),
    /// Parts, or first pieces of them, that have arrived.
    Acknowledgement(Vec<Receipt>),
}

/// Value of [`RobotState::interruptions`] while the robot's bridge has not answered yet.
pub const INTERRUPTIONS_UNKNOWN: u32 = u32::MAX;

/// State of a robot's link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RobotState {
    /// Session of the base whose list of parts the robot has; 0: it has none and cannot send its map.
    pub list_of: u64,
    /// Number of the run on the robot's machine. What the robot was in another run says nothing of where it is in this one.
    pub run: u32,
    /// Number of parts that wait to be sent.
    pub waiting: u32,
    /// Whether the robot's own emergency stop is set, if that is known.
    pub is_stopped: bool,
    /// Whether the robot's bridge answers, so that `is_stopped` is known.
    pub is_known: bool,
    /// Whether that stop is not the base's, which therefore cannot release it.
    pub is_own_stop: bool,
    /// Whether a person drives the robot at its own machine.
    pub is_driven_by_hand: bool,
    /// Whether the base's velocities arrive too late to be obeyed.
    pub is_late: bool,
    /// Number of stops and of drives by hand at the robot's machine; a change ends a drive of the base to a goal.
    pub interruptions: u32,
}

/// State of the base's link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BaseState {
    /// Number of the base's run: that of a link process that was started again is the same. 0: not known.
    pub run: u32,
    /// Whether the base's emergency stop is set.
    pub is_stopped: bool,
    /// Whether the base knows: its bridge has answered lately.
    pub is_known: bool,
    /// Scans that somebody at the base looks at; `None`: nobody looks.
    pub scans: Option<ScanRate>,
}

/// Piece of a compressed part.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Chunk {
    /// Key of the part.
    pub key: PartKey,
    /// Hash of the part's uncompressed content.
    pub hash: u64,
    /// Number of bytes of the whole compressed part; 0: the part does not exist any more.
    pub total: u32,
    /// Place of the piece in the compressed part.
    pub offset: u32,
    /// The compressed part's bytes from there on.
    pub bytes: Vec<u8>,
}

/// One page of the list of parts that the base holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HeldPage {
    /// Number of the page, from 0.
    pub page: u16,
    /// Number of pages of the list, at least 1.
    pub pages: u16,
    /// Number of the list, so that pages of two lists are not mixed.
    pub list: u32,
    /// Parts of this page.
    pub parts: Vec<Receipt>,
}

impl Message {
    /// Returns the kind of the message.
    pub fn kind(&self) -> Kind {
        match self {
            Self::RobotState(_) => Kind::RobotState,
            Self::PoseEstimate(_) => Kind::PoseEstimate,
            Self::Transforms(_) => Kind::Transforms,
            Self::Battery(_) => Kind::Battery,
            Self::Chunk(_) => Kind::Chunk,
            Self::Scan(_) => Kind::Scan,
            Self::BaseState(_) => Kind::BaseState,
            Self::Velocity(_) => Kind::Velocity,
            Self::Held(_) => Kind::Held,
            Self::Acknowledgement(_) => Kind::Acknowledgement,
        }
    }
}

impl Envelope {
    /// Encodes the message: at most [`MESSAGE_MAX`] bytes if its lists and pieces are within their bounds.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut to = Vec::with_capacity(64);
        to.extend([VERSION, self.message.kind() as u8]);
        to.extend(self.session.to_le_bytes());
        to.extend(self.to.to_le_bytes());
        to.extend(self.sent.0.to_le_bytes());
        to.extend(self.answers.0.to_le_bytes());
        self.message.write(&mut to);
        to
    }

    /// Decodes a message.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, WireError> {
        if bytes.len() > MESSAGE_MAX {
            return Err(WireError::Length(bytes.len()));
        }
        let mut from = Reader { bytes, whole: bytes.len() };
        let [version, kind] = from.array()?;
        if version != VERSION {
            return Err(WireError::Version(version));
        }
        let kind = Kind::from_code(kind).ok_or(WireError::Kind(kind))?;
        let (session, to) = (from.u64()?, from.u32()?);
        let (sent, answers) = (Monotonic(from.u64()?), Monotonic(from.u64()?));
        let message = Message::read(kind, &mut from)?;
        if from.bytes.is_empty() {
            Ok(Self { session, to, sent, answers, message })
        } else {
            Err(WireError::Length(bytes.len()))
        }
    }
}

impl Message {
    fn write(&self, to: &mut Vec<u8>) {
        match self {
            Self::RobotState(state) => {
                to.extend(state.list_of.to_le_bytes());
                to.extend(state.run.to_le_bytes());
                to.extend(state.waiting.to_le_bytes());
                let of_stop = [state.is_stopped, state.is_own_stop];
                let flags =
                    of_stop.into_iter().chain([state.is_driven_by_hand, state.is_late, state.is_known]);
                to.push(flags.rev().fold(0, |byte, flag| byte << 1 | u8::from(flag)));
                to.extend(state.interruptions.to_le_bytes());
            }
            Self::BaseState(state) => {
                to.extend(state.run.to_le_bytes());
                to.extend([u8::from(state.is_stopped), u8::from(state.is_known)]);
                let (period_ms, beams) = state.scans.map_or((0, 0), |scans| (scans.period_ms, scans.beams));
                to.extend(period_ms.to_le_bytes());
                to.extend(beams.to_le_bytes());
            }
            Self::Scan(scan) => scan.write(to),
            Self::Velocity(command) => write_f64s(to, &[command.linear_m_s, command.angular_rad_s]),
            Self::PoseEstimate(pose_estimate) => write_pose_estimate(to, pose_estimate),
            Self::Transforms(transforms) => write_transforms(to, transforms),
            Self::Battery(battery) => write_battery(to, battery),
            Self::Chunk(chunk) => {
                to.extend(chunk.key.to_bytes());
                to.extend(chunk.hash.to_le_bytes());
                to.extend(chunk.total.to_le_bytes());
                to.extend(chunk.offset.to_le_bytes());
                to.extend(&chunk.bytes);
            }
            Self::Held(held) => {
                to.extend(held.page.to_le_bytes());
                to.extend(held.pages.to_le_bytes());
                to.extend(held.list.to_le_bytes());
                write_receipts(to, &held.parts);
            }
            Self::Acknowledgement(parts) => write_receipts(to, parts),
        }
    }

    fn read(kind: Kind, from: &mut Reader<'_>) -> Result<Self, WireError> {
        let wrong = WireError::Range(kind);
        Ok(match kind {
            Kind::RobotState => Self::RobotState(read_robot_state(from)?.ok_or(wrong)?),
            Kind::BaseState => Self::BaseState(BaseState {
                run: from.u32()?,
                is_stopped: from.flag().ok_or(wrong)?,
                is_known: from.flag().ok_or(wrong)?,
                scans: ScanRate::read(from)?.ok_or(wrong)?,
            }),
            Kind::Scan => Self::Scan(Box::new(DecimatedScan::read(from)?.ok_or(wrong)?)),
            Kind::Velocity => {
                let (linear_m_s, angular_rad_s) = (from.f64()?, from.f64()?);
                if !linear_m_s.is_finite() || !angular_rad_s.is_finite() {
                    return Err(wrong);
                }
                Self::Velocity(VelocityCommand { linear_m_s, angular_rad_s, ..Default::default() })
            }
            Kind::PoseEstimate => Self::PoseEstimate(read_pose_estimate(from)?.ok_or(wrong)?),
            Kind::Transforms => Self::Transforms(Box::new(read_transforms(from)?.ok_or(wrong)?)),
            Kind::Battery => Self::Battery(read_battery(from)?),
            Kind::Chunk => Self::Chunk(read_chunk(from)?.ok_or(wrong)?),
            Kind::Held => {
                let (page, pages, list) = (from.u16()?, from.u16()?, from.u32()?);
                if page >= pages || pages > PAGES_MAX {
                    return Err(wrong);
                }
                Self::Held(HeldPage { page, pages, list, parts: read_receipts(from)?.ok_or(wrong)? })
            }
            Kind::Acknowledgement => Self::Acknowledgement(read_receipts(from)?.ok_or(wrong)?),
        })
    }
}

/// Returns what stands for a session in the head of a message to it; never 0.
pub fn address(session: u64) -> u32 {
    (session as u32).max(1)
}

fn read_robot_state(from: &mut Reader<'_>) -> Result<Option<RobotState>, WireError> {
    let (list_of, run, waiting) = (from.u64()?, from.u32()?, from.u32()?);
    let [flags] = from.array()?;
    let state = RobotState {
        list_of,
        run,
        waiting,
        is_stopped: flags & 1 != 0,
        is_own_stop: flags & 2 != 0,
        is_driven_by_hand: flags & 4 != 0,
        is_late: flags & 8 != 0,
        is_known: flags & 16 != 0,
        interruptions: from.u32()?,
    };
    Ok(Some(state).filter(|_| flags < 32))
}

fn write_f64s(to: &mut Vec<u8>, values: &[f64]) {
    values.iter().for_each(|value| to.extend(value.to_le_bytes()));
}

fn write_pose(to: &mut Vec<u8>, pose: Pose2) {
    write_f64s(to, &[pose.x_m, pose.y_m, pose.yaw_rad]);
}

fn write_pose_estimate(to: &mut Vec<u8>, pose_estimate: &PoseEstimate) {
    to.extend(pose_estimate.header.stamp.0.to_le_bytes());
    to.extend(pose_estimate.scan_seq.to_le_bytes());
    write_pose(to, pose_estimate.map_from_odom);
    write_pose(to, pose_estimate.map_from_base);
    pose_estimate.covariance.iter().for_each(|value| to.extend((*value as f32).to_le_bytes()));
    to.extend([pose_estimate.state as u8, pose_estimate.map_from_odom_unknown as u8]);
    to.extend(pose_estimate.nodes.to_le_bytes());
    to.extend(pose_estimate.closures.to_le_bytes());
}

fn read_pose_estimate(from: &mut Reader<'_>) -> Result<Option<PoseEstimate>, WireError> {
    let mut pose_estimate =
        PoseEstimate { header: header(from.i64()?), scan_seq: from.u64()?, ..Default::default() };
    (pose_estimate.map_from_odom, pose_estimate.map_from_base) = (from.pose()?, from.pose()?);
    for value in &mut pose_estimate.covariance {
        *value = f64::from(from.f32()?);
    }
    let [state, unknown] = from.array()?;
    (pose_estimate.state, pose_estimate.map_from_odom_unknown) = (state.into(), unknown.into());
    (pose_estimate.nodes, pose_estimate.closures) = (from.u32()?, from.u32()?);
    let is_finite = pose_estimate.map_from_odom.is_finite() && pose_estimate.map_from_base.is_finite();
    let is_finite = is_finite && pose_estimate.covariance.iter().all(|value| value.is_finite());
    Ok(Some(pose_estimate).filter(|_| is_finite))
}

/// Writes the frames with single precision: below a micrometre within ten metres.
fn write_transforms(to: &mut Vec<u8>, transforms: &Transforms) {
    to.extend(transforms.header.stamp.0.to_le_bytes());
    to.push(transforms.transforms().len() as u8);
    for transform in transforms.transforms() {
        to.extend([transform.parent_frame as u8, transform.child_frame as u8]);
        let values = transform.translation_m.iter().chain(&transform.rotation_xyzw);
        values.for_each(|value| to.extend((*value as f32).to_le_bytes()));
    }
}

fn read_transforms(from: &mut Reader<'_>) -> Result<Option<Transforms>, WireError> {
    let mut transforms = Transforms { header: header(from.i64()?), ..Default::default() };
    let [len] = from.array()?;
    if usize::from(len) > TRANSFORMS_MAX {
        return Ok(None);
    }
    transforms.len = len.into();
    for transform in &mut transforms.transforms[..usize::from(len)] {
        *transform = read_transform(from)?;
        let mut values = transform.translation_m.iter().chain(&transform.rotation_xyzw);
        if !values.all(|value| value.is_finite()) {
            return Ok(None);
        }
    }
    Ok(Some(transforms))
}

fn read_transform(from: &mut Reader<'_>) -> Result<RobotFrameTransform, WireError> {
    let [parent, child] = from.array()?;
    let mut transform =
        RobotFrameTransform { parent_frame: parent.into(), child_frame: child.into(), ..Default::default() };
    for value in transform.translation_m.iter_mut().chain(&mut transform.rotation_xyzw) {
        *value = f64::from(from.f32()?);
    }
    Ok(transform)
}

fn read_chunk(from: &mut Reader<'_>) -> Result<Option<Chunk>, WireError> {
    let key = PartKey::from_bytes(from.array()?);
    let (hash, total, offset) = (from.u64()?, from.u32()?, from.u32()?);
    let bytes = std::mem::take(&mut from.bytes);
    let Some(key) = key else { return Ok(None) };
    let fits = total as usize <= crate::part::PART_BYTES_MAX
        && (offset as usize).checked_add(bytes.len()).is_some_and(|end| end <= total as usize)
        && (bytes.is_empty() == (total == 0));
    Ok(fits.then(|| Chunk { key, hash, total, offset, bytes: bytes.to_vec() }))
}

fn header(stamp_ns: i64) -> Header {
    Header { stamp: Stamp(stamp_ns), ..Header::default() }
}
