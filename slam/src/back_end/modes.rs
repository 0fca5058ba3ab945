//! Modes of the back end: a node relocalizes the robot, localizes it in a fixed map, or extends the map.

use super::component_search::nearest_node;
use super::localization_state::UnconfirmedEstimate;
use super::{BackEnd, BackEndState};
use crate::closure::ClosureDetector;
use crate::config::SlamConfig;
use crate::front_end::{FrontEndState, TrajectorySample};
use crate::graph::{Edge, EdgeKind, Graph, upper_triangle};
use crate::localizer::Localizer;
use crate::node::{FrameUncertainty, MapFrameUpdate, Node};
use crate::relocalize::{
    LocalFrameEstimate, MapNodes, RelocalizationCounts, RelocalizationOutcome, Relocalizer,
};
use msg::{Pose2, SlamMode, Stamp};
use posegraph::information_from_sigmas;

/// Standard deviations of a robot that was located, metres and radians: small enough for links by alignment alone.
pub(super) const FOUND_M: f64 = 0.08;
pub(super) const FOUND_RAD: f64 = 0.03;
/// Least standard deviation of an estimate that a person gives, metres and radians: 0 would make its edge infinite.
const ESTIMATE_SIGMA_MIN: f64 = 1e-3;

/// Initial pose of the robot in a loaded map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum InitialPose {
    /// The front end continues where it was: the next node follows from the newest one.
    Continue,
    /// The robot is near this estimate, around which the map is searched.
    Near(LocalFrameEstimate),
    /// The pose is unknown: the whole map is searched.
    Unknown,
}

/// What is known of a scan's place in the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlaceInMap {
    /// It is known.
    Known,
    /// The component that begins with this node is not placed in the map: the pose is in a frame whose relation to the
    /// map's is unknown.
    Unplaced(u32),
    /// The scan fitted nothing: the pose is a guess.
    Lost,
}

impl BackEnd {
    /// A back end that continues with the map of a session.
    pub fn resume(
        config: SlamConfig,
        state: BackEndState,
        samples: Vec<TrajectorySample>,
        mode: SlamMode,
        initial_pose: InitialPose,
    ) -> Self {
        let mut back = Self::new(config.clone());
        back.graph = Graph::from_parts(config.graph.clone(), state.poses, state.edges);
        back.loop_closures.detector = ClosureDetector::resume(config, state.detector);
        back.node_ids.earlier = samples;
        back.lifelong.contradicted = vec![0; state.nodes.len()];
        back.unverified_node = state.unverified_node;
        back.node_ids.earlier_nodes =
            if initial_pose == InitialPose::Continue { 0 } else { state.nodes.len() };
        back.node_ids.newest_front = state.front_ids.last().copied().unwrap_or(0);
        (back.nodes, back.node_ids.front_ids) = (state.nodes, state.front_ids);
        (0..back.nodes.len() as u32).for_each(|id| back.learn_odometry_noise(id));
        back.update_components();
        // The session's map had its frame already.
        back.map_frame_changes = 0;
        back.mapper.restore(&back.nodes, &state.drawn);
        (back.loop_closures.not_found, back.loop_closures.to_retry) =
            (state.not_found.into(), state.to_retry.into());
        (back.loop_closures.travelled_m, back.linked_since_solve, back.loop_closures.rejected_closures) =
            (state.travelled_m, state.linked_since_solve, state.rejected_closures);
        (back.solutions, back.loop_closures.retracted, back.lifelong.removed_nodes) =
            (state.solutions, state.retracted, state.removed_nodes);
        back.reliability = state.reliability;
        back.update_after_edge_change();
        back.set_mode(mode);
        match initial_pose {
            InitialPose::Continue => back.restore_unconfirmed(),
            InitialPose::Near(estimate) => back.start_relocalization(Some(estimate)),
            InitialPose::Unknown => back.start_relocalization(None),
        }
        back
    }

    /// The configuration that the back end was created with.
    pub fn config(&self) -> &SlamConfig {
        &self.config
    }

    /// Returns whether the next node extends the map: nobody looks for the robot, and the map is not fixed. What the back
    /// end does then depends on its nodes alone.
    pub fn grows_map(&self) -> bool {
        self.location.relocalizer.is_none() && self.location.localizer.is_none()
    }

    /// The mode: mapping, localization or lifelong mapping.
    pub fn mode(&self) -> SlamMode {
        self.location.mode
    }

