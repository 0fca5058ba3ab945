//! The edge between two robots: its state, its evidence, and what the operator decided.

use crate::align::Alignment;
use crate::config::CheckConfig;
use msg::{AlignmentRefusal, EdgeAction, EdgeState, Pose2, pose::wrap_angle};
use serde::{Deserialize, Serialize};

/// Largest distance of two alignments that are the same one, metres: less than any two rooms are apart.
pub(crate) const SAME_ALIGNMENT_M: f64 = 1.0;
/// Largest rotation between two alignments that are the same one, radians: more than what growing
/// maps change.
pub(crate) const SAME_ALIGNMENT_RAD: f64 = 0.1;
/// Most rejected alignments that are remembered: the oldest go first.
pub(crate) const REJECTED_MAX: usize = 8;
/// Factor by which the nodes of both robots must grow before an alignment that their maps contradicted may be accepted
/// again: only new parts of the maps are new evidence.
const NEW_EVIDENCE_FACTOR: f64 = 1.25;
/// Number of closures that make an edge between two robots that are connected through others.
pub(crate) const CLOSURES_MIN: usize = 2;

/// Evidence for an edge.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Evidence {
    /// The newest comparison of the two whole maps.
    pub alignment: Alignment,
    /// Largest F1 of occupied cells under wrong transforms: what chance reaches.
    pub null_f1_max: f64,
}

/// Relation of the maps of two robots.
#[derive(Clone, Debug)]
pub(crate) struct MapEdge {
    state: EdgeState,
    a_from_b: Pose2,
    evidence: Option<Evidence>,
    /// Nodes of both robots when the evidence was found.
    found_at_nodes: [u32; 2],
    /// Alignments that the operator rejected.
    rejected: Vec<Pose2>,
    contradictions: u32,
    retracted: Option<RetractedAlignment>,
    /// Why the newest alignment did not make the edge accepted.
    refusal: Option<AlignmentRefusal>,
}

/// The newest alignment for which the edge was dropped.
#[derive(Clone, Copy, Debug)]
struct RetractedAlignment {
    a_from_b: Pose2,
    /// Nodes of both robots together when the maps contradicted it.
    nodes: u32,
}

impl Default for MapEdge {
    fn default() -> Self {
        Self {
            state: EdgeState::None,
            a_from_b: Pose2::IDENTITY,
            evidence: None,
            found_at_nodes: [0; 2],
            rejected: Vec::new(),
            contradictions: 0,
            retracted: None,
            refusal: None,
        }
    }
}

impl MapEdge {
    /// Creates an edge from saved values. The evidence is of `a_from_b`.
    pub fn restored(
        state: EdgeState,
        a_from_b: Pose2,
        evidence: Option<Evidence>,
        rejected: Vec<Pose2>,
    ) -> Self {
        let evidence = evidence
            .map(|evidence| Evidence { alignment: Alignment { a_from_b, ..evidence.alignment }, ..evidence });
        Self { state, a_from_b, evidence, rejected, ..Self::default() }
    }

    /// Returns the state of the edge.
    pub fn state(&self) -> EdgeState {
        self.state
    }

    /// Returns whether the edge is part of the graph.
    pub fn is_active(&self) -> bool {
        self.state.is_active()
    }

    /// Returns whether one alignment was found, and a second one is awaited.
    pub fn is_candidate(&self) -> bool {
        self.state == EdgeState::Candidate
    }

    /// Returns the transform from the second robot's map to the first's; valid unless the state is none.
    pub fn a_from_b(&self) -> Pose2 {
        self.a_from_b
    }

    /// Returns why the newest alignment did not make the edge accepted; none if no alignment was tried, and while the edge is active.
    pub fn refusal(&self) -> Option<AlignmentRefusal> {
        self.refusal.filter(|_| !self.is_active())
    }

    /// Returns the evidence for the edge.
    pub fn evidence(&self) -> Option<&Evidence> {
        self.evidence.as_ref()
    }

    /// Returns the alignments that the operator rejected.
    pub fn rejected(&self) -> &[Pose2] {
        &self.rejected
    }

    /// Returns whether the operator rejected this alignment.
    pub fn is_rejected(&self, a_from_b: Pose2) -> bool {
        self.rejected.iter().any(|rejected| is_same_alignment(*rejected, a_from_b))
    }

    /// Returns whether the maps contradicted this alignment, and have hardly grown since: `nodes` are those of both
    /// robots together.
    pub fn is_retracted(&self, a_from_b: Pose2, nodes: u32) -> bool {
        self.retracted.is_some_and(|retracted| {
            is_same_alignment(retracted.a_from_b, a_from_b)
                && f64::from(nodes) < NEW_EVIDENCE_FACTOR * f64::from(retracted.nodes)
        })
    }

    /// Applies an operator's command. `in_graph` is the relation that the fleet's graph has, if it has both robots.
    ///
    /// Returns the new state if the command changes it, and `None` if it does not apply.
    pub fn apply_command(&mut self, action: EdgeAction, in_graph: Option<Pose2>) -> Option<EdgeState> {
        match action {
            EdgeAction::Pin if self.state == EdgeState::None && in_graph.is_none() => return None,
            EdgeAction::Pin => {
                if !self.is_active() {
                    // The operator overrules the acceptance test, and an earlier rejection.
                    let a_from_b = self.a_from_b;
                    self.rejected.retain(|rejected| !is_same_alignment(*rejected, a_from_b));
                    if self.state == EdgeState::None {
                        self.a_from_b = in_graph.unwrap_or(self.a_from_b);
                    }
                }
                self.state = EdgeState::Pinned;
            }
            EdgeAction::Unpin if self.state != EdgeState::Pinned => return None,
            EdgeAction::Unpin => self.state = EdgeState::Accepted,
            EdgeAction::Undo if !self.is_active() && !self.is_candidate() => return None,
            EdgeAction::Undo => {
                let a_from_b = in_graph.filter(|_| self.is_active()).unwrap_or(self.a_from_b);
                self.reject(a_from_b);
            }
        }
        Some(self.state)
    }

