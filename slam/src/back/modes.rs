//! What becomes of a node: looked for in the map, held against it, or added to it.

use super::{Back, BackState};
use crate::closure::Detector;
use crate::config::SlamConfig;
use crate::front::{FrontState, Ride};
use crate::graph::{EdgeKind, Graph};
use crate::localize::Localizer;
use crate::node::{Node, Revision};
use crate::relocalize::{Hint, Placed, SeekCounts, Seeker, Sought};
use crate::session::{Identity, Session};
use msg::{Pose2, SlamMode, Stamp};
use posegraph::information_from_sigmas;

/// A robot that was found is known this well: links to what it sees may then be sought.
pub(super) const FOUND_M: f64 = 0.08;
pub(super) const FOUND_RAD: f64 = 0.03;

/// Where a node is that does not follow from the one before.
#[derive(Clone, Copy, Debug)]
pub struct Anchor {
    map_from_local: Pose2,
    sigma_m: f64,
    sigma_rad: f64,
}

/// Where the robot is when a map is loaded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Start {
    /// The scan path goes on where it was: the next node follows from the newest.
    GoOn,
    /// About there.
    At(Hint),
    /// To be found out.
    Unknown,
}

impl Back {
    /// Goes on with a map that was kept.
    pub fn resume(
        config: SlamConfig,
        state: BackState,
        rides: Vec<Ride>,
        mode: SlamMode,
        start: Start,
    ) -> Self {
        let mut back = Self::new(config.clone());
        back.graph = Graph::from_parts(config.graph.clone(), state.poses, state.edges);
        back.detector = Detector::resume(config, state.detector);
        back.earlier = rides;
        back.contradicted = vec![0; state.nodes.len()];
        back.joint = state.joint;
        back.newest_front = state.front_ids.last().copied().unwrap_or(0);
        (back.nodes, back.front_ids) = (state.nodes, state.front_ids);
        back.sort_pieces();
        back.canvas.restore(&back.nodes, &state.drawn);
        (back.not_found, back.again) = (state.not_found.into(), state.again.into());
        (back.travelled_m, back.unsolved, back.bans) = (state.travelled_m, state.unsolved, state.bans);
        (back.solutions, back.retracted, back.retired) = (state.solutions, state.retracted, state.retired);
        back.count_closures();
        back.set_mode(mode);
        match start {
            Start::GoOn => {}
            Start::At(hint) => back.seek(Some(hint)),
            Start::Unknown => back.seek(None),
        }
        back
    }

    /// How it was configured.
    pub fn config(&self) -> &SlamConfig {
        &self.config
    }

    /// What is done with the map from now on.
    pub fn mode(&self) -> SlamMode {
        self.mode
    }

    /// From now on the map is gone on with in this mode; the robot stays where it is believed to be.
    pub fn set_mode(&mut self, mode: SlamMode) {
        let was_fixed = self.localizer.is_some();
        let is_fixed = mode == SlamMode::Localization;
        self.mode = mode;
        if was_fixed == is_fixed {
            return;
        }
        // The graph does not have the newest nodes where the map is fixed, nor the localizer those from before.
        let newest = match &self.localizer {
            Some(localizer) => localizer.newest().map(|(_, map_from_local)| map_from_local),
            None => {
                let newest = self.nodes.last().filter(|n| n.adrift.is_none());
                newest.map(|n| self.graph.poses()[n.id as usize] * n.local_from_base.inverse())
            }
        };
        if let (Some(map_from_local), None) = (newest, &self.seeker) {
            self.anchor = Some(Anchor { map_from_local, sigma_m: FOUND_M, sigma_rad: FOUND_RAD });
        }
        self.localizer = is_fixed.then(|| Localizer::new(self.config.clone()));
        if is_fixed && self.seeker.is_none() && !self.newest_in_map() {
            self.seek(None);
        }
    }

    /// From now on the robot is looked for, near a hint or everywhere. In a map without nodes there is
    /// nothing to be found: there the map begins at the hint.
    pub fn seek(&mut self, hint: Option<Hint>) {
        if self.nodes.is_empty() {
            self.anchor = hint.map(|Hint { map_from_local, sigma_m, sigma_rad }| Anchor {
                map_from_local,
                sigma_m,
                sigma_rad,
            });
            return;
        }
        let map = Placed { nodes: &self.nodes, poses: self.graph.poses() };
        self.seeker = Some(Seeker::new(self.config.clone(), map, hint, self.sought));
    }

    /// Whether it is known where the robot is.
    pub fn located(&self) -> bool {
        let sure = self.localizer.as_ref().map_or(self.newest_in_map(), Localizer::sure);
        self.seeker.as_ref().map_or(sure, |seeker| seeker.hint().is_some())
    }

    /// The map from the robot at the newest node; as far as it is known.
    pub fn map_from_base(&self) -> Option<Pose2> {
        match (&self.seeker, &self.localizer) {
            (Some(_), _) => None,
            (None, Some(localizer)) => Some(localizer.newest()?.0),
            (None, None) => self.graph.poses().last().copied().filter(|_| self.newest_in_map()),
        }
    }