    /// Changes the mode; the robot stays where it is located.
    pub fn set_mode(&mut self, mode: SlamMode) {
        let was_fixed = self.location.localizer.is_some();
        let is_fixed = mode == SlamMode::Localization;
        self.location.mode = mode;
        if was_fixed == is_fixed {
            return;
        }
        // The graph does not have the newest nodes where the map is fixed, nor the localizer those from before.
        let newest = match &self.location.localizer {
            Some(localizer) => localizer.newest().map(|(_, map_from_local)| map_from_local),
            None => {
                let newest = self.nodes.last().filter(|n| n.disconnected_component.is_none());
                newest.map(|n| self.graph.poses()[n.id as usize] * n.local_from_base.inverse())
            }
        };
        if let (Some(map_from_local), None) = (newest, &self.location.relocalizer) {
            let found = LocalFrameEstimate { map_from_local, sigma_m: FOUND_M, sigma_rad: FOUND_RAD };
            let unconfirmed = self.location.unconfirmed;
            self.location.next_node_estimate =
                Some(unconfirmed.map_or(found, |it| LocalFrameEstimate { map_from_local, ..it.estimate }));
        }
        self.location.localizer = is_fixed.then(|| Localizer::new(self.config.clone()));
        if let Some(UnconfirmedEstimate { estimate, .. }) = self.location.unconfirmed {
            self.location.unconfirmed = Some(self.unconfirmed(estimate));
        }
        if is_fixed && self.location.relocalizer.is_none() && !self.newest_is_placed() {
            self.start_relocalization(None);
        }
    }

    /// Searches for the robot from now on, near an estimate or everywhere. An empty map begins at the
    /// estimate instead.
    pub fn start_relocalization(&mut self, estimate: Option<LocalFrameEstimate>) {
        self.location.unconfirmed = None;
        if self.nodes.is_empty() {
            self.location.next_node_estimate = estimate;
            return;
        }
        let map = MapNodes::of_map(&self.nodes, self.graph.poses());
        self.location.relocalizer =
            Some(Relocalizer::new(self.config.clone(), map, estimate, self.location.relocalization));
    }

    /// Whether it is known where the robot is.
    pub fn is_located(&self) -> bool {
        let in_map = self.newest_is_placed() || self.location.unconfirmed.is_some();
        let is_located = self.location.localizer.as_ref().map_or(in_map, Localizer::is_located);
        self.location
            .relocalizer
            .as_ref()
            .map_or(is_located, |relocalizer| relocalizer.initial_estimate().is_some())
    }

    /// Whether a person said where the robot is, and no scan has confirmed it yet.
    pub fn is_unconfirmed(&self) -> bool {
        let initial_estimate = self.location.relocalizer.as_ref().and_then(Relocalizer::initial_estimate);
        initial_estimate.is_some() || self.location.unconfirmed.is_some()
    }

    /// The map from the robot at the newest node; as far as it is known.
    pub fn map_from_base(&self) -> Option<Pose2> {
        match (&self.location.relocalizer, &self.location.localizer) {
            (Some(_), _) => None,
            (None, Some(localizer)) => Some(localizer.newest()?.0),
            (None, None) => self.graph.poses().last().copied().filter(|_| self.newest_is_placed()),
        }
    }

    pub(super) fn process_node(&mut self, node: Node) {
        self.location.just_located = false;
        let map = MapNodes::of_map(&self.nodes, self.graph.poses());
        let Some(relocalizer) = &mut self.location.relocalizer else { return self.integrate_node(node) };
        let relocalization = relocalizer.add_node(node, map);
        let estimate = match relocalization {
            RelocalizationOutcome::NotFound => return,
            RelocalizationOutcome::Found { map_from_local } => {
                LocalFrameEstimate { map_from_local, sigma_m: FOUND_M, sigma_rad: FOUND_RAD }
            }
            RelocalizationOutcome::EstimateAccepted(estimate) => estimate,
        };
        self.location.just_located = true;
        self.location.relocalization = relocalizer.counts();
        let waiting = relocalizer.take_waiting();
        self.location.relocalizer = None;
        self.location.next_node_estimate = Some(estimate);
        let is_accepted = matches!(relocalization, RelocalizationOutcome::EstimateAccepted(_));
        self.location.unconfirmed = is_accepted.then(|| self.unconfirmed(estimate));
        if let Some(localizer) = &mut self.location.localizer {
            localizer.clear();
        }
        waiting.into_iter().for_each(|node| self.integrate_node(node));
    }

    /// An estimate that nothing confirms yet: what is known so far is from before it.
    fn unconfirmed(&self, estimate: LocalFrameEstimate) -> UnconfirmedEstimate {
        let matched_before =
            self.location.localizer.as_ref().map_or(0, |localizer| localizer.counts().matched);
        UnconfirmedEstimate { estimate, first_node: self.nodes.len() as u32, matched_before }
    }

