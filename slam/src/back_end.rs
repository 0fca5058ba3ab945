//! The back end: node by node it builds the pose graph, links scans that see the same surfaces,
//! looks for places seen before, solves, and draws. It runs beside the scan path, on any thread;
//! what comes out depends on the nodes alone.
//!
//! `links` has how a node is linked with older ones, `pieces` those that hang on nothing. What it does with a map
//! it has is its mode's business (`modes`); `keep` has what is kept in a session, `undo` what people may take
//! back, `forget` what a map that is to last forgets.

mod forget;
mod keep;
mod links;
mod modes;
mod pieces;
mod undo;

pub use keep::BackEndState;
pub use modes::InitialPose;
pub use undo::{ClosureReport, RejectedClosure};

use crate::closure::{ClosureCandidate, ClosureDetector, ClosureSearch, ClosureSearchCounts, GraphView};
use crate::config::SlamConfig;
use crate::front_end::TrajectorySample;
use crate::graph::{EdgeKind, Graph, RelativeUncertainty};
use crate::localizer::{Localizer, LocalizerCounts};
use crate::mapper::OccupancyMapper;
use crate::node::{Node, Revision};
use crate::relocalize::{RelocalizationCounts, Relocalizer};
use crate::stages::{Stage, StageObserver};
use modes::Anchor;
use msg::{GridView, Header, Monotonic, Pose2, SlamMode, TileMap};
use nalgebra::{Matrix3, Vector3};
use posegraph::information_from_sigmas;
use std::collections::VecDeque;

/// Nodes up to so many before and after a closure are linked again.
const RELINK_NODES: u32 = 10;
/// Nodes not found that are remembered, to be looked for again after a closure.
const NOT_FOUND_MAX: usize = 256;
/// Nodes that the last word looks for again.
const LAST_SEARCHES_MAX: usize = 64;
/// An odometry edge that scans contradict, one standard deviation: metres and radians.
const TORN_M: f64 = 100.0;
const TORN_RAD: f64 = 3.0;
/// Nothing is known along it.
const TORN_VARIANCE: [f64; 2] = [TORN_M * TORN_M, TORN_RAD * TORN_RAD];

/// See the module.
pub struct BackEnd {
    config: SlamConfig,
    nodes: Vec<Node>,
    graph: Graph,
    detector: ClosureDetector,
    mapper: OccupancyMapper,
    travelled_m: f64,
    /// Nodes looked for and not found since the last closure,
    not_found: VecDeque<u32>,
    /// and those from before it, to be looked for once more.
    again: VecDeque<u32>,
    /// Nodes with links to older parts of the map since the last solution.
    unsolved: usize,
    closures: u32,
    solutions: u64,
    retracted: u64,
    mode: SlamMode,
    /// Scans of earlier scan paths, by this graph's own numbers.
    earlier: Vec<TrajectorySample>,
    /// The scan path's number of each node.
    front_ids: Vec<u32>,
    /// The scan path's number of the newest node, kept or not.
    newest_front: u32,
    /// While it is not known where the robot is.
    relocalizer: Option<Relocalizer>,
    relocalization: RelocalizationCounts,
    /// While the newest node's piece is not tied to the map.
    component_relocalizer: Option<Relocalizer>,
    /// The newest node that odometry alone joins to the ones before.
    unverified_edge: Option<u32>,
    /// The newest node is the one that found it.
    just_found: bool,
    /// Where the next node is, if it does not follow from the one before.
    anchor: Option<Anchor>,
    /// In localization, instead of a growing graph.
    localizer: Option<Localizer>,
    /// Closures that were undone.
    rejected_closures: Vec<RejectedClosure>,
    /// How often each node was contradicted.
    contradicted: Vec<u8>,
    retired: u64,
    retiring: Vec<u32>,
    stages: Box<dyn StageObserver>,
}

