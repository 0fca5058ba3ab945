//! Loop closing: the closure detector, which nodes to search for again, and which closures people rejected.

use crate::closure::{ClosureCandidate, ClosureDetector};
use crate::config::SlamConfig;
use crate::graph::Edge;
use msg::{Pose2, pose::wrap_angle};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Nodes not found that are remembered, to be searched for again after a closure: some 80 m of path.
const NOT_FOUND_MAX: usize = 256;
/// A candidate this near to a rejected closure, in order and in place, is the same mistake: nodes, metres, radians.
pub(super) const REJECTED_NODES: u32 = 20;
pub(super) const REJECTED_M: f64 = 1.0;
pub(super) const REJECTED_RAD: f64 = 0.3;
/// What SLAM drifts over [`REJECTED_NODES`] nodes, on top, metres.
const REJECTED_DRIFT_M: f64 = 2.0;
/// Rejected closures remembered; a person rejects a few.
const REJECTED_MAX: usize = 256;

/// A closure that a person undid: it is not accepted again.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RejectedClosure {
    /// The earlier node.
    pub a: u32,
    /// The later node.
    pub b: u32,
    /// Pose of the later node in the frame of the earlier one, as measured.
    pub a_from_b: Pose2,
}

/// State of loop closing.
pub(super) struct LoopClosureState {
    pub detector: ClosureDetector,
    /// Length of the path so far, metres.
    pub travelled_m: f64,
    /// Nodes searched for without success since the last closure.
    pub not_found: VecDeque<u32>,
    /// Nodes from before the last closure, to be searched for once more in the better map.
    pub to_retry: VecDeque<u32>,
    /// Closures that people undid.
    pub rejected_closures: Vec<RejectedClosure>,
    /// Number of active closures.
    pub active_count: u32,
    /// Number of closures retracted so far.
    pub retracted: u64,
}

impl LoopClosureState {
    pub fn new(config: SlamConfig) -> Self {
        Self {
            detector: ClosureDetector::new(config),
            travelled_m: 0.0,
            not_found: VecDeque::with_capacity(NOT_FOUND_MAX),
            to_retry: VecDeque::with_capacity(NOT_FOUND_MAX),
            rejected_closures: Vec::new(),
            active_count: 0,
            retracted: 0,
        }
    }

    /// Whether the newest node should be searched for.
    pub fn is_search_due(&self) -> bool {
        self.detector.due(self.travelled_m)
    }

    /// Records a node whose search failed: a better map may help later.
    pub fn record_not_found(&mut self, id: u32) {
        if self.not_found.len() == NOT_FOUND_MAX {
            self.not_found.pop_front();
        }
        self.not_found.push_back(id);
    }

    /// After a closure: the nodes not found before it are to be searched for once more.
    pub fn retry_not_found(&mut self) {
        while let Some(id) = self.not_found.pop_front() {
            if self.to_retry.len() < NOT_FOUND_MAX {
                self.to_retry.push_back(id);
            }
        }
    }

    /// Rejects the closure of an edge from now on.
    pub fn reject(&mut self, edge: &Edge) {
        if self.rejected_closures.len() == REJECTED_MAX {
            self.rejected_closures.remove(0);
        }
        self.rejected_closures.push(RejectedClosure { a: edge.a, b: edge.b, a_from_b: edge.a_from_b });
        self.retracted += 1;
    }

    /// Whether a person undid this edge.
    pub fn is_rejected_edge(&self, edge: &Edge) -> bool {
        self.rejected_closures
            .iter()
            .any(|rejected| (rejected.a, rejected.b, rejected.a_from_b) == (edge.a, edge.b, edge.a_from_b))
    }

    /// Whether a candidate is a closure that was undone.
    pub fn resembles_rejected(&self, candidate: &ClosureCandidate) -> bool {
        self.rejected_closures.iter().any(|rejected| {
            let near = candidate.older.abs_diff(rejected.a) <= REJECTED_NODES
                && candidate.newer.abs_diff(rejected.b) <= REJECTED_NODES;
            let turned = wrap_angle(candidate.older_from_newer.yaw_rad - rejected.a_from_b.yaw_rad).abs();
            let apart_m = candidate.older_from_newer.distance_m(rejected.a_from_b);
            near && apart_m < REJECTED_M + REJECTED_DRIFT_M && turned < REJECTED_RAD
        })
    }

    /// Nodes got other numbers; what is remembered of nodes that are gone is dropped.
    pub fn renumber(&mut self, number: &dyn Fn(u32) -> Option<u32>) {
        self.not_found = self.not_found.iter().filter_map(|id| number(*id)).collect();
        self.to_retry = self.to_retry.iter().filter_map(|id| number(*id)).collect();
        self.rejected_closures.retain_mut(|rejected| match (number(rejected.a), number(rejected.b)) {
            (Some(a), Some(b)) => {
                (rejected.a, rejected.b) = (a, b);
                true
            }
            _ => false,
        });
        self.detector.renumber(number);
    }
}
