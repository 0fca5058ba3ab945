//! A robot's SLAM as one value that can be kept: bytes out, bytes in. The shell writes and reads files.
//!
//! ```text
//! magic 8 | version u32 | CRC-32 of the rest u32 | length of the rest u64 | the rest
//! ```
//!
//! Whatever the bytes, decoding ends with a session that is sound (every number finite and in its
//! range, every reference to a node that is there) or with the reason why it is none.

mod bytes;
mod from_grid;
mod records;

use crate::back_end::BackEndState;
use crate::config::SlamConfig;
use crate::front_end::{FrontEndState, TrajectorySample};
use bytes::{In, Out};
use msg::{SlamMode, pose::wrap_angle};
use records::*;

/// The format this program reads and writes.
pub const VERSION: u32 = 4;
/// The oldest format it reads: nodes without the way that led there.
const VERSION_OLDEST: u32 = 3;
/// What a session file begins with.
pub const MAGIC: [u8; 8] = *b"MRSLAM\r\n";
/// Bytes before the content.
const HEAD: usize = 24;
/// Places of a LiDAR nearer than this are one: metres, radians.
const SAME_PLACE: f64 = 1e-3;

/// Why bytes are no session that can be gone on with.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SessionError {
    /// Something else.
    #[error("is not a session file: it begins with other bytes")]
    Magic,
    /// From another version of the program.
    #[error("is of format version {found}; this program reads versions {VERSION_OLDEST} to {VERSION}")]
    Version {
        /// What it says.
        found: u32,
    },
    /// Cut off, or with something behind it.
    #[error("is truncated or overlong: {found} bytes of content, expected {expected}")]
    Length {
        /// Bytes that are there.
        found: u64,
        /// Bytes that it says there are.
        expected: u64,
    },
    /// Changed since it was written.
    #[error("is damaged: its checksum is {found:08x}, expected {expected:08x}")]
    Checksum {
        /// Of what is there.
        found: u32,
        /// What it says.
        expected: u32,
    },
    /// Its content ends early.
    #[error("ends within {what}")]
    Ends {
        /// Where.
        what: &'static str,
    },
    /// A number of things beyond what is allowed.
    #[error("has {found} {what}, expected at most {most}")]
    TooMany {
        /// Of what.
        what: &'static str,
        /// How many.
        found: u64,
        /// How many there may be.
        most: usize,
    },
    /// A number that makes no sense.
    #[error("has a {what} that makes no sense")]
    Value {
        /// Which.
        what: &'static str,
    },
    /// Another robot's.
    #[error("is another robot's: {what} is {found}, here {expected}")]
    Stranger {
        /// What differs.
        what: &'static str,
        /// There.
        found: String,
        /// Here.
        expected: String,
    },
}

/// Whose session it is. Maps of other robots are not gone on with: their scans mean something else.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Identity {
    /// The robot's number; 0 for a log's.
    pub robot: u32,
    /// The run it was taken in, to tell a worker's own session from an older one; 0: none.
    pub run: u64,
    /// Pose of `base_scan` in `base_footprint`: x m, y m, yaw rad.
    pub base_from_scan: [f64; 3],
    /// Returns beyond it are not used, metres.
    pub range_use_max_m: f64,
}

impl Identity {
    /// Of this robot in this run.
    pub fn new(robot: u32, run: u64, config: &SlamConfig) -> Self {
        let lidar = &config.lidar;
        Self {
            robot,
            run,
            base_from_scan: lidar.base_from_scan,
            range_use_max_m: lidar.range_use_max_m.into(),
        }
    }

