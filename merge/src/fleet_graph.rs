//! Robots that started anywhere, and maps that drift has bent: one joint pose graph of the fleet.
//!
//! ```text
//! robotK/submap, submap_poses ─▶ pairs: align whole maps ─▶ gate, a second look ─▶ placed
//!                                          │ match submaps, verify ─▶ closures
//!                                          ▼
//!             closures that can be true together (PCM) ─▶ solve ─▶ anchors, straightened maps
//! ```
//!
//! The fleet only books; whatever takes time is a [`Task`] that any thread can do. One task is out at
//! a time, and in which order they come depends on the messages alone.

mod belief;
mod clique;
mod closure;
mod compose;
mod joint;
mod member;
mod pair;
mod snapshot;
mod task;

pub use snapshot::{FleetSnapshot, SnapshotRejected};
pub use task::{Outcome, Task};

use crate::align::AlignConfig;
use crate::merger::is_near;
use member::{Member, Straightened, SubmapRun};
use msg::{
    EdgeAction, EdgeState, Grid, MERGE_EDGES_MAX, MergeEdges, Pose2, ROBOTS_MAX, RobotId, Submap, SubmapPoses,
};
use pair::Pair;
use std::sync::Arc;
use task::{Answer, Job};

/// Attempts at the end, when nothing grows any more: each kind twice.
const LAST_TRIES: u32 = 6;

/// Why a message was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SubmapRejected {
    /// There is no such robot.
    #[error("{0} is not of this fleet")]
    UnknownRobot(RobotId),
    /// Numbers that make no sense.
    #[error("a submap or pose of {0} makes no sense")]
    Malformed(RobotId),
}

/// See the module.
pub struct FleetPoseGraph {
    align: AlignConfig,
    members: Vec<Member>,
    pairs: Vec<Pair>,
    /// The robot whose map the fleet's frame was taken from, and where it lies in it.
    holder: Option<(usize, Pose2)>,
    /// A task is out.
    busy: bool,
    /// Something came that may move the graph.
    unsolved: bool,
    /// Nothing more will come: every pair may be tried again, though it has not grown.
    last_round: bool,
    solutions: u64,
}

impl FleetPoseGraph {
    /// `starts` says where each robot's map lies, `map` from `robotK/map`, where that is known. If none
    /// is, the first robot that sends a map is where the fleet's frame comes from.
    pub fn new(align: &AlignConfig, starts: &[Option<Pose2>]) -> Self {
        let member = |start: &Option<Pose2>| {
            let start = start.filter(|start| is_near(*start));
            Member { start, anchor: start, corrections: start.into_iter().collect(), ..Member::default() }
        };
        let members: Vec<Member> = starts.iter().take(ROBOTS_MAX).map(member).collect();
        let pairs = vec![Pair::default(); members.len() * members.len().saturating_sub(1) / 2];
        Self {
            align: align.clone(),
            members,
            pairs,
            holder: None,
            busy: false,
            unsolved: false,
            last_round: false,
            solutions: 0,
        }
    }

    /// Takes a robot's submap, new or as it has grown.
    pub fn add_submap(&mut self, robot: RobotId, submap: &Submap) -> Result<(), SubmapRejected> {
        self.note_run(robot, (submap.grid.header.incarnation, submap.generation))?;
        let taken = self.members[robot.index()].submap(submap);
        if taken { Ok(()) } else { Err(SubmapRejected::Malformed(robot)) }
    }

    /// Takes where a robot's submaps lie in its own map.
    pub fn update_poses(&mut self, robot: RobotId, poses: &SubmapPoses) -> Result<(), SubmapRejected> {
        self.note_run(robot, (poses.header.incarnation, poses.generation))?;
        let index = robot.index();
        let new = self.members[index].take_poses(poses).ok_or(SubmapRejected::Malformed(robot))?;
        let begun = new && !self.members[index].poses.is_empty();
        if begun && self.holder.is_none() && self.members.iter().all(|member| member.start.is_none()) {
            self.hold(index, Pose2::IDENTITY);
        }
        self.unsolved |= new && self.members[index].anchor.is_some();
        Ok(())
    }

