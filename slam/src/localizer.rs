//! Localization in a fixed map: a sliding window of the newest nodes is aligned with the map's scans.
//!
//! A small pose graph of these nodes, with edges to the map where they matched it, yields the robot's pose.
//! Memory use is bounded by the window.

use crate::align::{Prior, Reference, align};
use crate::closure::{COMPARED_SCANS, compare_passes};
use crate::config::{GraphConfig, SlamConfig};
use crate::graph::{EdgeKind, Graph, UNOBSERVED};
use crate::node::Node;
use crate::relocalize::MapNodes;
use msg::Pose2;
use nalgebra::Matrix3;
use posegraph::{information_from_sigmas, limit_information};
use std::collections::VecDeque;

/// Most nodes of the window: bounds memory and the time of a solution.
const WINDOW: usize = 20;
/// Standard deviation of the position of a robot just located, metres: what a search or a person leaves open.
const START_M: f64 = 0.15;
/// Standard deviation of the heading of a robot just located, radians.
const START_RAD: f64 = 0.06;
/// Standard deviation of the position of a step between nodes, metres: scan matching noise of a robot at rest.
const STEP_M: f64 = 0.01;
/// Growth of that standard deviation, metres per metre of path.
const STEP_M_PER_M: f64 = 0.02;
/// Standard deviation of the heading of a step between nodes, radians.
const STEP_RAD: f64 = 0.004;
/// Growth of that standard deviation, radians per radian of turn.
const STEP_RAD_PER_RAD: f64 = 0.01;
/// Standard deviations of a step are this many times larger without a scan match: odometry alone measured it.
const UNMATCHED_STEP_FACTOR: f64 = 10.0;
/// Least standard deviation of the position after a match with the map, metres: alignment claims no more.
const MATCHED_MIN_M: f64 = 0.03;
/// Least standard deviation of the heading after a match with the map, radians.
const MATCHED_MIN_RAD: f64 = 0.01;
/// Most iterations of a solution of the window: it starts close to the last one.
const ITERATIONS_MAX: usize = 5;
/// Cost of a metre between viewpoints against a metre between what is looked at: scans from afar see other sides.
const VIEWPOINT_SHARE: f64 = 0.5;

/// A node of the sliding window.
struct WindowNode {
    node: Node,
    map_from_node: Pose2,
    /// Relative pose from the node before by scan matching or odometry, with its information.
    previous_from_this: (Pose2, Matrix3<f64>),
    /// Pose by alignment with the map's scans and its information, if the node matched them.
    matched: Option<(Pose2, Matrix3<f64>)>,
}

/// Tracks a robot in a fixed map with a sliding window of nodes.
pub struct Localizer {
    config: SlamConfig,
    window: VecDeque<WindowNode>,
    /// Standard deviations of the newest pose, metres and radians.
    sigma: [f64; 2],
    /// Length of the path since the last node that matched the map, metres.
    unmatched_m: f64,
    kidnap_check: KidnapCheck,
    counts: LocalizerCounts,
}

/// Check for a kidnapped robot, from when the front end lost track until enough nodes match the map, or fail to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum KidnapCheck {
    /// No reason for suspicion: the front end has not lost track since the last check passed.
    #[default]
    Passed,
    /// Nodes since the front end lost track that matched the map, and that did not.
    Pending { matched: u32, unmatched: u32 },
}

/// Nodes that must match the map for the kidnap check to pass: one may match by chance.
const MATCHES_TO_PASS: u32 = 2;
/// Nodes without a match after which the robot counts as kidnapped.
const MISSES_TO_FAIL: u32 = 3;

/// Counts of localization nodes by whether they matched the map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LocalizerCounts {
    /// Nodes that matched the map.
    pub matched: u64,
    /// Nodes that did not match: the room has changed, or the pose estimate is wrong.
    pub unmatched: u64,
    /// Solutions of the window that failed: its poses stayed as predicted.
    pub failed_solutions: u64,
}

