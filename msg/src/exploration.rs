//! Messages of coordinated exploration: how it is started and stopped, and how far it is.

use crate::navigation::REASON_BYTES_MAX;
use crate::{Header, ROBOTS_MAX, bounded_text};
use bytemuck::{Pod, Zeroable};

/// Most leftovers in an [`ExplorationReport`]: the largest ones.
pub const LEFTOVERS_MAX: usize = 16;

/// What a command of exploration asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum ExplorationAction {
    /// Explore with all robots but those that drive to a person's goal.
    Start = 1,
    /// Stop all robots that explore.
    Stop = 2,
}

/// Command to the navigator about the exploration of the fleet.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct ExplorationCommand {
    /// Header whose `stamp` is the time of the command.
    pub header: Header,
    /// Number of the command: its time on the machine's clock, nanoseconds. A later command has a larger one.
    pub number: u64,
    /// Code of an [`ExplorationAction`].
    pub action: u32,
    /// Fills the message to a multiple of 8 bytes; 0.
    pub reserved: u32,
}

impl ExplorationCommand {
    /// A command with this number.
    pub fn new(number: u64, action: ExplorationAction) -> Self {
        Self { number, action: action as u32, ..Self::default() }
    }

    /// Returns what is asked for; `None` for an unknown code.
    pub fn action(&self) -> Option<ExplorationAction> {
        use ExplorationAction::{Start, Stop};
        [Start, Stop].into_iter().find(|action| *action as u32 == self.action)
    }
}

/// State of the fleet's exploration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum ExplorationStatus {
    /// Nobody has asked for it.
    Idle = 0,
    /// Robots go to where unknown space is seen.
    Exploring = 1,
    /// Persons have taken or stopped all robots; it goes on with each that is given back.
    Paused = 2,
    /// Nothing reachable is unknown; robots drive to where they began.
    Returning = 3,
    /// Nothing reachable is unknown, and the robots are back.
    Completed = 4,
    /// A person has stopped it.
    Stopped = 5,
    /// It cannot go on.
    Failed = 6,
    /// No robot can explore now; it fails if this lasts.
    Waiting = 7,
}

impl ExplorationStatus {
    /// All states in the order of their codes.
    pub const ALL: [Self; 8] = [
        Self::Idle,
        Self::Exploring,
        Self::Paused,
        Self::Returning,
        Self::Completed,
        Self::Stopped,
        Self::Failed,
        Self::Waiting,
    ];

    /// Returns the state's name in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Idle => "idle",
            Self::Exploring => "exploring",
            Self::Paused => "paused",
            Self::Returning => "returning",
            Self::Completed => "completed",
            Self::Stopped => "stopped",
            Self::Failed => "failed",
            Self::Waiting => "waiting",
        }
    }

    /// Returns whether the exploration is over.
    pub fn is_final(self) -> bool {
        matches!(self, Self::Completed | Self::Stopped | Self::Failed)
    }
}

/// Part of one robot in an exploration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum ExplorerState {
    /// No exploration is under way.
    #[default]
    None = 0,
    /// It drives to the goals of the exploration.
    Exploring = 1,
    /// A person drives it, has stopped it, or has given it a goal.
    Manual = 2,
    /// Its pose in the map is not known.
    Lost = 3,
    /// Its scans or poses do not arrive.
    Silent = 4,
    /// It returns to a place that it knows, because its own has become uncertain.
    Revisiting = 5,
    /// It stands in an exclusion zone, and reaches no floor outside.
    Excluded = 6,
    /// It reaches no floor of the map: obstacles are around it, or the map ends before it.
    Enclosed = 7,
}

impl ExplorerState {
    const ALL: [Self; 8] = [
        Self::None,
        Self::Exploring,
        Self::Manual,
        Self::Lost,
        Self::Silent,
        Self::Revisiting,
        Self::Excluded,
        Self::Enclosed,
    ];

