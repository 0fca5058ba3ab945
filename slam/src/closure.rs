//! Loop-closure detection: searches for a node at places seen before and verifies what is found.
//!
//! A candidate is accepted when (1) its response is high, (2) no other place in the window comes near
//! it, (3) the scans of both passes do not contradict each other (no surface where the other saw
//! through), (4) the way that the graph knows between the two places admits it (`consistency`), and (5) candidates from
//! different places on the path agree with each other (Olson 2009, "Recognizing places using spectrally clustered local
//! matches").

mod candidate;
mod consistency;
mod error_model;
mod passes;
#[cfg(test)]
mod tests;

pub use candidate::{ClosureCandidate, ClosureDetectorState, ClosureSearchCounts};
use passes::nearest_scans;
pub(crate) use passes::{GraphView, PosedNode, compare_passes};

use crate::align::{Reference, ScanAlignment, align};
use crate::cloud::Cloud;
use crate::config::SlamConfig;
use crate::graph::{Graph, RelativeUncertainty};
use crate::likelihood_field::{LikelihoodField, SearchBuffers, SearchLimits, SearchPeak, SearchWindow};
use error_model::ErrorModel;
use msg::pose::wrap_angle;
use std::collections::VecDeque;

/// Candidates that wait for confirmation; beyond them the oldest is dropped.
const PENDING_MAX: usize = 64;
/// Nodes over which a candidate waits for confirmation: about 12 m of path.
const PENDING_NODES: u32 = 40;
/// Half side of the field that is searched, metres: the chain of nodes around a candidate and its view.
const REACH_M: f32 = 20.0;
/// Scans of the query that are compared with those of the other pass: the newest ones; more add time and no certainty.
pub(crate) const COMPARED_SCANS: usize = 6;
/// Least number of nodes before the newest that are searched for with it.
const QUERY_NODES_MIN: u32 = 5;
/// Most passes tried in one search: a second one where two lie near by.
const PASSES_MAX: usize = 2;
/// Nodes no farther from each other in order than this are linked, not searched for.
const NODE_GAP_MIN: u32 = 12;
/// A pose nearer to the best one than this is the same place, metres.
const SAME_PLACE_M: f64 = 0.6;
/// A pose turned by less than this against the best one is the same place, radians.
const SAME_PLACE_RAD: f64 = 0.2;
/// Largest distance between the best pose and its alignment, metres: farther off, it found other surfaces.
const ALIGNMENT_SHIFT_MAX_M: f64 = 0.5;
/// Least half side of the search window, metres: the graph may underestimate drift.
const WINDOW_MIN_M: f64 = 0.5;
/// Least half opening of the search window, radians.
const WINDOW_MIN_RAD: f64 = 0.1;
/// Variance (m², rad²) of a relative pose that the graph does not determine: larger than any window.
const UNKNOWN_VARIANCE: f64 = 1e6;
/// Most points of a merged query, in scans.
const QUERY_SCANS: usize = 4;

/// Result of a closure search.
pub enum ClosureSearchResult {
    /// No place seen before can be here, or the places that can are linked already.
    NoCandidate,
    /// The search found no pose that passed verification.
    NotFound,
    /// A pose was found; no other search has confirmed it yet.
    Unconfirmed,
    /// A pose was found and confirmed: this candidate and those that agree with it.
    Accepted(Vec<ClosureCandidate>),
}

/// Searches for places seen before and keeps the candidates that wait for confirmation.
pub struct ClosureDetector {
    config: SlamConfig,
    field: LikelihoodField,
    scratch: SearchBuffers,
    pending: VecDeque<ClosureCandidate>,
    counts: ClosureSearchCounts,
    last_search_m: Option<f64>,
}

impl ClosureDetector {
    /// A detector that has found nothing yet.
    pub fn new(config: SlamConfig) -> Self {
        let t = &config.tracking;
        Self {
            field: LikelihoodField::new(t.cell_m, REACH_M, t.blur_m),
            scratch: SearchBuffers::default(),
            pending: VecDeque::with_capacity(PENDING_MAX),
            counts: ClosureSearchCounts::default(),
            last_search_m: None,
            config,
        }
    }

    /// A detector that continues from this state.
    pub fn resume(config: SlamConfig, state: ClosureDetectorState) -> Self {
        let ClosureDetectorState { pending, counts, last_search_m } = state;
        Self { pending: pending.into(), counts, last_search_m, ..Self::new(config) }
    }

