//! Closures that the solved graph contradicted, and that later ones confirm; and those that stay removed although they agree.
//!
//! Robust kernels let a long path outvote two closures, however right, if its links claim more than they know. What two
//! cannot do, many that say the same can: closures that agree are judged as a set (pairwise consistency; Mangelson et al.,
//! "Pairwise consistent measurement set maximization", ICRA 2018).

use super::BackEnd;
use crate::closure::ClosureCandidate;
use crate::graph::{Edge, EdgeKind};
use msg::{Pose2, pose::wrap_angle};

/// Closures whose ends are this near in order can be compared: the graph knows the way between their ends, some 12 m, well.
const AGREEING_NODES: u32 = 40;
/// Distance between a closure and the map from which one of the two is wrong by what matters, metres. Closures that a map at 90° removes
/// for some centimetres are no evidence.
const REFUTED_M: f64 = 1.0;
/// Most refuted closures that are compared with each other, the newest.
const REFUTED_MAX: usize = 64;

impl BackEnd {
    /// Puts closures that were taken back into force again if new ones agree with them. If the solved graph still
    /// contradicts them, they are taken back again.
    pub(super) fn restore_retracted(&mut self, new: &[ClosureCandidate]) {
        let edges = self.graph.edges();
        let restored: Vec<usize> = (0..edges.len())
            .filter(|&index| {
                let edge = &edges[index];
                let is_retracted = edge.kind == EdgeKind::Closure && !edge.in_force;
                is_retracted
                    && !self.loop_closer.was_rejected(edge)
                    && new.iter().any(|it| self.agrees(edge, [it.older, it.newer], it.older_from_newer))
            })
            .collect();
        for index in restored {
            self.graph.edge_mut(index).in_force = true;
            self.loop_closer.retracted = self.loop_closer.retracted.saturating_sub(1);
        }
    }

    /// Number of closures that were removed although another one says the same, and that put nodes of the map more than a metre away
    /// from where they are. Either they are wrong together, or the path between their ends is: a robot that was carried along a
    /// corridor sees nothing that contradicts it but these.
    pub(super) fn count_refuted_closures(&self) -> u32 {
        let poses = self.graph.poses();
        let is_tied = |id: u32| self.nodes[id as usize].is_tied();
        let is_refuted = |edge: &&Edge| {
            let in_map = poses[edge.a as usize].between(poses[edge.b as usize]);
            edge.kind == EdgeKind::Closure
                && !edge.in_force
                && is_tied(edge.a)
                && is_tied(edge.b)
                && in_map.distance_m(edge.a_from_b) > REFUTED_M
                && !self.loop_closer.was_rejected(edge)
        };
        let refuted: Vec<&Edge> =
            self.graph.edges().iter().rev().filter(is_refuted).take(REFUTED_MAX).collect();
        let is_confirmed = |edge: &&&Edge| {
            refuted.iter().any(|other| {
                !core::ptr::eq(**edge, *other) && self.agrees(edge, [other.a, other.b], other.a_from_b)
            })
        };
        refuted.iter().filter(is_confirmed).count() as u32
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::common::{FULL, Noise, cast};
    use crate::config::SlamConfig;
    use crate::testing::standing_node;
    use msg::Stamp;
    use posegraph::information_from_sigmas;

    /// A path of 70 steps that claims to know each to 4.6 mm.
    fn long_path() -> BackEnd {
        let mut back = BackEnd::new(SlamConfig::default());
        for id in 0..70 {
            let at = Pose2::new(0.3 * f64::from(id), 0.0, 0.0);
            let scan = cast(&[], &FULL, at, Stamp(i64::from(id)), &mut Noise::new(1));
            back.graph.add_node(at);
            back.nodes.push(standing_node(id, &scan, at, &back.config.lidar));
            if id > 0 {
                let information = information_from_sigmas(0.0046, 0.0005);
                back.graph.add_edge(
                    [id - 1, id],
                    Pose2::new(0.3, 0.0, 0.0),
                    information,
                    EdgeKind::Link,
                    [0.0; 2],
                );
            }
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

    #[test]
    fn right_closures_that_a_long_path_outvotes_two_by_two_win_together() {
        // The end of the path is 0.6 m off.
        let mut back = long_path();
        let closure = |k: u32| closure(k, 17.4);
        back.add_closures(&[closure(0), closure(1)]);
        assert_eq!((back.counts().closures, back.counts().retracted), (0, 2));
        assert_eq!(back.count_refuted_closures(), 0, "less than a metre");
        back.add_closures(&[closure(2), closure(3)]);
        back.add_closures(&[closure(4), closure(5)]);
        back.add_closures(&[closure(6), closure(7)]);
        assert_eq!((back.counts().closures, back.counts().retracted), (8, 0));
        let end_m = back.graph.poses()[60].x_m - back.graph.poses()[0].x_m;
        assert!((end_m - 17.4).abs() < 0.05, "{end_m}");
    }

    #[test]
    fn a_map_that_contradicts_closures_which_agree_by_metres_is_unreliable() {
        let mut back = long_path();
        back.add_closures(&[closure(0, 14.7)]);
        back.renew_doubts();
        assert!(!back.doubts().is_unreliable(), "one alone may be wrong: {:?}", back.doubts());
        back.add_closures(&[closure(1, 14.7)]);
        back.renew_doubts();
        assert_eq!((back.counts().closures, back.doubts().refuted_closures), (0, 2));
        assert!(back.doubts().is_unreliable());
    }
}
