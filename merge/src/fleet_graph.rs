//! The fleet's pose graph, which estimates where the robots' maps lie and how drift has deformed them.
//!
//! ```text
//! submaps ─▶ candidates:   whole maps aligned       submaps matched where the graph expects overlap
//!                                │                            │
//!            verification: thresholds, twice        thresholds, margin over other places
//!                                │                            │
//!            edge between two robots                closures ─▶ largest consistent set
//!                                └────────────┬───────────────┘
//!                                   joint solution ─▶ map transforms, redrawn maps
//! ```
//!
//! | file | part |
//! |---|---|
//! | `submaps`, `estimate`, `robot` | one robot: what its SLAM sent, where it lies, its redrawn map (`draw_submaps`) |
//! | `edge`, `closures`, `starts`, `pair` | two robots: state and evidence of their edge, relations of their submaps, what their maps say of given starts |
//! | `alignment` | candidates and checks of whole maps, and when they are due |
//! | `submap_match` | candidates of closures, verified |
//! | `consistency`, `joint` | consistent set, joint solution |
//! | `frame` | the reference robot, in the largest component, and who is connected to it |
//! | `task`, `snapshot` | work for other threads, what survives the process |

mod alignment;
mod closures;
mod consistency;
mod draw_submaps;
mod edge;
mod estimate;
mod frame;
mod joint;
mod pair;
mod robot;
mod snapshot;
mod sources;
mod starts;
mod submap_match;
mod submaps;
mod task;

pub use snapshot::{FleetSnapshot, SnapshotRejected};
pub use task::{Task, TaskResult};

use crate::config::MergeConfig;
use crate::limits::is_plausible;
use alignment::{next_alignment, next_check};
use frame::{ReferenceRobot, connect_robots, reference_of_largest_component, set_reference, successor};
use joint::JointProblem;
use msg::{
    EdgeAction, EdgeState, Grid, MERGE_EDGES_MAX, MergeEdges, Pose2, ROBOTS_MAX, RobotId, Submap, SubmapPoses,
};
use pair::{RobotPair, pair_count, robots_of_pair};
use robot::{Robot, next_redraw};
use std::sync::Arc;
use submaps::SubmapSource;
use task::{Job, JobResult};

/// Alignments of each pair when nothing grows any more: both whole maps and each window, twice.
const FINAL_ALIGNMENTS: u32 = 6;

/// Reason why a message was rejected. Nothing of it is used but the run and the generation that it names.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SubmapRejected {
    /// The fleet has no such robot.
    #[error("{0} is not of this fleet")]
    UnknownRobot(RobotId),
    /// A number in the message is not valid.
    #[error("a submap or pose of {0} holds an invalid number")]
    Malformed(RobotId),
}

/// The joint pose graph of the submaps of all robots.
///
/// It only schedules: whatever takes time is a [`Task`] that any thread can run, one at a time. Which tasks come, and in
/// which order, depends on the messages alone.
///
/// ```
/// use merge::{FleetPoseGraph, MergeConfig};
/// use msg::{EdgeAction, MergeEdges, Pose2, RobotId};
///
/// // Two robots whose starts are known. Submaps would come by `add_submap` and `update_poses`.
/// let starts = [Some(Pose2::IDENTITY), Some(Pose2::new(4.0, 0.0, 1.5))];
/// let mut graph = FleetPoseGraph::new(&MergeConfig::default(), &starts);
/// while let Some(task) = graph.next_task() {
///     graph.apply_result(task.run());
/// }
/// let second = RobotId::new(2).unwrap();
/// assert_eq!(graph.map_from_robot_map(second), starts[1]);
///
/// // The operator pins the edge between the two: later maps cannot drop it.
/// assert!(graph.apply_command(1, EdgeAction::Pin));
/// let mut edges = MergeEdges::default();
/// graph.write_edges(&mut edges);
/// assert_eq!(edges.edges()[0].a_from_b, starts[1].unwrap());
/// ```
pub struct FleetPoseGraph {
    config: MergeConfig,
    /// One element for each robot of the fleet, at [`RobotId::index`].
    robots: Vec<Robot>,
    /// In the order of [`robots_of_pair`].
    pairs: Vec<RobotPair>,
    reference: Option<ReferenceRobot>,
    /// A task is being run.
    task_is_out: bool,
    /// A message or a result may have changed the solution.
    needs_solve: bool,
    /// No submap will come any more.
    maps_are_complete: bool,
    solves: SolveCounts,
}