    /// Confirms a person's estimate if a scan matched the fixed map, or if a link connects a node since with one before.
    pub(super) fn confirm_estimate(&mut self) {
        let Some(UnconfirmedEstimate { first_node, matched_before, .. }) = self.location.unconfirmed else {
            return;
        };
        let connects =
            |e: &Edge| e.is_active_scan() && e.a.min(e.b) < first_node && e.a.max(e.b) >= first_node;
        let is_confirmed = match &self.location.localizer {
            Some(localizer) => localizer.counts().matched > matched_before,
            // What it connects with may itself be where a person alone said.
            None => self.graph.edges().iter().any(connects) && self.newest_unconfirmed_component().is_none(),
        };
        if is_confirmed {
            self.location.unconfirmed = None;
            self.location.just_located = true;
            self.update_covariances();
        }
    }

    fn integrate_node(&mut self, node: Node) {
        let Some(localizer) = &mut self.location.localizer else {
            self.grow_map(node);
            if self.location.mode == SlamMode::Lifelong {
                self.remove_outdated_nodes();
            }
            return;
        };
        let map_from_local = match self.location.next_node_estimate.take() {
            Some(estimate) => estimate.map_from_local,
            None => localizer.newest().map_or(Pose2::IDENTITY, |(_, map_from_local)| map_from_local),
        };
        let map = MapNodes::of_map(&self.nodes, self.graph.poses());
        localizer.add_node(node, map_from_local, map);
        if localizer.is_lost() {
            self.start_relocalization(None);
        }
    }

    /// Adds the first node after the robot was located, with an edge from the nearest node of the map. What odometry measured to it began at a
    /// node that the graph does not have.
    pub(super) fn add_node_at_initial_pose(&mut self, node: Node, estimate: LocalFrameEstimate) {
        let node = Node { previous_from_this: None, ..node };
        let map_from_node = estimate.map_from_local * node.local_from_base;
        let nearest = nearest_node(MapNodes::of_map(&self.nodes, self.graph.poses()), map_from_node);
        let id = node.id;
        self.graph.add_node(map_from_node);
        self.nodes.push(node);
        let is_estimated = self.location.unconfirmed.is_some();
        let kind = if is_estimated { EdgeKind::EstimatedPose } else { EdgeKind::InitialPose };
        if let Some(nearest) = nearest {
            let measured = self.graph.poses()[nearest as usize].between(map_from_node);
            let information = information_from_sigmas(
                estimate.sigma_m.max(ESTIMATE_SIGMA_MIN),
                estimate.sigma_rad.max(ESTIMATE_SIGMA_MIN),
            );
            self.graph.add_edge([nearest, id], measured, information, kind, [0.0; 2]);
        }
    }

    pub(super) fn frame_update(&self) -> MapFrameUpdate {
        let of_graph = || {
            let newest = self.nodes.last()?;
            Some(self.graph.poses()[newest.id as usize] * newest.local_from_base.inverse())
        };
        let initial_estimate = self.location.relocalizer.as_ref().and_then(Relocalizer::initial_estimate);
        let map_from_local = match (&self.location.relocalizer, &self.location.localizer) {
            (Some(_), _) => initial_estimate.map(|estimate| estimate.map_from_local),
            (None, Some(localizer)) => localizer.newest().map(|(_, map_from_local)| map_from_local),
            (None, None) => of_graph(),
        };
        // Where a robot is in a fixed map it should know soon, and that it is not known where it is; what closures change
        // can wait until the back end has certainly answered, so that a run can be repeated.
        let soon = self.location.relocalizer.is_some()
            || self.location.localizer.is_some()
            || self.location.just_located
            || self.location.unconfirmed.is_some()
            || !self.newest_is_placed();
        let lag_nodes = if soon { 1 } else { self.config.graph.frame_update_lag_nodes };
        MapFrameUpdate {
            cause_node: self.node_ids.newest_front,
            effective_from_node: self.node_ids.newest_front.saturating_add(lag_nodes),
            map_from_local: map_from_local.unwrap_or_default(),
            uncertainty: self.frame_uncertainty(),
            closures: self.loop_closures.active_count,
            located: map_from_local.is_some() && self.is_located(),
            unconfirmed: self.is_unconfirmed(),
            unreliable: self.reliability_evidence().is_unreliable(),
        }
    }

