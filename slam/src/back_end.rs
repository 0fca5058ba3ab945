//! The back end: node by node it builds the pose graph, links scans that see the same surfaces,
//! searches for places seen before, solves, and draws. It may run on any thread: the result depends
//! on the nodes alone.
//!
//! `links` links a node with older ones, `components` handles those that nothing connects, `loop_closures` remembers
//! what to search for. `modes` decides what a node is used for; `state` is what a session keeps, `closure_report` what people
//! undo, `lifelong` what a lasting map removes.

mod append;
mod closure_report;
mod component_search;
mod components;
mod lifelong;
mod links;
mod localization_state;
mod loop_closures;
mod modes;
mod node_id_map;
mod odometry_noise;
mod reliability;
mod retracted;
mod state;
#[cfg(test)]
mod testing;
mod uncertain_components;

pub use closure_report::ClosureReport;
pub use loop_closures::RejectedClosure;
pub use modes::{InitialPose, PlaceInMap};
pub use reliability::ReliabilityMonitor;
pub use state::BackEndState;

use crate::closure::{ClosureCandidate, ClosureSearchCounts, ClosureSearchResult, GraphView};
use crate::config::SlamConfig;
use crate::graph::{EdgeKind, Graph, PoseVariances, RelativeUncertainty};
use crate::localizer::{Localizer, LocalizerCounts};
use crate::mapper::OccupancyMapper;
use crate::node::{MapFrameUpdate, Node};
use crate::relocalize::RelocalizationCounts;
use crate::stages::{Stage, StageObserver};
use lifelong::Lifelong;
use localization_state::LocalizationState;
use loop_closures::LoopClosureState;
use msg::{GridView, Header, Monotonic, TileMap};
use node_id_map::NodeIdMap;
use odometry_noise::OdometryNoise;
use posegraph::PoseSigmas;

/// Nodes this many before and after a closure are linked again: 3 m, where they now overlap.
const RELINK_NODES: u32 = 10;
/// Searches that `finish` makes at most: a few seconds.
const LAST_SEARCHES_MAX: usize = 64;
/// Standard deviations of the edge at an odometry break: weaker than any measurement.
const BREAK_SIGMAS: PoseSigmas = PoseSigmas { position_m: 100.0, heading_rad: 3.0 };
/// Variances of the same for the propagation of uncertainty.
const BREAK_VARIANCES: PoseVariances = PoseVariances {
    worst_axis_m2: BREAK_SIGMAS.position_m * BREAK_SIGMAS.position_m,
    heading_rad2: BREAK_SIGMAS.heading_rad * BREAK_SIGMAS.heading_rad,
};

/// The back end of one robot's SLAM; see the module.
///
/// ```
/// use msg::{Scan, Stamp};
/// use slam::{BackEnd, FrontEnd, SlamConfig};
///
/// // A LiDAR of 1° in the middle of a square room of 4 m.
/// let mut scan: Box<Scan> = bytemuck::allocation::zeroed_box();
/// (scan.range_min_m, scan.range_max_m, scan.len) = (0.1, 10.0, 360);
/// scan.angle_increment_rad = 1_f32.to_radians();
/// for beam in 0..360 {
///     let (sin, cos) = scan.angle_rad(beam).sin_cos();
///     scan.ranges_m[beam] = 2.0 / sin.abs().max(cos.abs());
/// }
/// scan.header.stamp = Stamp::from_seconds(0.1);
///
/// let config = SlamConfig::default();
/// let (mut front, mut back) = (FrontEnd::new(config.clone()), BackEnd::new(config));
/// let node = front.process(&scan).node.expect("the first scan becomes a node");
/// // The back end may do this on another thread, and later.
/// let frame_update = back.add_node(node);
/// front.add_frame_update(frame_update);
/// assert_eq!(back.nodes().len(), 1);
/// assert!(back.map().header.width >= 80, "4 m in cells of 5 cm");
/// ```
// More than 12 fields: one for each part of its work, which a module of its own does, and the counts that they share.
pub struct BackEnd {
    config: SlamConfig,
    /// The nodes, by id; their poses are the graph's.
    nodes: Vec<Node>,
    graph: Graph,
    loop_closures: LoopClosureState,
    location: LocalizationState,
    lifelong: Lifelong,
    node_ids: NodeIdMap,
    odometry_noise: OdometryNoise,
    reliability: ReliabilityMonitor,
    mapper: OccupancyMapper,
    /// The newest node that odometry alone connects with the nodes before: whether that is right is not yet verified.
    unverified_node: Option<u32>,
    /// Nodes linked to older parts of the map since the last solution.
    linked_since_solve: usize,
    /// Solutions of the whole graph so far.
    solutions: u64,
    /// How often the map became one of another frame.
    map_frame_changes: u32,
    stages: Box<dyn StageObserver>,
}

