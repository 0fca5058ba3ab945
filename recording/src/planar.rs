//! Poses in the plane from ROS's poses in space, which are checked: nothing in a file is trusted.

use msg::Pose2;
use msg::pose::yaw_of_quaternion;

/// Largest difference of a quaternion's length from 1; it is normalised.
const UNIT_TOLERANCE: f64 = 0.01;
/// Largest distance from a frame's origin, metres.
const DISTANCE_MAX_M: f64 = 1e6;

/// Returns the pose in the plane of a position in metres and a quaternion x, y, z, w; `None` if they are no pose.
pub fn pose(position: [f64; 3], rotation: [f64; 4]) -> Option<Pose2> {
    let [x, y, _] = position;
    let length = rotation.iter().map(|part| part * part).sum::<f64>().sqrt();
    let is_near = position.iter().all(|part| part.abs() <= DISTANCE_MAX_M);
    // NaN fails each comparison.
    let is_unit = (length - 1.0).abs() <= UNIT_TOLERANCE;
    if !(is_near && is_unit) {
        return None;
    }
    Some(Pose2::new(x, y, yaw_of_quaternion(rotation.map(|part| part / length))))
}
