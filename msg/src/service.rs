//! Requests to a robot's SLAM and its responses: the services that SLAM Toolbox offers.
//!
//! Several clients may send requests at a time (the command line, the bridge). A client puts a number of
//! its own into `client` and counts its requests in `id`; the response repeats both. A request without a
//! response within a few seconds was lost with a process that died. The client then sends it again.

use crate::{CommandSource, Header, Pose2, bounded_text};
use bytemuck::{Pod, Zeroable};

/// Length of the longest text, bytes of UTF-8.
pub const TEXT_MAX: usize = 1020;
/// Largest number of closures in one response. A client requests further ones by the number of the first.
pub const CLOSURES_MAX: usize = 32;

/// Text of bounded length in a message: a path, or the reason of a refusal.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Text {
    len: u32,
    bytes: [u8; TEXT_MAX],
}

impl Default for Text {
    fn default() -> Self {
        Self::zeroed()
    }
}

impl Text {
    /// Stores a text; `None` if it is longer than [`TEXT_MAX`] bytes.
    pub fn new(text: &str) -> Option<Self> {
        (text.len() <= TEXT_MAX).then(|| Self::shortened(text))
    }

    /// Stores as much of a text as fits, cut at a character.
    pub fn shortened(text: &str) -> Self {
        let mut short = Self::default();
        short.len = bounded_text::write(text, &mut short.bytes);
        short
    }

    /// Returns the text up to the first byte that is not UTF-8.
    pub fn as_str(&self) -> &str {
        let bytes = &self.bytes[..(self.len as usize).min(TEXT_MAX)];
        match core::str::from_utf8(bytes) {
            Ok(text) => text,
            Err(error) => core::str::from_utf8(&bytes[..error.valid_up_to()]).unwrap_or(""),
        }
    }
}

/// Mode of a robot's SLAM.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[repr(u32)]
pub enum SlamMode {
    /// Extends the map; a loaded map is continued.
    #[default]
    Mapping = 0,
    /// Keeps the map as it is and estimates the robot's pose in it.
    Localization = 1,
    /// Extends the map and removes obstacles that later scans contradict.
    Lifelong = 2,
}

impl SlamMode {
    /// All modes in the order of their codes.
    pub const ALL: [Self; 3] = [Self::Mapping, Self::Localization, Self::Lifelong];

    /// Decodes a mode; `None` for an unknown code.
    pub fn from_code(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|mode| *mode as u32 == code)
    }

    /// Returns the mode's name on the command line and in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mapping => "mapping",
            Self::Localization => "localization",
            Self::Lifelong => "lifelong",
        }
    }
}

/// Kind of a request to SLAM.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum SlamRequestKind {
    /// Reports the state and changes nothing. Every response contains the state.
    State = 0,
    /// Stops the processing of new scans.
    Pause = 1,
    /// Continues the processing of new scans.
    Resume = 2,
    /// Deletes the map. A new one starts at the robot's pose, in the same frame.
    Reset = 3,
    /// Writes the map to `text`.pgm, .yaml and .png. A relative `text` is below `saved/` in the run's folder.
    SaveMap = 4,
    /// Writes the session file `text`.slam. A relative `text` is below `saved/` in the run's folder.
    SaveSession = 5,
    /// Loads the session file `text`, or the map `text` if it ends in .yaml (localization only). `mode` is
    /// the mode to continue in, `initial_pose_kind` the robot's pose.
    LoadSession = 6,
    /// Sets the robot's pose to `pose` with the standard deviations `sigma_m` and `sigma_rad`. SLAM searches
    /// there first and accepts the pose after the robot has driven some distance.
    SetPose = 7,
    /// Lists the closures from number `number` on.
    ListClosures = 8,
    /// Removes closure `number` and never accepts it again.
    UndoClosure = 9,
    /// Removes all closures.
    ClearClosures = 10,
    /// Searches for the robot in the whole map.
    Relocalize = 11,
    /// Continues with the same map in `mode`.
    SetMode = 12,
}

impl SlamRequestKind {
    /// Returns whether it changes the map or the robot's place in it.
    pub fn changes_map(self) -> bool {
        match self {
            Self::Reset
            | Self::LoadSession
            | Self::SetPose
            | Self::Relocalize
            | Self::UndoClosure
            | Self::ClearClosures
            | Self::SetMode => true,
            Self::State
            | Self::Pause
            | Self::Resume
            | Self::SaveMap
            | Self::SaveSession
            | Self::ListClosures => false,
        }
    }

    /// All kinds in the order of their codes.
    pub const ALL: [Self; 13] = [
        Self::State,
        Self::Pause,
        Self::Resume,
        Self::Reset,
        Self::SaveMap,
        Self::SaveSession,
        Self::LoadSession,
        Self::SetPose,
        Self::ListClosures,
        Self::UndoClosure,
        Self::ClearClosures,
        Self::Relocalize,
        Self::SetMode,
    ];

    /// Decodes a kind; `None` for an unknown code.
    pub fn from_code(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| *kind as u32 == code)
    }
}

/// Kind of the robot's pose when a session is loaded (SLAM Toolbox's match type).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum InitialPoseKind {
    /// The pose is unknown and SLAM searches for it.
    #[default]
    Unknown = 0,
    /// The robot is at the request's `pose`.
    Given = 1,
    /// The robot is at the session's first pose-graph node.
    FirstNode = 2,
    /// The robot is at the session's last pose-graph node.
    LastNode = 3,
}

