//! Whether a closure agrees with the way that the graph knows between its two ends.
//!
//! Scans of equal aisles, bays or doors agree, and so do many of them with each other: what tells a new aisle from the old
//! one is how far the robot has gone. Each closure of a set has to be consistent with odometry and links (pairwise
//! consistency; Mangelson et al., "Pairwise consistent measurement set maximization", ICRA 2018, section IV).

use super::ClosureCandidate;
use crate::config::LinkConfig;
use crate::graph::{Graph, RelativeUncertainty, UNOBSERVED, turn_covariance};
use msg::pose::wrap_angle;
use nalgebra::Vector3;
use posegraph::limit_information;

/// Squared error of a closure that the way admits, in variances: the 75 % quantile of a chi-squared distribution of three degrees of freedom. The
/// covariance of a path is cautious, so that it admits nearly all right closures all the same. At the 50 % quantile 60 finds in a row
/// of intel at 90° would be refused that are right (3.5 to 3.8).
const CHI_SQUARED_MAX: f64 = 4.11;

/// Whether the graph, before this closure, admits it: its error in standard deviations of both. `known` is how well the node is
/// known as seen from the candidate: the errors that repeat are taken from it. `None` where nothing joins them.
pub(super) fn is_consistent(
    graph: &Graph,
    closure: &ClosureCandidate,
    links: &LinkConfig,
    known: Option<RelativeUncertainty>,
) -> bool {
    let [a, b] = [closure.older, closure.newer].map(|id| graph.poses()[id as usize]);
    let drift = [links.drift_m_per_m, links.drift_rad_per_m];
    let Some(path_covariance) = graph.relative_covariance(closure.older, closure.newer, drift) else {
        return true;
    };
    let information =
        limit_information(closure.information, [links.sigma_min_m, links.sigma_min_rad], UNOBSERVED);
    let Some(measured) = information.try_inverse() else { return true };
    let found = a * closure.older_from_newer;
    let error = Vector3::new(found.x_m - b.x_m, found.y_m - b.y_m, wrap_angle(found.yaw_rad - b.yaw_rad));
    let bias = known.unwrap_or_default().bias;
    let covariance = path_covariance + bias.covariance() + turn_covariance(measured, a.yaw_rad);
    covariance.try_inverse().is_none_or(|inverse| (error.transpose() * inverse * error)[0] < CHI_SQUARED_MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::SlamConfig;
    use crate::graph::{EdgeKind, SystematicError};
    use msg::Pose2;
    use posegraph::information_from_sigmas;

    /// A path of 10 m along x and back 3 m beside it, with edges of the given standard deviations each metre.
    fn there_and_back(sigma_m: f64, sigma_rad: f64) -> Graph {
        let mut graph = Graph::new(SlamConfig::default().graph);
        let there = (0..=10).map(|k| Pose2::new(f64::from(k), 0.0, 0.0));
        let back = (0..=10).map(|k| Pose2::new(f64::from(10 - k), 3.0, core::f64::consts::PI));
        for (id, pose) in there.chain(back).enumerate() {
            graph.add_node(pose);
            if let Some(before) = id.checked_sub(1) {
                let moved = graph.poses()[before].between(pose);
                let ends = [before as u32, id as u32];
                let information = information_from_sigmas(sigma_m, sigma_rad);
                graph.add_edge(ends, moved, information, EdgeKind::Odometry, [0.0; 2]);
            }
        }
        graph
    }

    #[test]
    fn an_equal_aisle_three_metres_beside_is_refused_unless_odometry_may_err_so_far() {
        let links = SlamConfig::default().links;
        let closure = |x_m: f64, y_m: f64| ClosureCandidate {
            newer: 21,
            older: 0,
            older_from_newer: Pose2::new(x_m, y_m, core::f64::consts::PI),
            information: information_from_sigmas(0.01, 0.003),
            response: 0.9,
        };
        // Found in the old aisle, where the path began, instead of 3 m beside it.
        let beside = closure(0.0, 0.0);
        let good = there_and_back(0.05, 0.01);
        assert!(is_consistent(&good, &closure(0.0, 3.0), &links, None));
        assert!(is_consistent(&good, &closure(0.0, 2.9), &links, None));
        assert!(!is_consistent(&good, &beside, &links, None));
        let bias = SystematicError { moved_m: [0.0, 2.0], turned_rad: 0.01 };
        let bias = RelativeUncertainty { bias, ..RelativeUncertainty::default() };
        assert!(is_consistent(&good, &beside, &links, Some(bias)), "what repeats may make 3 m of 20 m");
        let ahead = closure(-3.0, 3.0);
        assert!(!is_consistent(&good, &ahead, &links, Some(bias)), "to one side, and not ahead");
        let bad = there_and_back(0.3, 0.15);
        assert!(is_consistent(&bad, &beside, &links, None));
    }
}