/// How often the joint graph was solved.
#[derive(Clone, Copy, Debug, Default)]
struct SolveCounts {
    succeeded: u64,
    failed: u64,
}

impl FleetPoseGraph {
    /// Creates the graph of a fleet.
    ///
    /// `starts` is frame `map` from frame `robotK/map` where that is known, by [`RobotId::index`]. If no start is known,
    /// the first robot that sends submaps becomes the reference: its map fixes the frame `map`. When more robots are joined to
    /// each other than to it, the first of them becomes the reference.
    pub fn new(config: &MergeConfig, starts: &[Option<Pose2>]) -> Self {
        let robot = |start: &Option<Pose2>| Robot::new(start.filter(|start| is_plausible(*start)));
        let robots: Vec<Robot> = starts.iter().take(ROBOTS_MAX).map(robot).collect();
        let pairs = vec![RobotPair::default(); pair_count(robots.len())];
        Self {
            config: config.clone(),
            robots,
            pairs,
            reference: None,
            task_is_out: false,
            needs_solve: false,
            maps_are_complete: false,
            solves: SolveCounts::default(),
        }
    }

    /// Adds a robot's submap, or replaces it as it has grown.
    ///
    /// # Errors
    /// [`SubmapRejected`] says why the submap is not taken.
    pub fn add_submap(&mut self, robot: RobotId, submap: &Submap) -> Result<(), SubmapRejected> {
        let source = (submap.grid.header.incarnation, submap.generation);
        if self.is_late_submap(robot, source) {
            return Ok(());
        }
        self.check_source(robot, source)?;
        let added = self.robots[robot.index()].submaps.add(submap);
        if added { Ok(()) } else { Err(SubmapRejected::Malformed(robot)) }
    }

    /// Replaces the poses of a robot's submaps in its own map, and the links between them.
    ///
    /// Poses of another run than before are those of a robot whose machine began anew, anywhere: its place is unknown then.
    ///
    /// # Errors
    /// [`SubmapRejected`] says why the poses are not taken.
    pub fn update_poses(&mut self, robot: RobotId, poses: &SubmapPoses) -> Result<(), SubmapRejected> {
        self.check_map_frame(robot, poses.map_frame)?;
        let source = (poses.header.incarnation, poses.generation);
        self.check_source(robot, source)?;
        let index = robot.index();
        // SLAM never has fewer in one generation: it was started again, on another machine, where nothing else tells.
        if poses.poses().len() < self.robots[index].submaps.poses().len() {
            self.restart_source(index, source);
        }
        let submaps = &mut self.robots[index].submaps;
        let changed = submaps.update_poses(poses).ok_or(SubmapRejected::Malformed(robot))?;
        let has_map = changed && !submaps.poses().is_empty();
        let frame_is_free = self.reference.is_none()
            && self.robots.iter().all(|robot| robot.estimate.configured_map_from_robot_map().is_none());
        if has_map && frame_is_free {
            self.reference = Some(set_reference(&mut self.robots, index, Pose2::IDENTITY));
            self.graph_changed();
        }
        self.needs_solve |= changed && self.robots[index].estimate.map_from_robot_map().is_some();
        Ok(())
    }

    /// Returns the number of submaps of a robot that have a pose and have not arrived.
    pub fn missing_submaps(&self, robot: RobotId) -> usize {
        self.robots.get(robot.index()).map_or(0, |robot| robot.submaps.missing())
    }

