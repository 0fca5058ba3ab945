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

mod clique;
mod closure;
mod compose;
mod graph;
mod member;
mod pair;
mod task;

pub use task::{Outcome, Task};

use crate::align::{AlignConfig, Alignment};
use crate::merger::is_near;
use graph::{Constraint, certain_to};
use member::{Member, Straightened, SubmapRun};
use msg::{
    EdgeAction, EdgeState, Grid, MERGE_EDGES_MAX, MergeEdges, Pose2, ROBOTS_MAX, RobotId, Submap, SubmapPoses,
};
use pair::Pair;
use std::sync::Arc;
use task::{Answer, Job, Problem, ProblemPair, Solution};

/// Robots with fewer nodes are not aligned.
const ALIGN_NODES: u32 = 8;
/// A pair is tried again when the two have so many times the nodes, and so many more.
const GROWN: f64 = 1.15;
const GROWN_NODES: u32 = 4;
/// Attempts at the end, when nothing grows any more: each kind twice.
const LAST_TRIES: u32 = 6;
/// While a find waits for its second look, so many more are enough.
const GROWN_NODES_AGAIN: u32 = 2;
/// What two maps agree on must be ahead of chance by this much F1.
const AHEAD_OF_CHANCE: f64 = 0.3;
/// A pair in force is looked at again when the two have so many times the nodes.
const ASSESS_GROWN: f64 = 1.25;
/// Below this F1 (and with an overlap that says something) the maps contradict the edge; a second
/// time drops it. Right places have 0.8 and more, wrong ones 0.2 and less.
const CONTRADICTED_F1: f64 = 0.4;
const CONTRADICTED_OVERLAP_M2: f64 = 10.0;
/// A window of a robot's map: its newest submaps, if it has twice as many.
const WINDOW: usize = 5;
/// Closures that make an edge of two robots that others had brought together.
const CLOSURES_MIN: usize = 2;
/// How well a given start is known, metres and radians; and the frame of the fleet itself.
const START: [f64; 2] = [0.02, 0.005];
const FRAME: [f64; 2] = [1e-3, 1e-4];
/// Anchors and drawn maps follow the graph in steps of half a cell of 0.05 m.
const TOLERANCE_M: f64 = 0.025;

/// Why a message was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FleetRefused {
    /// There is no such robot.
    #[error("{0} is not of this fleet")]
    Stranger(RobotId),
    /// Numbers that make no sense.
    #[error("a submap or pose of {0} makes no sense")]
    Malformed(RobotId),
}

/// See the module.
pub struct Fleet {
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

impl Fleet {
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
    pub fn submap(&mut self, robot: RobotId, submap: &Submap) -> Result<(), FleetRefused> {
        self.note_run(robot, (submap.grid.header.run, submap.generation))?;
        let taken = self.members[robot.index()].submap(submap);
        if taken { Ok(()) } else { Err(FleetRefused::Malformed(robot)) }
    }

    /// Takes where a robot's submaps lie in its own map.
    pub fn poses(&mut self, robot: RobotId, poses: &SubmapPoses) -> Result<(), FleetRefused> {
        self.note_run(robot, (poses.header.run, poses.generation))?;
        let index = robot.index();
        let new = self.members[index].take_poses(poses).ok_or(FleetRefused::Malformed(robot))?;
        let begun = new && !self.members[index].poses.is_empty();
        if begun && self.holder.is_none() && self.members.iter().all(|member| member.start.is_none()) {
            self.hold(index, Pose2::IDENTITY);
        }
        self.unsolved |= new && self.members[index].anchor.is_some();
        Ok(())
    }

    /// Whether submaps are missing that the robot's poses speak of.
    pub fn lacks(&self, robot: RobotId) -> bool {
        self.members.get(robot.index()).is_some_and(Member::lacks)
    }

