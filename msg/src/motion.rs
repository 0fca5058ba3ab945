//! How a robot is told to move, how it thinks it moved, how it did, and where its parts are.

use crate::{Header, Pose2};
use bytemuck::{Pod, Zeroable};

/// A wished velocity of `base_footprint` (geometry_msgs/Twist). Valid for a short time only:
/// a robot that hears nothing stops.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct VelocityCommand {
    /// `stamp` is when the bridge took it.
    pub header: Header,
    /// Forward, m/s.
    pub linear_m_s: f64,
    /// Counter-clockwise, rad/s.
    pub angular_rad_s: f64,
}

/// What the wheels say (nav_msgs/Odometry): smooth, but it drifts.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Odometry {
    /// `stamp` is when the pose held.
    pub header: Header,
    /// Pose of `base_footprint` in `odom`.
    pub odom_from_base: Pose2,
    /// Forward, m/s, in `base_footprint`.
    pub linear_m_s: f64,
    /// Counter-clockwise, rad/s.
    pub angular_rad_s: f64,
}

/// Where a simulated robot really is. Only telemetry, tests and the peers' simulators may read it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct GroundTruth {
    /// `stamp` is when the pose held.
    pub header: Header,
    /// Pose of `base_footprint` in `world`.
    pub world_from_base: Pose2,
    /// Forward, m/s, in `base_footprint`.
    pub linear_m_s: f64,
    /// Counter-clockwise, rad/s.
    pub angular_rad_s: f64,
    /// How many times the body has begun to touch something other than the floor.
    pub contacts: u64,
}

/// The run's time (rosgraph_msgs/Clock).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Clock {
    /// `stamp` is the message.
    pub header: Header,
}

/// The most links one robot reports.
pub const LINKS_MAX: usize = 8;

/// A frame of one robot (REP-105 and ROBOTIS's model of the TurtleBot3).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Link {
    /// Where the wheels started counting.
    Odom = 1,
    /// The robot's position on the floor.
    BaseFootprint = 2,
    /// The body.
    BaseLink = 3,
    /// The LiDAR.
    BaseScan = 4,
    /// The left wheel, turning.
    WheelLeft = 5,
    /// The right wheel, turning.
    WheelRight = 6,
    /// The inertial unit.
    Imu = 7,
}

impl Link {
    /// All links, in the order of their codes.
    pub const ALL: [Self; 7] = [
        Self::Odom,
        Self::BaseFootprint,
        Self::BaseLink,
        Self::BaseScan,
        Self::WheelLeft,
        Self::WheelRight,
        Self::Imu,
    ];

    /// `None` for a code that no link has.
    pub fn from_code(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|link| *link as u32 == code)
    }

    /// Whether it sits still on its parent.
    pub fn is_fixed(self) -> bool {
        matches!(self, Self::BaseLink | Self::BaseScan | Self::Imu)
    }

    /// ROBOTIS's name of the frame.
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

/// One edge of the transform tree, `parent_from_child`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct LinkTransform {
    /// A [`Link`]'s code.
    pub parent: u32,
    /// A [`Link`]'s code.
    pub child: u32,
    /// Metres.
    pub translation_m: [f64; 3],
    /// Unit quaternion x, y, z, w.
    pub rotation_xyzw: [f64; 4],
}

/// One robot's part of /tf at one time.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Transforms {
    /// `stamp` holds for every link.
    pub header: Header,
    /// How many of `links` are set. Read it by [`Transforms::links`].
    pub len: u32,
    /// Zero.
    pub reserved: u32,
    /// Read it by [`Transforms::links`].
    pub links: [LinkTransform; LINKS_MAX],
}

impl Transforms {
    /// The set links.
    pub fn links(&self) -> &[LinkTransform] {
        &self.links[..(self.len as usize).min(LINKS_MAX)]
    }
}