    /// Removes everything known about a robot that has left or starts at another place. The frame `map` stays.
    pub fn remove_robot(&mut self, robot: RobotId) {
        let index = robot.index();
        let Some(robot) = self.robots.get_mut(index) else { return };
        robot.remove();
        for (pair_index, pair) in self.pairs.iter_mut().enumerate() {
            if robots_of_pair(pair_index).contains(&index) {
                *pair = RobotPair::default();
            }
        }
        // Without a reference the robots that have a start fix the frame. The last of them may be gone now.
        let has_start =
            self.robots.iter().any(|known| known.estimate.configured_map_from_robot_map().is_some());
        if self.reference.map_or(!has_start, |reference| reference.robot == index) {
            self.reference = successor(&self.robots);
        }
        self.graph_changed();
    }

    /// Applies the operator's command to an edge, by its number from 1. False if there is no such edge, or if the command
    /// does not apply to its state.
    pub fn apply_command(&mut self, edge: u32, action: EdgeAction) -> bool {
        let index = (edge as usize).checked_sub(1).filter(|index| *index < self.pairs.len());
        let Some(index) = index else { return false };
        let in_graph = self.a_from_b_in_graph(index);
        if !self.pairs[index].apply_command(action, in_graph) {
            return false;
        }
        self.graph_changed();
        true
    }

    /// The next step of work, if there is any and none is being done. Its result goes to
    /// [`FleetPoseGraph::apply_result`].
    pub fn next_task(&mut self) -> Option<Task> {
        if self.task_is_out {
            return None;
        }
        // Later stages come first, so that closures are in the solution before more are searched for.
        let job = self
            .joint_problem()
            .map(Job::Solve)
            .or_else(|| next_redraw(&self.robots).map(Job::Redraw))
            .or_else(|| self.next_match().map(Job::Match))
            .or_else(|| next_check(&self.robots, &mut self.pairs, &self.config).map(Job::Check))
            .or_else(|| next_alignment(&self.robots, &mut self.pairs, &self.config).map(Job::Align))?;
        self.task_is_out = true;
        Some(Task { sources: self.sources(), job })
    }

    /// Applies the result of a task.
    pub fn apply_result(&mut self, result: TaskResult) {
        self.task_is_out = false;
        if result.sources != self.sources() {
            // A robot's SLAM was restarted meanwhile: the result is about submaps that are gone.
            self.needs_solve = true;
            return;
        }
        match result.result {
            JobResult::Aligned(maps) => self.apply_alignment(maps),
            JobResult::Checked(maps) => self.apply_check(*maps),
            JobResult::Matched(submaps) => {
                let [a, b] = robots_of_pair(submaps.pair).map(|robot| &self.robots[robot]);
                self.needs_solve |= self.pairs[submaps.pair].closures.record(a, b, submaps);
            }
            JobResult::Solved(Ok(solution)) => {
                self.solves.succeeded += 1;
                let contradicted = solution.contradicted_start();
                solution.apply(&mut self.robots, &mut self.pairs);
                if let Some(robot) = contradicted {
                    self.robots[robot].forget_start();
                    self.graph_changed();
                }
            }
            // The estimate stays what it was; the graph is solved again when something changes.
            JobResult::Solved(Err(_)) => self.solves.failed += 1,
            JobResult::Redrawn(map) => map.apply(&mut self.robots),
        }
    }

    /// Announces that no submap will come any more: every pair that is not in one graph is aligned some more times.
    pub fn finish(&mut self) {
        self.maps_are_complete = true;
        self.needs_solve = true;
        for pair in &mut self.pairs {
            (pair.schedule.final_alignments, pair.schedule.checked_at_nodes) = (FINAL_ALIGNMENTS, 0);
        }
    }

    /// Frame `map` from frame `robotK/map`, right where the robot is now; `None` while it is unknown.
    pub fn map_from_robot_map(&self, robot: RobotId) -> Option<Pose2> {
        self.robots.get(robot.index())?.estimate.map_from_robot_map()
    }

