//! What merging believes about how robots' maps lie to each other, and on what grounds.

use crate::{Header, Pose2, ROBOTS_MAX, RobotId};
use bytemuck::{Pod, Zeroable};

/// Pairs in the largest fleet.
pub const MERGE_EDGES_MAX: usize = ROBOTS_MAX * (ROBOTS_MAX - 1) / 2;

/// What has become of a merge edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum EdgeState {
    /// Nothing found yet that passed the gate.
    None = 0,
    /// Passed the gate once, waits for a second look.
    Candidate = 1,
    /// In force.
    Accepted = 2,
    /// In force, and stays so whatever comes: the operator's word.
    Pinned = 3,
    /// Taken back by the operator: this place is not accepted again.
    Undone = 4,
    /// Taken back because the maps came to contradict it: it may be accepted again.
    Dropped = 5,
}

impl EdgeState {
    /// `None` for a code that no state has.
    pub fn from_code(code: u32) -> Option<Self> {
        use EdgeState::{Accepted, Candidate, Dropped, None, Pinned, Undone};
        [None, Candidate, Accepted, Pinned, Undone, Dropped].into_iter().find(|s| *s as u32 == code)
    }

    /// One word for tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Candidate => "candidate",
            Self::Accepted => "accepted",
            Self::Pinned => "pinned",
            Self::Undone => "undone",
            Self::Dropped => "dropped",
        }
    }

    /// Whether it holds two maps together.
    pub fn in_force(self) -> bool {
        matches!(self, Self::Accepted | Self::Pinned)
    }
}

/// How one robot's map lies in another's, and what speaks for it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct MergeEdge {
    /// The pair's number, from 1: stays the same for the whole run.
    pub id: u32,
    /// The robot it is seen from: its number, from 1.
    pub a: u32,
    /// The robot that is seen: its number, from 1.
    pub b: u32,
    /// An [`EdgeState`]'s code. Read it by [`MergeEdge::state`].
    pub state: u32,
    /// `robotA/map` from `robotB/map`.
    pub a_from_b: Pose2,
    /// Occupied cells found again, of both maps together.
    pub inliers: u32,
    /// Closures between submaps in force.
    pub closures: u32,
    /// Closures found and not believed together with the others.
    pub closures_rejected: u32,
    /// Alignments tried.
    pub tries: u32,
    /// Mean distance of walls found again, metres.
    pub residual_m: f64,
    /// Mean distance by which the fleet's graph leaves its closures, metres.
    pub closure_residual_m: f64,
    /// What both maps know, square metres.
    pub overlap_m2: f64,
    /// The same over what the map that knows less knows, 0 to 1.
    pub overlap_share: f64,
    /// Share of the cells both know on which they agree, 0 to 1.
    pub agreement: f64,
    /// F1 of occupied cells at one cell's tolerance, 0 to 1.
    pub occupied_f1: f64,
    /// The largest such F1 under 20 random wrong transforms: what chance gives.
    pub null_f1_max: f64,
    /// Walls of one map in the middle of the other's floor, 0 to 1.
    pub conflict: f64,
    /// Evidence over that of the best other place.
    pub margin: f64,
}

impl MergeEdge {
    /// The checked state; an unknown code reads as none.
    pub fn state(&self) -> EdgeState {
        EdgeState::from_code(self.state).unwrap_or(EdgeState::None)
    }
}

/// All merge edges of a fleet.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct MergeEdges {
    /// `stamp` is that of the newest map merged.
    pub header: Header,
    /// How many of `edges` are set. Read them by [`MergeEdges::edges`].
    pub len: u32,
    /// Commands answered so far.
    pub commands: u32,
    /// How many of them were refused: no such edge, or nothing known of it.
    pub refused: u32,
    /// Zero.
    pub reserved: u32,
    /// Pairs of robots; (1, 2), (1, 3), (2, 3), (1, 4) ...
    pub edges: [MergeEdge; MERGE_EDGES_MAX],
}

impl Default for MergeEdges {
    fn default() -> Self {
        Self::zeroed()
    }
}

impl MergeEdges {
    /// The set edges.
    pub fn edges(&self) -> &[MergeEdge] {
        &self.edges[..(self.len as usize).min(MERGE_EDGES_MAX)]
    }
}

/// The operator's word on an edge.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct EdgeCommand {
    /// When it was said.
    pub header: Header,
    /// The edge's number.
    pub edge: u32,
    /// An [`EdgeAction`]'s code.
    pub action: u32,
}

impl EdgeCommand {
    /// The command for a pair of robots, in any order. `None` if they are one.
    pub fn of(action: EdgeAction, a: RobotId, b: RobotId) -> Option<Self> {
        let (low, high) = (a.index().min(b.index()), a.index().max(b.index()));
        let edge = (high * high.saturating_sub(1) / 2 + low + 1) as u32;
        (low != high).then(|| Self { edge, action: action as u32, ..Self::default() })
    }

    /// As people say it: `pin 1 2`, `unpin 1 2`, `undo 1 2`, with the robots' numbers.
    pub fn parse(text: &str) -> Option<Self> {
        let mut words = text.split_whitespace();
        let action = match words.next()? {
            "pin" => EdgeAction::Pin,
            "unpin" => EdgeAction::Unpin,
            "undo" => EdgeAction::Undo,
            _ => return None,
        };
        let mut robot = || RobotId::new(words.next()?.parse().ok()?);
        let command = Self::of(action, robot()?, robot()?);
        command.filter(|_| words.next().is_none())
    }
}

/// What an operator can do to an edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum EdgeAction {
    /// It stays as it is found, whatever comes.
    Pin = 1,
    /// It is taken back, and the same place is not accepted again.
    Undo = 2,
    /// No longer pinned: it holds as long as the maps agree.
    Unpin = 3,
}

impl EdgeAction {
    /// `None` for a code that no action has.
    pub fn from_code(code: u32) -> Option<Self> {
        [Self::Pin, Self::Undo, Self::Unpin].into_iter().find(|action| *action as u32 == code)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_words() {
        let edge = |text| EdgeCommand::parse(text).map(|command| (command.edge, command.action));
        assert_eq!(edge("pin 1 2"), Some((1, EdgeAction::Pin as u32)));
        assert_eq!(edge(" undo 3 1 "), Some((2, EdgeAction::Undo as u32)));
        assert_eq!(edge("unpin 16 15"), Some((MERGE_EDGES_MAX as u32, EdgeAction::Unpin as u32)));
        for wrong in
            ["", "pin", "pin 1", "pin 1 1", "pin 0 1", "pin 1 17", "pin 1 2 3", "keep 1 2", "pin 1 -2"]
        {
            assert_eq!(edge(wrong), None, "{wrong}");
        }
    }
}