    /// A robot has left, or begins anew somewhere else: all that is known of it is forgotten. The
    /// fleet's frame stays.
    pub fn forget(&mut self, robot: RobotId) {
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
    pub fn command(&mut self, edge: u32, action: EdgeAction) -> bool {
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

    /// The next piece of work, if there is any and none is out. What comes of it goes to [`Fleet::take`].
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
    pub fn take(&mut self, outcome: Outcome) {
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
    pub fn anchor(&self, robot: RobotId) -> Option<Pose2> {
        self.members.get(robot.index())?.anchor
    }

    /// `map` from `robotK/map` at one of its submaps.
    pub fn correction(&self, robot: RobotId, submap: u32) -> Option<Pose2> {
        self.members.get(robot.index())?.correction(submap as usize)
    }

    /// The robot's map redrawn from its submaps, frame `robotK/map` as [`Fleet::anchor`] has it: where
    /// the anchor alone would be off by more than half a cell somewhere. `None`: its own map is right.
    pub fn straightened(&self, robot: RobotId) -> Option<&Arc<Grid>> {
        let drawn = self.members.get(robot.index())?.straightened.as_ref()?;
        Some(&drawn.grid).filter(|grid| !grid.cells.is_empty())
    }

    /// What is believed about each pair of robots, and on what grounds.
    pub fn edges(&self, out: &mut MergeEdges) {
        let edges = self.pairs.iter().enumerate().take(MERGE_EDGES_MAX);
        for (slot, (index, pair)) in out.edges.iter_mut().zip(edges) {
            *slot = pair.edge(index, robots_of(index));
        }
        out.len = self.pairs.len().min(MERGE_EDGES_MAX) as u32;
    }

    /// Solutions of the joint graph so far.
    pub fn solutions(&self) -> u64 {
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
    fn note_run(&mut self, robot: RobotId, run: SubmapRun) -> Result<(), FleetRefused> {
        let index = robot.index();
        let member = self.members.get_mut(index).ok_or(FleetRefused::Stranger(robot))?;
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

    /// Robots that nothing in force ties to the fleet's frame are taken out; those newly tied get a place.
    fn connect(&mut self) {
        let mut reached: Vec<bool> = self.members.iter().map(|member| member.start.is_some()).collect();
        if let Some((holder, _)) = self.holder {
            reached[holder] = true;
        }
        // As often as there are robots: a path has no more edges.
        for _ in 0..self.members.len() {
            for (index, pair) in self.pairs.iter().enumerate().filter(|(_, pair)| pair.state().in_force()) {
                let [a, b] = robots_of(index);
                for (from, to, from_from_to) in [(a, b, pair.a_from_b), (b, a, pair.a_from_b.inverse())] {
                    if reached[from] && !reached[to] {
                        reached[to] = true;
                        let Some(anchor) = self.members[from].anchor else { continue };
                        let member = &mut self.members[to];
                        if member.anchor.is_none() {
                            let anchor = anchor * from_from_to;
                            (member.anchor, member.corrections) = (Some(anchor), vec![anchor]);
                        }
                    }
                }
            }
        }
        for (member, _) in self.members.iter_mut().zip(reached).filter(|(_, reached)| !*reached) {
            (member.anchor, member.bent, member.straightened) = (None, false, None);
            member.corrections.clear();
        }
    }

    fn solve_task(&mut self) -> Option<Task> {
        if !core::mem::take(&mut self.unsolved) {
            return None;
        }
        for (index, pair) in self.pairs.iter_mut().enumerate() {
            let [a, b] = robots_of(index);
            pair.sow(&self.members[a], &self.members[b]);
        }
        let mut problem = Problem {
            poses: vec![Pose2::IDENTITY],
            constraints: Vec::new(),
            members: Vec::new(),
            pairs: Vec::new(),
        };
        let mut place = vec![None; self.members.len()];
        for (index, member) in self.members.iter().enumerate() {
            let (Some(anchor), Some(own)) = (member.anchor, member.poses.first()) else { continue };
            let first = problem.poses.len();
            place[index] = Some(problem.members.len());
            problem.members.push((index, first, member.poses.clone()));
            problem.poses.extend(member.poses.iter().map(|pose| anchor * *pose));
            problem.constraints.extend(member.constraints(first));
            let held = self.holder.filter(|(holder, _)| *holder == index).map(|(_, pose)| (pose, FRAME));
            if let Some((pose, [m, rad])) = member.start.map(|start| (start, START)).or(held) {
                let information = certain_to(m, rad);
                problem.constraints.push(Constraint {
                    a: 0,
                    b: first,
                    a_from_b: pose * *own,
                    information,
                    robust: false,
                });
            }
        }
        for (index, pair) in self.pairs.iter().enumerate() {
            let [a, b] = robots_of(index);
            let (Some(m), Some(n)) = (place[a], place[b]) else { continue };
            let seed = pair.seed_constraint([problem.members[m].1, problem.members[n].1]);
            problem.pairs.push(ProblemPair {
                pair: index,
                members: [m, n],
                closures: pair.closures.clone(),
                seed,
            });
        }
        (!problem.members.is_empty()).then(|| self.task(Job::Solve(problem))).flatten()
    }

    fn solved(&mut self, solution: Solution) {
        self.solutions += 1;
        for (robot, corrections) in solution.members {
            if self.members[robot].anchor.is_some() {
                self.members[robot].settle(corrections, TOLERANCE_M);
            }
        }
        for (index, in_force, residual_m) in solution.pairs {
            let [a, b] = robots_of(index);
            let pair = &mut self.pairs[index];
            (pair.in_force, pair.residual_m) = (in_force, residual_m);
            if let Some((a, b)) = self.members[a].anchor.zip(self.members[b].anchor)
                && (pair.state().in_force() || pair.in_force.len() >= CLOSURES_MIN)
            {
                pair.a_from_b = a.between(b);
                if !pair.state().in_force() && !pair.is_refused(pair.a_from_b) {
                    pair.state = Some(EdgeState::Accepted);
                }
            }
        }
    }

    fn straighten_task(&self) -> Option<Task> {
        let robot = (0..self.members.len()).find(|k| self.members[*k].wants_straightening(TOLERANCE_M))?;
        let member = &self.members[robot];
        let anchor = member.anchor?;
        self.task(Job::Straighten {
            robot,
            version: member.version,
            anchor,
            corrections: member.corrections.clone(),
            placed: member.placed_in(anchor.inverse()),
        })
    }

    fn match_task(&self) -> Option<Task> {
        for (index, pair) in self.pairs.iter().enumerate() {
            let [a, b] = robots_of(index).map(|robot| &self.members[robot]);
            let Some((on_a, on_b)) = a.anchor.zip(b.anchor) else { continue };
            if pair.is_refused(on_a.between(on_b)) {
                continue;
            }
            let Some(next) = pair.next_match(a, b) else { continue };
            let [i, j] = next.ids;
            let (of_i, of_j) = a.piece(i).zip(b.piece(j))?;
            let grids = [of_i.0.grid.clone(), of_j.0.grid.clone()];
            let (predicted, window) = (next.predicted, next.window);
            return self.task(Job::Match { pair: index, ids: next.ids, grids, predicted, window });
        }
        None
    }

    /// Pairs in force whose maps have grown: do they still agree?
    fn assess_task(&mut self) -> Option<Task> {
        for (index, pair) in self.pairs.iter_mut().enumerate().filter(|(_, pair)| pair.state().in_force()) {
            let [a, b] = robots_of(index).map(|robot| &self.members[robot]);
            let nodes = a.nodes() + b.nodes();
            if a.anchor.is_none()
                || b.anchor.is_none()
                || f64::from(nodes) < ASSESS_GROWN * f64::from(pair.assessed_at)
            {
                continue;
            }
            pair.assessed_at = nodes.max(1);
            let [a, b] = [a, b].map(|member| member.placed_in(Pose2::IDENTITY));
            if a.is_empty() || b.is_empty() {
                continue;
            }
            return self.task(Job::Assess { pair: index, a, b });
        }
        None
    }

    fn assessed(&mut self, index: usize, found: Option<(Alignment, f64)>) {
        let pair = &mut self.pairs[index];
        let Some((found, null_f1)) = found.filter(|_| pair.state().in_force()) else { return };
        // Where the margin over other places was found, it stays: this look was at one place only.
        let margin = pair.grounds.as_ref().map_or(0.0, |(before, _)| before.margin);
        pair.grounds = Some((Alignment { a_from_b: pair.a_from_b, margin, ..found }, null_f1));
        let contradicted = found.overlap_m2 >= CONTRADICTED_OVERLAP_M2 && found.score < CONTRADICTED_F1;
        pair.contradictions = if contradicted { pair.contradictions + 1 } else { 0 };
        if contradicted {
            pair.assessed_at = 0;
        }
        if pair.contradictions >= 2 && pair.state() == EdgeState::Accepted {
            pair.let_go(EdgeState::Dropped);
            self.connect();
            self.unsolved = true;
        }
    }

    /// The pair that was tried least, of those that are not yet together and have grown.
    fn align_task(&mut self) -> Option<Task> {
        let due = |(index, pair): &(usize, &Pair)| {
            let [a, b] = robots_of(*index).map(|robot| &self.members[robot]);
            let together = a.anchor.is_some() && b.anchor.is_some() || pair.state().in_force();
            let [m, n] = [a.nodes(), b.nodes()];
            let waits = pair.state() == EdgeState::Candidate;
            let more = if waits {
                GROWN_NODES_AGAIN
            } else {
                GROWN_NODES.max(((GROWN - 1.0) * f64::from(pair.tried_at)) as u32)
            };
            let fresh = pair.tried_at == 0 || m + n >= pair.tried_at + more || pair.last_tries > 0;
            !together
                && fresh
                && m >= ALIGN_NODES
                && n >= ALIGN_NODES
                && a.poses.len() >= a.pieces.len()
                && b.poses.len() >= b.pieces.len()
        };
        let next = self
            .pairs
            .iter()
            .enumerate()
            .filter(due)
            .min_by_key(|(_, pair)| (pair.state() != EdgeState::Candidate, pair.tries));
        let index = next?.0;
        let [a, b] = robots_of(index).map(|robot| &self.members[robot]);
        let nodes = [a.nodes(), b.nodes()];
        let pair = &mut self.pairs[index];
        // In turns: all of both, all of the one and what the other saw last (which drift has not bent).
        let newest = |member: &Member| {
            member.poses.len() - if member.poses.len() >= 2 * WINDOW { WINDOW } else { member.poses.len() }
        };
        let [from_a, from_b] = match pair.tries % 3 {
            0 => [0, 0],
            1 => [0, newest(b)],
            _ => [newest(a), 0],
        };
        let (of_a, of_b) = (a.placed(from_a..a.poses.len()), b.placed(from_b..b.poses.len()));
        pair.tries += 1;
        pair.last_tries = pair.last_tries.saturating_sub(1);
        pair.tried_at = nodes[0] + nodes[1];
        self.task(Job::Align { pair: index, nodes, a: of_a, b: of_b, config: self.align.clone() })
    }

    /// Past the gate twice, from maps that have grown between: then it is believed.
    fn aligned(&mut self, index: usize, nodes: [u32; 2], found: Option<(Alignment, f64)>) {
        let last_round = self.last_round;
        let pair = &mut self.pairs[index];
        let passed = found.filter(|(found, null_f1)| {
            found.accepted && found.score >= null_f1 + AHEAD_OF_CHANCE && !pair.is_refused(found.a_from_b)
        });
        let Some((found, null_f1)) = passed else { return };
        let again = pair.state() == EdgeState::Candidate && Pair::same(pair.a_from_b, found.a_from_b);
        let grown = pair.seen_at != nodes || last_round;
        if again && !grown {
            return;
        }
        (pair.a_from_b, pair.seen_at, pair.grounds) = (found.a_from_b, nodes, Some((found, null_f1)));
        if !again {
            pair.state = Some(EdgeState::Candidate);
            return;
        }
        pair.state = Some(EdgeState::Accepted);
        self.connect();
        self.unsolved = true;
    }
}

/// (0, 1), (0, 2), (1, 2), (0, 3), ...: a small fleet's pairs come first.
fn robots_of(pair: usize) -> [usize; 2] {
    let j = (1..ROBOTS_MAX).rfind(|j| j * (j - 1) / 2 <= pair).unwrap_or(1);
    [pair - j * (j - 1) / 2, j]
}

#[cfg(test)]
mod tests;
