//! Velocity commands for robots.

use msg::RobotId;

/// Velocity of `base_footprint` in the plane (geometry_msgs/Twist; axes as in REP-103).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Twist {
    /// Forward speed, m/s.
    pub linear_m_s: f64,
    /// Turning speed, rad/s; counter-clockwise is positive.
    pub angular_rad_s: f64,
}

impl Twist {
    /// Both speeds are 0: the robot stands still.
    pub const STOP: Self = Self { linear_m_s: 0.0, angular_rad_s: 0.0 };
}

/// Velocity that one robot is to drive until its next command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveCommand {
    /// The robot that the command is for.
    pub robot: RobotId,
    /// The velocity asked for.
    pub twist: Twist,
}
