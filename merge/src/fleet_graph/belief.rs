//! When two robots are believed to have been in the same place, and when no more.

use super::member::Member;
use super::pair::Pair;
use super::task::{Job, Task};
use super::{FleetPoseGraph, robots_of};
use crate::align::Alignment;
use msg::{EdgeState, Pose2};

/// Robots with fewer nodes are not aligned.
const ALIGN_NODES: u32 = 8;
/// A pair is tried again when the two have so many times the nodes, and so many more.
const GROWN: f64 = 1.15;
const GROWN_NODES: u32 = 4;
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

impl FleetPoseGraph {
    /// Pairs in force whose maps have grown: do they still agree?
    pub(super) fn assess_task(&mut self) -> Option<Task> {
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

    pub(super) fn assessed(&mut self, index: usize, found: Option<(Alignment, f64)>) {
        let pair = &mut self.pairs[index];
        let Some((found, null_f1)) = found.filter(|_| pair.state().in_force()) else { return };
        // Where the margin over other places was found, it stays: this look was at one place only.
        let margin = pair.grounds.as_ref().map_or(0.0, |(before, _)| before.margin);
        pair.grounds = Some((Alignment { a_from_b: pair.a_from_b, margin, ..found }, null_f1));
        let contradicted = found.overlap_m2 >= CONTRADICTED_OVERLAP_M2 && found.occupied_f1 < CONTRADICTED_F1;
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
    pub(super) fn align_task(&mut self) -> Option<Task> {
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
    pub(super) fn aligned(&mut self, index: usize, nodes: [u32; 2], found: Option<(Alignment, f64)>) {
        let last_round = self.last_round;
        let pair = &mut self.pairs[index];
        let passed = found.filter(|(found, null_f1)| {
            found.accepted
                && found.occupied_f1 >= null_f1 + AHEAD_OF_CHANCE
                && !pair.is_refused(found.a_from_b)
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