    /// Drops the edge, which the maps contradict; it is not accepted again before they have grown. `nodes` are those of
    /// both robots together.
    pub fn retract(&mut self, nodes: u32) {
        self.retracted = Some(RetractedAlignment { a_from_b: self.a_from_b, nodes });
        self.deactivate(EdgeState::Dropped);
    }

    /// Records that the maps contradict this relation, which no edge gave.
    pub fn retract_at(&mut self, a_from_b: Pose2, found: Evidence, nodes: u32) {
        let alignment = Alignment { a_from_b, ..found.alignment };
        (self.a_from_b, self.evidence) = (a_from_b, Some(Evidence { alignment, ..found }));
        self.retract(nodes);
    }

    /// Removes the edge from the graph.
    pub fn deactivate(&mut self, state: EdgeState) {
        self.state = state;
        self.contradictions = 0;
    }

    /// Continues after the submaps of one of the two were lost; only the transform remains.
    pub fn restart(&mut self, in_graph: Option<Pose2>) {
        match in_graph {
            Some(a_from_b) if self.is_active() => self.a_from_b = a_from_b,
            _ if self.is_candidate() => self.state = EdgeState::None,
            _ => {}
        }
    }

    /// Records that no place was found where walls of both maps match.
    pub fn record_nothing_found(&mut self) {
        self.refusal = Some(AlignmentRefusal::FewWalls);
    }

    /// Records an alignment of maps with so many nodes. Two alignments of the same place, from maps that have grown in
    /// between or are complete, make the edge accepted. Its F1 must lead over chance by so much. Returns whether it became
    /// accepted.
    pub fn record_alignment(
        &mut self,
        nodes: [u32; 2],
        found: Evidence,
        f1_above_chance_min: f64,
        maps_are_complete: bool,
    ) -> bool {
        let alignment = found.alignment;
        let is_out = self.is_rejected(alignment.a_from_b)
            || self.is_retracted(alignment.a_from_b, nodes[0] + nodes[1]);
        self.refusal = match alignment.refusal {
            Some(refusal) => Some(refusal),
            None if alignment.occupied_f1 < found.null_f1_max + f1_above_chance_min => {
                Some(AlignmentRefusal::Chance)
            }
            None => is_out.then_some(AlignmentRefusal::Rejected),
        };
        if self.refusal.is_some() {
            return false;
        }
        let again = self.is_candidate() && is_same_alignment(self.a_from_b, alignment.a_from_b);
        let independent = self.found_at_nodes != nodes || maps_are_complete;
        self.refusal = (!again || !independent).then_some(AlignmentRefusal::SecondAwaited);
        if again && !independent {
            return false;
        }
        (self.a_from_b, self.found_at_nodes, self.evidence) = (alignment.a_from_b, nodes, Some(found));
        self.state = if again { EdgeState::Accepted } else { EdgeState::Candidate };
        again
    }

    /// Whether the operator has pinned it.
    pub fn is_pinned(&self) -> bool {
        self.state == EdgeState::Pinned
    }

    /// Records a comparison of the two maps where the graph has them.
    pub fn record_check(&mut self, found: Evidence, config: &CheckConfig) -> RecheckResult {
        // This comparison is of one place, so the margins over other places stay as they were.
        let [margin, short_walls_margin] = self
            .evidence
            .map_or([0.0; 2], |before| [before.alignment.margin, before.alignment.short_walls_margin]);
        let alignment = Alignment { a_from_b: self.a_from_b, margin, short_walls_margin, ..found.alignment };
        self.evidence = Some(Evidence { alignment, ..found });
        let contradicted =
            alignment.overlap_m2 >= config.overlap_min_m2 && alignment.occupied_f1 < config.f1_min;
        self.contradictions = if contradicted { self.contradictions + 1 } else { 0 };
        match contradicted {
            false => RecheckResult::Confirmed,
            true if self.contradictions >= config.contradictions_max && self.state == EdgeState::Accepted => {
                RecheckResult::Refuted
            }
            true => RecheckResult::Contradicted,
        }
    }

    /// Follows a solution of the graph that relates the two robots. Enough closures make the edge accepted. `nodes` are
    /// those of both robots together.
    pub fn apply_solution(&mut self, a_from_b: Pose2, closures: usize, nodes: u32) {
        if self.is_active() || closures >= CLOSURES_MIN {
            self.a_from_b = a_from_b;
            let is_out = self.is_rejected(a_from_b) || self.is_retracted(a_from_b, nodes);
            if !self.is_active() && !is_out {
                self.state = EdgeState::Accepted;
            }
        }
    }

    fn reject(&mut self, a_from_b: Pose2) {
        if self.rejected.len() == REJECTED_MAX {
            self.rejected.remove(0);
        }
        self.rejected.push(a_from_b);
        self.a_from_b = a_from_b;
        self.deactivate(EdgeState::Undone);
    }
}

/// Result of comparing two maps again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RecheckResult {
    /// The maps agree, or their overlap is too small to judge.
    Confirmed,
    /// The maps contradict the edge: compare them again soon.
    Contradicted,
    /// The maps have contradicted the edge often enough to drop it.
    Refuted,
}

fn is_same_alignment(x: Pose2, y: Pose2) -> bool {
    x.distance_m(y) < SAME_ALIGNMENT_M && wrap_angle(x.yaw_rad - y.yaw_rad).abs() < SAME_ALIGNMENT_RAD
}
