//! Search for the newest node in the components of the pose graph that it is not part of: for the place of an unplaced
//! component in the map, and for unplaced components that the robot has come back to.

use super::BackEnd;
use super::modes::{FOUND_M, FOUND_RAD};
use crate::closure::ClosureCandidate;
use crate::cloud::Agreement;
use crate::config::SlamConfig;
use crate::front_end::UNMEASURED_MAX_S;
use crate::node::Node;
use crate::relocalize::{MapNodes, RelocalizationCounts, RelocalizationOutcome, Relocalizer};
use crate::stages::Stage;
use msg::{Pose2, pose::wrap_angle};
use posegraph::information_from_sigmas;
use std::collections::BTreeMap;

/// An unplaced component of more nodes than this is searched for; something passing by is over sooner.
const NODES_MIN: u32 = 5;
/// Most other components that are searched, the largest.
const OTHERS_MAX: usize = 4;
/// Least nodes of another component that is searched: a smaller one shows too little to tell places apart.
const OTHER_NODES_MIN: usize = 20;

/// The scans of two components are compared this far around the place where one was found in the other, metres: farther off, drift
/// counts.
const COMPARED_AROUND_M: f64 = 8.0;
/// Most scans of each that are compared: every other or third one, where the robot was often.
const COMPARED_NODES_MAX: usize = 64;
/// Scans taken farther apart than this are not compared, metres: they see different things.
const COMPARED_APART_M: f64 = 1.5;

/// A robot is carried this far when it is kidnapped, metres; and by its speed over the time between the scans.
const REACH_M: f64 = 3.0;
/// Standard deviations of the last place before it that count as well.
const REACH_SIGMAS: f64 = 3.0;
/// Drift of the path since it was kidnapped, metres per metre.
const PATH_DRIFT: f64 = 0.1;
/// What the front end drifts while nothing measures the motion, on top of the distance that the robot can have driven, metres and
/// radians.
const UNMEASURED_M: f64 = 1.0;
const UNMEASURED_RAD: f64 = 0.5;

/// A search in one component; its first node is `None` for the map.
struct ComponentSearch {
    component: Option<u32>,
    relocalizer: Relocalizer,
}

/// The searches for the newest node, all with the same nodes.
#[derive(Default)]
pub(super) struct ComponentSearches {
    /// The component of the node that is searched for: another one has other components to be searched in.
    searched_for: Option<u32>,
    searches: Vec<ComponentSearch>,
}

impl ComponentSearches {
    /// Forgets what was searched.
    pub(super) fn clear(&mut self) {
        self.searches.clear();
    }

    /// Gives the components the numbers that their first nodes have now; those that are no more are not searched.
    pub(super) fn renumber(&mut self, number: impl Fn(u32) -> Option<u32>) {
        let searched_for = self.searched_for.map(&number);
        if searched_for == Some(None) {
            return self.clear();
        }
        self.searched_for = searched_for.flatten();
        self.searches.retain_mut(|search| match search.component.map(&number) {
            Some(None) => false,
            component => {
                search.component = component.flatten();
                true
            }
        });
    }

    /// Adds the newest node. Returns the component in which it is found, and its pose there; `None` if it is found in none, or
    /// in several.
    fn add_node(
        &mut self,
        config: &SlamConfig,
        map: MapNodes<'_>,
        id: u32,
        counts: &mut RelocalizationCounts,
    ) -> Option<(Option<u32>, Pose2)> {
        let newest = &map.nodes[id as usize];
        if self.searched_for != newest.disconnected_component {
            self.clear();
        }
        if self.searches.is_empty() {
            self.searched_for = newest.disconnected_component;
            let components = other_components(map.nodes, newest);
            self.searches.extend(components.map(|component| ComponentSearch {
                component,
                relocalizer: Relocalizer::new(
                    config.clone(),
                    MapNodes { component, ..map },
                    None,
                    RelocalizationCounts::default(),
                ),
            }));
        }
        let mut found = Vec::new();
        for ComponentSearch { component, relocalizer } in &mut self.searches {
            let outcome = relocalizer.add_node(newest.clone(), MapNodes { component: *component, ..map });
            *counts += relocalizer.take_counts();
            if let RelocalizationOutcome::Found { map_from_local } = outcome {
                found.push((*component, map_from_local * newest.local_from_base));
            }
        }
        match found[..] {
            [only] => Some(only),
            _ => None,
        }
    }
}

