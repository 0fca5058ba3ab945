//! Merge edges as people and programs read them.

use super::FleetView;
use msg::{AlignmentRefusal, EdgeState, MergeEdge, MergeEdges};
use serde::Serialize;
use std::fmt::{self, Write};

/// Edge between two robots' maps: relative pose and evidence.
// More than 12 fields: the fields are the keys of one flat JSON object, like those of the message it shows.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EdgeView {
    /// Number of the edge.
    pub edge: u32,
    /// Robot in whose map the pose is given, such as `robot1`.
    pub a: String,
    /// Robot whose map's pose is given, such as `robot2`.
    pub b: String,
    /// `accepted`, `pinned`, `undone` ...
    pub state: &'static str,
    /// Why the two maps are not joined, by the newest alignment; `None`: they are, or none was tried.
    pub why_not: Option<&'static str>,
    /// Pose of `b`'s map in `a`'s map: x m, y m, yaw rad; `None`: no alignment has passed the test.
    pub a_from_b: Option<[f64; 3]>,
    /// Number of occupied cells of both maps that match.
    pub inliers: u32,
    /// Mean distance of matching walls, metres; `None` without an alignment, like the figures up to `margin`.
    pub residual_m: Option<f64>,
    /// Area that both maps know, square metres.
    pub overlap_m2: Option<f64>,
    /// Shared area over the smaller map's known area, 0 to 1.
    pub overlap_share: Option<f64>,
    /// Share of commonly known cells that agree, 0 to 1.
    pub agreement: Option<f64>,
    /// F1 of occupied cells with a tolerance of one cell.
    pub occupied_f1: Option<f64>,
    /// Largest such F1 under 20 wrong transforms.
    pub null_f1_max: Option<f64>,
    /// Share of one map's walls that lie in the other's free space, 0 to 1.
    pub conflict: Option<f64>,
    /// Evidence over that of the second best place.
    pub margin: Option<f64>,
    /// Number of closures between submaps in the fleet's pose graph.
    pub closures: u32,
    /// Number of closures found that contradict the others.
    pub closures_rejected: u32,
    /// Mean residual of the closures in the fleet's pose graph, metres; `None` without closures.
    pub closure_residual_m: Option<f64>,
    /// Number of submaps of both robots that were compared with the other robot's map.
    pub compared_submaps: u32,
    /// Number of these that the other map contradicts.
    pub contradicted_submaps: u32,
    /// Whether these are so many that one of the two maps is deformed, or lies wrong.
    pub contradicted: bool,
    /// Number of alignments tried.
    pub tries: u32,
}

impl EdgeView {
    /// Converts the message of merging.
    pub fn new(edge: &MergeEdge) -> Self {
        let was_found = edge.state() != EdgeState::None;
        // An alignment matches cells; an edge that was restored without its evidence has none.
        let has_evidence = was_found && edge.inliers > 0;
        let known = |value: f64| has_evidence.then_some(value);
        Self {
            edge: edge.id,
            a: format!("robot{}", edge.a),
            b: format!("robot{}", edge.b),
            state: edge.state().name(),
            why_not: edge.refusal().map(AlignmentRefusal::text),
            a_from_b: was_found.then_some([edge.a_from_b.x_m, edge.a_from_b.y_m, edge.a_from_b.yaw_rad]),
            inliers: edge.inliers,
            residual_m: known(edge.residual_m),
            overlap_m2: known(edge.overlap_m2),
            overlap_share: known(edge.overlap_share),
            agreement: known(edge.agreement),
            occupied_f1: known(edge.occupied_f1),
            null_f1_max: known(edge.null_f1_max),
            conflict: known(edge.conflict),
            margin: known(edge.margin),
            closures: edge.closures,
            closures_rejected: edge.closures_rejected,
            closure_residual_m: (edge.closures > 0).then_some(edge.closure_residual_m),
            compared_submaps: edge.compared_submaps,
            contradicted_submaps: edge.contradicted_submaps,
            contradicted: edge.is_contradicted(),
            tries: edge.tries,
        }
    }

    /// Returns whether a relative pose was ever found, even if it was undone since.
    pub fn was_found(&self) -> bool {
        self.a_from_b.is_some()
    }
}

impl fmt::Display for EdgeView {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { a, b, state, inliers, closures, .. } = self;
        let Some([x, y, yaw]) = self.a_from_b else { return write!(f, "{a} {b} {state}") };
        write!(
            f,
            "{a} {b} {state}: x {x:.2} m, y {y:.2} m, {:.1} degrees; {inliers} matching cells, F1 {} (chance {}), {} m2 shared, {closures} closures",
            yaw.to_degrees(),
            figure(self.occupied_f1, 2),
            figure(self.null_f1_max, 2),
            figure(self.overlap_m2, 0),
        )
    }
}

impl FleetView {
    /// Adds what merging says of the robots' maps.
    #[must_use]
    pub fn with_edges(self, edges: &MergeEdges) -> Self {
        Self {
            merge_edges: edges.edges().iter().map(EdgeView::new).collect(),
            contradicted_starts: edges.contradicted_starts().map(|robot| robot.to_string()).collect(),
            edges_unsaved: edges.unsaved != 0,
            ..self
        }
    }
}

/// Formats a figure, or `-` if it is not known.
fn figure(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(|| "-".into(), |value| format!("{value:.decimals$}"))
}

/// Formats all edges as JSON, as on the topic `/merge_edges`, with the robots whose given start the maps contradict, and
/// whether the newest state is not saved.
pub fn edges_json(edges: &MergeEdges) -> String {
    let views: Vec<EdgeView> = edges.edges().iter().map(EdgeView::new).collect();
    let starts: Vec<String> = edges.contradicted_starts().map(|robot| robot.to_string()).collect();
    let message =
        serde_json::json!({ "edges": views, "contradicted_starts": starts, "unsaved": edges.unsaved != 0 });
    serde_json::to_string(&message).unwrap_or_default()
}

/// Formats edges as a table for a terminal.
pub fn edge_table(edges: &[EdgeView]) -> String {
    let mut text = format!(
        "{:>4} {:<15} {:<9} {:>9} {:>9} {:>8} {:>8} {:>9} {:>11} {:>5} {:>7} {:>9} {:>8} {:>12}\n",
        "edge",
        "robots",
        "state",
        "x m",
        "y m",
        "yaw deg",
        "matches",
        "shared m2",
        "residual mm",
        "F1",
        "null F1",
        "closures",
        "rejected",
        "contradicted"
    );
    for e in edges {
        let [x, y, yaw] = [0, 1, 2].map(|axis| e.a_from_b.map(|pose| pose[axis]));
        let _ = writeln!(
            text,
            "{:>4} {:<15} {:<9} {:>9} {:>9} {:>8} {:>8} {:>9} {:>11} {:>5} {:>7} {:>9} {:>8} {:>12}",
            e.edge,
            format!("{} {}", e.a, e.b),
            e.state,
            figure(x, 3),
            figure(y, 3),
            figure(yaw.map(f64::to_degrees), 2),
            e.inliers,
            figure(e.overlap_m2, 0),
            figure(e.residual_m.map(|residual_m| 1e3 * residual_m), 0),
            figure(e.occupied_f1, 2),
            figure(e.null_f1_max, 2),
            e.closures,
            e.closures_rejected,
            format!("{} of {}", e.contradicted_submaps, e.compared_submaps)
        );
    }
    for e in edges {
        if let Some(why_not) = e.why_not {
            let _ =
                writeln!(text, "     {} {} not joined, {} alignments tried: {why_not}", e.a, e.b, e.tries);
        }
    }
    text
}
