//! Places seen before: which to try, how to look for them, and what a find must stand up to.
//!
//! A find is believed when (1) its response is high, (2) no other place in the window comes near
//! it, (3) the scans of both passes do not contradict each other (no surface where the other saw
//! through), and (4) finds from different places on the way agree with each other (pairwise
//! consistency, Olson 2009, "Recognizing places using spectrally clustered local matches").

use crate::align::{Alignment, Reference, align};
use crate::cloud::Cloud;
use crate::config::SlamConfig;
use crate::field::{Field, Limits, Peak, Scratch, Window};
use crate::graph::{Graph, Relative};
use crate::node::Node;
use msg::{Pose2, pose::wrap_angle};
use nalgebra::Matrix3;
use std::collections::VecDeque;

/// Finds that wait for a witness.
const PENDING_MAX: usize = 64;
/// A find waits for witnesses over so many nodes.
const PENDING_NODES: u32 = 40;
/// Half side of the field searched in, metres.
const REACH_M: f32 = 20.0;
/// References and query nodes that take part in alignment and contradiction tests.
const JUDGES: usize = 6;
/// Candidate passes tried in one search.
const TRIES: usize = 2;
/// Nodes must be this far apart in the graph's order to be a place seen before.
const AGO_NODES: u32 = 12;

/// A node found from a later one.
#[derive(Clone, Copy, Debug)]
pub struct Find {
    /// The later node.
    pub node: u32,
    /// The place seen before.
    pub candidate: u32,
    /// The later node as seen from it.
    pub candidate_from_node: Pose2,
    /// Inverse covariance in the candidate's frame.
    pub information: Matrix3<f64>,
}

/// How searches ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SearchCounts {
    /// Searches made.
    pub searches: u64,
    /// Without a pose that scores enough.
    pub no_response: u64,
    /// Two places looked alike, or the search was given up.
    pub ambiguous: u64,
    /// Too little found a surface, or too much was contradicted.
    pub contradicted: u64,
    /// Finds that waited for a witness in vain.
    pub unconfirmed: u64,
    /// Finds believed.
    pub believed: u64,
}

/// See the module.
pub struct Detector {
    config: SlamConfig,
    field: Field,
    scratch: Scratch,
    pending: VecDeque<Find>,
    counts: SearchCounts,
    last_search: Option<(u32, f64)>,
}

impl Detector {
    /// Nothing found yet.
    pub fn new(config: SlamConfig) -> Self {
        let t = &config.tracking;
        Self {
            field: Field::new(t.cell_m, REACH_M, t.blur_m),
            scratch: Scratch::default(),
            pending: VecDeque::with_capacity(PENDING_MAX),
            counts: SearchCounts::default(),
            last_search: None,
            config,
        }
    }

    /// How searches ended.
    pub fn counts(&self) -> SearchCounts {
        self.counts
    }

    /// Looks for the newest node among places seen before. `travelled_m` counts the way driven;
    /// `relative` says how well every node is known as seen from the newest one.
    /// Returns the finds that are believed now.
    pub fn search(
        &mut self,
        nodes: &[Node],
        graph: &Graph,
        relative: &[Option<Relative>],
        travelled_m: f64,
    ) -> Vec<Find> {
        let newest = nodes.len() as u32 - 1;
        let due = self.last_search.is_none_or(|(_, at)| travelled_m - at >= self.config.closures.travel_m);
        if !self.config.closures.enabled || !due {
            return Vec::new();
        }
        self.forget_old(newest);
        let mut believed = Vec::new();
        for candidate in self.candidates(graph, relative, newest) {
            self.last_search = Some((newest, travelled_m));
            self.counts.searches += 1;
            if let Some(find) = self.try_candidate(nodes, graph, relative, candidate) {
                believed = self.witnesses(graph, find);
                if !believed.is_empty() {
                    break;
                }
            }
        }
        believed
    }

    fn forget_old(&mut self, newest: u32) {
        while self.pending.front().is_some_and(|f| f.node + PENDING_NODES < newest) {
            self.pending.pop_front();
            self.counts.unconfirmed += 1;
        }
    }