    /// Whether a session of `found` may be gone on with by this robot, in whatever run.
    fn accept(&self, found: &Self) -> Result<(), SessionError> {
        let differs = |what, found: String, expected: String| {
            if found == expected { Ok(()) } else { Err(SessionError::Stranger { what, found, expected }) }
        };
        differs("the robot's number", found.robot.to_string(), self.robot.to_string())?;
        // Logs tell the place as a difference of two poses: rounding moves it.
        let [x, y, yaw] = [0, 1, 2].map(|k| found.base_from_scan[k] - self.base_from_scan[k]);
        let near = x.hypot(y) <= SAME_PLACE && wrap_angle(yaw).abs() <= SAME_PLACE;
        if !near {
            let place = |pose: [f64; 3]| format!("{pose:?}");
            differs("the LiDAR's place on it", place(found.base_from_scan), place(self.base_from_scan))?;
        }
        let reach = |metres: f64| format!("{metres} m");
        differs("the LiDAR's usable range", reach(found.range_use_max_m), reach(self.range_use_max_m))
    }
}

/// See the module.
#[derive(Clone, Debug)]
pub struct Session {
    /// Whose.
    pub identity: Identity,
    /// What was done with the map.
    pub mode: SlamMode,
    /// The map: nodes, graph, and how far the work on them is.
    pub back: BackEndState,
    /// Where the scan path was; without it, a loaded map has no robot in it yet.
    pub front: Option<FrontEndState>,
    /// Every scan's pose, where they were kept.
    pub samples: Vec<TrajectorySample>,
}

impl Session {
    /// As bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = Out::default();
        out.bytes.resize(HEAD, 0);
        put_identity(&mut out, &self.identity);
        out.put(&u64::from(self.mode as u32));
        put_back(&mut out, &self.back);
        out.put(&u64::from(self.front.is_some()));
        self.front.iter().for_each(|front| put_front(&mut out, front));
        put_rides(&mut out, &self.samples);
        let mut bytes = out.bytes;
        let (checksum, length) = (crc32fast::hash(&bytes[HEAD..]), (bytes.len() - HEAD) as u64);
        bytes[..8].copy_from_slice(&MAGIC);
        bytes[8..12].copy_from_slice(&VERSION.to_le_bytes());
        bytes[12..16].copy_from_slice(&checksum.to_le_bytes());
        bytes[16..24].copy_from_slice(&length.to_le_bytes());
        bytes
    }

    /// From bytes, for this robot.
    pub fn decode(bytes: &[u8], identity: &Identity) -> Result<Self, SessionError> {
        let session = Self::decode_any(bytes)?;
        identity.accept(&session.identity)?;
        Ok(session)
    }

    /// From bytes, whoever's they are.
    pub fn decode_any(bytes: &[u8]) -> Result<Self, SessionError> {
        if !bytes.starts_with(&MAGIC[..bytes.len().min(8)]) || bytes.is_empty() {
            return Err(SessionError::Magic);
        }
        let Some((head, content)) = bytes.split_at_checked(HEAD) else {
            return Err(SessionError::Ends { what: "its head" });
        };
        let mut head = In::new(&head[8..]);
        let found: u32 = head.take("its head")?;
        if !(VERSION_OLDEST..=VERSION).contains(&found) {
            return Err(SessionError::Version { found });
        }
        let expected_sum: u32 = head.take("its head")?;
        let expected: u64 = head.take("its head")?;
        if content.len() as u64 != expected {
            return Err(SessionError::Length { found: content.len() as u64, expected });
        }
        let found = crc32fast::hash(content);
        if found != expected_sum {
            return Err(SessionError::Checksum { found, expected: expected_sum });
        }
        Self::decode_content(content)
    }

    /// What is behind the head. Not to be trusted more than the head: a checksum is no signature.
    pub fn decode_content(content: &[u8]) -> Result<Self, SessionError> {
        let mut from = In::new(content);
        let identity = take_identity(&mut from)?;
        let mode = take_mode(&mut from)?;
        let back = take_back(&mut from)?;
        let front = match from.take::<u64>("the scan path")? {
            0 => None,
            _ => Some(take_front(&mut from, back.nodes.len())?),
        };
        let samples = take_rides(&mut from, back.nodes.len())?;
        if !from.is_empty() {
            return Err(SessionError::Value { what: "length (something follows its content)" });
        }
        Ok(Self { identity, mode, back, front, samples })
    }
}
