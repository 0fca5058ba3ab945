//! Loop-closure detection: which places seen before are tried, how they are searched for, and what a
//! candidate must pass.
//!
//! A candidate is accepted when (1) its response is high, (2) no other place in the window comes near
//! it, (3) the scans of both passes do not contradict each other (no surface where the other saw
//! through), and (4) candidates from different places on the path agree with each other (pairwise
//! consistency, Olson 2009, "Recognizing places using spectrally clustered local matches").

use crate::align::{Alignment, Reference, align};
use crate::cloud::{Agreement, Cloud};
use crate::config::SlamConfig;
use crate::graph::{Graph, RelativeUncertainty};
use crate::likelihood_field::{LikelihoodField, SearchBuffers, SearchLimits, SearchPeak, SearchWindow};
use crate::node::Node;
use msg::{Pose2, pose::wrap_angle};
use nalgebra::Matrix3;
use std::collections::VecDeque;

/// Candidates that wait for confirmation; beyond them the oldest is dropped.
const PENDING_MAX: usize = 64;
/// A candidate waits for confirmation over this many nodes: about 12 m.
const PENDING_NODES: u32 = 40;
/// Half side of the field that is searched, metres: the chain of nodes around a candidate and its view.
const REACH_M: f32 = 20.0;
/// Scans of each pass that are aligned and compared: the nearest ones; more add time and no certainty.
pub(crate) const COMPARED_SCANS: usize = 6;
/// Least number of nodes before the newest that are searched for with it.
const QUERY_NODES_MIN: u32 = 5;
/// Passes tried in one search: a second one where two lie near by.
const TRIES: usize = 2;
/// Nodes nearer to each other in order than this are linked, not searched for.
const AGO_NODES: u32 = 12;

/// A place seen before that a later node was found at.
#[derive(Clone, Copy, Debug)]
pub struct ClosureCandidate {
    /// The later node.
    pub node: u32,
    /// The earlier node.
    pub candidate: u32,
    /// Pose of the later node in the frame of the earlier one, as measured.
    pub candidate_from_node: Pose2,
    /// Inverse covariance in the frame of the earlier node, 1/m² and 1/rad².
    pub information: Matrix3<f64>,
    /// Mean field value under the later node's points, 0 to 1.
    pub response: f32,
}

/// State of a detector, kept in a session.
#[derive(Clone, Debug, Default)]
pub struct ClosureDetectorState {
    /// Candidates that wait for confirmation.
    pub pending: Vec<ClosureCandidate>,
    /// How searches ended.
    pub counts: ClosureSearchCounts,
    /// Length of the path at the last search, metres.
    pub last_search_m: Option<f64>,
}

/// Counts of closure searches by how they ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct ClosureSearchCounts {
    /// Searches made.
    pub searches: u64,
    /// Without a pose that scores enough.
    pub no_response: u64,
    /// Two places looked alike, or the search was given up.
    pub ambiguous: u64,
    /// Too little found a surface, or too much was contradicted.
    pub contradicted: u64,
    /// Candidates that were never confirmed.
    pub unconfirmed: u64,
    /// Candidates accepted.
    pub accepted: u64,
}

/// A node and its pose in some other node's frame.
pub(crate) type Placed<'a> = (&'a Node, Pose2);

/// The nodes and poses that a search reads.
pub struct GraphView<'a> {
    /// All nodes, by id.
    pub nodes: &'a [Node],
    /// Their poses.
    pub graph: &'a Graph,
}

