//! What SLAM and merging say about poses.

use crate::{Header, Monotonic, Pose2, ROBOTS_MAX};
use bytemuck::{Pod, Zeroable};

/// How well a robot knows where it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum TrackingState {
    /// No scan yet.
    Starting = 0,
    /// The scan fits the map.
    Tracking = 1,
    /// The scan fits, but says nothing about one direction, as in a long corridor.
    Degenerate = 2,
    /// The scan does not fit: the pose is odometry's, and nothing is drawn.
    Lost = 3,
}

impl TrackingState {
    /// `None` for a code that no state has.
    pub fn from_code(code: u32) -> Option<Self> {
        [Self::Starting, Self::Tracking, Self::Degenerate, Self::Lost].into_iter().find(|s| *s as u32 == code)
    }

    /// One word for tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Starting => "starting",
            Self::Tracking => "tracking",
            Self::Degenerate => "degenerate",
            Self::Lost => "lost",
        }
    }
}

/// SLAM's answer to one scan: where the robot's odometry lies in its map.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Correction {
    /// `stamp` is the scan's.
    pub header: Header,
    /// The scan's `seq`.
    pub scan_seq: u64,
    /// When the scan left its simulator: what scan-to-pose latency is counted from.
    pub scan_sent: Monotonic,
    /// `robotK/map` from `odom`: the transform that SLAM owns (REP-105).
    pub map_from_odom: Pose2,
    /// `robotK/map` from `base_footprint` at the stamp.
    pub map_from_base: Pose2,
    /// Of `map_from_base`, row-major upper triangle over (x, y, yaw): xx, xy, x yaw, yy, y yaw,
    /// yaw yaw; m, rad.
    pub covariance: [f64; 6],
    /// A [`TrackingState`]'s code. Read it by [`Correction::state`].
    pub state: u32,
    /// Nodes in the pose graph.
    pub nodes: u32,
    /// Loop closures in force.
    pub closures: u32,
    /// Zero.
    pub reserved: u32,
}

impl Correction {
    /// The checked state; an unknown code reads as lost.
    pub fn state(&self) -> TrackingState {
        TrackingState::from_code(self.state).unwrap_or(TrackingState::Lost)
    }
}

/// Where one robot's map lies in the merged map.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct MapTransform {
    /// `map` from `robotK/map`.
    pub map_from_robot_map: Pose2,
    /// 1 if the pose is known, 0 if the robot's map is not merged.
    pub known: u32,
    /// Zero.
    pub reserved: u32,
}

/// Where every robot's map lies in the merged map, by [`crate::RobotId::index`].
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct MapTransforms {
    /// `stamp` is that of the newest map merged.
    pub header: Header,
    /// Robots beyond the fleet are not known.
    pub robots: [MapTransform; ROBOTS_MAX],
}
