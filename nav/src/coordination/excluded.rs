//! Areas of the map that no robot may enter.

use crate::clearance_map::{ClearanceMap, is_inside};
use msg::{ExclusionZone, Pose2};

/// Whether a cell's centre lies where robots are kept out.
pub(super) fn is_excluded(map: &ClearanceMap, excluded: &[Vec<[f64; 2]>], cell: usize) -> bool {
    // The centre takes longer than all else here.
    !excluded.is_empty() && {
        let centre_m = map.cell_centre_m(cell);
        excluded.iter().any(|polygon| is_inside(centre_m, polygon))
    }
}

/// Whether a pose in the zones' frame lies in one of them.
pub(super) fn is_in_zone(zones: &[ExclusionZone], pose: &Pose2) -> bool {
    zones.iter().any(|zone| is_inside([pose.x_m, pose.y_m], zone.corners_m()))
}
