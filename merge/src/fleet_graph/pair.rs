//! A pair of robots, with the edge between their maps, the closures of their submaps and the times to compare them.

use super::closures::ClosureSet;
use super::edge::MapEdge;
use super::robot::Robot;
use super::starts::StartsOfPair;
use crate::align::ComparedSubmaps;
use msg::{EdgeAction, EdgeState, MergeEdge, Pose2, ROBOTS_MAX};

/// One pair of robots.
#[derive(Clone, Debug, Default)]
pub(crate) struct RobotPair {
    /// The relation of the two maps.
    pub edge: MapEdge,
    /// The relations of their submaps.
    pub closures: ClosureSet,
    /// What the two maps say of the given starts.
    pub starts: StartsOfPair,
    /// How many of their submaps the other's map contradicts, at the newest check.
    pub compared_submaps: ComparedSubmaps,
    /// When the two maps are compared.
    pub schedule: ComparisonSchedule,
}

/// Times at which the maps of a pair were compared, in pose-graph nodes of both robots together.
#[derive(Clone, Debug, Default)]
pub(crate) struct ComparisonSchedule {
    /// Number of alignments of the whole maps that were tried.
    pub alignments: u32,
    /// Nodes at the newest alignment; 0 before the first.
    pub aligned_at_nodes: u32,
    /// Alignments still to be tried after the maps have stopped growing.
    pub final_alignments: u32,
    /// Nodes at the newest check of an active edge or of given starts; 0 to check at once.
    pub checked_at_nodes: u32,
}

impl RobotPair {
    /// Applies an operator's command. `in_graph` is the relation that the fleet's graph has, if it has both robots.
    /// Returns false if the command does not apply.
    pub fn apply_command(&mut self, action: EdgeAction, in_graph: Option<Pose2>) -> bool {
        match self.edge.apply_command(action, in_graph) {
            Some(EdgeState::Undone) => self.clear_evidence(),
            Some(_) => {}
            None => return false,
        }
        true
    }

    /// Drops the edge, because the maps contradict it, and the closures with it. `nodes` are those of both robots
    /// together.
    pub fn drop_edge(&mut self, nodes: u32) {
        self.edge.retract(nodes);
        self.clear_evidence();
    }

    /// Clears what was found where the two maps lay: closures and compared submaps.
    pub fn clear_evidence(&mut self) {
        self.closures.clear();
        self.compared_submaps = ComparedSubmaps::default();
    }

    /// Continues after the submaps of one of the two were lost.
    pub fn restart(&mut self, in_graph: Option<Pose2>) {
        self.clear_evidence();
        (self.schedule.aligned_at_nodes, self.schedule.checked_at_nodes) = (0, 0);
        self.edge.restart(in_graph);
    }

    /// Links the nearest submaps by the alignment of the whole maps, if the edge is active.
    pub fn link_by_alignment(&mut self, a: &Robot, b: &Robot) {
        if self.edge.is_active() {
            self.closures.link_by_alignment(self.edge.a_from_b(), a, b);
        }
    }

    /// Returns the edge as a message. `index` is the pair's.
    pub fn message(&self, index: usize) -> MergeEdge {
        let [a, b] = robots_of_pair(index);
        let (edge, closures) = (&self.edge, &self.closures);
        let evidence = edge.evidence().copied();
        let found = evidence.map(|evidence| evidence.alignment);
        MergeEdge {
            id: index as u32 + 1,
            a: a as u32 + 1,
            b: b as u32 + 1,
            state: edge.state() as u32,
            a_from_b: edge.a_from_b(),
            inliers: found.map_or(0, |found| found.inliers),
            closures: closures.active().len() as u32,
            closures_rejected: (closures.found().len() - closures.active().len()) as u32,
            tries: self.schedule.alignments,
            refusal: edge.refusal().map_or(0, |refusal| refusal as u32),
            reserved: 0,
            compared_submaps: self.compared_submaps.compared,
            contradicted_submaps: self.compared_submaps.contradicted,
            residual_m: found.map_or(0.0, |found| found.residual_m),
            closure_residual_m: closures.residual_m(),
            overlap_m2: found.map_or(0.0, |found| found.overlap_m2),
            overlap_share: found.map_or(0.0, |found| found.overlap_share),
            agreement: found.map_or(0.0, |found| found.agreement),
            occupied_f1: found.map_or(0.0, |found| found.occupied_f1),
            null_f1_max: evidence.map_or(0.0, |evidence| evidence.null_f1_max),
            conflict: found.map_or(0.0, |found| found.conflict),
            margin: found.map_or(0.0, |found| found.margin),
        }
    }
}

/// Returns the number of pairs of `robots` robots.
pub(crate) fn pair_count(robots: usize) -> usize {
    robots * robots.saturating_sub(1) / 2
}

/// The robots of a pair: (0, 1), (0, 2), (1, 2), (0, 3), ... The pairs of a small fleet come first.
pub(crate) fn robots_of_pair(pair: usize) -> [usize; 2] {
    let j = (1..ROBOTS_MAX).rfind(|j| pair_count(*j) <= pair).unwrap_or(1);
    [pair - pair_count(j), j]
}
