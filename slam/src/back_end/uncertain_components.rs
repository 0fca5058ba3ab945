//! Components of the map whose position is too uncertain: they are not part of it until a closure tells where they are.
//!
//! A place that may be metres from where it is drawn is worse than none. The graph keeps such a component: closures are searched
//! for as everywhere, and with the covariance the component joins the map.
//!
//! So is what was mapped from where a person said that the robot is, until a scan of it is aligned with one of the map.

use super::BackEnd;
use super::localization_state::UnconfirmedEstimate;

use crate::graph::{Edge, EdgeKind};
use crate::reliability::SuspectedBreak;
use crate::relocalize::LocalFrameEstimate;
use core::ops::Range;

/// A node whose position has a larger standard deviation, relative to the map, is not part of it, metres. Public logs of large
/// buildings, whose maps are right, have up to 1.48.
const POSITION_SIGMA_MAX_M: f64 = 1.5;
/// Components that are tried as the map, a bound: the largest wins.
const COMPONENTS_MAX: usize = 16;

/// Least information of a person's estimate in a session, 1/m² and 1/rad²: a standard deviation of 100.
const ESTIMATE_INFORMATION_MIN: f64 = 1e-4;

impl BackEnd {
    /// Finds the covariances of all nodes anew, and which nodes are known well enough as seen from one of them. Where these
    /// are not all, the map is the largest such set, and the covariances are as seen from its first node.
    pub(super) fn update_covariances(&mut self) {
        let unconfirmed = self.unconfirmed_components();
        let separate = |back: &Self, id| back.component_beyond_break(id).or(first_of(&unconfirmed, id));
        for id in 0..self.nodes.len() as u32 {
            self.nodes[id as usize].uncertain_component = separate(self, id);
        }
        let systematic = self.systematic_odometry_errors();
        // First node and size of the largest component.
        let mut largest: Option<(u32, usize)> = None;
        let mut seen_from = None;
        for _ in 0..COMPONENTS_MAX {
            let Some(first) = self.nodes.iter().find(|node| node.in_map()).map(|node| node.id) else { break };
            self.graph.update_covariances(first, systematic);
            seen_from = Some(first);
            let size = self.mark_component(first);
            if largest.is_none_or(|(_, most)| size > most) {
                largest = Some((first, size));
            }
        }
        let Some((first, _)) = largest else { return self.graph.update_covariances(0, systematic) };
        if seen_from != Some(first) {
            self.graph.update_covariances(first, systematic);
        }
        for id in 0..self.nodes.len() as u32 {
            let (is_known, is_separate) = (self.is_position_known(id), separate(self, id).is_some());
            let node = &mut self.nodes[id as usize];
            let is_uncertain = (!is_known || is_separate) && node.disconnected_component.is_none();
            node.uncertain_component = is_uncertain.then(|| node.uncertain_component.unwrap_or(id));
        }
    }

    /// First node of the component of a node that lies beyond the place where the path is wrong, as seen from the larger part of it.
    fn component_beyond_break(&self, id: u32) -> Option<u32> {
        let SuspectedBreak { before, after } = self.reliability.suspected_break?;
        let is_earlier_larger = before + 1 >= self.nodes.len() as u32 - after.min(self.nodes.len() as u32);
        match is_earlier_larger {
            true => (id > before).then_some(before + 1),
            false => (id < after).then_some(0),
        }
    }

    /// The nodes that nothing but a person's estimate places: those from such an estimate to where the path begins anew, if no active link or
    /// closure leads from them to the map.
    fn unconfirmed_components(&self) -> Vec<Range<u32>> {
        let edges = self.graph.edges();
        let begins_anew = |edge: &&Edge| {
            use EdgeKind::{EstimatedPose, InitialPose, OdometryBreak};
            matches!(edge.kind, EstimatedPose | InitialPose | OdometryBreak)
        };
        let nodes_from = |first: u32| {
            let anew = edges.iter().filter(begins_anew).map(|edge| edge.b).filter(|id| *id > first);
            first..anew.min().unwrap_or(self.nodes.len() as u32)
        };
        let estimated = edges.iter().filter(|edge| edge.kind == EdgeKind::EstimatedPose);
        let mut unconfirmed: Vec<Range<u32>> = estimated.map(|edge| nodes_from(edge.b)).collect();
        // One that is confirmed confirms others.
        loop {
            let before = unconfirmed.clone();
            unconfirmed.retain(|nodes| {
                !edges.iter().filter(|edge| edge.is_active_scan()).any(|edge| {
                    let outside = match (nodes.contains(&edge.a), nodes.contains(&edge.b)) {
                        (true, false) => edge.b,
                        (false, true) => edge.a,
                        _ => return false,
                    };
                    first_of(&before, outside).is_none()
                })
            });
            if unconfirmed.len() == before.len() {
                return unconfirmed;
            }
        }
    }

