//! What one asks of a robot's SLAM, and what it answers: the services that SLAM Toolbox's users know.
//!
//! Several may ask at a time (the command line, the bridge). Who asks puts a number of its own into
//! `client` and counts its requests in `id`; the answer repeats both. A request that is not answered
//! within a few seconds was lost with a process that died: ask again.

use crate::{Header, Pose2};
use bytemuck::{Pod, Zeroable};

/// The longest text, bytes of UTF-8.
pub const TEXT_MAX: usize = 1020;
/// Closures in one answer; more are asked for by the number of the first.
pub const CLOSURES_MAX: usize = 32;

/// A path or a reason, of bounded length.
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
    /// `None` if it is longer than [`TEXT_MAX`] bytes.
    pub fn new(text: &str) -> Option<Self> {
        (text.len() <= TEXT_MAX).then(|| Self::shortened(text))
    }

    /// As much of the text as fits.
    pub fn shortened(text: &str) -> Self {
        let mut len = text.len().min(TEXT_MAX);
        while !text.is_char_boundary(len) {
            len -= 1;
        }
        let mut short = Self { len: len as u32, ..Self::default() };
        short.bytes[..len].copy_from_slice(&text.as_bytes()[..len]);
        short
    }

    /// The text, up to the first byte that is not UTF-8.
    pub fn as_str(&self) -> &str {
        let bytes = &self.bytes[..(self.len as usize).min(TEXT_MAX)];
        match core::str::from_utf8(bytes) {
            Ok(text) => text,
            Err(error) => core::str::from_utf8(&bytes[..error.valid_up_to()]).unwrap_or(""),
        }
    }
}

/// What SLAM does with a map it has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum SlamMode {
    /// The map grows; a loaded one is gone on with.
    #[default]
    Mapping = 0,
    /// The map stays as it is; only the robot's pose in it is wanted.
    Localization = 1,
    /// The map grows, and forgets what is no longer so.
    Lifelong = 2,
}

impl SlamMode {
    /// All modes, in the order of their codes.
    pub const ALL: [Self; 3] = [Self::Mapping, Self::Localization, Self::Lifelong];

    /// `None` for a code that no mode has.
    pub fn from_code(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|mode| *mode as u32 == code)
    }

    /// One word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mapping => "mapping",
            Self::Localization => "localization",
            Self::Lifelong => "lifelong",
        }
    }
}

/// What is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum SlamRequestKind {
    /// How it stands. Every answer says that; this asks for nothing else.
    State = 0,
    /// New scans are not looked at.
    Pause = 1,
    /// They are again.
    Resume = 2,
    /// Forget everything; the map begins anew where the robot is, in the frame in which it was.
    Reset = 3,
    /// Write `text`.pgm, .yaml and .png.
    SaveMap = 4,
    /// Write the session file `text`.
    SaveSession = 5,
    /// Take the session file `text`, or the map `text` if it ends in .yaml (localization only); `mode`
    /// says what for, `start` where the robot is.
    LoadSession = 6,
    /// The robot is at `pose`, give or take `sigma_m` and `sigma_rad`: it is looked for there, and after some
    /// way believed to be there.
    SetPose = 7,
    /// The closures from number `number` on.
    ListClosures = 8,
    /// Take closure `number` back, and believe it no more.
    UndoClosure = 9,
    /// Take all closures back.
    ClearClosures = 10,
    /// Look for the robot in the whole map.
    Relocalize = 11,
    /// Go on with the map in `mode`.
    SetMode = 12,
}

impl SlamRequestKind {
    /// All that can be asked, in the order of their codes.
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

    /// `None` for a code that means nothing.
    pub fn from_code(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| *kind as u32 == code)
    }
}

/// Where a robot is when a session is loaded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum StartPose {
    /// To be found out.
    #[default]
    Unknown = 0,
    /// At the request's `pose`.
    Given = 1,
    /// Where the session's first scan was taken.
    FirstNode = 2,
    /// Where its last scan was taken.
    LastNode = 3,
}

impl StartPose {
    /// `None` for a code that means nothing.
    pub fn from_code(code: u32) -> Option<Self> {
        [Self::Unknown, Self::Given, Self::FirstNode, Self::LastNode]
            .into_iter()
            .find(|start| *start as u32 == code)
    }
}