    /// The state to be kept in a session.
    pub fn state(&self) -> ClosureDetectorState {
        let pending = self.pending.iter().copied().collect();
        ClosureDetectorState { pending, counts: self.counts, last_search_m: self.last_search_m }
    }

    /// Drops unconfirmed candidates after an odometry break: they cannot agree with what follows.
    pub fn drop_pending(&mut self) {
        self.counts.unconfirmed += self.pending.len() as u64;
        self.pending.clear();
    }

    /// Renumbers nodes; candidates of nodes that are gone are dropped.
    pub fn renumber(&mut self, number: &dyn Fn(u32) -> Option<u32>) {
        self.pending.retain_mut(|waiting| match (number(waiting.newer), number(waiting.older)) {
            (Some(newer), Some(older)) => ((waiting.newer, waiting.older) = (newer, older), true).1,
            _ => false,
        });
    }

    /// Counts of searches by how they ended.
    pub fn counts(&self) -> ClosureSearchCounts {
        self.counts
    }

    /// Whether the newest node should be searched for, after `travelled_m` of path.
    pub fn due(&self, travelled_m: f64) -> bool {
        let far = self.last_search_m.is_none_or(|at| travelled_m - at >= self.config.closures.travel_m);
        self.config.closures.enabled && far
    }

    /// Searches for a node among other places; `relative` is the uncertainty of every node as seen from it.
    pub fn search(
        &mut self,
        view: &GraphView<'_>,
        node: u32,
        relative: &[Option<RelativeUncertainty>],
        travelled_m: f64,
    ) -> ClosureSearchResult {
        self.drop_expired(node);
        let mut result = ClosureSearchResult::NoCandidate;
        if !self.sees_enough(&view.nodes[node as usize]) {
            return result;
        }
        // In the smaller window fewer places look alike; the larger one is for long ways.
        for errors in [ErrorModel::Random, ErrorModel::Systematic] {
            let candidates = self.candidates(view, relative, node, errors);
            if !candidates.is_empty() {
                self.last_search_m = Some(travelled_m);
                result = ClosureSearchResult::NotFound;
            }
            for candidate in candidates {
                let known = relative[candidate as usize].map(|known| errors.apply(known));
                if let Some(found) = self.find_consistent(view, known, candidate, node) {
                    let accepted = self.confirm(view.graph, found);
                    return if accepted.is_empty() {
                        ClosureSearchResult::Unconfirmed
                    } else {
                        ClosureSearchResult::Accepted(accepted)
                    };
                }
            }
        }
        result
    }

    /// Searches for a node around one earlier node, of which it is `known` from the way where it is.
    fn find_consistent(
        &mut self,
        view: &GraphView<'_>,
        known: Option<RelativeUncertainty>,
        candidate: u32,
        node: u32,
    ) -> Option<ClosureCandidate> {
        self.counts.searches += 1;
        let window = self.window(view.graph, known, candidate, node);
        let found = self.try_candidate(view, window, candidate, node)?;
        let is_consistent = consistency::is_consistent(view.graph, &found, &self.config.links, known);
        self.counts.contradicted += u64::from(!is_consistent);
        is_consistent.then_some(found)
    }

    /// Drops candidates that waited for confirmation too long.
    fn drop_expired(&mut self, node: u32) {
        let before = self.pending.len();
        self.pending.retain(|f| f.newer.abs_diff(node) <= PENDING_NODES);
        self.counts.unconfirmed += (before - self.pending.len()) as u64;
    }

