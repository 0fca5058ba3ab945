//! A robot that believes to be back in a hall: it is, or it stands in another one that looks much the same.

use super::{ClosureDetector, ClosureSearchResult, GraphView, SAME_PLACE_M, SAME_PLACE_RAD};
use crate::common::{FULL, Lidar, Noise, Wall, cast, rectangle};
use crate::config::SlamConfig;
use crate::graph::Graph;
use crate::likelihood_field::SearchLimits;
use crate::node::Node;
use crate::point_transform::PointTransform;
use crate::testing::standing_node;
use msg::{Pose2, Stamp};

/// Sees all of a hall from everywhere in it.
const LIDAR: Lidar = Lidar { range_max_m: 15.0, ..FULL };
/// Nodes of one pass through a hall, 0.4 m apart.
const PASS_NODES: usize = 12;
/// Nodes between the two passes, far away: enough that the passes are not linked as neighbours.
const BETWEEN_NODES: usize = 16;

/// A hall of 8 m x 6 m with posts by its walls, which tell its corners apart.
fn hall() -> Vec<Wall> {
    let outline = [(0.0, 0.0, 8.0, 6.0), (0.0, 4.6, 1.1, 6.0), (7.1, 0.0, 8.0, 0.6), (3.0, 5.5, 3.6, 6.0)];
    outline.iter().flat_map(|b| rectangle(b.0, b.1, b.2, b.3)).collect()
}

/// The same hall with stacks of boxes where a robot saw through the first one.
fn hall_with_boxes() -> Vec<Wall> {
    let boxes = [(4.2, 3.2, 5.6, 4.6), (1.6, 3.0, 2.6, 4.0), (6.4, 1.2, 7.2, 3.0)];
    let boxes = boxes.iter().flat_map(|b| rectangle(b.0, b.1, b.2, b.3));
    hall().into_iter().chain(boxes).collect()
}

/// Passes of a robot through halls, and where the pose graph has them.
struct Passes {
    nodes: Vec<Node>,
    poses: Vec<Pose2>,
    noise: Noise,
    config: SlamConfig,
}

impl Passes {
    /// A pass through a hall, then a way outside and a pass through a hall for each of `later`. The graph has all halls
    /// at one place, later passes this far off along the hall's length, metres.
    fn new(first: &[Wall], later: &[(Vec<Wall>, f64)]) -> Self {
        let config = SlamConfig::default();
        let mut passes = Self { nodes: Vec::new(), poses: Vec::new(), noise: Noise::new(5), config };
        passes.drive_through(first, 0.0);
        for (hall, drift_m) in later {
            for i in 0..BETWEEN_NODES {
                let outside = Pose2::new(50.0 + i as f64, 0.0, 0.0);
                passes.add(&rectangle(45.0, -1.0, 75.0, 1.0), outside, outside);
            }
            passes.drive_through(hall, *drift_m);
        }
        passes
    }

    fn drive_through(&mut self, hall: &[Wall], drift_m: f64) {
        for pose in (0..PASS_NODES).map(Self::pose) {
            self.add(hall, pose, Pose2::new(pose.x_m + drift_m, pose.y_m, pose.yaw_rad));
        }
    }

    /// Pose of a pass's node in the hall.
    fn pose(i: usize) -> Pose2 {
        Pose2::new(1.5 + 0.4 * i as f64, 2.0, 0.05)
    }

    fn add(&mut self, walls: &[Wall], pose: Pose2, graph_pose: Pose2) {
        let scan = cast(walls, &LIDAR, pose, Stamp::default(), &mut self.noise);
        self.nodes.push(standing_node(self.nodes.len() as u32, &scan, graph_pose, &self.config.lidar));
        self.poses.push(graph_pose);
    }

    /// Searches for a node of a later pass (from 1), counted from its first; nothing is known about how far it drifted.
    fn search(&self, detector: &mut ClosureDetector, pass: usize, node: usize) -> ClosureSearchResult {
        // While the robot drives, no node is newer than the one that is searched for.
        let node = pass * (PASS_NODES + BETWEEN_NODES) + node;
        let graph = Graph::from_parts(self.config.graph.clone(), self.poses[..=node].to_vec(), Vec::new());
        let view = GraphView { nodes: &self.nodes[..=node], graph: &graph };
        let unknown = vec![None; node + 1];
        detector.search(&view, node as u32, &unknown, node as f64)
    }
}