/// Counts of what the back end has done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BackEndCounts {
    /// Nodes in the graph.
    pub nodes: usize,
    /// Number of active links.
    pub links: usize,
    /// Number of active closures.
    pub closures: usize,
    /// Closures that were retracted.
    pub retracted: u64,
    /// Solutions of the whole graph, failed ones included.
    pub solutions: u64,
    /// Solutions of this process that failed: the map stayed as it was.
    pub failed_solutions: u64,
    /// Nodes not drawn because the map would have become larger than a grid may be.
    pub not_drawn: u64,
    /// How closure searches ended.
    pub searches: ClosureSearchCounts,
    /// Counts of relocalization searches.
    pub relocalization: RelocalizationCounts,
    /// Localization: which nodes fitted the map.
    pub localized: LocalizerCounts,
    /// Nodes removed in lifelong mode.
    pub removed_nodes: u64,
    /// Nodes of unplaced components.
    pub unplaced: usize,
}

impl BackEnd {
    /// A back end without nodes.
    pub fn new(config: SlamConfig) -> Self {
        Self {
            nodes: Vec::new(),
            graph: Graph::new(config.graph.clone()),
            loop_closures: LoopClosureState::new(config.clone()),
            location: LocalizationState::new(),
            lifelong: Lifelong::default(),
            node_ids: NodeIdMap::default(),
            odometry_noise: OdometryNoise::new(),
            reliability: ReliabilityMonitor::default(),
            mapper: OccupancyMapper::new(config.map.clone()),
            unverified_node: None,
            linked_since_solve: 0,
            solutions: 0,
            map_frame_changes: 0,
            stages: Box::new(()),
            config,
        }
    }

    /// Reports every stage of the work to this observer from now on.
    pub fn observe_stages(&mut self, observer: Box<dyn StageObserver>) {
        self.stages = observer;
    }

    /// Adds the next node of the front end, as the mode wants it: locates the robot with it, or grows the map.
    pub fn add_node(&mut self, node: Node) -> MapFrameUpdate {
        let node = node.into_owned();
        self.node_ids.newest_front = node.id;
        self.process_node(node);
        self.confirm_estimate();
        self.update_reliability();
        self.stages.stage_started(Stage::Idle);
        self.frame_update()
    }

    /// Grows the map by a node.
    fn grow_map(&mut self, node: Node) {
        let id = self.nodes.len() as u32;
        if id as usize >= self.config.graph.nodes_max {
            return;
        }
        // Append the node where the front end has it, with odometry's edge.
        self.stages.stage_started(Stage::Link);
        self.append_node(node);
        // Link it with the nodes just before, and with others near by whose relative pose is well known.
        self.link_sequential(id);
        self.learn_odometry_noise(id);
        let relative = self.uncertainty_from(id);
        let linked = self.link_near(id, &relative);
        self.linked_since_solve += usize::from(linked > 0);
        self.graph.update_newest_covariance();
        self.check_newest_position_uncertainty();
        // Verify an odometry edge that no scan has confirmed.
        self.check_unverified_node(id, &relative);
        let unplaced = !self.newest_is_placed();
        // Search for a place seen before; between two searches, retry a node that was not found.
        if self.loop_closures.is_search_due() {
            self.search_closure(id, &relative);
        } else {
            self.retry_closure();
        }
        // Solve the graph when enough of it is new.
        if self.linked_since_solve as f64 > self.config.graph.new_share * self.nodes.len() as f64 {
            self.solve(false);
        }
        // Search for the node in the components that nothing connects it with.
        self.search_other_components(id);
        if unplaced {
            self.location.just_located = self.newest_is_placed();
        }
    }

    /// Finishes: searches again for nodes that were not found, and solves with all that is known.
    pub fn finish(&mut self) {
        self.solve(false);
        let mut left = LAST_SEARCHES_MAX;
        while left > 0 && self.retry_closure() {
            left -= 1;
        }
        self.solve(false);
        self.recompute_reliability();
        self.stages.stage_started(Stage::Idle);
    }

    /// Searches for a node among places seen before. A node that is not found is tried once more after
    /// the next closure.
    fn search_closure(&mut self, id: u32, relative: &[Option<RelativeUncertainty>]) -> bool {
        self.stages.stage_started(Stage::Closure);
        let view = GraphView { nodes: &self.nodes, graph: &self.graph };
        match self.loop_closures.detector.search(&view, id, relative, self.loop_closures.travelled_m) {
            ClosureSearchResult::NoCandidate => return false,
            ClosureSearchResult::NotFound | ClosureSearchResult::Unconfirmed => {
                self.loop_closures.record_not_found(id);
            }
            ClosureSearchResult::Accepted(closures) => self.add_closures(&closures),
        }
        true
    }

