//! Trajectory files of a replay: one line a scan, as `evo` and the TUM benchmark read them.

use msg::{Pose2, Stamp};
use slam::PlaceInMap;
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::Path;

/// Writes one line a scan, `t x y z qx qy qz qw`: seconds, metres, unit quaternion. Scans whose place
/// in the map is not known are comments.
pub(super) fn write_trajectory(
    path: &Path,
    poses: impl Iterator<Item = (Stamp, Pose2, PlaceInMap)>,
) -> std::io::Result<()> {
    let mut file = BufWriter::new(File::create(path)?);
    for (stamp, pose, place) in poses {
        match place {
            PlaceInMap::Known => {}
            PlaceInMap::Unplaced(first_node) => {
                write!(file, "# not placed in the map, component of node {first_node}: ")?
            }
            PlaceInMap::Lost => write!(file, "# lost: ")?,
        }
        let microseconds = stamp.0.div_euclid(1000) + i64::from(stamp.0.rem_euclid(1000) >= 500);
        let sign = if microseconds < 0 { "-" } else { "" };
        let (seconds, fraction) = (microseconds.abs() / 1_000_000, microseconds.abs() % 1_000_000);
        let (sin, cos) = (pose.yaw_rad / 2.0).sin_cos();
        writeln!(
            file,
            "{sign}{seconds}.{fraction:06} {:.6} {:.6} 0 0 0 {sin:.9} {cos:.9}",
            pose.x_m, pose.y_m
        )?;
    }
    file.flush()
}
