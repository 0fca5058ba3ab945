//! Trajectory files of a replay: one line a scan.

use formats::tum;
use msg::{Pose2, Stamp};
use slam::PlaceInMap;
use std::path::Path;

/// Writes one line a scan. Scans whose place in the map is not known are comments.
pub(super) fn write_trajectory(
    path: &Path,
    poses: impl Iterator<Item = (Stamp, Pose2, PlaceInMap)>,
) -> std::io::Result<()> {
    let remark = |place| match place {
        PlaceInMap::Known => None,
        PlaceInMap::Unplaced(node) => Some(format!("not placed in the map, component of node {node}")),
        PlaceInMap::Lost => Some("lost".into()),
    };
    tum::write_trajectory(path, poses.map(|(stamp, pose, place)| (stamp, pose, remark(place))))
}
