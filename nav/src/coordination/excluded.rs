//! Areas of the map that no robot may enter.

use crate::clearance_map::is_inside;
use msg::{ExclusionZone, Pose2};

/// Whether a pose in the zones' frame lies in one of them.
pub(super) fn is_in_zone(zones: &[ExclusionZone], pose: &Pose2) -> bool {
    zones.iter().any(|zone| is_inside([pose.x_m, pose.y_m], zone.corners_m()))
}