/// The components but that of a node, by their first nodes: the map, and the largest unplaced ones.
fn other_components(nodes: &[Node], newest: &Node) -> impl Iterator<Item = Option<u32>> + use<> {
    let mut sizes = BTreeMap::new();
    let others = nodes.iter().filter_map(|node| node.disconnected_component);
    for component in others.filter(|component| Some(*component) != newest.disconnected_component) {
        *sizes.entry(component).or_insert(0_usize) += 1;
    }
    let mut largest: Vec<(usize, u32)> =
        sizes.into_iter().map(|(component, size)| (size, component)).collect();
    largest.retain(|(size, _)| *size >= OTHER_NODES_MIN);
    largest.sort_unstable_by_key(|(size, component)| (core::cmp::Reverse(*size), *component));
    largest.truncate(OTHERS_MAX);
    let map = newest.disconnected_component.map(|_| None);
    map.into_iter().chain(largest.into_iter().map(|(_, component)| Some(component)))
}

/// The node of a map nearest to a place in it.
pub(super) fn nearest_node(map: MapNodes<'_>, at: Pose2) -> Option<u32> {
    let away_m = |node: &&Node| map.poses[node.id as usize].distance_m(at);
    let nodes = map.nodes.iter().filter(|node| map.contains(node));
    nodes.min_by(|a, b| away_m(a).total_cmp(&away_m(b))).map(|node| node.id)
}

impl BackEnd {
    /// Searches the other components for the newest node, if there are any: the robot may have come back to one.
    pub(super) fn search_other_components(&mut self, id: u32) {
        if self.nodes.iter().all(|node| node.disconnected_component.is_none()) {
            return;
        }
        self.stages.stage_started(Stage::Closure);
        let first = self.nodes[id as usize].disconnected_component;
        if first.is_none_or(|first| id - first >= NODES_MIN) {
            self.connect_component(id);
        }
        if first.is_some() {
            // It may be the largest now, and so the map.
            self.update_components();
        }
    }

    /// Connects the newest node with the component in which it is found.
    fn connect_component(&mut self, id: u32) {
        let searches = &mut self.location.component_searches;
        let map = MapNodes::of_map(&self.nodes, self.graph.poses());
        let found = searches.add_node(&self.config, map, id, &mut self.location.relocalization);
        let Some((component, map_from_node)) = found else { return };
        searches.clear();
        let map = MapNodes { component, ..map };
        let Some(candidate) = nearest_node(map, map_from_node) else { return };
        if !self.components_agree(id, component, map_from_node) {
            self.location.relocalization.contradicted += 1;
            return;
        }
        if self.is_beyond_reach(id, component, map_from_node) {
            self.reliability.implausible_relocalizations += 1;
            return;
        }
        self.add_closures(&[ClosureCandidate {
            newer: id,
            older: candidate,
            older_from_newer: self.graph.poses()[candidate as usize].between(map_from_node),
            information: information_from_sigmas(FOUND_M, FOUND_RAD),
            response: self.config.relocalize.response_min,
        }]);
    }

