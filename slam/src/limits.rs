//! Limits of stored values: values are kept within them where they are made, and sessions beyond them are refused.

/// Largest coordinate, metres: no building and no plausible odometry is larger.
pub(crate) const POSITION_M_MAX: f64 = 1e9;
/// Largest coordinate of odometry, metres: sums of a few stay within [`POSITION_M_MAX`].
pub(crate) const ODOMETRY_M_MAX: f64 = 1e8;
/// Largest coordinate of a point that a scan saw, metres.
pub(crate) const POINT_M_MAX: f32 = 1e4;
/// Longest beam, and largest distance of a LiDAR from the middle of its robot, metres: their sum with [`SWEEP_M_MAX`] is within
/// [`POINT_M_MAX`].
pub(crate) const REACH_M_MAX: f32 = 4e3;
/// Largest motion of a robot during one sweep, metres: more is an error of odometry.
pub(crate) const SWEEP_M_MAX: f64 = 1e3;
/// Largest standard deviation of an estimate, metres and radians.
pub(crate) const SIGMA_MAX: f64 = 1e3;
/// Longest time in which nothing measured the motion, seconds: 30 years.
pub(crate) const UNMEASURED_S_MAX: f32 = 1e9;
/// Longest interval between two scans, seconds.
pub(crate) const INTERVAL_S_MAX: f64 = 1e9;
/// Frame updates that may wait for their node; beyond them the oldest is dropped, which a newer one replaces anyway.
pub(crate) const FRAME_UPDATES_MAX: usize = 64;
