//! State of the back end, kept in a session.

use super::{BackEnd, RejectedClosure, ReliabilityMonitor};
use crate::closure::ClosureDetectorState;
use crate::graph::Edge;
use crate::node::Node;
use msg::Pose2;
use serde::{Deserialize, Serialize};

/// State of the back end as plain values; scans are shared, not copied.
// More than 12 fields: one for each value that a session stores.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct BackEndState {
    /// The nodes, numbered from 0.
    pub nodes: Vec<Node>,
    /// The front end's id of each node.
    pub front_ids: Vec<u32>,
    /// The map from each.
    pub poses: Vec<Pose2>,
    /// Poses with which the first nodes were drawn into the map.
    pub drawn: Vec<Pose2>,
    /// What was measured between them.
    pub edges: Vec<Edge>,
    /// Length of the path so far, metres.
    pub travelled_m: f64,
    /// Nodes searched for in vain since the last closure.
    pub not_found: Vec<u32>,
    /// Nodes from before it that are searched for once more.
    pub to_retry: Vec<u32>,
    /// Nodes with links to older parts since the last solution.
    pub linked_since_solve: usize,
    /// Solutions so far.
    pub solutions: u64,
    /// Number of closures retracted.
    pub retracted: u64,
    /// Number of nodes removed in lifelong mode.
    pub removed_nodes: u64,
    /// The newest node that odometry alone connects with the nodes before.
    pub unverified_node: Option<u32>,
    /// State of the closure detector.
    pub detector: ClosureDetectorState,
    /// Closures that were undone.
    pub rejected_closures: Vec<RejectedClosure>,
    /// Evidence that the map is wrong, and what it is computed from.
    pub reliability: ReliabilityMonitor,
}

impl BackEnd {
    /// The state to be kept in a session.
    pub fn state(&self) -> BackEndState {
        BackEndState {
            nodes: self.nodes.clone(),
            front_ids: self.node_ids.front_ids.clone(),
            poses: self.graph.poses().to_vec(),
            drawn: self.mapper.drawn(),
            edges: self.graph.edges().to_vec(),
            travelled_m: self.loop_closures.travelled_m,
            not_found: self.loop_closures.not_found.iter().copied().collect(),
            to_retry: self.loop_closures.to_retry.iter().copied().collect(),
            linked_since_solve: self.linked_since_solve,
            solutions: self.solutions,
            retracted: self.loop_closures.retracted,
            removed_nodes: self.lifelong.removed_nodes,
            unverified_node: self.unverified_node,
            detector: self.loop_closures.detector.state(),
            rejected_closures: self.loop_closures.rejected_closures.clone(),
            reliability: self.reliability.clone(),
        }
    }
}
