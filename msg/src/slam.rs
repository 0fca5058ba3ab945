//! Results of SLAM and merging: corrections and transforms between maps.

use crate::{Header, Monotonic, Pose2, ROBOTS_MAX};
use bytemuck::{Pod, Zeroable};

/// Quality of a robot's pose estimate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum TrackingState {
    /// No scan was processed yet.
    Starting = 0,
    /// The scan matches the map.
    Tracking = 1,
    /// The scan matches the map but does not constrain one direction, as in a long corridor.
    Degenerate = 2,
    /// The scan does not match: the pose comes from odometry and the map does not change.
    Lost = 3,
}

impl TrackingState {
    /// Decodes a state; `None` for an unknown code.
    pub fn from_code(code: u32) -> Option<Self> {
        [Self::Starting, Self::Tracking, Self::Degenerate, Self::Lost].into_iter().find(|s| *s as u32 == code)
    }

    /// Returns the state's name in tables and in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Starting => "starting",
            Self::Tracking => "tracking",
            Self::Degenerate => "degenerate",
            Self::Lost => "lost",
        }
    }
}

/// Result of SLAM for one scan: the transform from odometry to the map.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Correction {
    /// Header whose `stamp` is that of the scan.
    pub header: Header,
    /// Number of the scan, its header's `seq`.
    pub scan_seq: u64,
    /// Time at which the scan left its simulator. Scan-to-pose latency is counted from it.
    pub scan_sent: Monotonic,
    /// Transform to `robotK/map` from `odom`, which REP-105 assigns to SLAM.
    pub map_from_odom: Pose2,
    /// Pose of `base_footprint` in `robotK/map` at the stamp.
    pub map_from_base: Pose2,
    /// Covariance of `map_from_base`, row-major upper triangle over (x, y, yaw): xx, xy, x yaw, yy,
    /// y yaw, yaw yaw; m, rad.
    pub covariance: [f64; 6],
    /// Code of a [`TrackingState`]. Read it by [`Correction::state`].
    pub state: u32,
    /// Number of nodes in the pose graph.
    pub nodes: u32,
    /// Number of loop closures in the pose graph.
    pub closures: u32,
    /// Padding, always zero.
    pub reserved: u32,
}

impl Correction {
    /// Decodes the state; an unknown code reads as lost.
    pub fn state(&self) -> TrackingState {
        TrackingState::from_code(self.state).unwrap_or(TrackingState::Lost)
    }
}

/// Transform from one robot's map to the merged map.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct MapTransform {
    /// Transform to `map` from `robotK/map`.
    pub map_from_robot_map: Pose2,
    /// 1 if the transform is known, 0 if the robot's map is not merged.
    pub known: u32,
    /// Padding, always zero.
    pub reserved: u32,
}

/// Transforms from every robot's map to the merged map.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct MapTransforms {
    /// Header whose `stamp` is that of the newest merged map.
    pub header: Header,
    /// Transforms by [`crate::RobotId::index`]. Those beyond the fleet are unknown.
    pub robots: [MapTransform; ROBOTS_MAX],
}
