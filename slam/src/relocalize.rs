//! Relocalization: searches a whole map for a robot whose position and heading are not known.
//!
//! All poses that score nearly as well as the best one (`whole_map`) are aligned and compared with the
//! scans taken there. One must remain, and a second search from elsewhere must find the same.

#[cfg(test)]
mod tests;
mod whole_map;

use crate::align::{Reference, align};
use crate::closure::{COMPARED_SCANS, compare_passes};
use crate::cloud::Cloud;
use crate::config::SlamConfig;
use crate::node::{FrameUncertainty, Node};
use msg::{Pose2, pose::wrap_angle};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use whole_map::{Bounds, WholeMap};

/// Most points of a query: the cost of a search is proportional to them.
const POINTS_MAX: usize = 300;
/// Nodes kept while the robot is not located; beyond them the oldest is dropped.
const WAITING_MAX: usize = 128;
/// Poses nearer to each other than this count as the same place, metres.
const SAME_PLACE_M: f64 = 0.6;
/// Poses turned by less than this against each other count as the same place, radians.
const SAME_PLACE_RAD: f64 = 0.2;
/// Searches without success after which the path between two searches grows by its first length.
const SEARCHES_BEFORE_BACKOFF: f64 = 12.0;
/// Largest multiple of the path between two searches: a robot that is lost for long is still searched for.
const BACKOFF_MAX: f64 = 2.0;
/// Results that wait for confirmation; beyond them the oldest is dropped.
const PENDING_MAX: usize = 16;
/// Half side of the search area around an initial estimate, in standard deviations: 99.7 % of a normal distribution.
const ESTIMATE_SIGMAS: f64 = 3.0;
/// Largest distance between a search's result and its alignment, metres: farther off, it found other surfaces.
const ALIGNMENT_SHIFT_MAX_M: f64 = 0.5;
/// Scans of a limited field of view that a query is aligned and compared with: its up to nine scans see more than six of 90° cover.
const COMPARED_LIMITED_SCANS: usize = 2 * COMPARED_SCANS;
/// Cost of a radian between viewpoints against a metre if scans see all around, metres: the view hardly changes.
const TURN_WEIGHT_ALL_AROUND_M: f64 = 0.2;
/// The same cost for scans of a limited field of view, metres: the view changes with the heading.
const TURN_WEIGHT_LIMITED_M: f64 = 1.5;
/// Points of the merged query, and least points it needs, in scans.
const QUERY_SCANS: usize = 4;

/// An estimate of where the front end's frame lies in the map.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LocalFrameEstimate {
    /// Pose of the front end's frame in the map.
    pub map_from_local: Pose2,
    /// Standard deviation of the robot's position, metres.
    pub sigma_m: f64,
    /// Standard deviation of the robot's heading, radians.
    pub sigma_rad: f64,
}

impl LocalFrameEstimate {
    /// Covariance of the robot's pose in the map, by the estimate alone.
    pub(crate) fn uncertainty(&self, local_from_base: Pose2) -> FrameUncertainty {
        let at = self.map_from_local * local_from_base;
        let (position_m2, heading_rad2) = (self.sigma_m.powi(2), self.sigma_rad.powi(2));
        FrameUncertainty {
            covariance: [position_m2, 0.0, 0.0, position_m2, 0.0, heading_rad2],
            position_m: [at.x_m, at.y_m],
        }
    }
}

/// Counts of relocalization searches by how they ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct RelocalizationCounts {
    /// Searches of the map, whatever their result.
    pub searches: u64,
    /// Searches in which no pose reached the least score.
    pub below_min_response: u64,
    /// Searches in which scans contradicted every pose with a sufficient score.
    pub contradicted: u64,
    /// Searches with more than one pose left, or stopped at a limit.
    pub ambiguous: u64,
    /// Searches with exactly one pose left.
    pub found: u64,
    /// Results that enough searches confirmed: the robot was located.
    pub accepted: u64,
    /// Nodes dropped while the robot was not located.
    pub dropped: u64,
}

