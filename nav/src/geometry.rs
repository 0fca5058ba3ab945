//! Distances and directions between points of one frame.

use msg::{Pose2, pose::wrap_angle};

/// Distance between two points, metres.
pub fn distance_m(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Direction from one point to another, radians from the frame's x axis.
pub fn bearing_rad(from: [f64; 2], to: [f64; 2]) -> f64 {
    (to[1] - from[1]).atan2(to[0] - from[0])
}

/// Angle by which a robot has to turn to face a point of the map, radians in -pi..=pi.
pub fn heading_error_rad(map_from_base: Pose2, point_m: [f64; 2]) -> f64 {
    wrap_angle(bearing_rad([map_from_base.x_m, map_from_base.y_m], point_m) - map_from_base.yaw_rad)
}