impl InitialPoseKind {
    /// Decodes a kind; `None` for an unknown code.
    pub fn from_code(code: u32) -> Option<Self> {
        [Self::Unknown, Self::Given, Self::FirstNode, Self::LastNode]
            .into_iter()
            .find(|kind| *kind as u32 == code)
    }
}

/// One request to one robot's SLAM.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct SlamRequest {
    /// Header whose `stamp` is not used.
    pub header: Header,
    /// Number of the client, different from every other client's: its process id in the low bits and the
    /// kind of connection above them.
    pub client: u64,
    /// Number of the request among the client's requests.
    pub id: u64,
    /// Who sent it.
    pub sender: CommandSource,
    /// Code of a [`SlamRequestKind`].
    pub kind: u32,
    /// Code of a [`SlamMode`].
    pub mode: u32,
    /// Code of a [`InitialPoseKind`].
    pub initial_pose_kind: u32,
    /// Number of a closure.
    pub number: u32,
    /// Pose of `base_footprint` in `robotK/map`.
    pub pose: Pose2,
    /// Standard deviation of the position, metres; 0 selects the default.
    pub sigma_m: f64,
    /// Standard deviation of the heading, radians; 0 selects the default.
    pub sigma_rad: f64,
    /// Path of a file; a session's path without an extension gets `.slam`. A relative path lies below the run's
    /// folder and may not leave it. The bridge refuses absolute paths from the network.
    pub text: Text,
}

impl Default for SlamRequest {
    fn default() -> Self {
        Self::zeroed()
    }
}

/// Outcome of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum SlamOutcome {
    /// The request was carried out.
    Done = 0,
    /// The request was refused; the text gives the reason.
    Refused = 1,
    /// The request was carried out, but is not saved: a process that is started again would not know it. The text gives the reason.
    NotSaved = 2,
}

/// A loop closure with its evidence.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct ClosureInfo {
    /// Number of the closure, for [`SlamRequestKind::UndoClosure`].
    pub number: u32,
    /// Number of the earlier node.
    pub older: u32,
    /// Number of the later node.
    pub newer: u32,
    /// 1 if the closure is part of the graph, 0 if it was removed.
    pub is_active: u32,
    /// Measured pose of the later node in the frame of the earlier one.
    pub older_from_newer: Pose2,
    /// Pose of the earlier node in `robotK/map`.
    pub map_from_older: Pose2,
    /// Pose of the later node in `robotK/map`.
    pub map_from_newer: Pose2,
    /// Response of the scan matcher, 0 to 1.
    pub response: f32,
    /// Squared error in the graph, in squared standard deviations.
    pub chi_squared: f32,
}

/// Response to one request.
// More than 12 fields: the message is one row of measurements, in a fixed layout.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct SlamResponse {
    /// Header whose `stamp` is that of the newest node.
    pub header: Header,
    /// Number of the client, as in the request.
    pub client: u64,
    /// Number of the request, as in the request.
    pub id: u64,
    /// Code of a [`SlamOutcome`]. Read it by [`SlamResponse::outcome`].
    pub outcome: u32,
    /// Code of a [`SlamMode`].
    pub mode: u32,
    /// 1 if new scans are not processed, else 0.
    pub paused: u32,
    /// 1 if scans say where the robot is in the map, 2 if only a person does ([`SlamResponse::UNCONFIRMED`]), 0 if nobody knows.
    pub located: u32,
    /// Number of nodes in the pose graph.
    pub nodes: u32,
    /// Number of links in the pose graph.
    pub links: u32,
    /// Number of closures in the pose graph.
    pub closures: u32,
    /// Number of removed closures.
    pub retracted: u32,
    /// Number of closures that can be listed, removed ones included.
    pub listable: u32,
    /// Number of entries of `list` in use. Read them by [`SlamResponse::closures`].
    pub listed: u32,
    /// Pose of `base_footprint` in `robotK/map` at the newest node.
    pub map_from_base: Pose2,
    /// Storage of the requested closures. Read it by [`SlamResponse::closures`].
    pub list: [ClosureInfo; CLOSURES_MAX],
    /// Path of what was written, or the reason of a refusal.
    pub text: Text,
}

impl Default for SlamResponse {
    fn default() -> Self {
        Self::zeroed()
    }
}

impl SlamResponse {
    /// Value of `located` while a person's estimate of the robot's pose is not confirmed by scans.
    pub const UNCONFIRMED: u32 = 2;

    /// Decodes the outcome; an unknown code reads as refused.
    pub fn outcome(&self) -> SlamOutcome {
        let outcomes = [SlamOutcome::Done, SlamOutcome::NotSaved];
        outcomes.into_iter().find(|outcome| self.outcome == *outcome as u32).unwrap_or(SlamOutcome::Refused)
    }

    /// Returns the closures in this response.
    pub fn closures(&self) -> &[ClosureInfo] {
        &self.list[..(self.listed as usize).min(CLOSURES_MAX)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_text_is_stored_whole_or_cut_at_a_character(text in "\\PC{0,400}") {
            let short = Text::shortened(&text);
            prop_assert!(text.starts_with(short.as_str()));
            prop_assert_eq!(Text::new(&text).is_some(), text.len() <= TEXT_MAX);
            prop_assert!(text.len() > TEXT_MAX || short.as_str() == text);
        }

        #[test]
        fn any_bytes_read_as_a_bounded_text(len: u32, byte: u8) {
            let text = Text { len, bytes: [byte; TEXT_MAX] };
            prop_assert!(text.as_str().len() <= TEXT_MAX);
        }
    }
}