impl core::ops::AddAssign for RelocalizationCounts {
    fn add_assign(&mut self, other: Self) {
        self.searches += other.searches;
        self.below_min_response += other.below_min_response;
        self.contradicted += other.contradicted;
        self.ambiguous += other.ambiguous;
        self.found += other.found;
        self.accepted += other.accepted;
        self.dropped += other.dropped;
    }
}

/// The nodes of a map and their poses in it, by the same index.
#[derive(Clone, Copy)]
pub struct MapNodes<'a> {
    /// Nodes with their scans.
    pub nodes: &'a [Node],
    /// Pose of each node in the map's frame.
    pub poses: &'a [Pose2],
    /// First node of the unplaced component that is the map; `None`: the nodes that are placed.
    pub component: Option<u32>,
}

impl<'a> MapNodes<'a> {
    /// The nodes that are placed in the map.
    pub fn of_map(nodes: &'a [Node], poses: &'a [Pose2]) -> Self {
        Self { nodes, poses, component: None }
    }

    /// Whether a node is part of the map.
    pub fn contains(&self, node: &Node) -> bool {
        node.is_tracked && node.unplaced_component() == self.component
    }
}

/// Searches a map for a robot, node by node, until enough results agree.
pub struct Relocalizer {
    config: SlamConfig,
    whole_map: WholeMap,
    /// Estimate that bounds the search; `None` searches the whole map.
    initial_estimate: Option<LocalFrameEstimate>,
    /// The newest nodes since the search began.
    waiting: VecDeque<Node>,
    /// Nodes added since the search began.
    added: usize,
    /// Motion since the search began: metres of path plus radians of turns.
    travelled: f64,
    /// `travelled` at the last search.
    last_search: Option<f64>,
    /// Searches tried since the search began.
    tries: u32,
    /// Whether scans contradicted every place that the newest search found.
    is_contradicted: bool,
    /// Earlier results: the pose of the front end's frame in the map, and `travelled` at that search.
    pending: VecDeque<(Pose2, f64)>,
    counts: RelocalizationCounts,
}

/// Result of relocalization after a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RelocalizationOutcome {
    /// The robot is not located yet; further nodes are needed.
    NotFound,
    /// The robot is located.
    Found {
        /// Pose of the front end's frame in the map.
        map_from_local: Pose2,
    },
    /// No search near the initial estimate found anything to compare with; the estimate is accepted unverified.
    EstimateAccepted(LocalFrameEstimate),
}

impl Relocalizer {
    /// A relocalizer for this map, near an initial estimate or everywhere. The map must not change during the search.
    pub fn new(
        config: SlamConfig,
        map: MapNodes<'_>,
        initial_estimate: Option<LocalFrameEstimate>,
        counts: RelocalizationCounts,
    ) -> Self {
        Self {
            whole_map: WholeMap::new(&config, map),
            initial_estimate,
            waiting: VecDeque::with_capacity(WAITING_MAX),
            added: 0,
            travelled: 0.0,
            last_search: None,
            tries: 0,
            is_contradicted: false,
            pending: VecDeque::with_capacity(PENDING_MAX),
            counts,
            config,
        }
    }

    /// The initial estimate that bounds the search, if one was given.
    pub fn initial_estimate(&self) -> Option<LocalFrameEstimate> {
        self.initial_estimate
    }

    /// Covariance of the newest node's pose by the initial estimate, if one was given.
    pub fn initial_uncertainty(&self) -> Option<FrameUncertainty> {
        let newest = self.waiting.back().map_or(Pose2::IDENTITY, |node| node.local_from_base);
        Some(self.initial_estimate?.uncertainty(newest))
    }

    /// Counts of searches by how they ended.
    pub fn counts(&self) -> RelocalizationCounts {
        self.counts
    }

    /// Takes the counts of searches since they were taken last.
    pub fn take_counts(&mut self) -> RelocalizationCounts {
        core::mem::take(&mut self.counts)
    }

