//! Closures that the solved graph contradicted, and that later ones confirm; and those that stay removed although they agree.
//!
//! Robust kernels let a long path outvote two closures, however right, if its links claim more than they know. What two
//! cannot do, many that say the same can: closures that agree are judged as a set (pairwise consistency; Mangelson et al.,
//! "Pairwise consistent measurement set maximization", ICRA 2018).

use super::BackEnd;
use crate::closure::ClosureCandidate;
use crate::graph::{Edge, EdgeKind};
use crate::reliability::SuspectedBreak;
use msg::{Pose2, pose::wrap_angle};

/// Closures whose ends are this near in order can be compared: the graph knows the way between their ends, some 12 m, well.
const AGREEING_NODES: u32 = 40;
/// Distance between a closure and the map from which one of the two is wrong by what matters, metres. Closures that a map at 90° removes
/// for some centimetres are no evidence.
const CONFLICTING_M: f64 = 1.0;
/// Most conflicting closures that are compared with each other, the newest.
const CONFLICTING_MAX: usize = 64;
/// Conflicting closures that agree from which an odometry break is added where they say that the path is wrong: two acceptances of two each. One pair may be a
/// place that looks like another.
const BREAKING_MIN: usize = 4;

impl BackEnd {
    /// Activates retracted closures if new ones agree with them. If the solved graph still contradicts them, they are retracted
    /// again.
    pub(super) fn restore_retracted(&mut self, new: &[ClosureCandidate]) {
        let edges = self.graph.edges();
        let restored: Vec<usize> = (0..edges.len())
            .filter(|&index| {
                let edge = &edges[index];
                let is_retracted = edge.kind == EdgeKind::Closure && !edge.is_active;
                is_retracted
                    && !self.loop_closures.is_rejected_edge(edge)
                    && new.iter().any(|it| self.agrees(edge, [it.older, it.newer], it.older_from_newer))
            })
            .collect();
        for index in restored {
            self.graph.edge_mut(index).is_active = true;
            self.loop_closures.retracted = self.loop_closures.retracted.saturating_sub(1);
        }
    }

    /// Number of closures that were retracted although another one says the same, and that put nodes of the map more than a metre away
    /// from where they are. Either they are wrong together, or the path between their ends is: a robot that was carried along a
    /// corridor sees nothing that contradicts it but these.
    pub(super) fn count_conflicting_closures(&self) -> u32 {
        self.conflicting_closures().len() as u32
    }

    /// Those closures, as indices of edges.
    fn conflicting_closures(&self) -> Vec<usize> {
        let (edges, poses) = (self.graph.edges(), self.graph.poses());
        let component = |id: u32| self.nodes[id as usize].disconnected_component;
        let is_conflicting = |edge: &Edge| {
            let in_map = poses[edge.a as usize].between(poses[edge.b as usize]);
            edge.kind == EdgeKind::Closure
                && !edge.is_active
                && component(edge.a) == component(edge.b)
                && in_map.distance_m(edge.a_from_b) > CONFLICTING_M
                && !self.loop_closures.is_rejected_edge(edge)
        };
        let conflicting: Vec<usize> = (0..edges.len())
            .rev()
            .filter(|index| is_conflicting(&edges[*index]))
            .take(CONFLICTING_MAX)
            .collect();
        let is_confirmed = |index: usize| {
            conflicting.iter().any(|other| {
                let (edge, other_edge) = (&edges[index], &edges[*other]);
                index != *other && self.agrees(edge, [other_edge.a, other_edge.b], other_edge.a_from_b)
            })
        };
        conflicting.iter().copied().filter(|index| is_confirmed(*index)).collect()
    }

