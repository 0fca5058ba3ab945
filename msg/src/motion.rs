//! Messages about motion, such as velocity commands, odometry, ground truth, clock and transforms.

use crate::{CommandSource, Header, Pose2};
use bytemuck::{Pod, Zeroable};

/// Commanded velocity of `base_footprint` (geometry_msgs/Twist).
///
/// A command is valid for a short time only: a robot without a newer command stops.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct VelocityCommand {
    /// Header whose `stamp` is the time at which the bridge received the command.
    pub header: Header,
    /// Forward velocity, m/s.
    pub linear_m_s: f64,
    /// Turning rate, rad/s, counter-clockwise.
    pub angular_rad_s: f64,
    /// Who sent it.
    pub sender: CommandSource,
}

/// Wheel odometry (nav_msgs/Odometry): smooth, but it drifts.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable, serde::Serialize, serde::Deserialize)]
pub struct Odometry {
    /// Header whose `stamp` is the time of the pose.
    pub header: Header,
    /// Pose of `base_footprint` in `odom`.
    pub odom_from_base: Pose2,
    /// Forward velocity in `base_footprint`, m/s.
    pub linear_m_s: f64,
    /// Turning rate, rad/s, counter-clockwise.
    pub angular_rad_s: f64,
}

/// True pose of a simulated robot. Only telemetry, tests and the other robots' simulators may read it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct GroundTruth {
    /// Header whose `stamp` is the time of the pose.
    pub header: Header,
    /// Pose of `base_footprint` in `world`.
    pub world_from_base: Pose2,
    /// Forward velocity in `base_footprint`, m/s.
    pub linear_m_s: f64,
    /// Turning rate, rad/s, counter-clockwise.
    pub angular_rad_s: f64,
    /// Number of times that the body began to touch anything but the floor.
    pub contacts: u64,
}

/// Time of the run (rosgraph_msgs/Clock).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Clock {
    /// Header whose `stamp` is the content of the message.
    pub header: Header,
}

/// Largest number of transforms in one [`Transforms`] message.
pub const TRANSFORMS_MAX: usize = 8;

/// Coordinate frame of one robot (REP-105 and ROBOTIS's model of the TurtleBot3).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum RobotFrame {
    /// Frame in which the wheel odometry starts at zero.
    Odom = 1,
    /// Projection of the robot onto the floor.
    BaseFootprint = 2,
    /// Frame of the robot's body.
    BaseLink = 3,
    /// Frame of the LiDAR.
    BaseScan = 4,
    /// Frame of the left wheel, which turns with it.
    WheelLeft = 5,
    /// Frame of the right wheel, which turns with it.
    WheelRight = 6,
    /// Frame of the inertial measurement unit.
    Imu = 7,
}

impl RobotFrame {
    /// All frames in the order of their codes.
    pub const ALL: [Self; 7] = [
        Self::Odom,
        Self::BaseFootprint,
        Self::BaseLink,
        Self::BaseScan,
        Self::WheelLeft,
        Self::WheelRight,
        Self::Imu,
    ];

    /// Decodes a frame; `None` for an unknown code.
    pub fn from_code(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|frame| *frame as u32 == code)
    }

    /// Returns whether the frame never moves against its parent (tf_static).
    pub fn is_fixed(self) -> bool {
        matches!(self, Self::BaseLink | Self::BaseScan | Self::Imu)
    }

    /// Returns ROBOTIS's name of the frame.
    pub fn name(self) -> &'static str {
        match self {
            Self::Odom => "odom",
            Self::BaseFootprint => "base_footprint",
            Self::BaseLink => "base_link",
            Self::BaseScan => "base_scan",
            Self::WheelLeft => "wheel_left_link",
            Self::WheelRight => "wheel_right_link",
            Self::Imu => "imu_link",
        }
    }
}

/// Transform `parent_from_child` between two frames.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct RobotFrameTransform {
    /// Code of the parent [`RobotFrame`].
    pub parent_frame: u32,
    /// Code of the child [`RobotFrame`].
    pub child_frame: u32,
    /// Position of the child in the parent's frame, metres.
    pub translation_m: [f64; 3],
    /// Rotation of the child in the parent's frame, unit quaternion x, y, z, w.
    pub rotation_xyzw: [f64; 4],
}

/// Transforms between one robot's frames at one time (its part of /tf).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Transforms {
    /// Header whose `stamp` is the time of every transform.
    pub header: Header,
    /// Number of `transforms` in use. Read them by [`Transforms::transforms`].
    pub len: u32,
    /// Padding, always zero.
    pub reserved: u32,
    /// Storage of the transforms. Read it by [`Transforms::transforms`].
    pub transforms: [RobotFrameTransform; TRANSFORMS_MAX],
}

impl Transforms {
    /// Returns the transforms in use.
    pub fn transforms(&self) -> &[RobotFrameTransform] {
        &self.transforms[..(self.len as usize).min(TRANSFORMS_MAX)]
    }
}
