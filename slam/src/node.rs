//! What the scan path hands to the back end, and what comes back: plain values.

use crate::cloud::Cloud;
use crate::config::SlamConfig;
use crate::sweep::Sweep;
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
    /// Whether it contradicts the nodes before: the robot is not where odometry has it, and nothing
    /// ties this node to the ones before until its place is found.
    pub torn: bool,
    /// The back end's: set while the node is in a piece that is not tied to the map; the piece's first node.
    pub adrift: Option<u32>,
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

impl Node {
    /// Whether the node is part of the map: drawn, matched against, given out.
    pub fn in_map(&self) -> bool {
        self.fits && self.adrift.is_none()
    }

    /// A copy that owns what it needs, and no more: for whoever keeps nodes. The scan path's buffers
    /// are given back.
    pub fn kept(self) -> Self {
        let (cloud, rays) = (Arc::new(Cloud::clone(&self.cloud)), Arc::new(Rays::clone(&self.rays)));
        Self { cloud, rays, ..self }
    }
}

impl Rays {
    /// Without beams, with room for so many.
    pub fn with_room(beams: usize) -> Self {
        Self { sensor: [0.0; 2], hits: Vec::with_capacity(beams), misses: Vec::with_capacity(beams) }
    }

    /// The beams worth drawing, see [`Rays::fill`].
    pub fn new(scan: &Scan, sweep: &Sweep, config: &SlamConfig) -> Self {
        let mut rays = Self::default();
        rays.fill(scan, sweep, config);
        rays
    }

    /// Becomes the beams of a scan that are worth drawing: REP-117's +inf and ranges beyond the
    /// maximum saw nothing, NaN and ranges below the minimum say nothing.
    pub fn fill(&mut self, scan: &Scan, sweep: &Sweep, config: &SlamConfig) {
        let clear_m = config.map.clear_without_return_m.min(scan.range_max_m);
        let still = sweep.place(0);
        self.sensor = sweep.middle();
        self.hits.clear();
        self.misses.clear();
        for (beam, &range) in scan.ranges_m().iter().enumerate() {
            let (drawn, reach) = if range >= scan.range_max_m {
                (&mut self.misses, clear_m)
            } else if range >= scan.range_min_m && range > 0.0 && range <= config.map.range_max_m {
                (&mut self.hits, range)
            } else {
                continue;
            };
            let place = if sweep.moves() { sweep.place(beam) } else { still };
            let (sin, cos) = scan.angle_rad(beam).sin_cos();
            drawn.push(place.point([reach * cos, reach * sin]));
        }
    }
}
