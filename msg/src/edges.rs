//! Messages with the transforms between pairs of robots' maps (merge edges) and their evidence.

use crate::{AlignmentRefusal, CommandSource, Header, Pose2, ROBOTS_MAX, RobotId};
use bytemuck::{Pod, Zeroable};

/// Most edges in one message: all pairs of 16 robots. Those of the largest fleet would have 0.3 MB.
pub const MERGE_EDGES_MAX: usize = 120;

/// State of a merge edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum EdgeState {
    /// No alignment has passed the acceptance test yet.
    None = 0,
    /// An alignment passed the acceptance test once and waits for a second, independent one.
    Candidate = 1,
    /// The edge is part of the fleet's pose graph.
    Accepted = 2,
    /// The edge is part of the graph and stays so, because the operator pinned it.
    Pinned = 3,
    /// The operator rejected the edge: this alignment is never accepted again.
    Undone = 4,
    /// The edge was removed because later maps contradict it. It may be accepted again.
    Dropped = 5,
}

impl EdgeState {
    /// Decodes a state; `None` for an unknown code.
    pub fn from_code(code: u32) -> Option<Self> {
        use EdgeState::{Accepted, Candidate, Dropped, None, Pinned, Undone};
        [None, Candidate, Accepted, Pinned, Undone, Dropped].into_iter().find(|s| *s as u32 == code)
    }

    /// Returns the state's name in tables and in JSON.
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

    /// Returns whether the edge joins the two maps.
    pub fn is_active(self) -> bool {
        matches!(self, Self::Accepted | Self::Pinned)
    }
}

/// Transform between two robots' maps, with its evidence.
// More than 12 fields: the message is one row of measurements, in a fixed layout.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct MergeEdge {
    /// Number of the pair, from 1. It stays the same for the whole run.
    pub id: u32,
    /// Number, from 1, of the robot in whose map the transform is expressed.
    pub a: u32,
    /// Number, from 1, of the robot whose map is transformed.
    pub b: u32,
    /// Code of an [`EdgeState`]. Read it by [`MergeEdge::state`].
    pub state: u32,
    /// Transform to `robotA/map` from `robotB/map`.
    pub a_from_b: Pose2,
    /// Number of occupied cells that match a cell of the other map, of both maps together.
    pub inliers: u32,
    /// Number of accepted loop closures between submaps of the two robots.
    pub closures: u32,
    /// Number of closures that were rejected as inconsistent with the others.
    pub closures_rejected: u32,
    /// Number of alignments attempted.
    pub tries: u32,
    /// Code of an [`AlignmentRefusal`], why the newest alignment did not join the two maps; 0: none, or no alignment was tried.
    pub refusal: u32,
    /// 0: fills the row up to eight bytes.
    pub reserved: u32,
    /// Number of submaps of both robots that share walls with the other robot's map, at the newest check.
    pub compared_submaps: u32,
    /// Number of these that the other map contradicts: its floor is where their walls are.
    pub contradicted_submaps: u32,
    /// Mean distance between matched walls, metres.
    pub residual_m: f64,
    /// Mean residual of the closures in the fleet's pose graph, metres.
    pub closure_residual_m: f64,
    /// Area that both maps know, square metres.
    pub overlap_m2: f64,
    /// `overlap_m2` over the area of the map that knows less, 0 to 1.
    pub overlap_share: f64,
    /// Share of the cells known in both maps on which they agree, 0 to 1.
    pub agreement: f64,
    /// F1 score of occupied cells with a tolerance of one cell, 0 to 1.
    pub occupied_f1: f64,
    /// Largest such F1 score under 20 random wrong transforms: the level of chance.
    pub null_f1_max: f64,
    /// Share of one map's walls that lie in free space of the other map, 0 to 1.
    pub conflict: f64,
    /// Evidence over the evidence of the best different alignment.
    pub margin: f64,
}

/// Least number of contradicted submaps, and their least share of the compared ones, from which two maps contradict each other.
/// Few of right pairs have one, where furniture was moved.
const CONTRADICTED_SUBMAPS_MIN: (u32, f64) = (2, 0.1);

impl MergeEdge {
    /// Returns whether the two maps contradict each other in places where the fleet's graph has them: one of them is deformed, or lies
    /// wrong.
    pub fn is_contradicted(&self) -> bool {
        let (count_min, share_min) = CONTRADICTED_SUBMAPS_MIN;
        let share = f64::from(self.contradicted_submaps) / f64::from(self.compared_submaps.max(1));
        self.contradicted_submaps >= count_min && share >= share_min
    }

    /// Returns why the newest alignment did not join the two maps; `None` if it did, or none was tried.
    pub fn refusal(&self) -> Option<AlignmentRefusal> {
        AlignmentRefusal::from_code(self.refusal)
    }

    /// Decodes the state; an unknown code reads as [`EdgeState::None`].
    pub fn state(&self) -> EdgeState {
        EdgeState::from_code(self.state).unwrap_or(EdgeState::None)
    }
}