    /// Covariance of the newest node's pose in the map, or what a person said about it. In a fixed map it is the map's own frame that
    /// counts: none is added but what a person said while no scan has confirmed it.
    fn frame_uncertainty(&self) -> FrameUncertainty {
        if let Some(relocalizer) = &self.location.relocalizer {
            return relocalizer.initial_uncertainty().unwrap_or_default();
        }
        let in_fixed_map = self.location.localizer.as_ref().and_then(Localizer::newest);
        if let (Some((map_from_node, map_from_local)), Some(it)) = (in_fixed_map, self.location.unconfirmed) {
            let estimate = LocalFrameEstimate { map_from_local, ..it.estimate };
            return estimate.uncertainty(map_from_local.inverse() * map_from_node);
        }
        let newest = self.nodes.last().filter(|_| self.grows_map());
        newest.map_or(FrameUncertainty::default(), |node| {
            let pose = self.graph.poses()[node.id as usize];
            let covariance = upper_triangle(self.graph.covariance(node.id));
            FrameUncertainty { covariance, position_m: [pose.x_m, pose.y_m] }
        })
    }

    /// The current frame update, for a front end that begins.
    pub fn latest_frame_update(&self) -> MapFrameUpdate {
        self.frame_update()
    }

    /// The back end's id of a node of the present front end; `None` if the map does not have it.
    pub fn node_from_front_end(&self, front_id: u32) -> Option<u32> {
        self.node_ids.id_of(front_id)
    }

    /// Every scan's stamp and `map_from_base`, those of earlier front ends first: scans between nodes
    /// move with their node.
    pub fn trajectory<'a>(
        &'a self,
        samples: &'a [TrajectorySample],
    ) -> impl Iterator<Item = (Stamp, Pose2)> + 'a {
        self.trajectory_with_places(samples).map(|(stamp, pose, _)| (stamp, pose))
    }

    /// The same, with what is known of each place.
    pub fn trajectory_with_places<'a>(
        &'a self,
        samples: &'a [TrajectorySample],
    ) -> impl Iterator<Item = (Stamp, Pose2, PlaceInMap)> + 'a {
        let poses = self.graph.poses();
        self.node_ids.samples(samples).map(|sample| {
            let node = sample.node as usize;
            (sample.stamp, poses[node] * sample.node_from_base, self.place_of(&sample))
        })
    }

    /// What is known of a scan's place, `sample.node` being the back end's number.
    pub fn place_of(&self, sample: &TrajectorySample) -> PlaceInMap {
        let component = self.nodes.get(sample.node as usize).map(Node::unplaced_component);
        match component {
            _ if sample.is_lost => PlaceInMap::Lost,
            Some(Some(first_node)) => PlaceInMap::Unplaced(first_node),
            _ => PlaceInMap::Known,
        }
    }

    /// Whether a front end in this state can continue with this map: it made the map's newest node, and the map grows.
    pub(crate) fn is_continued_by(&self, front: &FrontEndState) -> bool {
        self.grows_map() && front.next_node.checked_sub(1) == self.node_ids.front_ids.last().copied()
    }

    /// Every scan's pose relative to its node, those of earlier front ends first.
    pub(crate) fn all_samples<'a>(
        &'a self,
        samples: &'a [TrajectorySample],
    ) -> impl Iterator<Item = TrajectorySample> + 'a {
        self.node_ids.samples(samples)
    }

    /// Counts of relocalization searches by how they ended.
    pub fn relocalization(&self) -> RelocalizationCounts {
        self.location.relocalization_counts()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::back_end::testing::straight_path;
    use nalgebra::Matrix3;

    #[test]
    fn a_link_with_what_was_there_before_confirms_an_estimate() {
        let mut back = straight_path(8, 0.3);
        let estimate = LocalFrameEstimate { map_from_local: Pose2::IDENTITY, sigma_m: 0.3, sigma_rad: 0.2 };
        back.location.unconfirmed = Some(UnconfirmedEstimate { estimate, first_node: 5, matched_before: 0 });
        let mut is_unconfirmed_after = |nodes: [u32; 2], kind| {
            back.graph.add_edge(nodes, Pose2::IDENTITY, Matrix3::identity(), kind, [0.0; 2]);
            back.confirm_estimate();
            back.frame_update().unconfirmed
        };
        assert!(is_unconfirmed_after([2, 5], EdgeKind::InitialPose), "the estimate itself");
        assert!(is_unconfirmed_after([3, 4], EdgeKind::ScanMatch), "before it");
        assert!(is_unconfirmed_after([5, 7], EdgeKind::ScanMatch), "since");
        assert!(!is_unconfirmed_after([4, 6], EdgeKind::Closure));
    }
}