impl<'a> GraphView<'a> {
    fn placed(&self, from: u32, id: u32) -> Placed<'a> {
        let poses = self.graph.poses();
        (&self.nodes[id as usize], poses[from as usize].between(poses[id as usize]))
    }

    /// Nodes before and after `middle` in its component, each side up to `half_m` of path and `half_nodes`:
    /// first and last.
    fn pass(&self, middle: u32, half_m: f64, half_nodes: u32) -> (u32, u32) {
        let poses = self.graph.poses();
        let reach = |step: i64| {
            let (mut id, mut way) = (i64::from(middle), 0.0);
            while (id - i64::from(middle)).unsigned_abs() < u64::from(half_nodes) {
                let Some(next) = poses.get((id + step) as usize) else { break };
                if self.nodes[(id + step) as usize].disconnected != self.nodes[middle as usize].disconnected {
                    break;
                }
                way += poses[id as usize].distance_m(*next);
                if way > half_m {
                    break;
                }
                id += step;
            }
            id as u32
        };
        (reach(-1), reach(1))
    }
}

/// Result of a closure search.
pub enum ClosureSearch {
    /// No place seen before can be here, or it is known already.
    NoCandidate,
    /// Searched for in vain.
    NotFound,
    /// Found, but not confirmed by another search yet.
    Unconfirmed,
    /// Found and confirmed: this candidate and those that agree with it.
    Accepted(Vec<ClosureCandidate>),
}