/// What the back end has done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BackEndCounts {
    /// Nodes in the graph.
    pub nodes: usize,
    /// Links in force.
    pub links: usize,
    /// Closures in force.
    pub closures: usize,
    /// Closures taken back.
    pub retracted: u64,
    /// Solutions of the whole graph.
    pub solutions: u64,
    /// Nodes not drawn because the map would have become larger than a grid may be.
    pub not_drawn: u64,
    /// How closure searches ended.
    pub searches: ClosureSearchCounts,
    /// How searches for the robot ended.
    pub relocalization: RelocalizationCounts,
    /// Localization: which nodes fitted the map.
    pub localized: LocalizerCounts,
    /// Nodes forgotten.
    pub retired: u64,
    /// Nodes that are not tied to the map.
    pub disconnected: usize,
}

impl BackEnd {
    /// Without nodes.
    pub fn new(config: SlamConfig) -> Self {
        Self {
            nodes: Vec::new(),
            graph: Graph::new(config.graph.clone()),
            detector: ClosureDetector::new(config.clone()),
            mapper: OccupancyMapper::new(config.map.clone()),
            travelled_m: 0.0,
            not_found: VecDeque::with_capacity(NOT_FOUND_MAX),
            again: VecDeque::with_capacity(NOT_FOUND_MAX),
            unsolved: 0,
            closures: 0,
            solutions: 0,
            retracted: 0,
            mode: SlamMode::Mapping,
            earlier: Vec::new(),
            front_ids: Vec::new(),
            newest_front: 0,
            relocalizer: None,
            component_relocalizer: None,
            unverified_edge: None,
            relocalization: RelocalizationCounts::default(),
            just_found: false,
            anchor: None,
            localizer: None,
            rejected_closures: Vec::new(),
            contradicted: Vec::new(),
            retired: 0,
            retiring: Vec::new(),
            stages: Box::new(()),
            config,
        }
    }

    /// From now on this watch hears of every stage.
    pub fn observe_stages(&mut self, observer: Box<dyn StageObserver>) {
        self.stages = observer;
    }

    /// Takes the next node, and does with it what the mode wants.
    pub fn add_node(&mut self, node: Node) -> Revision {
        let node = node.kept();
        self.newest_front = node.id;
        self.take(node);
        self.stages.stage_started(Stage::Idle);
        self.revision()
    }

    /// The map grows by a node: place it, link it, look for a closure, solve if that is due.
    fn extend(&mut self, node: Node) {
        let id = self.nodes.len() as u32;
        if id as usize >= self.config.graph.nodes_max {
            return;
        }
        self.stages.stage_started(Stage::Link);
        self.place(node);
        self.link_sequential(id);
        let relative = self.uncertainty_from(id);
        let linked = self.link_near(id, &relative);
        self.check_unverified_edge(id, &relative);
        let disconnected = !self.newest_in_map();
        self.unsolved += usize::from(linked > 0);
        if self.detector.due(self.travelled_m) {
            self.search(id, &relative);
        } else {
            self.search_again();
        }
        if self.unsolved as f64 > self.config.graph.new_share * self.nodes.len() as f64 {
            self.solve(false);
        }
        if disconnected {
            self.stages.stage_started(Stage::Closure);
            self.relocalize_component(id);
            self.update_components();
            self.just_found = self.newest_in_map();
        }
    }

    /// The last word: looks again where nothing was found, solves with all that is known.
    pub fn finish(&mut self) {
        self.solve(false);
        let mut left = LAST_SEARCHES_MAX;
        while left > 0 && self.search_again() {
            left -= 1;
        }
        self.solve(false);
        self.stages.stage_started(Stage::Idle);
    }

    /// Looks for a node among places seen before. Where nothing was found, a better map may help:
    /// the node is noted, to be tried once more after the next closure.
    fn search(&mut self, id: u32, relative: &[Option<RelativeUncertainty>]) -> bool {
        self.stages.stage_started(Stage::Closure);
        let view = GraphView { nodes: &self.nodes, graph: &self.graph };
        match self.detector.search(&view, id, relative, self.travelled_m) {
            ClosureSearch::NoCandidate => return false,
            ClosureSearch::NotFound | ClosureSearch::Unconfirmed => {
                if self.not_found.len() == NOT_FOUND_MAX {
                    self.not_found.pop_front();
                }
                self.not_found.push_back(id);
            }
            ClosureSearch::Accepted(finds) => self.close(&finds),
        }
        true
    }

