//! Trajectories as `evo` and the TUM RGB-D benchmark read them (Sturm et al., IROS 2012).

use msg::{Pose2, Stamp};
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::Path;

/// Writes one line for each pose, `t x y z qx qy qz qw`: seconds, metres, unit quaternion. A pose with a remark is a comment, which
/// begins with the remark.
///
/// # Errors
/// The file cannot be written.
pub fn write_trajectory(
    path: &Path,
    poses: impl Iterator<Item = (Stamp, Pose2, Option<String>)>,
) -> std::io::Result<()> {
    let mut file = BufWriter::new(File::create(path)?);
    for (stamp, pose, remark) in poses {
        if let Some(remark) = remark {
            write!(file, "# {remark}: ")?;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_are_lines_and_those_with_a_remark_comments() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.tum");
        let pose = Pose2::new(1.0, -2.0, core::f64::consts::PI);
        let poses = [(Stamp(-1_500_000_000), pose, None), (Stamp(2_000_000_499), pose, Some("lost".into()))];
        write_trajectory(&path, poses.into_iter()).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[0].starts_with("-1.500000 1.000000 -2.000000 0 0 0 1.000000000 "), "{text}");
        assert!(lines[1].starts_with("# lost: 2.000000 ") && lines.len() == 2, "{text}");
    }
}
