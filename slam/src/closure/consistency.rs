//! Whether a closure agrees with the way that the graph knows between its two ends.
//!
//! Scans of equal aisles, bays or doors agree, and so do many of them with each other: what tells a new aisle from the old
//! one is how far the robot has gone. Each closure of a set has to be consistent with odometry and links (pairwise
//! consistency; Mangelson et al., "Pairwise consistent measurement set maximization", ICRA 2018, section IV).

use super::ClosureCandidate;
use crate::config::LinkConfig;
use crate::graph::{Graph, RelativeUncertainty, UNOBSERVED, turn_covariance};
use msg::pose::wrap_angle;
use nalgebra::{Matrix3, Vector3};
use posegraph::limit_information;

/// Squared error of a closure that the way admits, in variances, where errors are independent: the 50 % quantile of a chi-squared
/// distribution of three degrees of freedom. The covariance of a path is cautious, so that it admits most right closures all the same: on the
/// generated seeds 0..144 (as drawn before 2026-11-28), 741 right and 9 wrong ones are part of the graph at the end with it, and 788 and 30 with the 90 % quantile.
const CHI_SQUARED_MAX: f64 = 2.37;
/// The same where errors that repeat along the way count too, which are no more than they are: the 75 % quantile. fhw needs 3.5, and is the same up
/// to 6.25.
const CHI_SQUARED_SYSTEMATIC_MAX: f64 = 4.11;

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
    let RelativeUncertainty { bias_m, bias_rad, .. } = known.unwrap_or_default();
    let bias = Vector3::new(bias_m, bias_m, bias_rad).map(|sigma| sigma * sigma);
    let covariance = path_covariance + Matrix3::from_diagonal(&bias) + turn_covariance(measured, a.yaw_rad);
    let most = if bias_m > 0.0 { CHI_SQUARED_SYSTEMATIC_MAX } else { CHI_SQUARED_MAX };
    covariance.try_inverse().is_none_or(|inverse| (error.transpose() * inverse * error)[0] < most)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::SlamConfig;
    use crate::graph::EdgeKind;
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
        // Found in the old aisle, where the path began, instead of 3 m beside it.
        let closure = |y_m: f64| ClosureCandidate {
            newer: 21,
            older: 0,
            older_from_newer: Pose2::new(0.0, y_m, core::f64::consts::PI),
            information: information_from_sigmas(0.01, 0.003),
            response: 0.9,
        };
        let good = there_and_back(0.05, 0.01);
        assert!(is_consistent(&good, &closure(3.0), &links, None));
        assert!(is_consistent(&good, &closure(2.9), &links, None));
        assert!(!is_consistent(&good, &closure(0.0), &links, None));
        let bias = RelativeUncertainty { bias_m: 2.0, bias_rad: 0.1, ..RelativeUncertainty::default() };
        assert!(is_consistent(&good, &closure(0.0), &links, Some(bias)), "what repeats may make 3 m of 20 m");
        let bad = there_and_back(0.3, 0.15);
        assert!(is_consistent(&bad, &closure(0.0), &links, None));
    }
}