/// One request to one robot's SLAM.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct SlamRequest {
    /// `stamp` is not looked at.
    pub header: Header,
    /// A number that no other asker has: the bridge's and a command's process id will do, with a
    /// kind of connection above it.
    pub client: u64,
    /// Counts the client's requests.
    pub id: u64,
    /// A [`SlamRequestKind`]'s code.
    pub kind: u32,
    /// A [`SlamMode`]'s code.
    pub mode: u32,
    /// A [`StartPose`]'s code.
    pub start: u32,
    /// A closure's number.
    pub number: u32,
    /// `robotK/map` from `base_footprint`.
    pub pose: Pose2,
    /// One standard deviation of its position, metres; 0: as usual.
    pub sigma_m: f64,
    /// And of its heading, radians; 0: as usual.
    pub sigma_rad: f64,
    /// A path; a session's without an ending gets `.slam`. Relative ones lie below the run's folder and may not
    /// leave it. What comes from a network must be relative: the bridge sees to that.
    pub text: Text,
}

impl Default for SlamRequest {
    fn default() -> Self {
        Self::zeroed()
    }
}

/// How a request ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum SlamOutcome {
    /// Done.
    Done = 0,
    /// Not done; the text says why.
    Refused = 1,
}

/// A closure and what speaks for it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct ClosureInfo {
    /// What it is undone by.
    pub number: u32,
    /// The earlier node.
    pub older: u32,
    /// The later node.
    pub newer: u32,
    /// 1 if it has effect, 0 if it was taken back.
    pub in_force: u32,
    /// The later node as seen from the earlier one, as measured.
    pub older_from_newer: Pose2,
    /// `robotK/map` from the earlier node.
    pub map_from_older: Pose2,
    /// `robotK/map` from the later node.
    pub map_from_newer: Pose2,
    /// How well the scans fitted, 0 to 1.
    pub response: f32,
    /// Squared error in the graph, in standard deviations.
    pub chi_squared: f32,
}

/// The answer to one request.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct SlamResponse {
    /// `stamp` is that of the newest node.
    pub header: Header,
    /// The request's.
    pub client: u64,
    /// The request's.
    pub id: u64,
    /// 0: done, 1: refused. Read it by [`SlamResponse::outcome`].
    pub outcome: u32,
    /// A [`SlamMode`]'s code.
    pub mode: u32,
    /// 1: new scans are not looked at.
    pub paused: u32,
    /// 1: where the robot is in its map is known.
    pub located: u32,
    /// Nodes in the map.
    pub nodes: u32,
    /// Links in force.
    pub links: u32,
    /// Closures in force.
    pub closures: u32,
    /// Closures taken back.
    pub retracted: u32,
    /// Closures that there are to list, in force or not.
    pub listable: u32,
    /// How many of `list` are used. Read it by [`SlamResponse::closures`].
    pub listed: u32,
    /// `robotK/map` from `base_footprint`, where the robot was at the newest node.
    pub map_from_base: Pose2,
    /// Closures that were asked for.
    pub list: [ClosureInfo; CLOSURES_MAX],
    /// What was written, or why not.
    pub text: Text,
}

impl Default for SlamResponse {
    fn default() -> Self {
        Self::zeroed()
    }
}

impl SlamResponse {
    /// The checked outcome; an unknown code reads as refused.
    pub fn outcome(&self) -> SlamOutcome {
        if self.outcome == SlamOutcome::Done as u32 { SlamOutcome::Done } else { SlamOutcome::Refused }
    }

    /// The closures in this answer.
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
        fn text_comes_back_or_is_cut_at_a_character(text in "\\PC{0,400}") {
            let short = Text::shortened(&text);
            prop_assert!(text.starts_with(short.as_str()));
            prop_assert_eq!(Text::new(&text).is_some(), text.len() <= TEXT_MAX);
            prop_assert!(text.len() > TEXT_MAX || short.as_str() == text);
        }

        #[test]
        fn any_bits_are_a_text(len: u32, byte: u8) {
            let text = Text { len, bytes: [byte; TEXT_MAX] };
            prop_assert!(text.as_str().len() <= TEXT_MAX);
        }
    }
}