    /// Returns the state's name in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "idle",
            Self::Exploring => "exploring",
            Self::Manual => "manual",
            Self::Lost => "lost",
            Self::Silent => "silent",
            Self::Revisiting => "revisiting",
            Self::Excluded => "excluded",
            Self::Enclosed => "enclosed",
        }
    }

    /// Returns whether the exploration drives the robot, or may drive it at any time: a lost robot looks for its place, a silent one
    /// comes back.
    pub fn may_drive(self) -> bool {
        !matches!(self, Self::None | Self::Manual)
    }

    /// Says for people why the robot has no part in the exploration; `None` if it has, or if there is no exploration.
    pub fn absence(self) -> Option<&'static str> {
        match self {
            Self::None | Self::Exploring | Self::Revisiting => None,
            Self::Manual => Some("taken by hand or stopped"),
            Self::Lost => Some("lost"),
            Self::Silent => Some("no scans or poses"),
            Self::Excluded => Some("in an exclusion zone"),
            Self::Enclosed => Some("on no floor of the map"),
        }
    }
}

/// Reason why a frontier is left.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u32)]
pub enum LeftoverReason {
    /// Robots looked there twice in vain.
    NotVisible = 1,
    /// It lies where a robot does not fit, and is not seen from elsewhere.
    TooNarrow = 2,
    /// Obstacles or excluded areas lie between it and all robots.
    Unreachable = 3,
    /// What is expected behind it is not worth a look.
    TooSmall = 4,
    /// Robots drove for a long time and showed nothing more, there or elsewhere.
    TookTooLong = 5,
}

impl core::fmt::Display for LeftoverReason {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::NotVisible => "looked at twice, and nothing was seen",
            Self::TooNarrow => "too narrow for a robot",
            Self::Unreachable => "cut off from all robots",
            Self::TooSmall => "too small to be worth a look",
            Self::TookTooLong => "not seen although robots drove for a long time",
        })
    }
}

/// Unknown space beside known free space that the fleet leaves.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct ExplorationLeftover {
    /// A free point beside it, metres, in the frame of `map_robot`.
    pub position_m: [f64; 2],
    /// Length of its border with known free space, metres.
    pub length_m: f64,
    /// Its area, square metres; not a number if known space does not enclose it.
    pub area_m2: f64,
    /// Robot in whose own map the point is, from 1; 0: in the merged map.
    pub map_robot: u32,
    /// Code of a [`LeftoverReason`].
    pub reason: u32,
}

impl ExplorationLeftover {
    /// Returns why it is left; `None` for an unknown code.
    pub fn reason(&self) -> Option<LeftoverReason> {
        use LeftoverReason::{NotVisible, TooNarrow, TooSmall, TookTooLong, Unreachable};
        let all = [NotVisible, TooNarrow, Unreachable, TooSmall, TookTooLong];
        all.into_iter().find(|reason| *reason as u32 == self.reason)
    }
}

/// State of the fleet's exploration.
// More than 12 fields: one message, whose variable parts have a length each.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct ExplorationReport {
    /// Header whose `stamp` is the time of the state.
    pub header: Header,
    /// Number of the newest command that was applied; 0 before the first.
    pub number: u64,
    /// Time from the start of the exploration to this state, or to its end, seconds; not a number before the first.
    pub elapsed_s: f64,
    /// Area that the maps of the exploration show, square metres; not a number before the first.
    pub known_m2: f64,
    /// Least time expected until nothing reachable is unknown, seconds; not a number if it is not known.
    pub least_s: f64,
    /// Most time expected, seconds; not a number if it is not known.
    pub most_s: f64,
    /// Code of an [`ExplorationStatus`]. Read it by [`ExplorationReport::status`].
    pub status: u32,
    /// Number of `leftovers` in use. Read them by [`ExplorationReport::leftovers`].
    pub leftovers_len: u32,
    /// Number of all leftovers, those included that have no place here.
    pub leftovers_count: u32,
    /// Number of bytes of `reason` in use. Read them by [`ExplorationReport::reason`].
    pub reason_len: u32,
    /// Codes of an [`ExplorerState`] for each robot. Read them by [`ExplorationReport::robot`].
    pub robots: [u8; ROBOTS_MAX],
    /// Why it stands or is over, in UTF-8. Read it by [`ExplorationReport::reason`].
    pub reason: [u8; REASON_BYTES_MAX],
    /// Storage of the leftovers, largest first. Read it by [`ExplorationReport::leftovers`].
    pub leftovers: [ExplorationLeftover; LEFTOVERS_MAX],
}