    /// Nearest nodes of up to [`PASSES_MAX`] earlier passes that may be here, given what is known. Only nodes of the same component count:
    /// an unplaced one may be anywhere.
    fn candidates(
        &self,
        view: &GraphView<'_>,
        relative: &[Option<RelativeUncertainty>],
        node: u32,
        errors: ErrorModel,
    ) -> Vec<u32> {
        let (graph, component) = (view.graph, view.nodes[node as usize].disconnected_component);
        let (c, l) = (&self.config.closures, &self.config.links);
        let here = graph.poses()[node as usize];
        let known = |r: &RelativeUncertainty| {
            r.worst_axis_variance_m2 < l.sigma_max_m.powi(2)
                && r.heading_variance_rad2 < l.sigma_max_rad.powi(2)
        };
        let mut near: Vec<(f64, u32)> = (0..graph.poses().len() as u32)
            .filter(|id| {
                let candidate = &view.nodes[*id as usize];
                id.abs_diff(node) > NODE_GAP_MIN
                    && candidate.disconnected_component == component
                    && self.sees_enough(candidate)
            })
            .filter_map(|id| {
                let relative = relative[id as usize];
                if relative.as_ref().is_some_and(known) || !errors.has_effect(relative) {
                    return None;
                }
                let sigma_m =
                    relative.map_or(f64::INFINITY, |r| errors.apply(r).worst_axis_variance_m2.sqrt());
                let reach = c.radius_m + (c.window_sigmas * sigma_m).min(c.window_max_m);
                let distance = here.distance_m(graph.poses()[id as usize]);
                (distance < reach).then_some((distance, id))
            })
            .collect();
        near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut chosen: Vec<u32> = Vec::new();
        for (_, id) in near {
            if chosen.iter().all(|other| !self.same_pass(graph, *other, id)) {
                chosen.push(id);
            }
            if chosen.len() == PASSES_MAX {
                break;
            }
        }
        chosen
    }

    /// Searches for a node around one earlier node and verifies the best pose.
    fn try_candidate(
        &mut self,
        view: &GraphView<'_>,
        window: SearchWindow,
        candidate: u32,
        node: u32,
    ) -> Option<ClosureCandidate> {
        let query = self.query(view, node);
        let chain = self.chain(view, candidate, &query);
        let peak = self.correlate(&query, &window)?;
        let fit = self.verify(&chain, &query, peak)?;
        let (older_from_newer, information) = (fit.frame_from_cloud, fit.information);
        Some(ClosureCandidate {
            newer: node,
            older: candidate,
            older_from_newer,
            information,
            response: peak.score.clamp(0.0, 1.0),
        })
    }

