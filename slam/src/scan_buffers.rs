//! Pool of scan buffers, so that the front end allocates no memory while it runs.
//!
//! The front end fills a buffer and shares it with a node. A buffer is filled again when no node holds it any more, so
//! code that keeps a node copies it ([`Node::kept`]).
//!
//! [`Node::kept`]: crate::Node::kept

use crate::beam_poses::BeamPoses;
use crate::cloud::{Cloud, CloudScratch};
use crate::config::SlamConfig;
use crate::node::Rays;
use msg::Scan;
use std::sync::Arc;

/// Most nodes that the back end holds and has not copied yet; at this number scans do not become nodes of the graph.
/// A channel of this capacity never fills. A replay, which needs every node, waits while two fewer are in flight.
pub const NODES_IN_FLIGHT_MAX: usize = 66;

/// Pool of the clouds and rays of nodes.
pub struct ScanBufferPool {
    clouds: Vec<Arc<Cloud>>,
    rays: Vec<Arc<Rays>>,
    scratch: CloudScratch,
}

impl ScanBufferPool {
    /// Allocates buffers for the nodes in flight, the references of scan matching and the current scan.
    pub fn new(config: &SlamConfig) -> Self {
        let count = NODES_IN_FLIGHT_MAX + config.tracking.references + 1;
        Self {
            clouds: (0..count).map(|_| Arc::new(Cloud::with_capacity(config.lidar.points_max))).collect(),
            rays: (0..count).map(|_| Arc::new(Rays::with_capacity(msg::BEAMS_MAX))).collect(),
            scratch: CloudScratch::with_capacity(config.lidar.points_max),
        }
    }

    /// The surface points of a scan, in a free buffer.
    pub fn cloud(&mut self, scan: &Scan, sweep: &BeamPoses, config: &SlamConfig) -> Arc<Cloud> {
        let slot = free(&mut self.clouds);
        if let Some(cloud) = Arc::get_mut(slot) {
            cloud.fill(scan, sweep, &config.lidar, &mut self.scratch);
        } else {
            // Normally a buffer is free; if callers hold all of them, a new one replaces one of theirs.
            let mut cloud = Cloud::with_capacity(config.lidar.points_max);
            cloud.fill(scan, sweep, &config.lidar, &mut self.scratch);
            *slot = Arc::new(cloud);
        }
        slot.clone()
    }

    /// The beams of a scan, in a free buffer.
    pub fn rays(&mut self, scan: &Scan, sweep: &BeamPoses, config: &SlamConfig) -> Arc<Rays> {
        let slot = free(&mut self.rays);
        if let Some(rays) = Arc::get_mut(slot) {
            rays.fill(scan, sweep, config);
        } else {
            *slot = Arc::new(Rays::new(scan, sweep, config));
        }
        slot.clone()
    }

    /// Whether another node may be published, while the front end itself holds `held` nodes.
    pub fn has_capacity(&self, held: usize) -> bool {
        let shared: usize = self.rays.iter().map(|rays| Arc::strong_count(rays) - 1).sum();
        shared.saturating_sub(held) < NODES_IN_FLIGHT_MAX
    }
}

/// A buffer that no node holds, or the first one if all are held.
fn free<T>(buffers: &mut [Arc<T>]) -> &mut Arc<T> {
    let found = buffers.iter_mut().position(|buffer| Arc::get_mut(buffer).is_some()).unwrap_or(0);
    &mut buffers[found]
}
