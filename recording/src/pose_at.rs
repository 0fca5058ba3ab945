//! Poses between those of odometry.

use msg::{Pose2, Stamp};

/// Longest time between a scan and the odometry before or after it, seconds.
const GAP_MAX_S: f64 = 0.5;

/// Returns the pose at a time, between its two neighbours; `None` if one of them is too far away.
pub(crate) fn pose_at(poses: &[(Stamp, Pose2)], at: Stamp) -> Option<Pose2> {
    let after = poses.partition_point(|(stamp, _)| *stamp < at);
    let near = |index: usize| poses.get(index).filter(|(stamp, _)| (*stamp - at).abs() <= GAP_MAX_S);
    let before = after.checked_sub(1).and_then(near);
    match (before, near(after)) {
        (Some((from, a)), Some((to, b))) => {
            let share = if *to == *from { 0.0 } else { (at - *from) / (*to - *from) };
            let turn = (b.yaw_rad - a.yaw_rad).sin().atan2((b.yaw_rad - a.yaw_rad).cos());
            let between = |a: f64, b: f64| a + (b - a) * share;
            Some(Pose2::new(between(a.x_m, b.x_m), between(a.y_m, b.y_m), a.yaw_rad + turn * share))
        }
        (Some((_, pose)), None) | (None, Some((_, pose))) => Some(*pose),
        (None, None) => None,
    }
}
