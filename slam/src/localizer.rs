//! Localization in a map that stays as it is: its newest nodes are aligned with the map's, and a small
//! graph of those few nodes, tied to the map where they fitted it, says where the robot is. What it
//! needs in memory does not grow.

use crate::align::{Prior, Reference, align};
use crate::closure::{COMPARED_SCANS, compare_passes};
use crate::config::{GraphConfig, SlamConfig};
use crate::graph::{EdgeKind, Graph, UNOBSERVED};
use crate::node::Node;
use crate::relocalize::Placed;
use msg::Pose2;
use nalgebra::Matrix3;
use posegraph::{information_from_sigmas, limit_information};
use std::collections::VecDeque;

/// Live nodes that are solved for together.
const WINDOW: usize = 20;
/// How unsure the robot's pose is after it was put down or found, metres and radians.
const START_M: f64 = 0.15;
const START_RAD: f64 = 0.06;

/// A live node.
struct WindowNode {
    node: Node,
    map_from_node: Pose2,
    /// Seen from the node before: what the scan path or odometry say, and how sure that is.
    before_from_this: (Pose2, Matrix3<f64>),
    /// Where the map's scans put it, if it fitted them, and how sure that is.
    measured: Option<(Pose2, Matrix3<f64>)>,
}

/// Tracks the robot in a fixed map; see the module.
pub struct Localizer {
    config: SlamConfig,
    live: VecDeque<WindowNode>,
    /// How unsure the newest pose is, metres and radians (one standard deviation).
    sigma: [f64; 2],
    unseen_m: f64,
    doubt: Doubt,
    fitted: u64,
    strange: u64,
}

/// Whether the robot may have been kidnapped, after the front end was lost.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Doubt {
    #[default]
    None,
    /// Nodes since that fitted the map well, and that did not.
    Some { good: u32, bad: u32 },
}

/// Nodes in a row that clear a doubt, and that confirm it.
const CLEARED: u32 = 2;
const CONFIRMED: u32 = 3;

/// What live nodes did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LocalizerCounts {
    /// Nodes that fitted the map.
    pub fitted: u64,
    /// Nodes that did not: the room has changed, or the robot is not where it is believed to be.
    pub strange: u64,
}

impl Localizer {
    /// Without live nodes.
    pub fn new(config: SlamConfig) -> Self {
        let live = VecDeque::with_capacity(WINDOW + 1);
        Self {
            config,
            live,
            sigma: [START_M, START_RAD],
            unseen_m: 0.0,
            doubt: Doubt::None,
            fitted: 0,
            strange: 0,
        }
    }

    /// Forgets the live nodes: the next one begins elsewhere.
    pub fn begin(&mut self) {
        self.live.clear();
        self.sigma = [START_M, START_RAD];
        self.unseen_m = 0.0;
        self.doubt = Doubt::None;
    }

    /// What live nodes did.
    pub fn counts(&self) -> LocalizerCounts {
        LocalizerCounts { fitted: self.fitted, strange: self.strange }
    }

    /// The map from the newest node and from the scan path's frame.
    pub fn newest(&self) -> Option<(Pose2, Pose2)> {
        let live = self.live.back()?;
        Some((live.map_from_node, live.map_from_node * live.node.local_from_base.inverse()))
    }

    /// Whether the robot is believed to be where [`Localizer::newest`] says.
    pub fn sure(&self) -> bool {
        self.doubt == Doubt::None
    }

    /// Whether the robot must be looked for: it is not where it was believed to be.
    pub fn astray(&self) -> bool {
        let carried = matches!(self.doubt, Doubt::Some { bad, .. } if bad >= CONFIRMED);
        carried || self.unseen_m > self.config.relocalize.give_up_m
    }