    /// Whether the scans of a node's component and those of another one in which it was found agree around that place, not only
    /// those that were compared to find it: two rooms that are alike at one place differ elsewhere.
    /// Where no scans of both were taken near enough to each other, nothing speaks against the place.
    fn components_agree(&self, id: u32, component: Option<u32>, map_from_node: Pose2) -> bool {
        let poses = self.graph.poses();
        let map_from_own = map_from_node * poses[id as usize].inverse();
        let own = self.nodes[id as usize].disconnected_component;
        let compared = |component: Option<u32>, map_from_its: Pose2| {
            let is_near =
                |id: u32| (map_from_its * poses[id as usize]).distance_m(map_from_node) < COMPARED_AROUND_M;
            let nodes = self.nodes.iter().filter(|node| node.disconnected_component == component);
            let near: Vec<&Node> = nodes.filter(|node| node.is_tracked && is_near(node.id)).collect();
            let stride = near.len().div_ceil(COMPARED_NODES_MAX).max(1);
            near.into_iter().step_by(stride).collect::<Vec<&Node>>()
        };
        let others = compared(component, Pose2::IDENTITY);
        let mut agreement = Agreement::default();
        for node in compared(own, map_from_own) {
            let map_from_this = map_from_own * poses[node.id as usize];
            for other in &others {
                let other_from_this = poses[other.id as usize].between(map_from_this);
                if other_from_this.x_m.hypot(other_from_this.y_m) < COMPARED_APART_M {
                    agreement += Agreement::both_ways(&other.cloud, &node.cloud, other_from_this);
                }
            }
        }
        agreement.is_sound(self.config.relocalize.agreement_min)
    }

    /// Whether the robot, last in a component before node `id`, cannot have gone to where that node was found in it. Carried, it has no
    /// heading that is known; where only the motion was not measured, it is not far from where the front end has it.
    fn is_beyond_reach(&self, id: u32, component: Option<u32>, map_from_node: Pose2) -> bool {
        let is_in_it = |node: &&Node| node.unplaced_component() == component;
        let Some(last) = self.nodes[..id as usize].iter().rfind(is_in_it) else {
            return false;
        };
        let since = &self.nodes[last.id as usize + 1..=id as usize];
        let node = &self.nodes[id as usize];
        let map_from_last = self.graph.poses()[last.id as usize];
        let speed_max_m_s = self.config.odometry.speed_max_m_s;
        let is_kidnapped = |node: &Node| node.odometry_break && !self.is_unmeasured_break(node.id);
        if since.iter().any(is_kidnapped) {
            return self.is_beyond_reach_of_kidnapped(id, component, map_from_node, is_kidnapped);
        }
        let expected = map_from_last * last.local_from_base.between(node.local_from_base);
        let unmeasured_s: f64 = since.iter().map(|node| f64::from(node.unmeasured_s)).sum();
        let turned_rad = wrap_angle(expected.yaw_rad - map_from_node.yaw_rad).abs();
        expected.distance_m(map_from_node) > UNMEASURED_M + speed_max_m_s * unmeasured_s
            || turned_rad > UNMEASURED_RAD
    }

    /// Whether a kidnapped robot cannot have gone to where node `id` was found. The path since it was kidnapped is known, its
    /// heading in the map is not; of the paths between earlier losses only the length is known.
    fn is_beyond_reach_of_kidnapped(
        &self,
        id: u32,
        component: Option<u32>,
        map_from_node: Pose2,
        is_kidnapped: impl Fn(&Node) -> bool,
    ) -> bool {
        let nodes = &self.nodes[..=id as usize];
        let is_connected = |node: &&Node| node.disconnected_component == component;
        let Some(last) = nodes[..id as usize].iter().rfind(is_connected) else { return false };
        let (node, since) = (&nodes[id as usize], &nodes[last.id as usize + 1..]);
        let first = since.iter().rfind(|node| node.odometry_break).unwrap_or(node);
        let map_from_first = map_from_node * node.local_from_base.between(first.local_from_base);
        let path_m = |nodes: &[Node]| -> f64 {
            nodes.windows(2).map(|pair| pair[0].local_from_base.distance_m(pair[1].local_from_base)).sum()
        };
        let (before, after) = (&nodes[last.id as usize..=first.id as usize], &nodes[first.id as usize..]);
        let speed_max_m_s = self.config.odometry.speed_max_m_s;
        let carries = since.iter().filter(|node| node.id <= first.id && is_kidnapped(node));
        let carried_m = carries.map(|node| {
            REACH_M + speed_max_m_s * (node.header.stamp - nodes[node.id as usize - 1].header.stamp)
        });
        let unmeasured_s: f64 = since.iter().map(|node| f64::from(node.unmeasured_s)).sum();
        let sigma_m = self.graph.position_variance_trace_m2(last.id).sqrt();
        let reach_m = carried_m.sum::<f64>()
            + REACH_SIGMAS * sigma_m
            + path_m(before)
            + speed_max_m_s * unmeasured_s
            + PATH_DRIFT * path_m(after);
        self.graph.poses()[last.id as usize].distance_m(map_from_first) > reach_m
    }