    /// Adds an odometry break where many retracted closures agree that the path is wrong, and activates these: the robot was carried there, and
    /// saw nothing that contradicted it. The nodes around the break stay unplaced, as the place is not known better.
    pub(super) fn break_odometry_at_conflicting_closures(&mut self) {
        let conflicting = self.conflicting_closures();
        let Some(newest) = conflicting.first().copied().filter(|_| conflicting.len() >= BREAKING_MIN) else {
            return;
        };
        let edges = self.graph.edges();
        let ends = |edge: &Edge| [edge.a.min(edge.b), edge.a.max(edge.b)];
        let spans: Vec<[u32; 2]> = conflicting.iter().map(|index| ends(&edges[*index])).collect();
        let active = edges.iter().filter(|edge| edge.kind == EdgeKind::Closure && edge.is_active);
        let active: Vec<[u32; 2]> = active.map(ends).collect();
        let Some(at) = suspected_break_of_closures(&spans, &active) else { return };
        if self.nodes[at.before as usize + 1..=at.after as usize].iter().any(|node| node.odometry_break) {
            return;
        }
        for step in [at.before, at.after - 1] {
            for index in 0..self.graph.edges().len() {
                let edge = self.graph.edge_mut(index);
                let [first, last] = ends(edge);
                if edge.kind == EdgeKind::ScanMatch && (first..last).contains(&step) {
                    edge.is_active = false;
                }
            }
            self.break_odometry(step + 1);
        }
        self.update_components();
        let Edge { a, b, a_from_b, information, response, .. } = self.graph.edges()[newest];
        let closure =
            ClosureCandidate { older: a, newer: b, older_from_newer: a_from_b, information, response };
        self.align_components(&closure);
        for index in &conflicting {
            self.graph.edge_mut(*index).is_active = true;
        }
        self.loop_closures.retracted = self.loop_closures.retracted.saturating_sub(conflicting.len() as u64);
        self.solve(true);
    }

    /// Whether a closure says the same as another one between the same passes, of the nodes `a` and `b`.
    fn agrees(&self, edge: &Edge, [a, b]: [u32; 2], a_from_b: Pose2) -> bool {
        let c = &self.config.closures;
        let implied = self.graph.implied_by(edge, [a, b]);
        let turned = wrap_angle(implied.yaw_rad - a_from_b.yaw_rad).abs();
        let is_near = edge.a.abs_diff(a).max(edge.b.abs_diff(b)) <= AGREEING_NODES;
        is_near && implied.distance_m(a_from_b) < c.agree_m && turned < c.agree_rad
    }
}

/// The place in the path that all these retracted closures span, and none of those in the graph: there the motion is wrong. Each closure is the
/// first and the last node of what it spans.
fn suspected_break_of_closures(retracted: &[[u32; 2]], active: &[[u32; 2]]) -> Option<SuspectedBreak> {
    let first = retracted.iter().map(|[first, _]| *first).max()?;
    let last = retracted.iter().map(|[_, last]| *last).min()?;
    let is_confirmed = |step: u32| active.iter().any(|[first, last]| (*first..*last).contains(&step));
    let before = (first..last).find(|step| !is_confirmed(*step))?;
    let after = (first..last).rfind(|step| !is_confirmed(*step))? + 1;
    Some(SuspectedBreak { before, after })
}

#[cfg(test)]
mod tests {
    use super::super::testing::straight_path;
    use super::*;
    use posegraph::information_from_sigmas;

    /// A path of 70 steps that claims to know each to 4.6 mm.
    fn long_path() -> BackEnd {
        let mut back = straight_path(70, 0.3);
        for id in 1..70 {
            let information = information_from_sigmas(0.0046, 0.0005);
            let moved = Pose2::new(0.3, 0.0, 0.0);
            back.graph.add_edge([id - 1, id], moved, information, EdgeKind::ScanMatch, [0.0; 2]);
        }
        back
    }

    /// The `k`-th closure, which says that the ends of 60 steps, 18 m, are this far apart, metres.
    fn closure(k: u32, apart_m: f64) -> ClosureCandidate {
        ClosureCandidate {
            newer: 60 + k,
            older: k,
            older_from_newer: Pose2::new(apart_m, 0.0, 0.0),
            information: information_from_sigmas(0.01, 0.003),
            response: 0.8,
        }
    }