    /// Takes the nodes since the search began, oldest first.
    pub fn take_waiting(&mut self) -> VecDeque<Node> {
        core::mem::take(&mut self.waiting)
    }

    /// Adds a node, and searches if the robot has moved far enough since the last search.
    pub fn add_node(&mut self, node: Node, map: MapNodes<'_>) -> RelocalizationOutcome {
        let moved = self
            .waiting
            .back()
            .map_or(Pose2::IDENTITY, |last| last.local_from_base.between(node.local_from_base));
        self.travelled += moved.x_m.hypot(moved.y_m) + moved.yaw_rad.abs();
        if !node.is_tracked || node.odometry_break {
            // At best odometry connects this node with those before: earlier results cannot confirm later ones.
            self.pending.clear();
        }
        if node.odometry_break {
            // Nothing connects this node with those before: they cannot be part of a query.
            self.counts.dropped += self.waiting.len() as u64;
            self.waiting.clear();
        }
        self.added += 1;
        if self.waiting.len() == WAITING_MAX {
            self.waiting.pop_front();
            self.counts.dropped += 1;
        }
        self.waiting.push_back(node);
        let r = &self.config.relocalize;
        // Searches of a robot that is not found become rarer: each costs as much as the first.
        let backoff = 1.0 + (self.tries as f64 / SEARCHES_BEFORE_BACKOFF).min(BACKOFF_MAX - 1.0).floor();
        if self.last_search.is_none_or(|at| self.travelled - at >= backoff * r.travel_m) {
            self.tries += 1;
            self.last_search = Some(self.travelled);
            if let Some(map_from_local) = self.search(map)
                && self.is_confirmed(map_from_local)
            {
                self.counts.accepted += 1;
                return RelocalizationOutcome::Found { map_from_local };
            }
        }
        match self.initial_estimate {
            // What the scans contradict is not where the robot is.
            Some(estimate)
                if self.added >= self.config.relocalize.estimate_nodes_max && !self.is_contradicted =>
            {
                RelocalizationOutcome::EstimateAccepted(estimate)
            }
            _ => RelocalizationOutcome::NotFound,
        }
    }

    /// Searches once with the newest nodes. Returns the pose of the front end's frame in the map if exactly one pose
    /// remains.
    fn search(&mut self, map: MapNodes<'_>) -> Option<Pose2> {
        let query = self.query()?;
        let newest = self.waiting.back()?;
        self.counts.searches += 1;
        let merged = Cloud::merged(
            query.iter().map(|(n, pose)| (&*n.cloud, *pose)),
            QUERY_SCANS * self.config.lidar.points_max,
        );
        let stride = merged.points().len().div_ceil(POINTS_MAX).max(1);
        let points: Vec<[f32; 2]> = merged.points().iter().step_by(stride).map(|p| p.at).collect();
        let bounds = self.initial_estimate.map(|estimate| Bounds {
            centre: estimate.map_from_local * newest.local_from_base,
            half_m: ESTIMATE_SIGMAS * estimate.sigma_m,
            half_rad: ESTIMATE_SIGMAS * estimate.sigma_rad,
        });
        let (found, given_up) = self.whole_map.search(&points, bounds, &self.config.relocalize);
        self.is_contradicted = false;
        if found.is_empty() {
            self.counts.below_min_response += 1;
            return None;
        }
        let mut remaining: Vec<Pose2> = Vec::new();
        for coarse in found {
            if let Some(pose) = self.verify(map, &merged, &query, coarse)
                && remaining.iter().all(|other| !is_same_place(*other, pose))
            {
                remaining.push(pose);
            }
        }
        match remaining[..] {
            [] => {
                self.is_contradicted = true;
                self.counts.contradicted += 1;
            }
            [map_from_newest] if !given_up => {
                self.counts.found += 1;
                return Some(map_from_newest * newest.local_from_base.inverse());
            }
            _ => self.counts.ambiguous += 1,
        }
        None
    }

