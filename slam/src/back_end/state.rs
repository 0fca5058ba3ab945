//! What of the back end is kept in a session.

use super::{BackEnd, RejectedClosure};
use crate::closure::ClosureDetectorState;
use crate::graph::Edge;
use crate::node::Node;
use msg::Pose2;

/// All that the back end knows, as plain values. Scans are shared, not copied.
#[derive(Clone, Debug, Default)]
pub struct BackEndState {
    /// The nodes, numbered from 0.
    pub nodes: Vec<Node>,
    /// The scan path's number of each.
    pub front_ids: Vec<u32>,
    /// The map from each.
    pub poses: Vec<Pose2>,
    /// Where the first so many lay when they were drawn.
    pub drawn: Vec<Pose2>,
    /// What was measured between them.
    pub edges: Vec<Edge>,
    /// The way so far, metres.
    pub travelled_m: f64,
    /// Nodes looked for and not found since the last closure,
    pub not_found: Vec<u32>,
    /// and those from before it.
    pub again: Vec<u32>,
    /// Nodes with links to older parts since the last solution.
    pub unsolved: usize,
    /// Solutions so far.
    pub solutions: u64,
    /// Closures taken back.
    pub retracted: u64,
    /// Nodes forgotten.
    pub retired: u64,
    /// The newest node that odometry alone joins to the ones before.
    pub unverified_edge: Option<u32>,
    /// Finds that wait.
    pub detector: ClosureDetectorState,
    /// Closures that were undone.
    pub rejected_closures: Vec<RejectedClosure>,
}

impl BackEnd {
    /// All that must be kept to go on later.
    pub fn state(&self) -> BackEndState {
        BackEndState {
            nodes: self.nodes.clone(),
            front_ids: self.numbers.front_ids.clone(),
            poses: self.graph.poses().to_vec(),
            drawn: self.mapper.drawn(),
            edges: self.graph.edges().to_vec(),
            travelled_m: self.closer.travelled_m,
            not_found: self.closer.not_found.iter().copied().collect(),
            again: self.closer.again.iter().copied().collect(),
            unsolved: self.unsolved,
            solutions: self.solutions,
            retracted: self.closer.retracted,
            retired: self.lifelong.retired,
            unverified_edge: self.unverified_edge,
            detector: self.closer.detector.state(),
            rejected_closures: self.closer.rejected_closures.clone(),
        }
    }
}
