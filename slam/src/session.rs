//! Sessions: the state of a robot's SLAM, encoded to bytes and decoded from them. Callers read and write the files.
//!
//! ```text
//! magic 8 | version u32 | CRC-32 of the content u32 | length of the content u64 | content
//! ```
//!
//! The content is [`Session`] in postcard's encoding (<https://postcard.jamesmunns.com/wire-format>), field by field in
//! the order of the types. So a field that is added, removed or moved in [`Session`] or in a type within it makes a new
//! [`VERSION`].
//!
//! Whatever the bytes, decoding ends with a session that [`Session::validate`] accepts or with the reason why it is none.
//! It never allocates by a length that the bytes only claim: postcard reserves 1 MiB of a list at most before its
//! elements are there, and byte strings must be there whole.

mod from_grid;
pub mod log;
mod validate;

use crate::back_end::{BackEnd, BackEndState};
use crate::config::SlamConfig;
use crate::front_end::{FrontEndState, TrajectorySample};
use log::LogPosition;
use msg::{SlamMode, pose::wrap_angle};
use serde::{Deserialize, Serialize};

/// Version of the format of sessions and of records of their logs.
pub const VERSION: u32 = 14;
/// First bytes of a session file.
pub const MAGIC: [u8; 8] = *b"MRSLAM\r\n";
/// Length of the head before the content, bytes.
const HEAD: usize = 24;
/// Largest session that is decoded, bytes. 20 000 nodes of a dense LiDAR take about 300 MB.
pub const BYTES_MAX: usize = 1 << 30;
/// Mounting poses of a LiDAR nearer than this are the same, metres and radians.
const SAME_PLACE: f64 = 1e-3;

/// Reason why bytes are not a session that can be continued.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SessionError {
    /// The bytes do not begin with [`MAGIC`].
    #[error("is not a session file: it begins with other bytes")]
    Magic,
    /// A version of the format that this program does not read.
    #[error(
        "is of format version {found}; this program reads version {VERSION}: map again, or save the map as pictures \
         (mr-slam slam ROBOT map NAME) with the version of MR-SLAM that wrote it, and localize in that"
    )]
    Version {
        /// Version in the head.
        found: u32,
    },
    /// More bytes than [`BYTES_MAX`].
    #[error("has {found} bytes, expected at most {BYTES_MAX}")]
    TooLarge {
        /// Number of bytes.
        found: u64,
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
    /// The bytes end within the head.
    #[error("ends within {what}")]
    Ends {
        /// Part that is cut off.
        what: &'static str,
    },
    /// The content does not follow the format.
    #[error("cannot be decoded: {0}")]
    Encoding(#[from] postcard::Error),
    /// Bytes follow the content.
    #[error("has {found} bytes after its content")]
    Trailing {
        /// Number of bytes.
        found: usize,
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
    #[error("has an invalid {what}")]
    Value {
        /// Name of the value.
        what: &'static str,
    },
    /// The session of another robot.
    #[error("is another robot's: {what} is {found}, here {expected}")]
    OtherRobot {
        /// Name of the property that differs.
        what: &'static str,
        /// Property of the session's robot.
        found: String,
        /// Property of this robot.
        expected: String,
    },
}

/// Robot and run of a session. Another robot cannot continue it: its LiDAR is mounted differently.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SessionIdentity {
    /// The robot's number; 0 for a log's.
    pub robot: u32,
    /// The run it was taken in, to tell a worker's own session from an older one; 0: none.
    pub run: u64,
    /// Pose of `base_scan` in `base_footprint`: x m, y m, yaw rad.
    pub base_from_scan: [f64; 3],
    /// Returns beyond it are not used, metres.
    pub range_use_max_m: f64,
}

impl SessionIdentity {
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
            if found == expected { Ok(()) } else { Err(SessionError::OtherRobot { what, found, expected }) }
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
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Session {
    /// Robot and run that it was made by.
    pub identity: SessionIdentity,
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
        identity: SessionIdentity,
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
    /// Encodes the session. What could not be read back is not written: it would replace a session that can.
    ///
    /// # Errors
    /// [`SessionError`] if a value is not valid, or there are too many bytes.
    pub fn encode(&self) -> Result<Vec<u8>, SessionError> {
        self.validate()?;
        let mut bytes = encode_after(vec![0; HEAD], self);
        if bytes.len() > BYTES_MAX {
            return Err(SessionError::TooLarge { found: bytes.len() as u64 });
        }
        let (checksum, length) = (crc32fast::hash(&bytes[HEAD..]), (bytes.len() - HEAD) as u64);
        bytes[..8].copy_from_slice(&MAGIC);
        bytes[8..12].copy_from_slice(&VERSION.to_le_bytes());
        bytes[12..16].copy_from_slice(&checksum.to_le_bytes());
        bytes[16..24].copy_from_slice(&length.to_le_bytes());
        Ok(bytes)
    }

    /// Decodes the session of this robot.
    ///
    /// # Errors
    /// [`SessionError`] if the bytes are not a sound session, or another robot's.
    pub fn decode(bytes: &[u8], identity: &SessionIdentity) -> Result<Self, SessionError> {
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
        if bytes.len() > BYTES_MAX {
            return Err(SessionError::TooLarge { found: bytes.len() as u64 });
        }
        let Some((head, content)) = bytes.split_first_chunk::<HEAD>() else {
            return Err(SessionError::Ends { what: "its head" });
        };
        let (version, expected_sum, length) =
            (word(head, 8), word(head, 12), [word(head, 16), word(head, 20)]);
        if version != VERSION {
            return Err(SessionError::Version { found: version });
        }
        let expected = u64::from(length[0]) | u64::from(length[1]) << 32;
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
        let mut session: Self = decode_whole(content)?;
        session.validate()?;
        // Nodes that were removed may still be counted.
        session.back.linked_since_solve = session.back.linked_since_solve.min(session.back.nodes.len());
        Ok(session)
    }
}

/// Appends a value to bytes.
fn encode_after(bytes: Vec<u8>, value: &impl Serialize) -> Vec<u8> {
    postcard::to_extend(value, bytes).expect("memory has room, and every list knows its length")
}

/// Decodes a value from bytes that hold nothing else.
fn decode_whole<'a, T: Deserialize<'a>>(bytes: &'a [u8]) -> Result<T, SessionError> {
    let (value, rest) = postcard::take_from_bytes(bytes)?;
    if rest.is_empty() { Ok(value) } else { Err(SessionError::Trailing { found: rest.len() }) }
}

/// Returns the 32-bit number at an offset of a head.
fn word<const N: usize>(head: &[u8; N], at: usize) -> u32 {
    u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]])
}