    /// Tries one node once more that was not found before the last closure; false if there is none.
    fn search_again(&mut self) -> bool {
        while let Some(id) = self.again.pop_front() {
            self.stages.stage_started(Stage::Link);
            let relative = self.uncertainty_from(id);
            self.unsolved += usize::from(self.link_near(id, &relative) > 0);
            self.stages.stage_started(Stage::Closure);
            let view = GraphView { nodes: &self.nodes, graph: &self.graph };
            match self.detector.search(&view, id, &relative, self.travelled_m) {
                ClosureSearch::NoCandidate => continue,
                ClosureSearch::NotFound | ClosureSearch::Unconfirmed => {}
                ClosureSearch::Accepted(finds) => self.close(&finds),
            }
            return true;
        }
        false
    }

    /// What has been done.
    pub fn counts(&self) -> BackEndCounts {
        let count = |kind| self.graph.edges().iter().filter(|e| e.in_force && e.kind == kind).count();
        BackEndCounts {
            nodes: self.nodes.len(),
            links: count(EdgeKind::Link),
            closures: count(EdgeKind::Closure),
            retracted: self.retracted,
            solutions: self.solutions,
            not_drawn: self.mapper.clipped(),
            searches: self.detector.counts(),
            relocalization: self.relocalizer.as_ref().map_or(self.relocalization, Relocalizer::counts),
            localized: self.localizer.as_ref().map(Localizer::counts).unwrap_or_default(),
            retired: self.retired,
            disconnected: self.nodes.iter().filter(|node| node.disconnected.is_some()).count(),
        }
    }

    /// Nodes forgotten so far; the others then have new numbers.
    pub fn retired(&self) -> u64 {
        self.retired
    }

    /// The pose graph.
    pub fn graph(&self) -> &Graph {
        &self.graph
    }

