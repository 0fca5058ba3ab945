//! What the scan path hands to the back end, and what comes back: plain values.

use crate::cloud::{Cloud, Placement};
use crate::config::SlamConfig;
use msg::{Header, Pose2, Scan};
use std::sync::Arc;

/// A scan that entered the pose graph.
#[derive(Clone, Debug)]
pub struct Node {
    /// Nodes count from 0 without gaps: by the scan path as it makes them, by the back end as it keeps them.
    pub id: u32,
    /// The scan's header.
    pub header: Header,
    /// Pose in the scan path's own frame, which never jumps.
    pub local_from_base: Pose2,
    /// Where odometry says this node lies as seen from the one before.
    pub previous_from_this: Option<Pose2>,
    /// Whether the scan fitted the local map; if not, only odometry ties it to the others.
    pub fits: bool,
    /// Surfaces, for matching.
    pub cloud: Arc<Cloud>,
    /// Beams, for drawing.
    pub rays: Arc<Rays>,
}

/// The back end's answer to a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Revision {
    /// The node that caused it.
    pub cause: u32,
    /// It takes effect with the scan that makes this node, or the first one after it.
    pub effective_from: u32,
    /// The loop-closed map from the scan path's own frame, as the newest node has it.
    pub map_from_local: Pose2,
    /// Closures in force.
    pub closures: u32,
    /// Whether it is known where the robot is in its map; if not, `map_from_local` means nothing.
    pub located: bool,
}

/// A scan's beams as end points in `base_footprint`, metres.
#[derive(Clone, Debug, Default)]
pub struct Rays {
    /// Where the beams start.
    pub sensor: [f32; 2],
    /// Returns.
    pub hits: Vec<[f32; 2]>,
    /// How far beams without a return are known to be free.
    pub misses: Vec<[f32; 2]>,
}

impl Rays {
    /// The beams worth drawing: REP-117's +inf and ranges beyond the maximum saw nothing, NaN and
    /// ranges below the minimum say nothing.
    pub fn new(scan: &Scan, config: &SlamConfig) -> Self {
        let [x, y, _] = config.lidar.base_from_scan;
        let place = Placement::new(config.base_from_scan());
        let clear_m = config.map.clear_without_return_m.min(scan.range_max_m);
        let mut rays = Self { sensor: [x as f32, y as f32], ..Self::default() };
        for (i, &range) in scan.ranges_m().iter().enumerate() {
            let (sin, cos) = scan.angle_rad(i).sin_cos();
            if range >= scan.range_max_m {
                rays.misses.push(place.point([clear_m * cos, clear_m * sin]));
            } else if range >= scan.range_min_m && range > 0.0 && range <= config.map.range_max_m {
                rays.hits.push(place.point([range * cos, range * sin]));
            }
        }
        rays
    }
}
