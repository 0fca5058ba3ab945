//! What the front end gives out: the pose in the map, its covariance and its state.

use super::FrontEnd;
use super::local_frame::LocalFrameInMap;
use super::scan_matcher::TrackedPose;
use crate::graph::upper_triangle;
use msg::{Pose2, PoseEstimate, Scan, Stamp, TrackingState};
use nalgebra::{Matrix3, Vector3};

/// Standard deviations of a robot that is not located, metres and radians: it may be anywhere.
const NOT_LOCATED_M: f64 = 100.0;
const NOT_LOCATED_RAD: f64 = core::f64::consts::PI;

/// Covariance over (x, y, yaw) of a robot that may be anywhere.
pub(super) fn unknown_pose_covariance() -> Matrix3<f64> {
    let variance_m2 = NOT_LOCATED_M.powi(2);
    Matrix3::from_diagonal(&Vector3::new(variance_m2, variance_m2, NOT_LOCATED_RAD.powi(2)))
}

impl FrontEnd {
    /// Covariance of the pose in the map by odometry alone since the newest reference, the robot being at `map_from_base`; upper
    /// triangle over (x, y, yaw), row by row. Without odometry the robot may be anywhere.
    pub fn covariance_by_odometry(&mut self, stamp: Stamp, map_from_base: Pose2) -> [f64; 6] {
        let continuous_from_base = self.motion.odometry.at(stamp);
        let newest = self.matcher.references.back();
        let prediction = self.motion.predict(stamp, continuous_from_base, newest, &self.config.odometry);
        upper_triangle(match self.frame.is_located && prediction.allows_dead_reckoning {
            true => self.frame.covariance_in_map(prediction.covariance(), map_from_base),
            false => unknown_pose_covariance(),
        })
    }

    /// The state given out: that of the scan, unless the robot is not located, its pose is what a person said, or its map may be wrong.
    fn state_in_map(&self, pose: &TrackedPose) -> TrackingState {
        match (self.frame.is_located, pose.state) {
            (false, _) => TrackingState::Lost,
            (true, state) if self.frame.is_unconfirmed && state != TrackingState::Lost => {
                TrackingState::Unconfirmed
            }
            (true, TrackingState::Tracking | TrackingState::Degenerate) if self.frame.is_unreliable => {
                TrackingState::MapUnreliable
            }
            (true, state) => state,
        }
    }

    /// The answer to a scan. `continuous_from_base` is `None` if odometry is missing at its stamp.
    pub(super) fn pose_estimate(
        &mut self,
        scan: &Scan,
        pose: &TrackedPose,
        continuous_from_base: Option<Pose2>,
    ) -> PoseEstimate {
        let LocalFrameInMap { map_from_local, is_located, .. } = self.frame;
        let map_from_base = map_from_local * pose.local_from_base;
        let covariance = match is_located {
            true => self.frame.covariance_in_map(pose.covariance, map_from_base),
            false => unknown_pose_covariance(),
        };
        let located = is_located.then_some(map_from_local);
        self.odom_in_map.update(pose.local_from_base, continuous_from_base, located);
        let map_from_odom = self.odom_in_map.map_from_odom(self.motion.odometry.continuous_from_odom());
        PoseEstimate {
            header: msg::Header { stamp: scan.header.stamp, ..Default::default() },
            scan_seq: scan.header.seq,
            scan_sent: scan.header.sent,
            map_from_odom: map_from_odom.unwrap_or_default(),
            map_from_base,
            covariance: upper_triangle(covariance),
            state: self.state_in_map(pose) as u32,
            nodes: self.node_builder.next_node,
            closures: self.frame.closures,
            map_from_odom_unknown: map_from_odom.is_none().into(),
        }
    }
}
