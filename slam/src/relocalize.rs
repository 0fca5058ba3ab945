//! Relocalization: searches a whole map for a robot whose position and heading are not known.
//!
//! All poses that score nearly as well as the best one (`whole_map`) are aligned and compared with the
//! scans taken there. One must remain, and a second search from elsewhere must find the same.

mod whole_map;

use crate::align::{Reference, align};
use crate::closure::{COMPARED_SCANS, compare_passes};
use crate::cloud::Cloud;
use crate::config::SlamConfig;
use crate::node::Node;
use msg::{Pose2, pose::wrap_angle};
use std::collections::VecDeque;
use whole_map::{Bounds, WholeMap};

/// Points of the query: the cost of a search is proportional to them.
const POINTS_MAX: usize = 300;
/// Nodes kept while the robot is not located; beyond them the oldest is dropped.
const WAITING_MAX: usize = 128;
/// Poses nearer to each other than this are one place, metres and radians.
const SAME_M: f64 = 0.6;
const SAME_RAD: f64 = 0.2;
/// After this many searches in vain the path between two of them doubles,
const SEARCHES_OFTEN: f64 = 12.0;
/// but grows no more than to this multiple.
const RARELY_MAX: f64 = 2.0;
/// Searches whose outcome is remembered.
const PENDING_MAX: usize = 16;

/// An estimate of where the front end's frame lies in the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseEstimate {
    /// The map from the scan path's frame.
    pub map_from_local: Pose2,
    /// One standard deviation of the robot's position, metres.
    pub sigma_m: f64,
    /// And of its heading, radians.
    pub sigma_rad: f64,
}

/// Counts of relocalization searches by how they ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct RelocalizationCounts {
    /// Searches made.
    pub searches: u64,
    /// No place scores enough.
    pub no_response: u64,
    /// Every place that scores was contradicted.
    pub contradicted: u64,
    /// More than one place remained, or the search was given up.
    pub ambiguous: u64,
    /// One place remained.
    pub found: u64,
    /// Times that the robot was accepted as located.
    pub accepted: u64,
    /// Nodes dropped while nothing was found.
    pub dropped: u64,
}

/// Nodes and where they lie.
#[derive(Clone, Copy)]
pub struct Placed<'a> {
    /// The nodes,
    pub nodes: &'a [Node],
    /// and the map from each.
    pub poses: &'a [Pose2],
}

/// Searches a map for a robot, node by node; see the module.
pub struct Relocalizer {
    config: SlamConfig,
    whole: WholeMap,
    hint: Option<PoseEstimate>,
    /// The newest nodes since the search began.
    waiting: VecDeque<Node>,
    nodes: usize,
    way_m: f64,
    searched_m: Option<f64>,
    searched: u32,
    /// Earlier results: the map from the front end's frame, and the path length at that search, metres.
    pending: VecDeque<(Pose2, f64)>,
    counts: RelocalizationCounts,
}

/// What relocalization knows after a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RelocalizationOutcome {
    /// Not found yet.
    NotFound,
    /// The map from the scan path's frame.
    Found(Pose2),
    /// Not found near the estimate, which is accepted as it is.
    HintAccepted(PoseEstimate),
}

impl Relocalizer {
    /// Of a robot in this map; the map must stay the same while it is looked for.
    pub fn new(
        config: SlamConfig,
        map: Placed<'_>,
        hint: Option<PoseEstimate>,
        counts: RelocalizationCounts,
    ) -> Self {
        Self {
            whole: WholeMap::new(&config, map),
            hint,
            waiting: VecDeque::with_capacity(WAITING_MAX),
            nodes: 0,
            way_m: 0.0,
            searched_m: None,
            searched: 0,
            pending: VecDeque::with_capacity(PENDING_MAX),
            counts,
            config,
        }
    }

    /// Where it is said to be.
    pub fn hint(&self) -> Option<PoseEstimate> {
        self.hint
    }

    /// How searches ended.
    pub fn counts(&self) -> RelocalizationCounts {
        self.counts
    }

    /// The nodes since the search began, oldest first; it has them no more.
    pub fn take_waiting(&mut self) -> VecDeque<Node> {
        core::mem::take(&mut self.waiting)
    }

    /// Adds a node, and searches if it is time.
    pub fn add_node(&mut self, node: Node, map: Placed<'_>) -> RelocalizationOutcome {
        let moved = self
            .waiting
            .back()
            .map_or(Pose2::IDENTITY, |last| last.local_from_base.between(node.local_from_base));
        self.way_m += moved.x_m.hypot(moved.y_m) + moved.yaw_rad.abs();
        if !node.fits {
            // What was seen before is tied to what is seen now by odometry alone,
            self.pending.clear();
        }
        if node.odometry_break {
            // or not even by that.
            self.counts.dropped += self.waiting.len() as u64;
            self.waiting.clear();
        }
        self.nodes += 1;
        if self.waiting.len() == WAITING_MAX {
            self.waiting.pop_front();
            self.counts.dropped += 1;
        }
        self.waiting.push_back(node);
        let r = &self.config.relocalize;
        // The longer the robot is not found, the rarer the searches.
        let rarely = 1.0 + (self.searched as f64 / SEARCHES_OFTEN).min(RARELY_MAX - 1.0).floor();
        if self.searched_m.is_none_or(|at| self.way_m - at >= rarely * r.travel_m) {
            self.searched += 1;
            self.searched_m = Some(self.way_m);
            if let Some(map_from_local) = self.search(map)
                && self.is_confirmed(map_from_local)
            {
                self.counts.accepted += 1;
                return RelocalizationOutcome::Found(map_from_local);
            }
        }
        match self.hint {
            Some(hint) if self.nodes >= self.config.relocalize.hint_nodes => {
                RelocalizationOutcome::HintAccepted(hint)
            }
            _ => RelocalizationOutcome::NotFound,
        }
    }

