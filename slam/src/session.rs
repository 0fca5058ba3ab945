//! Sessions: the state of a robot's SLAM, encoded to bytes and decoded from them. Callers read and write the files.
//!
//! ```text
//! magic 8 | version u32 | CRC-32 of the rest u32 | length of the rest u64 | the rest
//! ```
//!
//! Whatever the bytes, decoding ends with a session that is sound (every number finite and in its
//! range, every reference to a node that is there) or with the reason why it is none.

mod bytes;
mod from_grid;
pub mod log;
mod records;

use crate::back_end::{BackEnd, BackEndState};
use crate::config::SlamConfig;
use crate::front_end::{FrontEndState, TrajectorySample};
use bytes::{In, Out};
use log::LogPosition;
use msg::{SlamMode, pose::wrap_angle};
use records::*;

/// Version of the format that is written.
pub const VERSION: u32 = 5;
/// Oldest version of the format that is read: it has no place in a log, and its nodes have no swept path.
const VERSION_OLDEST: u32 = 3;
/// First bytes of a session file.
pub const MAGIC: [u8; 8] = *b"MRSLAM\r\n";
/// Length of the head before the content, bytes.
const HEAD: usize = 24;
/// Mounting poses of a LiDAR nearer than this are the same, metres and radians.
const SAME_PLACE: f64 = 1e-3;

/// Reason why bytes are not a session that can be continued.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SessionError {
    /// The bytes do not begin with [`MAGIC`].
    #[error("is not a session file: it begins with other bytes")]
    Magic,
    /// A version of the format that this program does not read.
    #[error("is of format version {found}; this program reads versions {VERSION_OLDEST} to {VERSION}")]
    Version {
        /// Version in the head.
        found: u32,
    },
    /// The file is truncated, or has bytes after its content.
    #[error("is truncated or overlong: {found} bytes of content, expected {expected}")]
    Length {
        /// Bytes of content in the file.
        found: u64,
        /// Bytes of content by the head.
        expected: u64,
    },
    /// The content was changed since it was written.
    #[error("is damaged: its checksum is {found:08x}, expected {expected:08x}")]
    Checksum {
        /// Checksum of the content.
        found: u32,
        /// Checksum in the head.
        expected: u32,
    },
    /// The content ends within a value.
    #[error("ends within {what}")]
    Ends {
        /// Value that is cut off.
        what: &'static str,
    },
    /// A number of entries beyond its limit.
    #[error("has {found} {what}, expected at most {most}")]
    TooMany {
        /// Name of the entries.
        what: &'static str,
        /// Number of entries in the session.
        found: u64,
        /// Largest number allowed.
        most: usize,
    },
    /// A value that is not finite, out of its range, or refers to nothing.
    #[error("has a {what} that makes no sense")]
    Value {
        /// Name of the value.
        what: &'static str,
    },
    /// The session of another robot.
    #[error("is another robot's: {what} is {found}, here {expected}")]
    Stranger {
        /// Name of the property that differs.
        what: &'static str,
        /// Property of the session's robot.
        found: String,
        /// Property of this robot.
        expected: String,
    },
}

/// Robot and run of a session. Another robot cannot continue it: its LiDAR is mounted differently.
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
    /// The identity of this robot in this run.
    pub fn new(robot: u32, run: u64, config: &SlamConfig) -> Self {
        let lidar = &config.lidar;
        Self {
            robot,
            run,
            base_from_scan: lidar.base_from_scan,
            range_use_max_m: lidar.range_use_max_m.into(),
        }
    }

    /// Checks that this robot may continue a session of `found`, of any run.
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

/// State of a robot's SLAM, from which it can continue.
#[derive(Clone, Debug)]
pub struct Session {
    /// Robot and run that it was made by.
    pub identity: Identity,
    /// Mode of SLAM when the session was made.
    pub mode: SlamMode,
    /// State of the back end: nodes, pose graph, and progress of the work on them.
    pub back: BackEndState,
    /// State of the front end; `None` for a map without a robot in it.
    pub front: Option<FrontEndState>,
    /// Every scan's pose relative to its node; empty if they were not kept.
    pub samples: Vec<TrajectorySample>,
    /// The newest record of the log beside the session's file whose nodes are in the session.
    pub log: LogPosition,
}

impl BackEnd {
    /// A session to continue from later. `front`: the state of the front end, after exactly the nodes
    /// that were added here; it is kept if its newest nodes are the map's. `samples`: its scans, if they are to
    /// be kept.
    pub fn session(
        &self,
        identity: Identity,
        front: Option<FrontEndState>,
        samples: &[TrajectorySample],
    ) -> Session {
        Session {
            identity,
            mode: self.mode(),
            back: self.state(),
            front: front.filter(|front| self.is_continued_by(front)),
            samples: self.all_samples(samples).collect(),
            log: LogPosition::default(),
        }
    }
}

impl Session {
    /// Encodes the session.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = Out::default();
        out.bytes.resize(HEAD, 0);
        put_identity(&mut out, &self.identity);
        out.put(&u64::from(self.mode as u32));
        put_back(&mut out, &self.back);
        out.put(&u64::from(self.front.is_some()));
        self.front.iter().for_each(|front| put_front(&mut out, front));
        put_rides(&mut out, &self.samples);
        out.put(&[self.log.number, u64::from(self.log.checksum)]);
        let mut bytes = out.bytes;
        let (checksum, length) = (crc32fast::hash(&bytes[HEAD..]), (bytes.len() - HEAD) as u64);
        bytes[..8].copy_from_slice(&MAGIC);
        bytes[8..12].copy_from_slice(&VERSION.to_le_bytes());
        bytes[12..16].copy_from_slice(&checksum.to_le_bytes());
        bytes[16..24].copy_from_slice(&length.to_le_bytes());
        bytes
    }

    /// Decodes the session of this robot.
    ///
    /// # Errors
    /// [`SessionError`] if the bytes are not a sound session, or another robot's.
    pub fn decode(bytes: &[u8], identity: &Identity) -> Result<Self, SessionError> {
        let session = Self::decode_any(bytes)?;
        identity.accept(&session.identity)?;
        Ok(session)
    }

    /// Decodes the session of any robot.
    ///
    /// # Errors
    /// [`SessionError`] if the bytes are not a sound session.
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

    /// Decodes the content after the head. Every value is checked: a matching checksum does not make the content valid.
    ///
    /// # Errors
    /// [`SessionError`] if a value is missing or not valid.
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
        let log = take_log_position(&mut from)?;
        if !from.is_empty() {
            return Err(SessionError::Value { what: "length (something follows its content)" });
        }
        Ok(Self { identity, mode, back, front, samples, log })
    }
}
