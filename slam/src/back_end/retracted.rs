//! Closures that the solved graph contradicted, and that later ones confirm.
//!
//! Robust kernels let a long path outvote two closures, however right, if its links claim more than they know. What two
//! cannot do, many that say the same can: closures that agree are judged as a set (pairwise consistency; Mangelson et al.,
//! "Pairwise consistent measurement set maximization", ICRA 2018).

use super::BackEnd;
use crate::closure::ClosureCandidate;
use crate::graph::{Edge, EdgeKind};
use msg::pose::wrap_angle;

/// Closures whose ends are this near in order can be compared: the graph knows the way between their ends, some 12 m, well.
const AGREEING_NODES: u32 = 40;

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
                    && new.iter().any(|closure| self.agrees(edge, closure))
            })
            .collect();
        for index in restored {
            self.graph.edge_mut(index).in_force = true;
            self.loop_closer.retracted = self.loop_closer.retracted.saturating_sub(1);
        }
    }

    /// Whether two closures between the same passes say the same.
    fn agrees(&self, edge: &Edge, new: &ClosureCandidate) -> bool {
        let c = &self.config.closures;
        let poses = self.graph.poses();
        let to = poses[new.candidate as usize].between(poses[edge.a as usize]);
        let back = poses[edge.b as usize].between(poses[new.node as usize]);
        let implied = to * edge.a_from_b * back;
        let turned = wrap_angle(implied.yaw_rad - new.candidate_from_node.yaw_rad).abs();
        let is_near = edge.a.abs_diff(new.candidate).max(edge.b.abs_diff(new.node)) <= AGREEING_NODES;
        is_near && implied.distance_m(new.candidate_from_node) < c.agree_m && turned < c.agree_rad
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::common::{FULL, Noise, cast};
    use crate::config::SlamConfig;
    use crate::testing::standing_node;
    use msg::{Pose2, Stamp};
    use posegraph::information_from_sigmas;

    #[test]
    fn right_closures_that_a_long_path_outvotes_two_by_two_win_together() {
        let mut back = BackEnd::new(SlamConfig::default());
        // A path that claims 4.6 mm a step, and whose end is 0.6 m off after 60 of them.
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
        let closure = |k: u32| ClosureCandidate {
            node: 60 + k,
            candidate: k,
            candidate_from_node: Pose2::new(17.4, 0.0, 0.0),
            information: information_from_sigmas(0.01, 0.003),
            response: 0.8,
        };
        back.add_closures(&[closure(0), closure(1)]);
        assert_eq!((back.counts().closures, back.counts().retracted), (0, 2));
        back.add_closures(&[closure(2), closure(3)]);
        back.add_closures(&[closure(4), closure(5)]);
        back.add_closures(&[closure(6), closure(7)]);
        assert_eq!((back.counts().closures, back.counts().retracted), (8, 0));
        let end_m = back.graph.poses()[60].x_m - back.graph.poses()[0].x_m;
        assert!((end_m - 17.4).abs() < 0.05, "{end_m}");
    }
}