    /// Takes the next node; `map_from_local` says where the first one is.
    pub fn add(&mut self, node: Node, map_from_local: Pose2, map: Placed<'_>) {
        let (moved, predicted) = match self.live.back() {
            Some(last) => {
                let moved = last.node.local_from_base.between(node.local_from_base);
                (moved, last.map_from_node * moved)
            }
            None => (Pose2::IDENTITY, map_from_local * node.local_from_base),
        };
        let (way, turn) = (moved.x_m.hypot(moved.y_m), moved.yaw_rad.abs());
        // The scan path aligned them; where it was lost, odometry alone ties them.
        let doubt = if node.fits { 1.0 } else { 10.0 };
        let step = [doubt * (0.01 + 0.02 * way), doubt * (0.004 + 0.01 * turn)];
        self.sigma = [self.sigma[0].hypot(step[0] + way * self.sigma[1]), self.sigma[1].hypot(step[1])];
        self.unseen_m += way;
        if !node.fits {
            self.doubt = Doubt::Some { good: 0, bad: 0 };
        }
        let measured = self.measure(&node, predicted, map);
        if let Doubt::Some { good, bad } = &mut self.doubt {
            match measured {
                Some(_) => *good += 1,
                None => *bad += 1,
            }
            if *good >= CLEARED {
                self.doubt = Doubt::None;
            }
        }
        if measured.is_some() {
            self.fitted += 1;
            self.unseen_m = 0.0;
            self.sigma = [self.config.links.floor_m.max(0.03), self.config.links.floor_rad.max(0.01)];
        } else if node.fits {
            self.strange += 1;
        }
        if self.live.len() == WINDOW {
            self.live.pop_front();
        }
        let before_from_this = (moved, information_from_sigmas(step[0], step[1]));
        self.live.push_back(WindowNode { node, map_from_node: predicted, before_from_this, measured });
        self.solve();
    }

    /// Aligns a node with what the map's scans around it saw.
    fn measure(&self, node: &Node, predicted: Pose2, map: Placed<'_>) -> Option<(Pose2, Matrix3<f64>)> {
        let l = &self.config.links;
        if !node.fits || node.cloud.points().len() < self.config.tracking.points_min {
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
        let fit = align(&node.cloud, predicted, references, Some(prior), l);
        let chain: Vec<(&Node, Pose2)> = near.iter().map(|&i| (&map.nodes[i], map.poses[i])).collect();
        let agreement = compare_passes(chain.iter(), &[(node, Pose2::IDENTITY)], fit.frame_from_cloud);
        // In doubt as much is asked as of a robot that is looked for.
        let (overlap_min, agreement_min) = match self.doubt {
            Doubt::None => (l.overlap_min, l.agreement_min),
            Doubt::Some { .. } => (self.config.relocalize.overlap_min, self.config.relocalize.agreement_min),
        };
        let sound = agreement.is_sound(agreement_min);
        if fit.overlap < overlap_min || !sound {
            return None;
        }
        let information = limit_information(fit.information, [l.floor_m, l.floor_rad], UNOBSERVED);
        Some((fit.frame_from_cloud, information))
    }

    /// All live poses from all that is known of them; the map is the graph's fixed first node.
    fn solve(&mut self) {
        let config = GraphConfig { iterations_max: 5, ..self.config.graph.clone() };
        let mut graph = Graph::new(config);
        graph.add_node(Pose2::IDENTITY);
        for (i, live) in self.live.iter().enumerate() {
            let id = i as u32 + 1;
            graph.add_node(live.map_from_node);
            if i > 0 {
                let (moved, information) = live.before_from_this;
                graph.add_edge([id - 1, id], moved, information, EdgeKind::Odometry, [0.0; 2]);
            } else {
                // Where the window begins it is held lightly where it was.
                let held = information_from_sigmas(START_M, START_RAD);
                graph.add_edge([0, id], live.map_from_node, held, EdgeKind::InitialPose, [0.0; 2]);
            }
            if let Some((pose, information)) = live.measured {
                graph.add_edge([0, id], pose, information, EdgeKind::Link, [0.0; 2]);
            }
        }
        // After an error the poses are where the scan path has them.
        let _ = graph.solve(false);
        for (live, pose) in self.live.iter_mut().zip(&graph.poses()[1..]) {
            live.map_from_node = *pose;
        }
    }
}

/// Nodes of the map that look at what this one looks at, best first, not two of the same view.
fn nearest(map: Placed<'_>, node: &Node, map_from_node: Pose2, distance_max_m: f64) -> Vec<usize> {
    let [x, y] = map_from_node.apply(node.cloud.middle());
    let mut near: Vec<(f64, usize)> = (0..map.nodes.len())
        .filter(|&i| map.nodes[i].in_map())
        .filter_map(|i| {
            let seen = map.poses[i].apply(map.nodes[i].cloud.middle());
            let apart = (seen[0] - x).hypot(seen[1] - y);
            (apart < distance_max_m).then_some((apart + 0.5 * map_from_node.distance_m(map.poses[i]), i))
        })
        .collect();
    near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    near.truncate(COMPARED_SCANS);
    near.into_iter().map(|(_, i)| i).collect()
}
