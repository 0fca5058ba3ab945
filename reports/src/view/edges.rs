//! Merge edges as people and programs read them.

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
    /// Pose of `b`'s map in `a`'s map: x m, y m, yaw rad.
    pub a_from_b: [f64; 3],
    /// Number of occupied cells of both maps that match.
    pub inliers: u32,
    /// Mean distance of matching walls, metres.
    pub residual_m: f64,
    /// Area that both maps know, square metres.
    pub overlap_m2: f64,
    /// Shared area over the smaller map's known area, 0 to 1.
    pub overlap_share: f64,
    /// Share of commonly known cells that agree, 0 to 1.
    pub agreement: f64,
    /// F1 of occupied cells with a tolerance of one cell.
    pub occupied_f1: f64,
    /// Largest such F1 under 20 wrong transforms.
    pub null_f1_max: f64,
    /// Share of one map's walls that lie in the other's free space, 0 to 1.
    pub conflict: f64,
    /// Evidence over that of the second best place.
    pub margin: f64,
    /// Number of closures between submaps in the fleet's pose graph.
    pub closures: u32,
    /// Number of closures found that contradict the others.
    pub closures_rejected: u32,
    /// Mean residual of the closures in the fleet's pose graph, metres.
    pub closure_residual_m: f64,
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
        Self {
            edge: edge.id,
            a: format!("robot{}", edge.a),
            b: format!("robot{}", edge.b),
            state: edge.state().name(),
            why_not: edge.refusal().map(AlignmentRefusal::text),
            a_from_b: [edge.a_from_b.x_m, edge.a_from_b.y_m, edge.a_from_b.yaw_rad],
            inliers: edge.inliers,
            residual_m: edge.residual_m,
            overlap_m2: edge.overlap_m2,
            overlap_share: edge.overlap_share,
            agreement: edge.agreement,
            occupied_f1: edge.occupied_f1,
            null_f1_max: edge.null_f1_max,
            conflict: edge.conflict,
            margin: edge.margin,
            closures: edge.closures,
            closures_rejected: edge.closures_rejected,
            closure_residual_m: edge.closure_residual_m,
            compared_submaps: edge.compared_submaps,
            contradicted_submaps: edge.contradicted_submaps,
            contradicted: edge.is_contradicted(),
            tries: edge.tries,
        }
    }

    /// Returns whether a relative pose was ever found, even if it was undone since.
    pub fn was_found(&self) -> bool {
        self.state != EdgeState::None.name()
    }
}

impl fmt::Display for EdgeView {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [x, y, yaw] = self.a_from_b;
        write!(
            f,
            "{} {} {}: x {x:.2} m, y {y:.2} m, {:.1} degrees; {} matching cells, F1 {:.2} (chance {:.2}), {:.0} m2 shared, {} closures",
            self.a,
            self.b,
            self.state,
            yaw.to_degrees(),
            self.inliers,
            self.occupied_f1,
            self.null_f1_max,
            self.overlap_m2,
            self.closures
        )
    }
}

/// Formats all edges as JSON, as on the topic `/merge_edges`, with the robots whose given start the maps contradict.
pub fn edges_json(edges: &MergeEdges) -> String {
    let views: Vec<EdgeView> = edges.edges().iter().map(EdgeView::new).collect();
    let starts: Vec<String> = edges.contradicted_starts().map(|robot| robot.to_string()).collect();
    let message = serde_json::json!({ "edges": views, "contradicted_starts": starts });
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
        let [x, y, yaw] = e.a_from_b;
        let _ = writeln!(
            text,
            "{:>4} {:<15} {:<9} {x:>9.3} {y:>9.3} {:>8.2} {:>8} {:>9.0} {:>11.0} {:>5.2} {:>7.2} {:>9} {:>8} {:>12}",
            e.edge,
            format!("{} {}", e.a, e.b),
            e.state,
            yaw.to_degrees(),
            e.inliers,
            e.overlap_m2,
            1e3 * e.residual_m,
            e.occupied_f1,
            e.null_f1_max,
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
