//! Which errors of the way a closure search counts: it looks first where random errors allow, then where systematic ones do.

use crate::graph::RelativeUncertainty;

/// Errors of the way that a search counts.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum ErrorModel {
    /// Those of each edge by itself, which are independent of each other.
    Random,
    /// Also those that repeat along the way, such as of a wrong wheel radius.
    Systematic,
}

impl ErrorModel {
    /// Returns what is known of a node with these errors.
    pub(super) fn apply(self, known: RelativeUncertainty) -> RelativeUncertainty {
        match self {
            Self::Random => RelativeUncertainty { bias_m: 0.0, bias_rad: 0.0, ..known },
            Self::Systematic => known.with_bias(),
        }
    }

    /// Whether a search that counts them differs from one that does not.
    pub(super) fn has_effect(self, known: Option<RelativeUncertainty>) -> bool {
        self == Self::Random || known.is_some_and(|known| known.bias_m.powi(2) > known.position_variance_m2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::SlamConfig;
    use crate::graph::{EdgeKind, Graph};
    use msg::Pose2;
    use posegraph::information_from_sigmas;

    #[test]
    fn errors_that_repeat_matter_after_a_long_way_and_not_after_a_short_one() {
        let mut graph = Graph::new(SlamConfig::default().graph);
        for id in 0..=150 {
            graph.add_node(Pose2::new(f64::from(id), 0.0, 0.0));
            if id > 0 {
                let information = information_from_sigmas(0.01, 0.003);
                let moved = Pose2::new(1.0, 0.0, 0.0);
                graph.add_edge([id as u32 - 1, id as u32], moved, information, EdgeKind::ScanMatch, [0.0; 2]);
            }
        }
        let known = graph.uncertainty_from(0, f64::INFINITY);
        let [near, far] = [8, 150].map(|id: usize| known[id].unwrap());
        // 0.5 mrad a metre: 75 mrad, and 5.6 m to the side.
        assert!((far.bias_rad - 0.075).abs() < 1e-9 && (far.bias_m - 5.5875).abs() < 1e-6, "{far:?}");
        assert!(
            ErrorModel::Systematic.has_effect(Some(far)) && !ErrorModel::Systematic.has_effect(Some(near))
        );
        assert!(ErrorModel::Random.has_effect(Some(near)) && ErrorModel::Random.has_effect(None));
        assert!(ErrorModel::Systematic.apply(far).position_variance_m2.sqrt() > 5.58);
        assert!(ErrorModel::Random.apply(far).position_variance_m2.sqrt() < 4.0);
        assert_eq!(ErrorModel::Random.apply(far).bias_m, 0.0);
    }
}
