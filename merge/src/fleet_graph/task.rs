//! The expensive steps as plain values: any thread can run them, and the result depends on the input alone.

use super::alignment::{AlignJob, AlignmentResult, CheckJob, CheckResult};
use super::closures::{MatchJob, SubmapMatchResult};
use super::joint::{JointProblem, JointSolution};
use super::robot::{RedrawJob, Redrawn};
use super::submaps::SubmapSource;
use posegraph::SolveError;

/// One task. See [`FleetPoseGraph::next_task`](super::FleetPoseGraph::next_task).
#[derive(Debug)]
pub struct Task {
    /// Sources of the submaps that it uses: a result for other sources is dropped.
    pub(super) sources: Vec<Option<SubmapSource>>,
    pub(super) job: Job,
}

/// Result of a [`Task`]. See [`FleetPoseGraph::apply_result`](super::FleetPoseGraph::apply_result).
#[derive(Debug)]
pub struct TaskResult {
    pub(super) sources: Vec<Option<SubmapSource>>,
    pub(super) result: JobResult,
}

#[derive(Debug)]
pub(super) enum Job {
    /// Find where one robot's map lies in another's.
    Align(AlignJob),
    /// Compare two robots' maps where the fleet's graph has them.
    Check(CheckJob),
    /// Match two submaps of different robots.
    Match(MatchJob),
    /// Solve the joint graph.
    Solve(JointProblem),
    /// Draw one robot's map from its submaps.
    Redraw(RedrawJob),
}

#[derive(Debug)]
pub(super) enum JobResult {
    Aligned(AlignmentResult),
    Checked(Box<CheckResult>),
    Matched(SubmapMatchResult),
    Solved(Result<JointSolution, SolveError>),
    Redrawn(Redrawn),
}

impl Task {
    /// Runs the task. It takes up to some hundred milliseconds.
    pub fn run(self) -> TaskResult {
        let result = match self.job {
            Job::Align(job) => JobResult::Aligned(job.run()),
            Job::Check(job) => JobResult::Checked(Box::new(job.run())),
            Job::Match(job) => JobResult::Matched(job.run()),
            Job::Solve(problem) => JobResult::Solved(problem.solve()),
            Job::Redraw(job) => JobResult::Redrawn(job.run()),
        };
        TaskResult { sources: self.sources, result }
    }
}

impl TaskResult {
    /// Returns the reason why the joint graph could not be solved, if the task was to solve it and failed.
    pub fn solve_error(&self) -> Option<SolveError> {
        match &self.result {
            JobResult::Solved(Err(error)) => Some(*error),
            _ => None,
        }
    }
}