    /// The pass around the candidate, in the candidate's frame; draws its scans into the field.
    fn chain<'a>(
        &mut self,
        view: &GraphView<'a>,
        candidate: u32,
        query: &[PosedNode<'a>],
    ) -> Vec<PosedNode<'a>> {
        let c = &self.config.closures;
        let (first, last) = view.pass(candidate, c.chain_m / 2.0, c.chain_nodes as u32 / 2);
        let (from, to) = (query[0].0.id, query[query.len() - 1].0.id);
        self.field.clear([0.0; 2]);
        let mut chain = Vec::with_capacity(c.chain_nodes + 1);
        for id in (first..=last).filter(|id| !(from..=to).contains(id)) {
            let (node, older_from_newer) = view.posed_node(candidate, id);
            self.field.insert(&node.cloud, older_from_newer);
            chain.push((node, older_from_newer));
        }
        chain
    }

    /// The pass around `node`, in its frame: the nodes before the newest one, or both sides of an older one.
    fn query<'a>(&self, view: &GraphView<'a>, node: u32) -> Vec<PosedNode<'a>> {
        let c = &self.config.closures;
        let nodes_max = c.query_nodes as u32;
        let (mut first, last) = view.pass(node, c.query_m / 2.0, nodes_max / 2);
        // A new node has nothing after it: what is missing there is taken from before.
        let newest = last + 1 == view.nodes.len() as u32;
        if newest {
            first = view.pass(node, c.query_m, nodes_max).0.max((last + 1).saturating_sub(nodes_max));
        }
        // However dense the nodes, a few more than one scan.
        first = first.min(last.saturating_sub(QUERY_NODES_MIN));
        (first..=last).map(|id| view.posed_node(node, id)).collect()
    }

    /// Search window around the pose that the graph predicts, by its uncertainty.
    fn window(
        &self,
        graph: &Graph,
        relative: Option<RelativeUncertainty>,
        candidate: u32,
        node: u32,
    ) -> SearchWindow {
        let c = &self.config.closures;
        let unknown = RelativeUncertainty {
            worst_axis_variance_m2: UNKNOWN_VARIANCE,
            heading_variance_rad2: UNKNOWN_VARIANCE,
            ..RelativeUncertainty::default()
        };
        let sigmas = relative.unwrap_or(unknown);
        SearchWindow {
            centre: graph.poses()[candidate as usize].between(graph.poses()[node as usize]),
            half_m: (c.window_sigmas * sigmas.worst_axis_variance_m2.sqrt())
                .clamp(WINDOW_MIN_M, c.window_max_m),
            half_rad: (c.window_sigmas * sigmas.heading_variance_rad2.sqrt())
                .clamp(WINDOW_MIN_RAD, c.window_max_rad),
            prediction_weight: 0.0,
        }
    }

    /// The best pose in the window, if it scores enough and no other place scores nearly as well.
    fn correlate(&mut self, query: &[PosedNode<'_>], window: &SearchWindow) -> Option<SearchPeak> {
        let c = &self.config.closures;
        let total: usize = query.iter().map(|(n, _)| n.cloud.points().len()).sum();
        let stride = total.div_ceil(c.query_points_max).max(1);
        let mut points = Vec::with_capacity(c.query_points_max + query.len());
        for (node, query_from_node) in query {
            let transform = crate::point_transform::PointTransform::new(*query_from_node);
            points.extend(node.cloud.points().iter().step_by(stride).map(|p| transform.point(p.at)));
        }
        let limits =
            SearchLimits { score_min: c.response_min, evaluations_max: c.evaluations_max, excluded: None };
        let best = self.field.search(&points, window, &limits, &mut self.scratch);
        let Some(peak) = best.peak.filter(|_| !best.given_up) else {
            self.counts.ambiguous += u64::from(best.given_up);
            self.counts.below_min_response += u64::from(!best.given_up);
            return None;
        };
        let elsewhere = SearchLimits {
            score_min: peak.score * c.ambiguity_ratio_max,
            excluded: Some((peak.pose, SAME_PLACE_M, SAME_PLACE_RAD)),
            ..limits
        };
        let other = self.field.search(&points, window, &elsewhere, &mut self.scratch);
        if other.given_up || other.peak.is_some() {
            self.counts.ambiguous += 1;
            return None;
        }
        Some(peak)
    }

    /// Aligns the query at the peak and compares the scans of both passes.
    fn verify(
        &mut self,
        chain: &[PosedNode<'_>],
        query: &[PosedNode<'_>],
        peak: SearchPeak,
    ) -> Option<ScanAlignment> {
        let c = &self.config.closures;
        let near = nearest_scans(chain, query, peak.pose);
        let references = near.iter().map(|(n, pose)| Reference { cloud: &n.cloud, frame_from_cloud: *pose });
        let merged = Cloud::merged(
            query.iter().map(|(n, pose)| (&*n.cloud, *pose)),
            QUERY_SCANS * self.config.lidar.points_max,
        );
        let fit = align(&merged, peak.pose, references, None, &self.config.alignment);
        let shifted = fit.frame_from_cloud.distance_m(peak.pose) > ALIGNMENT_SHIFT_MAX_M;
        let agreement = compare_passes(near.iter().copied(), query, fit.frame_from_cloud);
        let sound = agreement.is_sound(c.agreement_min);
        if shifted || fit.overlap < c.overlap_min || !sound {
            self.counts.contradicted += 1;
            return None;
        }
        Some(fit)
    }

    /// Returns this candidate and those that agree with it if they are enough; otherwise this one waits.
    fn confirm(&mut self, graph: &Graph, found: ClosureCandidate) -> Vec<ClosureCandidate> {
        let c = &self.config.closures;
        let agrees = |other: &ClosureCandidate| {
            let poses = graph.poses();
            let between_candidates = poses[found.older as usize].between(poses[other.older as usize]);
            let between_nodes = poses[other.newer as usize].between(poses[found.newer as usize]);
            let implied = between_candidates * other.older_from_newer * between_nodes;
            let turned = wrap_angle(implied.yaw_rad - found.older_from_newer.yaw_rad).abs();
            implied.distance_m(found.older_from_newer) < c.agree_m && turned < c.agree_rad
        };
        let mut together: Vec<ClosureCandidate> =
            self.pending.iter().filter(|f| agrees(f)).copied().collect();
        together.push(found);
        if together.len() < c.confirmations_min {
            if self.pending.len() == PENDING_MAX {
                self.pending.pop_front();
            }
            self.pending.push_back(found);
            return Vec::new();
        }
        self.pending.retain(|f| together.iter().all(|t| t.newer != f.newer || t.older != f.older));
        self.counts.accepted += together.len() as u64;
        together
    }
}