    pub(super) fn take(&mut self, node: Node) {
        self.just_found = false;
        let map = Placed { nodes: &self.nodes, poses: self.graph.poses() };
        let Some(seeker) = &mut self.seeker else { return self.use_node(node) };
        let sought = seeker.seek(node, map);
        let anchor = match sought {
            Sought::Nothing => return,
            Sought::Found(map_from_local) => {
                Anchor { map_from_local, sigma_m: FOUND_M, sigma_rad: FOUND_RAD }
            }
            Sought::HintTaken(Hint { map_from_local, sigma_m, sigma_rad }) => {
                Anchor { map_from_local, sigma_m, sigma_rad }
            }
        };
        self.just_found = true;
        self.sought = seeker.counts();
        let waiting = seeker.take_waiting();
        self.seeker = None;
        self.anchor = Some(anchor);
        if let Some(localizer) = &mut self.localizer {
            localizer.begin();
        }
        waiting.into_iter().for_each(|node| self.use_node(node));
    }

    fn use_node(&mut self, node: Node) {
        let Some(localizer) = &mut self.localizer else {
            self.extend(node);
            if self.mode == SlamMode::Lifelong {
                self.forget();
            }
            return;
        };
        let map_from_local = match self.anchor.take() {
            Some(anchor) => anchor.map_from_local,
            None => localizer.newest().map_or(Pose2::IDENTITY, |(_, map_from_local)| map_from_local),
        };
        let map = Placed { nodes: &self.nodes, poses: self.graph.poses() };
        localizer.add(node, map_from_local, map);
        if localizer.astray() {
            self.seek(None);
        }
    }

    /// The first node of a pass: tied to the nearest node of the map, as well as its place is known.
    pub(super) fn put_down(&mut self, node: Node, anchor: Anchor) {
        let map_from_node = anchor.map_from_local * node.local_from_base;
        let nearest = self.nearest_in_map(map_from_node);
        let id = node.id;
        self.graph.add_node(map_from_node);
        self.nodes.push(node);
        if let Some(nearest) = nearest {
            let measured = self.graph.poses()[nearest as usize].between(map_from_node);
            let information = information_from_sigmas(anchor.sigma_m.max(1e-3), anchor.sigma_rad.max(1e-3));
            self.graph.add_edge([nearest, id], measured, information, EdgeKind::Placed, [0.0; 2]);
        }
    }

    pub(super) fn revision(&self) -> Revision {
        let of_graph = || {
            let newest = self.nodes.last()?;
            Some(self.graph.poses()[newest.id as usize] * newest.local_from_base.inverse())
        };
        let map_from_local = match (&self.seeker, &self.localizer) {
            (Some(seeker), _) => seeker.hint().map(|hint| hint.map_from_local),
            (None, Some(localizer)) => localizer.newest().map(|(_, map_from_local)| map_from_local),
            (None, None) => of_graph(),
        };
        // Where a robot is in a fixed map it should know soon; what closures change can wait until
        // it is sure to have been worked out, so that a run can be repeated.
        let soon = self.seeker.is_some() || self.localizer.is_some() || self.just_found;
        let lag = if soon { 1 } else { self.config.graph.revision_lag_nodes };
        Revision {
            cause: self.newest_front,
            effective_from: self.newest_front.saturating_add(lag),
            map_from_local: map_from_local.unwrap_or_default(),
            closures: self.closures,
            located: map_from_local.is_some() && self.located(),
        }
    }

    /// The newest revision, for a scan path that begins.
    pub fn newest_revision(&self) -> Revision {
        self.revision()
    }

    /// The node that one of the scan path's became; the newest if its numbers came twice.
    pub fn node_of(&self, front_id: u32) -> Option<u32> {
        let newest = self.front_ids.len().checked_sub(1)?;
        // Numbers rise by one, but where nodes were dropped, or another scan path began.
        let guess = newest.checked_sub(self.front_ids[newest].checked_sub(front_id)? as usize)?;
        let found = match self.front_ids[guess] == front_id {
            true => guess,
            false => self.front_ids.iter().rposition(|id| *id == front_id)?,
        };
        Some(found as u32)
    }

    /// Every scan's stamp and `map_from_base`, those of earlier scan paths first: scans between nodes
    /// ride on their node.
    pub fn trajectory<'a>(&'a self, rides: &'a [Ride]) -> impl Iterator<Item = (Stamp, Pose2)> + 'a {
        let poses = self.graph.poses();
        let rides = self.rides(rides);
        rides.map(|ride| (ride.stamp, poses[ride.node as usize] * ride.node_from_base))
    }

    /// Scans by this graph's own numbers, from the scan path's.
    fn rides<'a>(&'a self, rides: &'a [Ride]) -> impl Iterator<Item = Ride> + 'a {
        let newer = rides.iter().filter_map(|ride| Some(Ride { node: self.node_of(ride.node)?, ..*ride }));
        self.earlier.iter().copied().chain(newer)
    }

    /// All that must be kept to go on later. `front`: where the scan path is, after exactly the nodes
    /// that were added here; it is kept if its newest nodes are the map's. `rides`: its scans, if they are to
    /// be kept.
    pub fn session(&self, identity: Identity, front: Option<FrontState>, rides: &[Ride]) -> Session {
        let grows = self.seeker.is_none() && self.localizer.is_none();
        let same = |front: &FrontState| front.next_node.checked_sub(1) == self.front_ids.last().copied();
        let front = front.filter(|front| grows && same(front));
        Session { identity, mode: self.mode, back: self.state(), front, rides: self.rides(rides).collect() }
    }

    /// How searches for the robot ended.
    pub fn sought(&self) -> SeekCounts {
        self.seeker.as_ref().map_or(self.sought, Seeker::counts)
    }
}