    /// First node of the newest node's component, if nothing but a person's estimate places that.
    pub(super) fn newest_unconfirmed_component(&self) -> Option<u32> {
        first_of(&self.unconfirmed_components(), self.nodes.last()?.id)
    }

    /// Takes what a person said before the session was saved as said, if nothing had confirmed it.
    pub(super) fn restore_unconfirmed(&mut self) {
        let Some((first, newest)) = self.newest_unconfirmed_component().zip(self.nodes.last()) else {
            return;
        };
        let estimated = |edge: &&Edge| edge.kind == EdgeKind::EstimatedPose && edge.b == first;
        let Some(edge) = self.graph.edges().iter().find(estimated) else { return };
        let sigma = |axis: usize| edge.information[(axis, axis)].max(ESTIMATE_INFORMATION_MIN).sqrt().recip();
        let map_from_local = self.graph.poses()[newest.id as usize] * newest.local_from_base.inverse();
        let estimate = LocalFrameEstimate { map_from_local, sigma_m: sigma(0), sigma_rad: sigma(2) };
        self.location.unconfirmed =
            Some(UnconfirmedEstimate { estimate, first_node: first, matched_before: 0 });
    }

    /// Marks the nodes of no component yet that are known well enough as seen from `first`; returns their number.
    fn mark_component(&mut self, first: u32) -> usize {
        let mut size = 0;
        for id in first..self.nodes.len() as u32 {
            if self.nodes[id as usize].is_placed() && self.is_position_known(id) {
                self.nodes[id as usize].uncertain_component = Some(first);
                size += 1;
            }
        }
        size
    }

    /// The node whose pose in the map is certain: covariances are as seen from it.
    pub fn covariance_reference_node(&self) -> u32 {
        self.graph.covariance_reference_node()
    }

    /// Checks whether the newest node's position is known well enough, by its covariance.
    pub(super) fn check_newest_position_uncertainty(&mut self) {
        let Some(newest) = self.nodes.len().checked_sub(1) else { return };
        let before = newest.checked_sub(1).and_then(|before| self.nodes[before].uncertain_component);
        let unconfirmed = self.newest_unconfirmed_component();
        let is_known = self.is_position_known(newest as u32)
            && self.component_beyond_break(newest as u32).is_none()
            && unconfirmed.is_none();
        let node = &mut self.nodes[newest];
        let is_uncertain = !is_known && node.disconnected_component.is_none();
        node.uncertain_component = is_uncertain.then(|| unconfirmed.or(before).unwrap_or(node.id));
    }

    fn is_position_known(&self, id: u32) -> bool {
        self.graph.position_variance_trace_m2(id) <= POSITION_SIGMA_MAX_M.powi(2)
    }
}

/// First node of that of these ranges which has node `id`.
fn first_of(components: &[Range<u32>], id: u32) -> Option<u32> {
    components.iter().find(|nodes| nodes.contains(&id)).map(|nodes| nodes.start)
}

#[cfg(test)]
mod tests {
    use super::super::testing::straight_path;
    use super::*;
    use crate::graph::EdgeKind;
    use crate::node::Node;
    use msg::Pose2;
    use posegraph::information_from_sigmas;

    /// A path of 60 nodes along x, each metre; between the nodes 19 and 20 it is known to 3 m.
    fn path_with_gap() -> BackEnd {
        let mut back = straight_path(60, 1.0);
        for id in 1..60 {
            let sigma_m = if id == 20 { 3.0 } else { 0.01 };
            let information = information_from_sigmas(sigma_m, 0.001);
            let moved = Pose2::new(1.0, 0.0, 0.0);
            back.graph.add_edge([id - 1, id], moved, information, EdgeKind::ScanMatch, [0.0; 2]);
        }
        back.update_covariances();
        back
    }