    /// One search with the newest nodes. The map from the scan path's frame, if one place remains.
    fn search(&mut self, map: Placed<'_>) -> Option<Pose2> {
        let query = self.query()?;
        let newest = self.waiting.back()?;
        self.counts.searches += 1;
        let merged =
            Cloud::merged(query.iter().map(|(n, pose)| (&*n.cloud, *pose)), 4 * self.config.lidar.points_max);
        let stride = merged.points().len().div_ceil(POINTS_MAX).max(1);
        let points: Vec<[f32; 2]> = merged.points().iter().step_by(stride).map(|p| p.at).collect();
        let bounds = self.hint.map(|hint| Bounds {
            centre: hint.map_from_local * newest.local_from_base,
            half_m: 3.0 * hint.sigma_m,
            half_rad: 3.0 * hint.sigma_rad,
        });
        let (places, given_up) = self.whole.search(&points, bounds, &self.config.relocalize);
        if places.is_empty() {
            self.counts.no_response += 1;
            return None;
        }
        let mut remaining: Vec<Pose2> = Vec::new();
        for place in places {
            if let Some(pose) = self.verify(map, &merged, &query, place)
                && remaining.iter().all(|other| !same(*other, pose))
            {
                remaining.push(pose);
            }
        }
        match remaining[..] {
            [] => self.counts.contradicted += 1,
            [map_from_newest] if !given_up => {
                self.counts.found += 1;
                return Some(map_from_newest * newest.local_from_base.inverse());
            }
            _ => self.counts.ambiguous += 1,
        }
        None
    }

    /// The newest nodes as seen from the newest, as a closure's query; none if they see too little.
    fn query(&self) -> Option<Vec<(Node, Pose2)>> {
        let c = &self.config.closures;
        let newest = self.waiting.back()?;
        let mut way = 0.0;
        let mut query: Vec<(Node, Pose2)> = Vec::new();
        for node in self.waiting.iter().rev().take(c.query_nodes) {
            let pose = newest.local_from_base.between(node.local_from_base);
            way += query.last().map_or(0.0, |(_, last)| last.distance_m(pose));
            if way > c.query_m {
                break;
            }
            query.push((node.clone(), pose));
            if !node.fits {
                break;
            }
        }
        query.reverse();
        let points: usize = query.iter().map(|(n, _)| n.cloud.points().len()).sum();
        (points >= 4 * self.config.tracking.points_min).then_some(query)
    }

    /// Aligns the query at a place and asks the scans taken there whether they agree.
    fn verify(&self, map: Placed<'_>, merged: &Cloud, query: &[(Node, Pose2)], at: Pose2) -> Option<Pose2> {
        let r = &self.config.relocalize;
        let mut near: Vec<(f64, usize)> = (0..map.nodes.len())
            .filter(|&i| map.nodes[i].in_map())
            .map(|i| {
                let away = wrap_angle(map.poses[i].yaw_rad - at.yaw_rad).abs();
                (map.poses[i].distance_m(at) + self.whole.turn_weight_m * away, i)
            })
            .collect();
        near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        near.truncate(COMPARED_SCANS);
        let references = near
            .iter()
            .map(|&(_, i)| Reference { cloud: &map.nodes[i].cloud, frame_from_cloud: map.poses[i] });
        let fit = align(merged, at, references, None, &self.config.links);
        if fit.frame_from_cloud.distance_m(at) > 0.5 || fit.overlap < r.overlap_min {
            return None;
        }
        let chain: Vec<(&Node, Pose2)> = near.iter().map(|&(_, i)| (&map.nodes[i], map.poses[i])).collect();
        let seen: Vec<(&Node, Pose2)> = query.iter().map(|(node, pose)| (node, *pose)).collect();
        let agreement = compare_passes(chain.iter(), &seen, fit.frame_from_cloud);
        agreement.is_sound(r.agreement_min).then_some(fit.frame_from_cloud)
    }

    /// Whether enough earlier finds, from elsewhere, say the same. With a hint one is enough.
    fn is_confirmed(&mut self, map_from_local: Pose2) -> bool {
        let r = &self.config.relocalize;
        let newest = self.waiting.back().map_or(Pose2::IDENTITY, |n| n.local_from_base);
        let here = map_from_local * newest;
        let mut way_m = self.way_m;
        let mut agreeing = 1;
        for (other, at_m) in self.pending.iter().rev() {
            let there = *other * newest;
            let turned = wrap_angle(there.yaw_rad - here.yaw_rad).abs();
            if here.distance_m(there) < r.agree_m && turned < r.agree_rad && way_m - at_m >= r.apart_m {
                agreeing += 1;
                way_m = *at_m;
            }
        }
        if self.pending.len() == PENDING_MAX {
            self.pending.pop_front();
        }
        self.pending.push_back((map_from_local, self.way_m));
        self.hint.is_some() || agreeing >= r.witnesses
    }
}

fn same(a: Pose2, b: Pose2) -> bool {
    a.distance_m(b) < SAME_M && wrap_angle(a.yaw_rad - b.yaw_rad).abs() < SAME_RAD
}
