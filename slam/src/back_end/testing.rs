//! A back end with a straight path, for unit tests.

use super::BackEnd;
use crate::common::{FULL, Noise, cast};
use crate::config::SlamConfig;
use crate::testing::standing_node;
use msg::{Pose2, Stamp};

/// Creates a back end with this number of nodes along x, `step_m` metres apart, whose scans see nothing; without edges.
pub fn straight_path(nodes: u32, step_m: f64) -> BackEnd {
    let mut back = BackEnd::new(SlamConfig::default());
    for id in 0..nodes {
        let at = Pose2::new(step_m * f64::from(id), 0.0, 0.0);
        let scan = cast(&[], &FULL, at, Stamp(i64::from(id)), &mut Noise::new(1));
        back.graph.add_node(at);
        back.nodes.push(standing_node(id, &scan, at, &back.config.lidar));
    }
    back
}