    /// The nodes, by id.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// The map of all nodes, each exactly where it is, as one grid.
    pub fn map(&mut self) -> GridView<'_> {
        self.stages.stage_started(Stage::Draw);
        let map = self.mapper.finish(&self.nodes, self.graph.poses());
        self.stages.stage_started(Stage::Idle);
        map
    }

    /// Brings [`BackEnd::tiles`] closer to what is known, by about so many cells of beams: new nodes
    /// first, then what solutions have moved visibly. True if there is more to do.
    pub fn draw(&mut self, cells_max: usize) -> bool {
        self.stages.stage_started(Stage::Draw);
        let more = self.mapper.work(&self.nodes, self.graph.poses(), cells_max);
        self.stages.stage_started(Stage::Idle);
        more
    }

    /// The map as drawn so far. Nodes that moved are drawn elsewhere all at once.
    pub fn tiles(&self) -> &TileMap {
        self.mapper.tiles()
    }

    /// The map is as of this scan until the next one is drawn: a loaded map's own are of another time.
    pub fn set_map_header(&mut self, header: Header, scan_sent: Monotonic) {
        self.mapper.date(header, scan_sent);
    }

    /// Puts a node where the scan path says, as seen from the node before, with odometry's edge; or
    /// where it was put down.
    fn place(&mut self, mut node: Node) {
        self.front_ids.push(node.id);
        self.contradicted.push(0);
        node.id = self.nodes.len() as u32;
        if let Some(anchor) = self.anchor.take() {
            return self.add_anchored_node(node, anchor);
        }
        let Some(previous) = self.nodes.last() else {
            self.graph.add_node(node.local_from_base);
            self.nodes.push(node);
            return;
        };
        let moved = previous.local_from_base.between(node.local_from_base);
        let (a, b) = (previous.id, node.id);
        let map_from_node = self.graph.poses()[a as usize] * moved;
        self.travelled_m += moved.x_m.hypot(moved.y_m);
        self.graph.add_node(map_from_node);
        let measured = node.previous_from_this.unwrap_or(moved);
        let (kind, information) = if node.odometry_break {
            self.detector.tear();
            self.component_relocalizer = None;
            (EdgeKind::OdometryBreak, information_from_sigmas(TORN_M, TORN_RAD))
        } else {
            let known = node.previous_from_this.is_some();
            (EdgeKind::Odometry, self.odometry_information(measured, known))
        };
        node.disconnected = if node.odometry_break { Some(b) } else { previous.disconnected };
        self.nodes.push(node);
        self.graph.add_edge([a, b], measured, information, kind, [0.0; 2]);
    }

    fn odometry_information(&self, moved: Pose2, measured: bool) -> Matrix3<f64> {
        let c = &self.config.odometry;
        let (way, turn) = (moved.x_m.hypot(moved.y_m), moved.yaw_rad.abs());
        let doubt = if measured { 1.0 } else { 5.0 };
        let m = doubt * (c.sigma_m + c.sigma_m_per_m * way);
        let rad = doubt * (c.sigma_rad + c.sigma_rad_per_rad * turn + c.sigma_rad_per_m * way);
        Matrix3::from_diagonal(&Vector3::new(1.0 / (m * m), 1.0 / (m * m), 1.0 / (rad * rad)))
    }

    /// Brings believed finds into the graph, solves, and links the newest nodes to what they now see.
    fn close(&mut self, finds: &[ClosureCandidate]) {
        let finds: Vec<ClosureCandidate> =
            finds.iter().filter(|find| !self.is_rejected(find)).copied().collect();
        if finds.is_empty() {
            return;
        }
        self.align_components(&finds[finds.len() - 1]);
        for find in &finds {
            let information = self.floored(find.information);
            let (a, b) = (find.candidate, find.node);
            let drift = self.drift(find.candidate_from_node);
            self.graph.add_edge([a, b], find.candidate_from_node, information, EdgeKind::Closure, drift);
            let newest = self.graph.edges().len() - 1;
            self.graph.edge_mut(newest).response = find.response;
        }
        self.solve(true);
        self.stages.stage_started(Stage::Link);
        for id in self.around(&finds) {
            let relative = self.uncertainty_from(id);
            self.link_near(id, &relative);
        }
        while let Some(id) = self.not_found.pop_front() {
            if self.again.len() < NOT_FOUND_MAX {
                self.again.push_back(id);
            }
        }
        self.solve(false);
    }

    /// Nodes around both ends of closures, without doubles, in order.
    fn around(&self, finds: &[ClosureCandidate]) -> Vec<u32> {
        let newest = self.nodes.len() as u32 - 1;
        let span = |id: u32| id.saturating_sub(RELINK_NODES)..=(id + RELINK_NODES).min(newest);
        let mut ids: Vec<u32> = finds.iter().flat_map(|f| span(f.node)).collect();
        ids.sort_unstable();
        ids.dedup();
        ids
    }

    fn solve(&mut self, shock: bool) {
        self.stages.stage_started(Stage::Solve);
        // After an error the poses are what they were: the map stays as it is.
        let _ = self.graph.solve(shock);
        self.solutions += 1;
        self.unsolved = 0;
        self.retract_contradicted();
    }

    /// Takes back closures that the solved graph contradicts.
    fn retract_contradicted(&mut self) {
        let limit = self.config.graph.retract_sigmas.powi(2);
        let contradicted: Vec<usize> = (0..self.graph.edges().len())
            .filter(|&i| {
                let edge = &self.graph.edges()[i];
                edge.in_force && edge.kind == EdgeKind::Closure && self.graph.chi_squared(edge) > limit
            })
            .collect();
        for &index in &contradicted {
            self.graph.edge_mut(index).in_force = false;
            self.retracted += 1;
        }
        self.count_closures();
    }

    /// After edges came into force or no longer are.
    fn count_closures(&mut self) {
        self.update_components();
        let in_force = |e: &&crate::graph::Edge| e.in_force && e.kind == EdgeKind::Closure;
        self.closures = self.graph.edges().iter().filter(in_force).count() as u32;
    }
}