    /// Frame `map` from frame `robotK/map`, right at one of the robot's submaps.
    pub fn map_from_robot_map_at(&self, robot: RobotId, submap: u32) -> Option<Pose2> {
        self.robots.get(robot.index())?.estimate.at_submap(submap as usize)
    }

    /// The robot's map redrawn from its submaps, frame `robotK/map`. `None` where the robot's own map is right to half a
    /// cell at [`FleetPoseGraph::map_from_robot_map`].
    pub fn redrawn_map(&self, robot: RobotId) -> Option<&Arc<Grid>> {
        self.robots.get(robot.index())?.redrawn_map()
    }

    /// Writes the state of each pair of robots, with its evidence, and the contradicted starts into a message.
    ///
    /// If there are more pairs than places, those without an edge are left out first, and then the last.
    pub fn write_edges(&self, out: &mut MergeEdges) {
        let has_space = self.pairs.len() <= MERGE_EDGES_MAX;
        let pairs = self.pairs.iter().enumerate();
        let wanted = pairs.filter(|(_, pair)| has_space || pair.edge.state() != EdgeState::None);
        let mut written = 0;
        for (slot, (index, pair)) in out.edges.iter_mut().zip(wanted) {
            *slot = pair.message(index);
            written += 1;
        }
        out.len = written as u32;
        out.left_out = (self.pairs.len() - written) as u32;
        let contradicted = self.robots.iter().enumerate().filter(|(_, robot)| robot.is_start_contradicted);
        out.contradicted_start_bits = contradicted.fold(0, |bits, (index, _)| bits | 1 << index);
    }

    /// Returns the number of solutions of the joint graph so far.
    pub fn solve_count(&self) -> u64 {
        self.solves.succeeded
    }

    /// Returns how often the joint graph could not be solved. The estimate then stayed what it was.
    pub fn failed_solve_count(&self) -> u64 {
        self.solves.failed
    }

    /// Applies changed edges: connects robots to the frame or removes them, and requests a new solution.
    fn graph_changed(&mut self) {
        let has_start =
            self.robots.iter().any(|robot| robot.estimate.configured_map_from_robot_map().is_some());
        if let Some(reference) = self.reference.filter(|_| !has_start) {
            self.reference = Some(reference_of_largest_component(&mut self.robots, &self.pairs, reference));
        }
        connect_robots(&mut self.robots, &self.pairs, self.reference);
        self.needs_solve = true;
    }

    /// Returns the joint graph, if something has changed since it was solved.
    fn joint_problem(&mut self) -> Option<JointProblem> {
        if !core::mem::take(&mut self.needs_solve) {
            return None;
        }
        for (index, pair) in self.pairs.iter_mut().enumerate() {
            let [a, b] = robots_of_pair(index).map(|robot| &self.robots[robot]);
            pair.link_by_alignment(a, b);
        }
        JointProblem::collect(&self.robots, &self.pairs, self.reference, &self.config.closures)
    }

    /// Returns the next match of two submaps, of the first connected pair of robots that has any.
    fn next_match(&self) -> Option<closures::MatchJob> {
        self.pairs.iter().enumerate().find_map(|(index, pair)| {
            let in_graph = self.a_from_b_in_graph(index)?;
            let [a, b] = robots_of_pair(index).map(|robot| &self.robots[robot]);
            let nodes = a.submaps.node_count() + b.submaps.node_count();
            let is_out = pair.edge.is_rejected(in_graph) || pair.edge.is_retracted(in_graph, nodes);
            if is_out { None } else { pair.closures.next_match(index, [a, b], &self.config) }
        })
    }

    /// Returns the transform of the graph from the second robot's map to the first's, if both are in it.
    fn a_from_b_in_graph(&self, pair: usize) -> Option<Pose2> {
        let [a, b] = robots_of_pair(pair).map(|robot| self.robots[robot].estimate.map_from_robot_map());
        a.zip(b).map(|(a, b)| a.between(b))
    }

    fn sources(&self) -> Vec<Option<SubmapSource>> {
        self.robots.iter().map(|robot| robot.submaps.source()).collect()
    }
}

#[cfg(test)]
mod tests;