/// Searches for places seen before; see the module.
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

    /// Drops unconfirmed candidates: the next node does not follow from the ones before.
    pub fn tear(&mut self) {
        self.counts.unconfirmed += self.pending.len() as u64;
        self.pending.clear();
    }

    /// Renumbers nodes; candidates of nodes that are gone are dropped.
    pub fn renumber(&mut self, number: &dyn Fn(u32) -> Option<u32>) {
        self.pending.retain_mut(|find| match (number(find.node), number(find.candidate)) {
            (Some(node), Some(candidate)) => ((find.node, find.candidate) = (node, candidate), true).1,
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

    /// Searches for a node among other places; `relative` is the uncertainty of every node as seen
    /// from it.
    pub fn search(
        &mut self,
        view: &GraphView<'_>,
        node: u32,
        relative: &[Option<RelativeUncertainty>],
        travelled_m: f64,
    ) -> ClosureSearch {
        self.forget_old(node);
        let candidates = self.candidates(view, relative, node);
        if candidates.is_empty() {
            return ClosureSearch::NoCandidate;
        }
        self.last_search_m = Some(travelled_m);
        for candidate in candidates {
            self.counts.searches += 1;
            let window = self.window(view.graph, relative[candidate as usize], candidate, node);
            if let Some(find) = self.try_candidate(view, window, candidate, node) {
                let accepted = self.confirm(view.graph, find);
                return if accepted.is_empty() {
                    ClosureSearch::Unconfirmed
                } else {
                    ClosureSearch::Accepted(accepted)
                };
            }
        }
        ClosureSearch::NotFound
    }

    fn forget_old(&mut self, node: u32) {
        let before = self.pending.len();
        self.pending.retain(|f| f.node.abs_diff(node) <= PENDING_NODES);
        self.counts.unconfirmed += (before - self.pending.len()) as u64;
    }

    /// Nearest nodes of up to [`TRIES`] earlier passes that may be here, given what is known.
    /// Only nodes of the same component count: a disconnected one may be anywhere.
    fn candidates(
        &self,
        view: &GraphView<'_>,
        relative: &[Option<RelativeUncertainty>],
        node: u32,
    ) -> Vec<u32> {
        let (graph, piece) = (view.graph, view.nodes[node as usize].disconnected);
        let (c, l) = (&self.config.closures, &self.config.links);
        let here = graph.poses()[node as usize];
        let known = |r: &RelativeUncertainty| {
            r.position < l.sigma_max_m.powi(2) && r.heading < l.sigma_max_rad.powi(2)
        };
        let mut near: Vec<(f64, u32)> = (0..graph.poses().len() as u32)
            .filter(|id| id.abs_diff(node) > AGO_NODES && view.nodes[*id as usize].disconnected == piece)
            .filter_map(|id| {
                if relative[id as usize].as_ref().is_some_and(known) {
                    return None;
                }
                let sigma = relative[id as usize].map_or(f64::INFINITY, |r| r.position.sqrt());
                let reach = c.radius_m + (c.window_sigmas * sigma).min(c.window_max_m);
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
            if chosen.len() == TRIES {
                break;
            }
        }
        chosen
    }

    /// Whether the pass around one node covers the other one.
    fn same_pass(&self, graph: &Graph, a: u32, b: u32) -> bool {
        let c = &self.config.closures;
        let poses = &graph.poses()[a.min(b) as usize..=a.max(b) as usize];
        let way: f64 = poses.windows(2).map(|p| p[0].distance_m(p[1])).sum();
        way < c.chain_m && poses.len() <= c.chain_nodes
    }

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
        let (candidate_from_node, information) = (fit.frame_from_cloud, fit.information);
        Some(ClosureCandidate {
            node,
            candidate,
            candidate_from_node,
            information,
            response: peak.score.clamp(0.0, 1.0),
        })
    }

    /// The pass around the candidate, as seen from it.
    fn chain<'a>(&mut self, view: &GraphView<'a>, candidate: u32, query: &[Placed<'a>]) -> Vec<Placed<'a>> {
        let c = &self.config.closures;
        let (first, last) = view.pass(candidate, c.chain_m / 2.0, c.chain_nodes as u32 / 2);
        let (from, to) = (query[0].0.id, query[query.len() - 1].0.id);
        self.field.clear([0.0; 2]);
        let mut chain = Vec::with_capacity(c.chain_nodes + 1);
        for id in (first..=last).filter(|id| !(from..=to).contains(id)) {
            let (node, candidate_from_node) = view.placed(candidate, id);
            self.field.insert(&node.cloud, candidate_from_node);
            chain.push((node, candidate_from_node));
        }
        chain
    }

    /// The nodes around `node`, as seen from it: those before it, or both sides of an older one.
    fn query<'a>(&self, view: &GraphView<'a>, node: u32) -> Vec<Placed<'a>> {
        let c = &self.config.closures;
        let most = c.query_nodes as u32;
        let (mut first, last) = view.pass(node, c.query_m / 2.0, most / 2);
        // A new node has nothing after it: what is missing there is taken from before.
        let newest = last + 1 == view.nodes.len() as u32;
        if newest {
            first = view.pass(node, c.query_m, most).0.max((last + 1).saturating_sub(most));
        }
        // However dense the nodes, a few more than one scan.
        first = first.min(last.saturating_sub(QUERY_NODES_MIN));
        (first..=last).map(|id| view.placed(node, id)).collect()
    }

    fn window(
        &self,
        graph: &Graph,
        relative: Option<RelativeUncertainty>,
        candidate: u32,
        node: u32,
    ) -> SearchWindow {
        let c = &self.config.closures;
        let sigmas = relative.unwrap_or(RelativeUncertainty { position: 1e6, heading: 1e6 });
        SearchWindow {
            centre: graph.poses()[candidate as usize].between(graph.poses()[node as usize]),
            half_m: (c.window_sigmas * sigmas.position.sqrt()).clamp(0.5, c.window_max_m),
            half_rad: (c.window_sigmas * sigmas.heading.sqrt()).clamp(0.1, c.window_max_rad),
            pull: 0.0,
        }
    }

    fn correlate(&mut self, query: &[Placed<'_>], window: &SearchWindow) -> Option<SearchPeak> {
        let c = &self.config.closures;
        let total: usize = query.iter().map(|(n, _)| n.cloud.points().len()).sum();
        let stride = total.div_ceil(c.query_points_max).max(1);
        let mut points = Vec::with_capacity(c.query_points_max + query.len());
        for (node, query_from_node) in query {
            let place = crate::cloud::PointTransform::new(*query_from_node);
            points.extend(node.cloud.points().iter().step_by(stride).map(|p| place.point(p.at)));
        }
        let limits =
            SearchLimits { score_min: c.response_min, evaluations_max: c.evaluations_max, except: None };
        let Some(peak) = self.field.search(&points, window, &limits, &mut self.scratch) else {
            self.counts.no_response += 1;
            return None;
        };
        let rival = SearchLimits {
            score_min: peak.score * c.rival_max,
            except: Some((peak.pose, 0.6, 0.2)),
            ..limits
        };
        let other = self.field.search(&points, window, &rival, &mut self.scratch);
        if peak.given_up || other.is_some() {
            self.counts.ambiguous += 1;
            return None;
        }
        Some(peak)
    }

    /// Aligns the newest scan at the peak and asks the scans of both passes whether they agree.
    fn verify(&mut self, chain: &[Placed<'_>], query: &[Placed<'_>], peak: SearchPeak) -> Option<Alignment> {
        let c = &self.config.closures;
        let mut near: Vec<&Placed<'_>> = chain.iter().collect();
        let away = |p: &Pose2| p.distance_m(peak.pose) + wrap_angle(p.yaw_rad - peak.pose.yaw_rad).abs();
        near.sort_by(|a, b| away(&a.1).total_cmp(&away(&b.1)).then(a.0.id.cmp(&b.0.id)));
        near.truncate(COMPARED_SCANS);
        let references = near.iter().map(|(n, pose)| Reference { cloud: &n.cloud, frame_from_cloud: *pose });
        let merged =
            Cloud::merged(query.iter().map(|(n, pose)| (&*n.cloud, *pose)), 4 * self.config.lidar.points_max);
        let fit = align(&merged, peak.pose, references, None, &self.config.links);
        let strayed = fit.frame_from_cloud.distance_m(peak.pose) > 0.5;
        let agreement = compare_passes(near.iter().copied(), query, fit.frame_from_cloud);
        let sound = agreement.is_sound(c.agreement_min);
        if strayed || fit.overlap < c.overlap_min || !sound {
            self.counts.contradicted += 1;
            return None;
        }
        Some(fit)
    }

    /// The candidates that agree with this one, and this one, if they are enough; else it waits.
    fn confirm(&mut self, graph: &Graph, find: ClosureCandidate) -> Vec<ClosureCandidate> {
        let c = &self.config.closures;
        let agrees = |other: &ClosureCandidate| {
            let poses = graph.poses();
            let to = poses[find.candidate as usize].between(poses[other.candidate as usize]);
            let back = poses[other.node as usize].between(poses[find.node as usize]);
            let implied = to * other.candidate_from_node * back;
            let turned = wrap_angle(implied.yaw_rad - find.candidate_from_node.yaw_rad).abs();
            implied.distance_m(find.candidate_from_node) < c.agree_m && turned < c.agree_rad
        };
        let mut together: Vec<ClosureCandidate> =
            self.pending.iter().filter(|f| agrees(f)).copied().collect();
        together.push(find);
        if together.len() < c.witnesses {
            if self.pending.len() == PENDING_MAX {
                self.pending.pop_front();
            }
            self.pending.push_back(find);
            return Vec::new();
        }
        self.pending.retain(|f| together.iter().all(|t| t.node != f.node || t.candidate != f.candidate));
        self.counts.accepted += together.len() as u64;
        together
    }
}

/// Compares the scans of two passes over the same place, the newest few of the query with each of the chain.
pub(crate) fn compare_passes<'a>(
    chain: impl Iterator<Item = &'a Placed<'a>>,
    query: &[Placed<'_>],
    chain_from_query: Pose2,
) -> Agreement {
    let mut agreement = Agreement::default();
    for (old, chain_from_old) in chain {
        for (new, query_from_new) in query.iter().rev().take(COMPARED_SCANS) {
            let old_from_new = chain_from_old.inverse() * chain_from_query * *query_from_new;
            agreement += Agreement::both_ways(&old.cloud, &new.cloud, old_from_new);
        }
    }
    agreement
}
