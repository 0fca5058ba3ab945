//! Buffers for scans, made once. The scan path fills them and lends them out as a node's; whoever
//! keeps a node copies it ([`Node::kept`]), and a buffer that nobody holds any more is filled again.
//!
//! [`Node::kept`]: crate::Node::kept

use crate::beam_poses::BeamPoses;
use crate::cloud::{Cloud, CloudScratch};
use crate::config::SlamConfig;
use crate::node::Rays;
use msg::Scan;
use std::sync::Arc;

/// The most nodes that the back end holds and has not copied yet. While there are as many, scans
/// become no nodes of the graph. A channel with this room never fills; whoever wants every node, as in
/// a replay, waits while two fewer are under way.
pub const NODES_IN_FLIGHT_MAX: usize = 66;

/// Reuses the memory of clouds and rays; see the module.
pub struct ScanBufferPool {
    clouds: Vec<Arc<Cloud>>,
    rays: Vec<Arc<Rays>>,
    scratch: CloudScratch,
}

impl ScanBufferPool {
    /// Enough for the nodes under way, those matched against, and the scan at hand.
    pub fn new(config: &SlamConfig) -> Self {
        let count = NODES_IN_FLIGHT_MAX + config.tracking.references + 1;
        Self {
            clouds: (0..count).map(|_| Arc::new(Cloud::with_capacity(config.lidar.points_max))).collect(),
            rays: (0..count).map(|_| Arc::new(Rays::with_capacity(msg::BEAMS_MAX))).collect(),
            scratch: CloudScratch::with_capacity(config.lidar.points_max),
        }
    }

    /// The surfaces of a scan.
    pub fn cloud(&mut self, scan: &Scan, sweep: &BeamPoses, config: &SlamConfig) -> Arc<Cloud> {
        let slot = free(&mut self.clouds);
        if let Some(cloud) = Arc::get_mut(slot) {
            cloud.fill(scan, sweep, &config.lidar, &mut self.scratch);
        } else {
            // There are more buffers than can be held; if somebody held them all the same, a new one.
            let mut cloud = Cloud::with_capacity(config.lidar.points_max);
            cloud.fill(scan, sweep, &config.lidar, &mut self.scratch);
            *slot = Arc::new(cloud);
        }
        slot.clone()
    }

    /// The beams of a scan.
    pub fn rays(&mut self, scan: &Scan, sweep: &BeamPoses, config: &SlamConfig) -> Arc<Rays> {
        let slot = free(&mut self.rays);
        if let Some(rays) = Arc::get_mut(slot) {
            rays.fill(scan, sweep, config);
        } else {
            *slot = Arc::new(Rays::new(scan, sweep, config));
        }
        slot.clone()
    }

    /// Whether another node may be handed over, while the scan path itself holds `held` nodes.
    pub fn has_capacity(&self, held: usize) -> bool {
        let lent: usize = self.rays.iter().map(|rays| Arc::strong_count(rays) - 1).sum();
        lent.saturating_sub(held) < NODES_IN_FLIGHT_MAX
    }
}

/// A buffer that nobody holds, if there is one.
fn free<T>(buffers: &mut [Arc<T>]) -> &mut Arc<T> {
    let found = buffers.iter_mut().position(|buffer| Arc::get_mut(buffer).is_some()).unwrap_or(0);
    &mut buffers[found]
}