impl Localizer {
    /// A localizer with an empty window.
    pub fn new(config: SlamConfig) -> Self {
        Self {
            config,
            window: VecDeque::with_capacity(WINDOW + 1),
            sigma: [START_M, START_RAD],
            unmatched_m: 0.0,
            kidnap_check: KidnapCheck::Passed,
            counts: LocalizerCounts::default(),
        }
    }

    /// Removes all nodes from the window: the next node's pose does not follow from them.
    pub fn clear(&mut self) {
        self.window.clear();
        self.sigma = [START_M, START_RAD];
        self.unmatched_m = 0.0;
        self.kidnap_check = KidnapCheck::Passed;
    }

    /// Counts of nodes by whether they matched the map.
    pub fn counts(&self) -> LocalizerCounts {
        self.counts
    }

    /// Poses in the map of the newest node and of the front end's frame; `None` while the window is empty.
    pub fn newest(&self) -> Option<(Pose2, Pose2)> {
        let newest = self.window.back()?;
        Some((newest.map_from_node, newest.map_from_node * newest.node.local_from_base.inverse()))
    }

    /// Whether the pose of [`Localizer::newest`] can be relied on: no kidnap check is pending.
    pub fn is_located(&self) -> bool {
        self.kidnap_check == KidnapCheck::Passed
    }

    /// Whether the robot must be relocalized: it was kidnapped, or matched nothing over `relocalize.give_up_m`.
    pub fn is_lost(&self) -> bool {
        let kidnapped = matches!(self.kidnap_check, KidnapCheck::Pending { unmatched, .. } if unmatched >= MISSES_TO_FAIL);
        kidnapped || self.unmatched_m > self.config.relocalize.give_up_m
    }

    /// Adds the next node. `map_from_local`: pose of the front end's frame in the map, used for the first node.
    pub fn add_node(&mut self, node: Node, map_from_local: Pose2, map: MapNodes<'_>) {
        let (moved, predicted) = match self.window.back() {
            Some(last) => {
                let moved = last.node.local_from_base.between(node.local_from_base);
                (moved, last.map_from_node * moved)
            }
            None => (Pose2::IDENTITY, map_from_local * node.local_from_base),
        };
        let (distance_m, turn_rad) = (moved.x_m.hypot(moved.y_m), moved.yaw_rad.abs());
        let factor = if node.is_tracked { 1.0 } else { UNMATCHED_STEP_FACTOR };
        let step = [
            factor * (STEP_M + STEP_M_PER_M * distance_m),
            factor * (STEP_RAD + STEP_RAD_PER_RAD * turn_rad),
        ];
        self.sigma =
            [self.sigma[0].hypot(step[0] + distance_m * self.sigma[1]), self.sigma[1].hypot(step[1])];
        self.unmatched_m += distance_m;
        if !node.is_tracked || node.odometry_break {
            self.kidnap_check = KidnapCheck::Pending { matched: 0, unmatched: 0 };
        }
        let match_result = self.match_to_map(&node, predicted, map);
        if let KidnapCheck::Pending { matched, unmatched } = &mut self.kidnap_check {
            match match_result {
                Some(_) => *matched += 1,
                None => *unmatched += 1,
            }
            if *matched >= MATCHES_TO_PASS {
                self.kidnap_check = KidnapCheck::Passed;
            }
        }
        if match_result.is_some() {
            self.counts.matched += 1;
            self.unmatched_m = 0.0;
            self.sigma = [
                self.config.links.sigma_min_m.max(MATCHED_MIN_M),
                self.config.links.sigma_min_rad.max(MATCHED_MIN_RAD),
            ];
        } else if node.is_tracked {
            self.counts.unmatched += 1;
        }
        if self.window.len() == WINDOW {
            self.window.pop_front();
        }
        let previous_from_this = (moved, information_from_sigmas(step[0], step[1]));
        self.window.push_back(WindowNode {
            node,
            map_from_node: predicted,
            previous_from_this,
            matched: match_result,
        });
        self.solve();
    }