    /// Number of submaps that the robot's poses name and that have not arrived.
    pub fn missing_submaps(&self, robot: RobotId) -> usize {
        self.members.get(robot.index()).map_or(0, Member::missing_submaps)
    }

    /// A robot has left, or begins anew somewhere else: all that is known of it is forgotten. The
    /// fleet's frame stays.
    pub fn remove_robot(&mut self, robot: RobotId) {
        let index = robot.index();
        let Some(member) = self.members.get_mut(index) else { return };
        *member = Member { version: member.version + 1, ..Member::default() };
        for pair in 0..self.pairs.len() {
            if robots_of(pair).contains(&index) {
                self.pairs[pair] = Pair::default();
            }
        }
        self.pass_frame_on(index);
        self.connect();
        self.unsolved = true;
    }

    /// The operator's word on an edge, by its number. False if there is no such edge, or nothing is known of it.
    pub fn apply_command(&mut self, edge: u32, action: EdgeAction) -> bool {
        let Some(index) = (edge as usize).checked_sub(1).filter(|index| *index < self.pairs.len()) else {
            return false;
        };
        let [a, b] = robots_of(index);
        let anchored = self.members[a].anchor.zip(self.members[b].anchor).map(|(a, b)| a.between(b));
        let pair = &mut self.pairs[index];
        match action {
            EdgeAction::Pin if pair.state() == EdgeState::None && anchored.is_none() => return false,
            EdgeAction::Pin => {
                if !pair.state().in_force() {
                    // The operator's word is above the gate's: what was found is held, even if it was undone.
                    pair.refused.retain(|refused| !Pair::same(*refused, pair.a_from_b));
                    if pair.state() == EdgeState::None {
                        pair.a_from_b = anchored.unwrap_or(pair.a_from_b);
                    }
                }
                pair.state = Some(EdgeState::Pinned);
            }
            EdgeAction::Unpin if pair.state() != EdgeState::Pinned => return false,
            EdgeAction::Unpin => pair.state = Some(EdgeState::Accepted),
            EdgeAction::Undo if !pair.state().in_force() && pair.state() != EdgeState::Candidate => {
                return false;
            }
            EdgeAction::Undo => {
                let place = anchored.filter(|_| pair.state().in_force()).unwrap_or(pair.a_from_b);
                pair.undo(place);
            }
        }
        self.connect();
        self.unsolved = true;
        true
    }

    /// The next piece of work, if there is any and none is out. What comes of it goes to [`FleetPoseGraph::apply_outcome`].
    pub fn next_task(&mut self) -> Option<Task> {
        if self.busy {
            return None;
        }
        let task = self
            .solve_task()
            .or_else(|| self.straighten_task())
            .or_else(|| self.match_task())
            .or_else(|| self.assess_task())
            .or_else(|| self.align_task());
        self.busy = task.is_some();
        task
    }

    /// Takes what came of a task.
    pub fn apply_outcome(&mut self, outcome: Outcome) {
        self.busy = false;
        if outcome.runs != self.runs() {
            // A robot began again meanwhile: the work is about what no longer is.
            self.unsolved = true;
            return;
        }
        match outcome.answer {
            Answer::Align { pair, nodes, found } => self.aligned(pair, nodes, found),
            Answer::Assess { pair, found } => self.assessed(pair, found),
            Answer::Match { pair, ids, found } => {
                let [a, b] = robots_of(pair);
                self.pairs[pair].matched(&self.members[a], &self.members[b], ids, found);
                self.unsolved |= found.is_some();
            }
            Answer::Solve(solution) => self.solved(solution),
            Answer::Straighten { robot, version, anchor, corrections, grid } => {
                let member = &mut self.members[robot];
                // A robot that could not be drawn keeps the map it draws itself.
                let grid = Arc::new(grid.unwrap_or_default());
                member.straightened = Some(Straightened { grid, version, anchor, corrections });
            }
        }
    }

    /// Nothing more will come: newest submaps are complete, and every pair gets another look.
    pub fn finish(&mut self) {
        self.last_round = true;
        self.unsolved = true;
        for pair in &mut self.pairs {
            (pair.last_tries, pair.assessed_at) = (LAST_TRIES, 0);
        }
    }