    impl ClosureCandidate {
        /// The same with another newer node.
        fn to(self, newer: u32) -> Self {
            Self { newer, ..self }
        }
    }

    #[test]
    fn right_closures_that_a_long_path_outvotes_two_by_two_win_together() {
        // The end of the path is 0.6 m off.
        let mut back = long_path();
        let closure = |k: u32| closure(k, 17.4);
        back.add_closures(&[closure(0), closure(1)]);
        assert_eq!((back.counts().closures, back.counts().retracted), (0, 2));
        assert_eq!(back.count_conflicting_closures(), 0, "less than a metre");
        back.add_closures(&[closure(2), closure(3)]);
        back.add_closures(&[closure(4), closure(5)]);
        back.add_closures(&[closure(6), closure(7)]);
        assert_eq!((back.counts().closures, back.counts().retracted), (8, 0));
        let end_m = back.graph.poses()[60].x_m - back.graph.poses()[0].x_m;
        assert!((end_m - 17.4).abs() < 0.05, "{end_m}");
    }

    #[test]
    fn the_suspected_break_lies_where_all_removed_closures_and_none_active_span_the_path() {
        let removed = [[3, 60], [5, 62], [7, 64]];
        assert_eq!(suspected_break_of_closures(&removed, &[]), Some(SuspectedBreak { before: 7, after: 60 }));
        assert_eq!(
            suspected_break_of_closures(&removed, &[[0, 40], [58, 70]]),
            Some(SuspectedBreak { before: 40, after: 58 })
        );
        assert_eq!(suspected_break_of_closures(&removed, &[[0, 60]]), None, "the others confirm all of it");
        assert_eq!(suspected_break_of_closures(&[[3, 20], [40, 60]], &[]), None, "not one place");
        assert_eq!(suspected_break_of_closures(&[], &[]), None);
    }

    #[test]
    fn a_path_that_many_closures_contradict_by_metres_is_broken_where_they_say_and_they_win() {
        // Carried by 3.3 m between the nodes 40 and 60, which nothing measured. The way before is confirmed.
        let mut back = long_path();
        for id in 1..70 {
            let information = information_from_sigmas(0.05, 0.01);
            let moved = Pose2::new(0.3, 0.0, 0.0);
            back.graph.add_edge([id - 1, id], moved, information, EdgeKind::Odometry, [0.0; 2]);
        }
        back.add_closures(&[closure(0, 12.0).to(40), closure(1, 12.0).to(41)]);
        let closure = |k: u32| closure(k, 14.7);
        back.add_closures(&[closure(0), closure(1)]);
        assert_eq!(
            (back.counts().closures, back.counts().retracted),
            (2, 2),
            "one pair may be a place that looks alike"
        );
        back.add_closures(&[closure(2), closure(3)]);
        assert_eq!((back.counts().closures, back.counts().retracted), (6, 0));
        let end_m = back.graph.poses()[60].x_m - back.graph.poses()[0].x_m;
        assert!((end_m - 14.7).abs() < 0.05, "{end_m}");
        let is_placed = |id: usize| back.nodes[id].is_placed();
        assert!((0..=41).chain(60..70).all(is_placed), "both sides are one map");
        assert!(!(42..60).any(is_placed), "what lies between has no known place");
        // Nothing is left to break.
        let edges = back.graph.edges().len();
        back.break_odometry_at_conflicting_closures();
        assert_eq!((back.counts().closures, back.graph.edges().len()), (6, edges));
    }

    #[test]
    fn a_map_that_contradicts_closures_which_agree_by_metres_is_unreliable() {
        let mut back = long_path();
        back.add_closures(&[closure(0, 14.7)]);
        back.recompute_reliability();
        assert!(
            !back.reliability_evidence().is_unreliable(),
            "one alone may be wrong: {:?}",
            back.reliability_evidence()
        );
        back.add_closures(&[closure(1, 14.7)]);
        back.recompute_reliability();
        assert_eq!((back.counts().closures, back.reliability_evidence().conflicting_closures), (0, 2));
        assert!(back.reliability_evidence().is_unreliable());
    }
}