#[test]
fn a_place_is_accepted_when_a_second_search_agrees_and_not_before() {
    let passes = Passes::new(&hall(), &[(hall(), 0.4)]);
    let mut detector = ClosureDetector::new(passes.config.clone());
    assert!(
        matches!(passes.search(&mut detector, 1, 6), ClosureSearchResult::Unconfirmed),
        "one search is no proof"
    );
    assert_eq!(detector.counts().accepted, 0);
    let ClosureSearchResult::Accepted(closures) = passes.search(&mut detector, 1, 9) else {
        panic!("not accepted: {:?}", detector.counts());
    };
    assert_eq!(closures.len(), 2);
    for closure in closures {
        let [old, new] =
            [closure.older, closure.newer].map(|id| Passes::pose(id as usize % (PASS_NODES + BETWEEN_NODES)));
        let error_m = closure.older_from_newer.distance_m(old.between(new));
        assert!(error_m < 0.03, "{error_m} m off");
    }
}

#[test]
fn searches_that_disagree_confirm_nothing() {
    // Both passes are found in the hall, but the graph has them 0.8 m apart: one of the two is wrong, or the graph is.
    let passes = Passes::new(&hall(), &[(hall(), 0.4), (hall(), -0.4)]);
    let mut detector = ClosureDetector::new(passes.config.clone());
    for pass in [1, 2] {
        let search = passes.search(&mut detector, pass, 9);
        assert!(matches!(search, ClosureSearchResult::Unconfirmed), "pass {pass}: {:?}", detector.counts());
    }
    assert_eq!(detector.counts().accepted, 0);
}

#[test]
fn a_hall_of_the_same_walls_that_scans_contradict_is_not_taken_for_the_first() {
    let passes = Passes::new(&hall(), &[(hall_with_boxes(), 0.4)]);
    let mut detector = ClosureDetector::new(passes.config.clone());
    for node in 5..PASS_NODES {
        let search = passes.search(&mut detector, 1, node);
        assert!(matches!(search, ClosureSearchResult::NotFound), "node {node}: {:?}", detector.counts());
    }
    // The walls alone look right: it is the scans that contradict.
    assert!(detector.counts().contradicted > 0, "{:?}", detector.counts());
}

#[test]
fn a_place_is_not_unique_when_the_search_for_a_second_one_gives_up() {
    let passes = Passes::new(&hall(), &[(hall(), 0.4)]);
    let node = PASS_NODES + BETWEEN_NODES + 9;
    let graph = Graph::from_parts(passes.config.graph.clone(), passes.poses[..=node].to_vec(), Vec::new());
    let view = GraphView { nodes: &passes.nodes[..=node], graph: &graph };
    let mut config = passes.config.clone();
    // All points are compared.
    config.closures.query_points_max = 100_000;
    let mut detector = ClosureDetector::new(config);
    let query = detector.query(&view, node as u32);
    detector.chain(&view, 9, &query);
    let window = detector.window(&graph, None, 9, node as u32);
    let points: Vec<[f32; 2]> = query
        .iter()
        .flat_map(|(node, pose)| {
            let transform = PointTransform::new(*pose);
            node.cloud.points().iter().map(move |point| transform.point(point.at))
        })
        .collect();
    let mut second_gave_up = 0;
    for (ratio, power) in [0.9, 0.8, 0.7, 0.6, 0.5].into_iter().flat_map(|r| (6..28).map(move |p| (r, p))) {
        let limit = 1.5_f64.powi(power) as usize;
        detector.config.closures.ambiguity_ratio_max = ratio;
        detector.config.closures.evaluations_max = limit;
        let score_min = detector.config.closures.response_min;
        let limits = SearchLimits { score_min, evaluations_max: limit, excluded: None };
        let mut search = |limits| detector.field.search(&points, &window, &limits, &mut detector.scratch);
        let first = search(limits);
        let Some(peak) = first.peak.filter(|_| !first.given_up) else { continue };
        let excluded = Some((peak.pose, SAME_PLACE_M, SAME_PLACE_RAD));
        let second = search(SearchLimits { score_min: peak.score * ratio, excluded, ..limits });
        second_gave_up += u32::from(second.given_up && second.peak.is_none());
        let ambiguous = detector.counts().ambiguous;
        let is_unique = !second.given_up && second.peak.is_none();
        assert_eq!(detector.correlate(&query, &window).is_some(), is_unique, "{limit} evaluations");
        assert_eq!(detector.counts().ambiguous - ambiguous, u64::from(!is_unique), "{limit} evaluations");
    }
    assert!(second_gave_up > 0, "the case was met");
}