    /// Aligns a node with the map's scans around it. Returns its pose in the map and the information, if they agree.
    fn match_to_map(
        &self,
        node: &Node,
        predicted: Pose2,
        map: MapNodes<'_>,
    ) -> Option<(Pose2, Matrix3<f64>)> {
        let l = &self.config.links;
        if !node.is_tracked || node.cloud.points().len() < self.config.tracking.points_min {
            return None;
        }
        let near = nearest(map, node, predicted, l.distance_max_m);
        if near.is_empty() {
            return None;
        }
        let references =
            near.iter().map(|&i| Reference { cloud: &map.nodes[i].cloud, frame_from_cloud: map.poses[i] });
        let prior =
            Prior { pose: predicted, information: information_from_sigmas(self.sigma[0], self.sigma[1]) };
        let fit = align(&node.cloud, predicted, references, Some(prior), &self.config.alignment);
        let chain: Vec<(&Node, Pose2)> = near.iter().map(|&i| (&map.nodes[i], map.poses[i])).collect();
        let agreement = compare_passes(chain.iter(), &[(node, Pose2::IDENTITY)], fit.frame_from_cloud);
        // While a kidnapping is suspected, a match must pass the stricter limits of relocalization.
        let (overlap_min, agreement_min) = match self.kidnap_check {
            KidnapCheck::Passed => (l.overlap_min, l.agreement_min),
            KidnapCheck::Pending { .. } => {
                (self.config.relocalize.overlap_min, self.config.relocalize.agreement_min)
            }
        };
        let sound = agreement.is_sound(agreement_min);
        if fit.overlap < overlap_min || !sound {
            return None;
        }
        let information = limit_information(fit.information, [l.sigma_min_m, l.sigma_min_rad], UNOBSERVED);
        Some((fit.frame_from_cloud, information))
    }

    /// Solves for all poses of the window; the graph's fixed first node stands for the map.
    fn solve(&mut self) {
        let config = GraphConfig { iterations_max: ITERATIONS_MAX, ..self.config.graph.clone() };
        let mut graph = Graph::new(config);
        graph.add_node(Pose2::IDENTITY);
        for (i, entry) in self.window.iter().enumerate() {
            let id = i as u32 + 1;
            graph.add_node(entry.map_from_node);
            if i > 0 {
                let (moved, information) = entry.previous_from_this;
                graph.add_edge([id - 1, id], moved, information, EdgeKind::Odometry, [0.0; 2]);
            } else {
                // A weak prior keeps the window's first node where it was.
                let held = information_from_sigmas(START_M, START_RAD);
                graph.add_edge([0, id], entry.map_from_node, held, EdgeKind::InitialPose, [0.0; 2]);
            }
            if let Some((pose, information)) = entry.matched {
                graph.add_edge([0, id], pose, information, EdgeKind::ScanMatch, [0.0; 2]);
            }
        }
        // If the solver fails, the poses stay as predicted by the front end.
        self.counts.failed_solutions += u64::from(graph.solve(false).is_err());
        for (entry, pose) in self.window.iter_mut().zip(&graph.poses()[1..]) {
            entry.map_from_node = *pose;
        }
    }
}

/// Nodes of the map with the view most like this node's, most similar first, at most [`COMPARED_SCANS`].
fn nearest(map: MapNodes<'_>, node: &Node, map_from_node: Pose2, distance_max_m: f64) -> Vec<usize> {
    let [x, y] = map_from_node.apply(node.cloud.centroid_m());
    let mut near: Vec<(f64, usize)> = (0..map.nodes.len())
        .filter(|&i| map.contains(&map.nodes[i]))
        .filter_map(|i| {
            let seen = map.poses[i].apply(map.nodes[i].cloud.centroid_m());
            let apart = (seen[0] - x).hypot(seen[1] - y);
            (apart < distance_max_m)
                .then_some((apart + VIEWPOINT_SHARE * map_from_node.distance_m(map.poses[i]), i))
        })
        .collect();
    near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    near.truncate(COMPARED_SCANS);
    near.into_iter().map(|(_, i)| i).collect()
}