    #[test]
    fn the_largest_component_that_is_known_is_the_map_until_a_closure_joins_them() {
        let mut back = path_with_gap();
        let components =
            |back: &BackEnd| back.nodes.iter().map(|node| node.uncertain_component).collect::<Vec<_>>();
        assert!(
            components(&back)[..20].iter().all(|component| *component == Some(0)),
            "{:?}",
            components(&back)
        );
        assert!(components(&back)[20..].iter().all(Option::is_none), "{:?}", components(&back));
        assert_eq!((back.covariance_reference_node(), back.unplaced_component_count()), (20, 1));
        assert_eq!(back.counts().unplaced, 20);
        let closure = Pose2::new(30.0, 0.0, 0.0);
        let information = information_from_sigmas(0.02, 0.003);
        back.graph.add_edge([10, 40], closure, information, EdgeKind::Closure, [0.0; 2]);
        back.update_covariances();
        assert!(back.nodes.iter().all(Node::is_placed), "{:?}", components(&back));
    }

    #[test]
    fn what_lies_beyond_a_wrong_motion_is_no_part_of_the_map() {
        let mut back = path_with_gap();
        back.reliability.suspected_break = Some(SuspectedBreak { before: 49, after: 52 });
        back.update_covariances();
        assert!(back.nodes[20..50].iter().all(Node::is_placed));
        assert!(back.nodes[50..].iter().all(|node| node.unplaced_component() == Some(50)));
        // The next node goes on beyond it.
        back.check_newest_position_uncertainty();
        assert_eq!(back.nodes[59].unplaced_component(), Some(50));
    }

    #[test]
    fn what_a_person_alone_places_is_no_part_of_the_map_until_a_scan_confirms_it() {
        let mut back = straight_path(30, 1.0);
        let information = information_from_sigmas(0.01, 0.001);
        let mut add = |a: u32, b: u32, kind| {
            back.graph.add_edge(
                [a, b],
                Pose2::new(f64::from(b) - f64::from(a), 0.0, 0.0),
                information,
                kind,
                [0.0; 2],
            );
            back.update_covariances();
            back.nodes.iter().map(Node::unplaced_component).collect::<Vec<_>>()
        };
        for id in (1..30).filter(|id| ![10, 20].contains(id)) {
            add(id - 1, id, EdgeKind::ScanMatch);
        }
        add(9, 10, EdgeKind::EstimatedPose);
        let unplaced = add(9, 20, EdgeKind::EstimatedPose);
        let expected = |id: usize| [None, Some(10), Some(20)][id / 10];
        assert!((0..30).all(|id| unplaced[id] == expected(id)), "{unplaced:?}");
        // Two that agree are not confirmed by that.
        let unplaced = add(12, 22, EdgeKind::Closure);
        assert!((0..30).all(|id| unplaced[id] == expected(id)), "{unplaced:?}");
        let unplaced = add(5, 25, EdgeKind::Closure);
        assert!(unplaced.iter().all(Option::is_none), "{unplaced:?}");
    }

    #[test]
    fn an_estimate_is_confirmed_by_the_map_and_not_by_another_estimate() {
        let mut back = straight_path(9, 1.0);
        let estimate = LocalFrameEstimate { map_from_local: Pose2::IDENTITY, sigma_m: 0.3, sigma_rad: 0.2 };
        back.location.unconfirmed = Some(UnconfirmedEstimate { estimate, first_node: 6, matched_before: 0 });
        let mut is_unconfirmed_after = |a: u32, b: u32, kind| {
            let moved = Pose2::new(f64::from(b - a), 0.0, 0.0);
            back.graph.add_edge([a, b], moved, information_from_sigmas(0.01, 0.001), kind, [0.0; 2]);
            back.confirm_estimate();
            back.frame_update().unconfirmed
        };
        assert!(is_unconfirmed_after(2, 3, EdgeKind::EstimatedPose));
        assert!(is_unconfirmed_after(2, 6, EdgeKind::EstimatedPose));
        assert!(is_unconfirmed_after(4, 7, EdgeKind::Closure), "with what another estimate placed");
        assert!(!is_unconfirmed_after(1, 7, EdgeKind::Closure));
    }
}