    /// `map` from `robotK/map` as it is where the robot is now; `None` while that is not known.
    pub fn map_from_robot_map(&self, robot: RobotId) -> Option<Pose2> {
        self.members.get(robot.index())?.anchor
    }

    /// `map` from `robotK/map` at one of its submaps.
    pub fn map_from_robot_map_at(&self, robot: RobotId, submap: u32) -> Option<Pose2> {
        self.members.get(robot.index())?.correction(submap as usize)
    }

    /// The robot's map redrawn from its submaps, frame `robotK/map` as [`FleetPoseGraph::map_from_robot_map`] has it: where
    /// the anchor alone would be off by more than half a cell somewhere. `None`: its own map is right.
    pub fn redrawn_map(&self, robot: RobotId) -> Option<&Arc<Grid>> {
        let drawn = self.members.get(robot.index())?.straightened.as_ref()?;
        Some(&drawn.grid).filter(|grid| !grid.cells.is_empty())
    }

    /// What is believed about each pair of robots, and on what grounds.
    pub fn write_edges(&self, out: &mut MergeEdges) {
        let edges = self.pairs.iter().enumerate().take(MERGE_EDGES_MAX);
        for (slot, (index, pair)) in out.edges.iter_mut().zip(edges) {
            *slot = pair.edge(index, robots_of(index));
        }
        out.len = self.pairs.len().min(MERGE_EDGES_MAX) as u32;
    }

    /// Solutions of the joint graph so far.
    pub fn solve_count(&self) -> u64 {
        self.solutions
    }

    fn runs(&self) -> Vec<Option<SubmapRun>> {
        self.members.iter().map(|member| member.run).collect()
    }

    fn task(&self, job: Job) -> Option<Task> {
        Some(Task { runs: self.runs(), job })
    }

    /// A robot whose SLAM was started again goes on in the same frame, with new submaps. One that has fewer of them
    /// than before begins anew within one incarnation, which their generation says.
    fn note_run(&mut self, robot: RobotId, run: SubmapRun) -> Result<(), SubmapRejected> {
        let index = robot.index();
        let member = self.members.get_mut(index).ok_or(SubmapRejected::UnknownRobot(robot))?;
        if member.run == Some(run) {
            return Ok(());
        }
        let again = member.run.is_some();
        member.run = Some(run);
        if again {
            member.begin_again();
            member.run = Some(run);
            for pair in 0..self.pairs.len() {
                let [a, b] = robots_of(pair);
                if [a, b].contains(&index) {
                    let anchors = self.members[a].anchor.zip(self.members[b].anchor);
                    self.pairs[pair].begin_again(anchors.map(|(a, b)| a.between(b)));
                }
            }
            if let Some((holder, pose)) = &mut self.holder
                && *holder == index
            {
                *pose = self.members[index].anchor.unwrap_or(*pose);
            }
        }
        Ok(())
    }

    fn hold(&mut self, index: usize, map_from_robot_map: Pose2) {
        self.holder = Some((index, map_from_robot_map));
        let member = &mut self.members[index];
        member.anchor = Some(map_from_robot_map);
        member.corrections = vec![map_from_robot_map];
        self.unsolved = true;
    }

    /// The fleet's frame does not go with the robot it came from.
    fn pass_frame_on(&mut self, gone: usize) {
        if self.holder.is_none_or(|(holder, _)| holder != gone) {
            return;
        }
        let next = (0..self.members.len()).find(|k| !self.members[*k].corrections.is_empty());
        self.holder = next.map(|k| (k, self.members[k].corrections[0]));
    }
}

/// (0, 1), (0, 2), (1, 2), (0, 3), ...: a small fleet's pairs come first.
fn robots_of(pair: usize) -> [usize; 2] {
    let j = (1..ROBOTS_MAX).rfind(|j| j * (j - 1) / 2 <= pair).unwrap_or(1);
    [pair - j * (j - 1) / 2, j]
}

#[cfg(test)]
mod tests;