    /// Nearest nodes of up to [`TRIES`] earlier passes that may be here, given what is known.
    fn candidates(&self, graph: &Graph, relative: &[Option<Relative>], newest: u32) -> Vec<u32> {
        let (c, l) = (&self.config.closures, &self.config.links);
        let here = graph.poses()[newest as usize];
        let known = |r: &Relative| r.position < l.sigma_max_m.powi(2) && r.heading < l.sigma_max_rad.powi(2);
        let mut near: Vec<(f64, u32)> = (0..newest.saturating_sub(AGO_NODES))
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
            if chosen.iter().all(|other| other.abs_diff(id) > c.chain_nodes as u32) {
                chosen.push(id);
            }
            if chosen.len() == TRIES {
                break;
            }
        }
        chosen
    }

    fn try_candidate(
        &mut self,
        nodes: &[Node],
        graph: &Graph,
        relative: &[Option<Relative>],
        candidate: u32,
    ) -> Option<Find> {
        let newest = nodes.len() as u32 - 1;
        let chain = self.chain(nodes, graph, candidate);
        let query = self.query(nodes, graph);
        let peak = self.correlate(&chain, &query, graph, relative[candidate as usize], candidate, newest)?;
        let fit = self.settle(&chain, &query, peak)?;
        Some(Find {
            node: newest,
            candidate,
            candidate_from_node: fit.frame_from_cloud,
            information: fit.information,
        })
    }

    /// The pass around the candidate, as seen from it.
    fn chain<'a>(&mut self, nodes: &'a [Node], graph: &Graph, candidate: u32) -> Vec<(&'a Node, Pose2)> {
        let half = self.config.closures.chain_nodes as u32 / 2;
        let last = (candidate + half).min(nodes.len() as u32 - 1 - self.config.closures.query_nodes as u32);
        let middle = graph.poses()[candidate as usize];
        self.field.clear([0.0; 2]);
        let mut chain = Vec::with_capacity(2 * half as usize + 1);
        for id in candidate.saturating_sub(half)..=last {
            let candidate_from_node = middle.between(graph.poses()[id as usize]);
            self.field.insert(&nodes[id as usize].cloud, candidate_from_node);
            chain.push((&nodes[id as usize], candidate_from_node));
        }
        chain
    }

    /// The newest nodes, as seen from the newest.
    fn query<'a>(&self, nodes: &'a [Node], graph: &Graph) -> Vec<(&'a Node, Pose2)> {
        let first = nodes.len().saturating_sub(self.config.closures.query_nodes);
        let newest = graph.poses()[nodes.len() - 1];
        let seen = |n: &'a Node| (n, newest.between(graph.poses()[n.id as usize]));
        nodes[first..].iter().map(seen).collect()
    }

    fn correlate(
        &mut self,
        _chain: &[(&Node, Pose2)],
        query: &[(&Node, Pose2)],
        graph: &Graph,
        relative: Option<Relative>,
        candidate: u32,
        newest: u32,
    ) -> Option<Peak> {
        let c = &self.config.closures;
        let total: usize = query.iter().map(|(n, _)| n.cloud.points().len()).sum();
        let stride = total.div_ceil(c.query_points_max).max(1);
        let mut points = Vec::with_capacity(c.query_points_max + 8);
        for (node, newest_from_node) in query {
            let place = crate::cloud::Placement::new(*newest_from_node);
            points.extend(node.cloud.points().iter().step_by(stride).map(|p| place.point(p.at)));
        }
        let sigmas = relative.unwrap_or(Relative { position: 1e6, heading: 1e6 });
        let window = Window {
            centre: graph.poses()[candidate as usize].between(graph.poses()[newest as usize]),
            half_m: (c.window_sigmas * sigmas.position.sqrt()).clamp(0.5, c.window_max_m),
            half_rad: (c.window_sigmas * sigmas.heading.sqrt()).clamp(0.1, c.window_max_rad),
            pull: 0.0,
        };
        let limits = Limits { score_min: c.response_min, evaluations_max: c.evaluations_max, except: None };
        let Some(peak) = self.field.search(&points, &window, &limits, &mut self.scratch) else {
            self.counts.no_response += 1;
            if std::env::var_os("SLAM_DEBUG2").is_some() {
                eprintln!("D q {newest} c {candidate} no response, window {:.2} {:.3}", window.half_m, window.half_rad);
            }
            return None;
        };
        let rival =
            Limits { score_min: peak.score * c.rival_max, except: Some((peak.pose, 0.6, 0.2)), ..limits };
        let other = self.field.search(&points, &window, &rival, &mut self.scratch);
        if std::env::var_os("SLAM_DEBUG2").is_some() {
            eprintln!("D q {newest} c {candidate} peak {:.3} at {:.2} {:.2} {:.3} rival {:?} window {:.2} {:.3} dist {:.2} {}", peak.score, peak.pose.x_m, peak.pose.y_m, peak.pose.yaw_rad, other.map(|o| o.score), window.half_m, window.half_rad, window.centre.distance_m(peak.pose), if peak.given_up {"GIVEN UP"} else {""});
        }
        if peak.given_up || other.is_some() {
            self.counts.ambiguous += 1;
            return None;
        }
        Some(peak)
    }

    /// Aligns the newest scan at the peak and asks the scans of both passes whether they agree.
    fn settle(
        &mut self,
        chain: &[(&Node, Pose2)],
        query: &[(&Node, Pose2)],
        peak: Peak,
    ) -> Option<Alignment> {
        let c = &self.config.closures;
        let mut near: Vec<&(&Node, Pose2)> = chain.iter().collect();
        let away = |p: &Pose2| p.distance_m(peak.pose) + wrap_angle(p.yaw_rad - peak.pose.yaw_rad).abs();
        near.sort_by(|a, b| away(&a.1).total_cmp(&away(&b.1)).then(a.0.id.cmp(&b.0.id)));
        near.truncate(JUDGES);
        let references: Vec<Reference<'_>> =
            near.iter().map(|(n, pose)| Reference { cloud: &n.cloud, frame_from_cloud: *pose }).collect();
        let merged =
            Cloud::merged(query.iter().map(|(n, pose)| (&*n.cloud, *pose)), 4 * self.config.lidar.points_max);
        let fit = align(&merged, peak.pose, &references, None, &self.config.links);
        if std::env::var_os("SLAM_DEBUG2").is_some() {
            let (agree, contradict) = judge(near.iter().copied(), query, fit.frame_from_cloud);
            eprintln!(
                "D q {} c {} resp {:.3} overlap {:.3} agree {} contra {} ratio {:.3} rms {:.3} moved {:.2} pose {:.2} {:.2} {:.3}",
                query.last().unwrap().0.id, chain[chain.len()/2].0.id, peak.score, fit.overlap, agree, contradict,
                agree as f32 / (agree + contradict).max(1) as f32, fit.rms_m,
                fit.frame_from_cloud.distance_m(peak.pose), fit.frame_from_cloud.x_m, fit.frame_from_cloud.y_m, fit.frame_from_cloud.yaw_rad
            );
        }
        let strayed = fit.frame_from_cloud.distance_m(peak.pose) > 0.5;
        let (agree, contradict) = judge(near.iter().copied(), query, fit.frame_from_cloud);
        let sound = agree as f32 >= c.agreement_min * (agree + contradict) as f32;
        if strayed || fit.overlap < c.overlap_min || !sound {
            self.counts.contradicted += 1;
            return None;
        }
        Some(fit)
    }

    /// Finds that agree with this one, and this one, if they are enough; else it waits.
    fn witnesses(&mut self, graph: &Graph, find: Find) -> Vec<Find> {
        let c = &self.config.closures;
        let agrees = |other: &Find| {
            let poses = graph.poses();
            let to = poses[find.candidate as usize].between(poses[other.candidate as usize]);
            let back = poses[other.node as usize].between(poses[find.node as usize]);
            let implied = to * other.candidate_from_node * back;
            let turned = wrap_angle(implied.yaw_rad - find.candidate_from_node.yaw_rad).abs();
            implied.distance_m(find.candidate_from_node) < c.agree_m && turned < c.agree_rad
        };
        let mut together: Vec<Find> = self.pending.iter().filter(|f| agrees(f)).copied().collect();
        together.push(find);
        if together.len() < c.witnesses {
            if self.pending.len() == PENDING_MAX {
                self.pending.pop_front();
            }
            self.pending.push_back(find);
            return Vec::new();
        }
        self.pending.retain(|f| together.iter().all(|t| t.node != f.node || t.candidate != f.candidate));
        self.counts.believed += together.len() as u64;
        together
    }
}

/// Points of each pass against the other's: (on a surface, where the other saw through).
fn judge<'a>(
    chain: impl Iterator<Item = &'a (&'a Node, Pose2)>,
    query: &[(&Node, Pose2)],
    chain_from_query: Pose2,
) -> (usize, usize) {
    let (mut agree, mut contradict) = (0, 0);
    for (old, chain_from_old) in chain {
        for (new, query_from_new) in query.iter().rev().take(JUDGES) {
            let old_from_new = chain_from_old.inverse() * chain_from_query * *query_from_new;
            for (a, c) in [
                old.cloud.judge(&new.cloud, old_from_new, 0.15, 0.4),
                new.cloud.judge(&old.cloud, old_from_new.inverse(), 0.15, 0.4),
            ] {
                agree += a;
                contradict += c;
            }
        }
    }
    (agree, contradict)
}
