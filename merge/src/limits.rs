//! Valid ranges of every grid and pose from outside.

use msg::Pose2;

/// Plausible sides of a grid's cell, metres.
pub(crate) const RESOLUTION_M: core::ops::RangeInclusive<f64> = 0.005..=1.0;
/// Largest distance from a frame's origin, metres: a pose beyond it is an error.
const DISTANCE_M_MAX: f64 = 100_000.0;

/// Returns whether a pose is finite and within [`DISTANCE_M_MAX`] of its frame's origin.
pub(crate) fn is_plausible(pose: Pose2) -> bool {
    pose.is_finite() && pose.x_m.abs() <= DISTANCE_M_MAX && pose.y_m.abs() <= DISTANCE_M_MAX
}
