//! Results of SLAM and merging: pose estimates and transforms between maps.

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
    /// The scan matches the map but leaves a direction open, as in a long corridor, or sees nothing, as on open floor, or nothing
    /// that is known: odometry tells the rest.
    Degenerate = 2,
    /// The scan contradicts the map, or the pose by odometry is missing or too uncertain: the map does not change.
    Lost = 3,
    /// The scan matches the map, but there is evidence that the map is wrong: this pose may be metres off.
    MapUnreliable = 4,
    /// The pose is what a person said; scans have not confirmed it yet.
    Unconfirmed = 5,
    /// SLAM is paused: no scan is processed, and the pose is odometry's.
    Paused = 6,
}

impl TrackingState {
    /// The code of statistics of a robot whose SLAM has not answered lately: its state is not known.
    pub const UNKNOWN_CODE: u32 = u32::MAX;

    /// Decodes a state; `None` for an unknown code.
    pub fn from_code(code: u32) -> Option<Self> {
        const STATES: [TrackingState; 7] = [
            TrackingState::Starting,
            TrackingState::Tracking,
            TrackingState::Degenerate,
            TrackingState::Lost,
            TrackingState::MapUnreliable,
            TrackingState::Unconfirmed,
            TrackingState::Paused,
        ];
        STATES.into_iter().find(|state| *state as u32 == code)
    }

    /// Returns the state's name in tables and in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Starting => "starting",
            Self::Tracking => "tracking",
            Self::Degenerate => "degenerate",
            Self::Lost => "lost",
            Self::MapUnreliable => "unreliable",
            Self::Unconfirmed => "unconfirmed",
            Self::Paused => "paused",
        }
    }
}

/// Result of SLAM for one scan: the pose in the map, its covariance and the transform from odometry to the map.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct PoseEstimate {
    /// Header whose `stamp` is that of the scan.
    pub header: Header,
    /// Number of the scan, its header's `seq`.
    pub scan_seq: u64,
    /// Time at which the scan left its simulator. Scan-to-pose latency is counted from it.
    pub scan_sent: Monotonic,
    /// Transform to `robotK/map` from `odom`, which REP-105 assigns to SLAM. Read it by [`PoseEstimate::map_from_odom`].
    pub map_from_odom: Pose2,
    /// Pose of `base_footprint` in `robotK/map` at the stamp.
    pub map_from_base: Pose2,
    /// Covariance of `map_from_base`, row-major upper triangle over (x, y, yaw): xx, xy, x yaw, yy,
    /// y yaw, yaw yaw; m, rad.
    pub covariance: [f64; 6],
    /// Code of a [`TrackingState`]. Read it by [`PoseEstimate::state`].
    pub state: u32,
    /// Number of nodes in the pose graph.
    pub nodes: u32,
    /// Number of loop closures in the pose graph.
    pub closures: u32,
    /// 1 if `map_from_odom` is not known, because odometry or the robot's place in the map never was; else 0.
    pub map_from_odom_unknown: u32,
}

impl PoseEstimate {
    /// Transform to `robotK/map` from `odom`; `None` if it is not known. While odometry is missing or the robot is not
    /// located, it is the last known one.
    pub fn map_from_odom(&self) -> Option<Pose2> {
        (self.map_from_odom_unknown == 0).then_some(self.map_from_odom)
    }

    /// Whether scans tell where the robot is in its map: a robot may be driven to a goal by this pose.
    pub fn is_located(&self) -> bool {
        let is_by_scans = match self.state() {
            TrackingState::Starting
            | TrackingState::Tracking
            | TrackingState::Degenerate
            | TrackingState::MapUnreliable => true,
            TrackingState::Lost | TrackingState::Unconfirmed | TrackingState::Paused => false,
        };
        is_by_scans && self.nodes > 0
    }

    /// Returns the pose estimate in another map frame, of which `other_from_map` is the pose of this one.
    pub fn transformed(&self, other_from_map: Pose2) -> Self {
        let (sin, cos) = other_from_map.yaw_rad.sin_cos();
        let [xx, xy, x_yaw, yy, y_yaw, yaw_yaw] = self.covariance;
        // The covariance of R p, with the rotation R of positions: R C R^T.
        let covariance = [
            cos * cos * xx - 2.0 * cos * sin * xy + sin * sin * yy,
            cos * sin * (xx - yy) + (cos * cos - sin * sin) * xy,
            cos * x_yaw - sin * y_yaw,
            sin * sin * xx + 2.0 * cos * sin * xy + cos * cos * yy,
            sin * x_yaw + cos * y_yaw,
            yaw_yaw,
        ];
        Self {
            map_from_odom: other_from_map * self.map_from_odom,
            map_from_base: other_from_map * self.map_from_base,
            covariance,
            ..*self
        }
    }

    /// Standard deviation of the position in its least certain direction, metres.
    pub fn position_sigma_m(&self) -> f64 {
        let [xx, xy, _, yy, ..] = self.covariance;
        // The larger eigenvalue of the position's part.
        ((xx + yy) / 2.0 + ((xx - yy) / 2.0).hypot(xy)).sqrt()
    }

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
    /// Number of the robot's map frame, [`crate::SubmapPoses::map_frame`]: 0 is the one in which the robot began.
    pub map_frame: u32,
}

impl MapTransform {
    /// Returns frame `map` from the robot's map, if it is known.
    pub fn known_pose(&self) -> Option<Pose2> {
        (self.known == 1).then_some(self.map_from_robot_map)
    }
}

/// Transforms from every robot's map to the merged map.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct MapTransforms {
    /// Header whose `stamp` is that of the newest merged map.
    pub header: Header,
    /// Transforms by [`crate::RobotId::index`]. Those beyond the fleet are unknown.
    pub robots: [MapTransform; ROBOTS_MAX],
    /// Time at which merging last received an answer of each robot's SLAM to a scan; zero: never. Until then the robot's
    /// part of the merged map is up to date.
    pub pose_estimate_received: [Monotonic; ROBOTS_MAX],
}

/// Age from which a robot's part of the merged map counts as old, seconds. It reaches a reader up to 0.5 s late, and a
/// SLAM process that was killed is back within about 1 s.
pub const MAP_OLD_AFTER_S: f64 = 2.5;

impl Default for MapTransforms {
    fn default() -> Self {
        Self::zeroed()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_certain_direction_may_lie_between_the_axes() {
        // Standard deviations of 3 m along the diagonal and of 1 m across it.
        let pose_estimate =
            PoseEstimate { covariance: [5.0, 4.0, 0.0, 5.0, 0.0, 0.0], ..PoseEstimate::default() };
        assert!((pose_estimate.position_sigma_m() - 3.0).abs() < 1e-12);
    }

    #[test]
    fn a_pose_estimate_in_a_turned_map_has_its_axes_swapped() {
        let pose_estimate = PoseEstimate {
            map_from_base: Pose2::new(1.0, 0.0, 0.0),
            covariance: [4.0, 0.5, 0.1, 1.0, 0.2, 0.3],
            ..PoseEstimate::default()
        };
        let turned = pose_estimate.transformed(Pose2::new(10.0, 0.0, core::f64::consts::FRAC_PI_2));
        assert!(
            (turned.map_from_base.x_m - 10.0).abs() < 1e-12 && (turned.map_from_base.y_m - 1.0).abs() < 1e-12
        );
        assert!((turned.position_sigma_m() - pose_estimate.position_sigma_m()).abs() < 1e-12);
        let expected = [1.0, -0.5, -0.2, 4.0, 0.1, 0.3];
        assert!(turned.covariance.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{turned:?}");
    }
}
