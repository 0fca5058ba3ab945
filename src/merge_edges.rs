//! Merge edges as people and programs read them.

use msg::MergeEdge;
use serde::Serialize;
use std::fmt::Write;

/// How one robot's map lies in another's, and what speaks for it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EdgeView {
    /// The edge's number.
    pub edge: u32,
    /// `robot1`: the robot it is seen from.
    pub a: String,
    /// `robot2`: the robot that is seen.
    pub b: String,
    /// `accepted`, `pinned`, `undone` ...
    pub state: &'static str,
    /// `a`'s map from `b`'s: x, y in metres, yaw in radians.
    pub a_from_b: [f64; 3],
    /// Occupied cells found again, of both maps together.
    pub inliers: u32,
    /// Mean distance of walls found again, metres.
    pub residual_m: f64,
    /// What both maps know, square metres.
    pub overlap_m2: f64,
    /// The same over what the map that knows less knows.
    pub overlap_share: f64,
    /// Share of the cells both know on which they agree.
    pub strict: f64,
    /// F1 of occupied cells at one cell's tolerance.
    pub occupied_f1: f64,
    /// The largest such F1 under 20 wrong transforms.
    pub null_f1: f64,
    /// Walls of one map in the middle of the other's floor.
    pub conflict: f64,
    /// Evidence over that of the best other place.
    pub margin: f64,
    /// Closures between submaps in force.
    pub closures: u32,
    /// Closures found and not believed together with the others.
    pub closures_out: u32,
    /// Mean distance by which the fleet's graph leaves its closures, metres.
    pub closure_residual_m: f64,
    /// Alignments tried.
    pub tries: u32,
}

impl EdgeView {
    /// Names the figures.
    pub fn new(edge: &MergeEdge) -> Self {
        Self {
            edge: edge.id,
            a: format!("robot{}", edge.a),
            b: format!("robot{}", edge.b),
            state: edge.state().name(),
            a_from_b: [edge.a_from_b.x_m, edge.a_from_b.y_m, edge.a_from_b.yaw_rad],
            inliers: edge.inliers,
            residual_m: edge.residual_m,
            overlap_m2: edge.overlap_m2,
            overlap_share: edge.overlap_share,
            strict: edge.strict,
            occupied_f1: edge.occupied_f1,
            null_f1: edge.null_f1,
            conflict: edge.conflict,
            margin: edge.margin,
            closures: edge.closures,
            closures_out: edge.closures_out,
            closure_residual_m: edge.closure_residual_m,
            tries: edge.tries,
        }
    }
}

/// A table for a terminal.
pub fn table(edges: &[EdgeView]) -> String {
    let mut text = format!(
        "{:>4} {:<15} {:<9} {:>9} {:>9} {:>8} {:>8} {:>8} {:>10} {:>5} {:>5} {:>9}\n",
        "edge",
        "robots",
        "state",
        "x m",
        "y m",
        "yaw deg",
        "inliers",
        "shared",
        "resid. mm",
        "F1",
        "null",
        "closures"
    );
    for e in edges {
        let [x, y, yaw] = e.a_from_b;
        let _ = writeln!(
            text,
            "{:>4} {:<15} {:<9} {x:>9.3} {y:>9.3} {:>8.2} {:>8} {:>5.0} m2 {:>10.0} {:>5.2} {:>5.2} {:>5} -{:>2}",
            e.edge,
            format!("{} {}", e.a, e.b),
            e.state,
            yaw.to_degrees(),
            e.inliers,
            e.overlap_m2,
            1e3 * e.residual_m,
            e.occupied_f1,
            e.null_f1,
            e.closures,
            e.closures_out
        );
    }
    text
}
