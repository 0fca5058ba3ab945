//! Helpers of this crate's unit tests.

use crate::beam_poses::BeamPoses;
use crate::cloud::{Cloud, CloudScratch};
use crate::config::LidarConfig;
use crate::node::{Node, Rays, SweptPath};
use msg::{Header, Pose2, Scan};
use std::sync::Arc;

/// Creates a node whose robot stood while it scanned. `local_from_base`: where the front end has it.
pub fn standing_node(id: u32, scan: &Scan, local_from_base: Pose2, lidar: &LidarConfig) -> Node {
    let mut cloud = Cloud::with_capacity(lidar.points_max);
    let mut scratch = CloudScratch::with_capacity(lidar.points_max);
    cloud.fill(scan, &BeamPoses::still(Pose2::IDENTITY), lidar, &mut scratch);
    Node {
        id,
        header: Header::default(),
        local_from_base,
        previous_from_this: None,
        is_tracked: true,
        odometry_break: false,
        disconnected_component: None,
        uncertain_component: None,
        unmeasured_s: 0.0,
        slip: [0.0; 3],
        possibly_kidnapped: false,
        cloud: Arc::new(cloud),
        rays: Arc::new(Rays::default()),
        swept_path: SweptPath::default(),
    }
}