    /// The newest nodes and their poses in the newest one's frame; `None` if they have too few points.
    fn query(&self) -> Option<Vec<(Node, Pose2)>> {
        let c = &self.config.closures;
        let newest = self.waiting.back()?;
        let mut path_m = 0.0;
        let mut query: Vec<(Node, Pose2)> = Vec::new();
        for node in self.waiting.iter().rev().take(c.query_nodes) {
            let pose = newest.local_from_base.between(node.local_from_base);
            path_m += query.last().map_or(0.0, |(_, last)| last.distance_m(pose));
            if path_m > c.query_m {
                break;
            }
            query.push((node.clone(), pose));
            if !node.is_tracked {
                break;
            }
        }
        query.reverse();
        let points: usize = query.iter().map(|(n, _)| n.cloud.points().len()).sum();
        (points >= QUERY_SCANS * self.config.tracking.points_min).then_some(query)
    }

    /// Aligns the query at a pose and compares it with the scans taken there. Returns the aligned pose if they agree.
    fn verify(&self, map: MapNodes<'_>, merged: &Cloud, query: &[(Node, Pose2)], at: Pose2) -> Option<Pose2> {
        let r = &self.config.relocalize;
        let (turn_weight_m, scans_max) = match self.whole_map.sees_all_around {
            true => (TURN_WEIGHT_ALL_AROUND_M, COMPARED_SCANS),
            false => (TURN_WEIGHT_LIMITED_M, COMPARED_LIMITED_SCANS),
        };
        let mut near: Vec<(f64, usize)> = (0..map.nodes.len())
            .filter(|&i| map.contains(&map.nodes[i]))
            .map(|i| {
                let away = wrap_angle(map.poses[i].yaw_rad - at.yaw_rad).abs();
                (map.poses[i].distance_m(at) + turn_weight_m * away, i)
            })
            .collect();
        near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        near.truncate(scans_max);
        let references = near
            .iter()
            .map(|&(_, i)| Reference { cloud: &map.nodes[i].cloud, frame_from_cloud: map.poses[i] });
        let fit = align(merged, at, references, None, &self.config.alignment);
        if fit.frame_from_cloud.distance_m(at) > ALIGNMENT_SHIFT_MAX_M || fit.overlap < r.overlap_min {
            return None;
        }
        let chain: Vec<(&Node, Pose2)> = near.iter().map(|&(_, i)| (&map.nodes[i], map.poses[i])).collect();
        let seen: Vec<(&Node, Pose2)> = query.iter().map(|(node, pose)| (node, *pose)).collect();
        let agreement = compare_passes(chain.iter(), &seen, fit.frame_from_cloud);
        agreement.is_sound(r.agreement_min).then_some(fit.frame_from_cloud)
    }

    /// Whether enough earlier results, from elsewhere on the path, agree. With an initial estimate one result is
    /// enough.
    fn is_confirmed(&mut self, map_from_local: Pose2) -> bool {
        let r = &self.config.relocalize;
        let newest = self.waiting.back().map_or(Pose2::IDENTITY, |n| n.local_from_base);
        let here = map_from_local * newest;
        let mut travelled = self.travelled;
        let mut agreeing = 1;
        for (other, at) in self.pending.iter().rev() {
            let there = *other * newest;
            let turned = wrap_angle(there.yaw_rad - here.yaw_rad).abs();
            if here.distance_m(there) < r.agree_m
                && turned < r.agree_rad
                && travelled - at >= r.confirmation_distance_m
            {
                agreeing += 1;
                travelled = *at;
            }
        }
        if self.pending.len() == PENDING_MAX {
            self.pending.pop_front();
        }
        self.pending.push_back((map_from_local, self.travelled));
        self.initial_estimate.is_some() || agreeing >= r.confirmations_min
    }
}

/// Whether two poses are one place: [`SAME_PLACE_M`] and [`SAME_PLACE_RAD`].
fn is_same_place(a: Pose2, b: Pose2) -> bool {
    a.distance_m(b) < SAME_PLACE_M && wrap_angle(a.yaw_rad - b.yaw_rad).abs() < SAME_PLACE_RAD
}