impl Default for ExplorationReport {
    fn default() -> Self {
        Self {
            elapsed_s: f64::NAN,
            known_m2: f64::NAN,
            least_s: f64::NAN,
            most_s: f64::NAN,
            ..Self::zeroed()
        }
    }
}

impl ExplorationReport {
    /// Decodes the state; an unknown code reads as [`ExplorationStatus::Idle`].
    pub fn status(&self) -> ExplorationStatus {
        let code = |status: &ExplorationStatus| *status as u32 == self.status;
        ExplorationStatus::ALL.into_iter().find(code).unwrap_or(ExplorationStatus::Idle)
    }

    /// Decodes the part of the robot with this index; an unknown code reads as [`ExplorerState::None`].
    pub fn robot(&self, index: usize) -> ExplorerState {
        let code = self.robots.get(index).copied().unwrap_or(0);
        ExplorerState::ALL.into_iter().find(|state| *state as u8 == code).unwrap_or(ExplorerState::None)
    }

    /// Returns the leftovers in use.
    pub fn leftovers(&self) -> &[ExplorationLeftover] {
        &self.leftovers[..(self.leftovers_len as usize).min(LEFTOVERS_MAX)]
    }

    /// Sets the leftovers: the first [`LEFTOVERS_MAX`], and the number of all.
    pub fn set_leftovers(&mut self, leftovers: &[ExplorationLeftover]) {
        let len = leftovers.len().min(LEFTOVERS_MAX);
        self.leftovers[..len].copy_from_slice(&leftovers[..len]);
        (self.leftovers_len, self.leftovers_count) = (len as u32, leftovers.len() as u32);
    }

    /// Returns the reason; empty if it is not UTF-8.
    pub fn reason(&self) -> &str {
        bounded_text::read(&self.reason, self.reason_len)
    }

    /// Sets the reason, cut to 128 bytes at the end of a character.
    pub fn set_reason(&mut self, reason: &str) {
        self.reason_len = bounded_text::write(reason, &mut self.reason);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exploration_may_drive_all_robots_but_those_that_persons_have() {
        let left_alone: Vec<ExplorerState> =
            ExplorerState::ALL.into_iter().filter(|state| !state.may_drive()).collect();
        assert_eq!(left_alone, [ExplorerState::None, ExplorerState::Manual]);
    }

    #[test]
    fn damaged_messages_are_read_within_their_bounds() {
        let command = ExplorationCommand { action: 99, ..Default::default() };
        assert_eq!(command.action(), None);
        let mut report = ExplorationReport {
            leftovers_len: u32::MAX,
            reason_len: u32::MAX,
            status: 99,
            ..Default::default()
        };
        report.robots[3] = 77;
        assert_eq!((report.leftovers().len(), report.reason().len()), (LEFTOVERS_MAX, REASON_BYTES_MAX));
        assert_eq!((report.status(), report.robot(3)), (ExplorationStatus::Idle, ExplorerState::None));
        assert_eq!(report.leftovers()[0].reason(), None);
        report.set_leftovers(&[ExplorationLeftover::default(); LEFTOVERS_MAX + 3]);
        assert_eq!((report.leftovers().len(), report.leftovers_count), (LEFTOVERS_MAX, 19));
        report.set_reason(&"ä".repeat(100));
        assert_eq!(report.reason(), "ä".repeat(64));
    }
}