    /// Searches once more for a node that was not found before the last closure; false if there is none.
    fn retry_closure(&mut self) -> bool {
        while let Some(id) = self.loop_closures.to_retry.pop_front() {
            self.stages.stage_started(Stage::Link);
            let relative = self.uncertainty_from(id);
            self.linked_since_solve += usize::from(self.link_near(id, &relative) > 0);
            self.stages.stage_started(Stage::Closure);
            let view = GraphView { nodes: &self.nodes, graph: &self.graph };
            match self.loop_closures.detector.search(&view, id, &relative, self.loop_closures.travelled_m) {
                ClosureSearchResult::NoCandidate => continue,
                ClosureSearchResult::NotFound | ClosureSearchResult::Unconfirmed => {}
                ClosureSearchResult::Accepted(closures) => self.add_closures(&closures),
            }
            return true;
        }
        false
    }

    /// Counts of what has been done.
    pub fn counts(&self) -> BackEndCounts {
        let count = |kind| self.graph.edges().iter().filter(|e| e.is_active && e.kind == kind).count();
        BackEndCounts {
            nodes: self.nodes.len(),
            links: count(EdgeKind::ScanMatch),
            closures: count(EdgeKind::Closure),
            retracted: self.loop_closures.retracted,
            solutions: self.solutions,
            failed_solutions: self.failed_solutions(),
            not_drawn: self.mapper.nodes_not_drawn(),
            searches: self.loop_closures.detector.counts(),
            relocalization: self.location.relocalization_counts(),
            localized: self.location.localizer.as_ref().map(Localizer::counts).unwrap_or_default(),
            removed_nodes: self.lifelong.removed_nodes,
            unplaced: self.nodes.iter().filter(|node| !node.is_placed()).count(),
        }
    }

    /// Solutions that failed since the back end was made: the map stayed as it was.
    pub fn failed_solutions(&self) -> u64 {
        let localizer = self.location.localizer.as_ref().map(Localizer::counts).unwrap_or_default();
        self.graph.failed_solutions() + localizer.failed_solutions
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

    /// Draws about `cells_max` cells into [`BackEnd::tiles`]: new nodes first, then nodes that solutions moved visibly.
    /// Returns whether there is more to do.
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
        self.mapper.set_header(header, scan_sent);
    }

    /// Adds accepted closures to the graph, solves, and links the nodes around them. Where they and others show together that the
    /// path is wrong, an odometry break is added.
    fn add_closures(&mut self, closures: &[ClosureCandidate]) {
        let closures: Vec<ClosureCandidate> = closures
            .iter()
            .filter(|closure| !self.loop_closures.resembles_rejected(closure))
            .copied()
            .collect();
        if closures.is_empty() {
            return;
        }
        self.align_components(&closures[closures.len() - 1]);
        for closure in &closures {
            let information = self.limit_information(closure.information);
            let (a, b) = (closure.older, closure.newer);
            let drift = self.drift(closure.older_from_newer);
            self.graph.add_edge([a, b], closure.older_from_newer, information, EdgeKind::Closure, drift);
            let newest = self.graph.edges().len() - 1;
            self.graph.edge_mut(newest).response = closure.response;
        }
        self.restore_retracted(&closures);
        self.solve(true);
        self.stages.stage_started(Stage::Link);
        for id in self.nodes_around_newer_ends(&closures) {
            let relative = self.uncertainty_from(id);
            self.link_near(id, &relative);
        }
        self.loop_closures.retry_not_found();
        self.solve(false);
        self.break_odometry_at_conflicting_closures();
    }

    /// Nodes around the newer ends of closures, without doubles, in order.
    fn nodes_around_newer_ends(&self, closures: &[ClosureCandidate]) -> Vec<u32> {
        let newest = self.nodes.len() as u32 - 1;
        let span = |id: u32| id.saturating_sub(RELINK_NODES)..=(id + RELINK_NODES).min(newest);
        let mut ids: Vec<u32> = closures.iter().flat_map(|f| span(f.newer)).collect();
        ids.sort_unstable();
        ids.dedup();
        ids
    }

    fn solve(&mut self, graduated: bool) {
        self.stages.stage_started(Stage::Solve);
        // After an error, which the graph counts, the poses are what they were: the map stays as it is.
        let _ = self.graph.solve(graduated);
        self.solutions += 1;
        self.linked_since_solve = 0;
        self.retract_contradicted();
    }

    /// Retracts closures that the solved graph contradicts.
    fn retract_contradicted(&mut self) {
        let limit = self.config.graph.retract_sigmas.powi(2);
        let contradicted: Vec<usize> = (0..self.graph.edges().len())
            .filter(|&i| {
                let edge = &self.graph.edges()[i];
                edge.is_active && edge.kind == EdgeKind::Closure && self.graph.chi_squared(edge) > limit
            })
            .collect();
        for &index in &contradicted {
            self.graph.edge_mut(index).is_active = false;
            self.loop_closures.retracted += 1;
        }
        self.update_after_edge_change();
    }

    /// Updates components and the number of closures, after edges changed.
    fn update_after_edge_change(&mut self) {
        self.update_components();
        self.update_covariances();
        let is_active = |e: &&crate::graph::Edge| e.is_active && e.kind == EdgeKind::Closure;
        self.loop_closures.active_count = self.graph.edges().iter().filter(is_active).count() as u32;
    }
}