/// Message with all merge edges of a fleet.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct MergeEdges {
    /// Header whose `stamp` is that of the newest merged map.
    pub header: Header,
    /// Number of `edges` in use. Read them by [`MergeEdges::edges`].
    pub len: u32,
    /// Number of commands answered since the start.
    pub commands: u32,
    /// Number of those commands that were refused: no such edge, or no transform known for it.
    pub refused: u32,
    /// Number of edges that have no place in the message.
    pub left_out: u32,
    /// 1 if the newest state, with what the operator said, is not in its file: merging that is started again does not know it.
    pub unsaved: u32,
    /// Padding, always zero.
    pub reserved: u32,
    /// Robots whose given start the maps contradict, as bits by [`RobotId::index`]. Read them by
    /// [`MergeEdges::contradicted_starts`].
    pub contradicted_start_bits: u64,
    /// Edges in the order of pairs of robots (1, 2), (1, 3), (2, 3), (1, 4) and so on. Of a fleet with more pairs than
    /// places, those that were never found are left out first.
    pub edges: [MergeEdge; MERGE_EDGES_MAX],
}

impl Default for MergeEdges {
    fn default() -> Self {
        Self::zeroed()
    }
}

impl MergeEdges {
    /// Returns the edges in use.
    pub fn edges(&self) -> &[MergeEdge] {
        &self.edges[..(self.len as usize).min(MERGE_EDGES_MAX)]
    }

    /// Returns the robots whose given start the maps contradict. These starts are not used.
    pub fn contradicted_starts(&self) -> impl Iterator<Item = RobotId> {
        RobotId::first(ROBOTS_MAX).filter(|robot| self.contradicted_start_bits & (1 << robot.index()) != 0)
    }
}

/// Command of the operator on one merge edge.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct EdgeCommand {
    /// Header whose `stamp` is the time of the command.
    pub header: Header,
    /// Number of the edge, [`MergeEdge::id`].
    pub edge: u32,
    /// Code of an [`EdgeAction`].
    pub action: u32,
    /// Who sent it.
    pub sender: CommandSource,
}

impl EdgeCommand {
    /// Builds the command for a pair of robots, in any order. `None` if both are the same robot.
    pub fn for_pair(action: EdgeAction, a: RobotId, b: RobotId) -> Option<Self> {
        let (low, high) = (a.index().min(b.index()), a.index().max(b.index()));
        let edge = (high * high.saturating_sub(1) / 2 + low + 1) as u32;
        (low != high).then(|| Self { edge, action: action as u32, ..Self::default() })
    }

    /// Returns the number of the later one of the two robots.
    pub fn later_robot(&self) -> usize {
        let fits = |number: &usize| number * (number - 1) / 2 >= self.edge as usize;
        (2..ROBOTS_MAX).find(fits).unwrap_or(ROBOTS_MAX)
    }

    /// Parses `pin 1 2`, `unpin 1 2` or `undo 1 2`, with the robots' numbers.
    pub fn parse(text: &str) -> Option<Self> {
        let mut words = text.split_whitespace();
        let action = match words.next()? {
            "pin" => EdgeAction::Pin,
            "unpin" => EdgeAction::Unpin,
            "undo" => EdgeAction::Undo,
            _ => return None,
        };
        let mut robot = || RobotId::new(words.next()?.parse().ok()?);
        let command = Self::for_pair(action, robot()?, robot()?);
        command.filter(|_| words.next().is_none())
    }
}

/// Action of the operator on a merge edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum EdgeAction {
    /// Keeps the edge as it is, whatever later maps say.
    Pin = 1,
    /// Removes the edge and never accepts the same alignment again.
    Undo = 2,
    /// Ends the pin: the edge stays as long as the maps agree.
    Unpin = 3,
}

impl EdgeAction {
    /// Decodes an action; `None` for an unknown code.
    pub fn from_code(code: u32) -> Option<Self> {
        [Self::Pin, Self::Undo, Self::Unpin].into_iter().find(|action| *action as u32 == code)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parses_commands_and_refuses_everything_else() {
        let edge = |text| EdgeCommand::parse(text).map(|command| (command.edge, command.action));
        assert_eq!(edge("pin 1 2"), Some((1, EdgeAction::Pin as u32)));
        assert_eq!(edge(" undo 3 1 "), Some((2, EdgeAction::Undo as u32)));
        assert_eq!(edge("unpin 16 15"), Some((MERGE_EDGES_MAX as u32, EdgeAction::Unpin as u32)));
        for (a, b) in (2..=ROBOTS_MAX).flat_map(|b| (1..b).map(move |a| (a, b))) {
            let command = EdgeCommand::parse(&format!("pin {a} {b}")).unwrap();
            assert_eq!(command.later_robot(), b);
        }
        for wrong in
            ["", "pin", "pin 1", "pin 1 1", "pin 0 1", "pin 1 65", "pin 1 2 3", "keep 1 2", "pin 1 -2"]
        {
            assert_eq!(edge(wrong), None, "{wrong}");
        }
    }
}
