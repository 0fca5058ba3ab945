//! Which errors of the way a closure search counts: it looks first where random errors allow, then where systematic ones do.

use crate::graph::{RelativeUncertainty, SystematicError};

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
            Self::Random => RelativeUncertainty { bias: SystematicError::default(), ..known },
            Self::Systematic => known.with_bias(),
        }
    }

    /// Whether a search that counts them differs from one that does not.
    pub(super) fn has_effect(self, known: Option<RelativeUncertainty>) -> bool {
        self == Self::Random
            || known.is_some_and(|known| known.bias.distance_m().powi(2) > known.worst_axis_variance_m2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::SlamConfig;
    use crate::graph::{EdgeKind, Graph};
    use core::f64::consts::PI;
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
        let [near, far] = [4, 150].map(|id: usize| known[id].unwrap());
        // 1 mrad a metre: 150 mrad, and 11 m to the side.
        assert!((far.bias.turned_rad.abs() - 0.15).abs() < 1e-9, "{far:?}");
        assert!((far.bias.distance_m() - 11.3).abs() < 0.1 && far.bias.moved_m[0].abs() < 1e-9, "{far:?}");
        assert!(
            ErrorModel::Systematic.has_effect(Some(far)) && !ErrorModel::Systematic.has_effect(Some(near))
        );
        assert!(ErrorModel::Random.has_effect(Some(near)) && ErrorModel::Random.has_effect(None));
        assert!(ErrorModel::Systematic.apply(far).worst_axis_variance_m2.sqrt() > 11.2);
        assert!(ErrorModel::Random.apply(far).worst_axis_variance_m2.sqrt() < 4.0);
        assert_eq!(ErrorModel::Random.apply(far).bias, SystematicError::default());
    }

    #[test]
    fn there_and_back_a_bend_displaces_the_end_less_than_straight_on() {
        let way = |turns_back: bool| {
            let mut graph = Graph::new(SlamConfig::default().graph);
            for id in 0..=100 {
                let x_m = if turns_back && id > 50 { 100.0 - f64::from(id) } else { f64::from(id) };
                graph.add_node(Pose2::new(x_m, 0.0, if turns_back && id > 50 { PI } else { 0.0 }));
                if id > 0 {
                    let (poses, ends) = (graph.poses(), [id as u32 - 1, id as u32]);
                    let moved = poses[ends[0] as usize].between(poses[ends[1] as usize]);
                    let information = information_from_sigmas(0.01, 0.003);
                    graph.add_edge(ends, moved, information, EdgeKind::ScanMatch, [0.0; 2]);
                }
            }
            // As seen from the end, and from the beginning.
            [(100, 0), (0, 100)]
                .map(|(from, to)| graph.uncertainty_from(from, f64::INFINITY)[to].unwrap().bias)
        };
        for (straight, back) in way(false).into_iter().zip(way(true)) {
            assert!(
                (straight.turned_rad.abs() - back.turned_rad.abs()).abs() < 1e-9,
                "{straight:?} {back:?}"
            );
            assert!(straight.distance_m() > 1.9 * back.distance_m(), "{straight:?} {back:?}");
        }
    }
}