    /// Whether the odometry break before a node is there because the motion was not measured.
    fn is_unmeasured_break(&self, id: u32) -> bool {
        let before = self.nodes[..id as usize].iter().rev().take_while(|node| !node.odometry_break);
        let unmeasured_s: f32 = before.map(|node| node.unmeasured_s).sum();
        unmeasured_s + self.nodes[id as usize].unmeasured_s > UNMEASURED_MAX_S
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::straight_path;
    use super::*;

    /// A path of 30 nodes along x, each metre, at one moment; before node 20 the robot was kidnapped.
    fn kidnapped_robot() -> BackEnd {
        let mut back = straight_path(30, 1.0);
        for node in &mut back.nodes[20..] {
            node.disconnected_component = Some(20);
        }
        back.nodes[20].odometry_break = true;
        back
    }

    #[test]
    fn a_node_is_searched_for_in_the_components_that_it_is_not_part_of() {
        let mut nodes = straight_path(200, 1.0).nodes;
        let components = [(0..80, None), (80..105, Some(80)), (105..110, Some(105)), (110..160, Some(110))];
        for (ids, component) in components {
            nodes[ids].iter_mut().for_each(|node| node.disconnected_component = component);
        }
        let searched_for = |id: usize| other_components(&nodes, &nodes[id]).collect::<Vec<_>>();
        assert_eq!(searched_for(0), [Some(110), Some(80)], "a placed node, in the larger unplaced one first");
        assert_eq!(searched_for(80), [None, Some(110)]);
        assert_eq!(searched_for(105), [None, Some(110), Some(80)], "its own is too small to be searched");
        nodes.iter_mut().for_each(|node| node.disconnected_component = None);
        assert_eq!(other_components(&nodes, &nodes[0]).count(), 0);
    }

    #[test]
    fn a_kidnapped_robot_is_found_where_it_can_have_been_carried_to_whatever_its_heading() {
        let back = kidnapped_robot();
        // Since it was kidnapped it has driven 9 m.
        let newest_if_carried_to = |first: Pose2| first * Pose2::new(9.0, 0.0, 0.0);
        let is_beyond = |first: Pose2| back.is_beyond_reach(29, None, newest_if_carried_to(first));
        for yaw_rad in [0.0, 1.5, core::f64::consts::PI] {
            assert!(!is_beyond(Pose2::new(21.0, 2.0, yaw_rad)), "2.8 m from where it was seen last");
            assert!(is_beyond(Pose2::new(30.0, 2.0, yaw_rad)), "11 m from there");
        }
        // The same place of the newest node, but driven to from the other side.
        let place = newest_if_carried_to(Pose2::new(21.0, 2.0, 0.0));
        assert!(!back.is_beyond_reach(29, None, place));
        let turned = place * Pose2::new(0.0, 0.0, core::f64::consts::PI);
        assert!(back.is_beyond_reach(29, None, turned), "it would have been carried by 18 m");
    }
}
