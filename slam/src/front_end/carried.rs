//! A robot that was carried while nothing was recorded: its wheels stood, and it sees something else than before.

use super::FrontEnd;
use super::scan_matcher::TrackedPose;
use crate::cloud::{Cloud, SEE_THROUGH_M};
use msg::{Pose2, Stamp, TrackingState};

/// In less time between two scans nobody carries a robot, seconds.
const CARRIED_MIN_S: f64 = 4.0;
/// Wheels that moved faster than this in the mean of that time drove the robot, m/s.
const STANDING_SPEED_MAX_M_S: f64 = 0.15;
/// A robot that moved farther than this looks at something else, metres and radians.
const STANDING_MOVED_MAX: [f64; 2] = [1.0, 0.3];
/// Least share of each scan's points that lie on surfaces of the other one, if the robot stood. At the 139 stops of the recorded logs it is 0.36 or more, cropped
/// to 90° at all but one of 77 it is 0.29 or more; where generated robots were carried out of their view it is 0.17 or less.
const SAME_VIEW_SHARE_MIN: f32 = 0.22;

impl FrontEnd {
    /// Whether the robot was carried since the last scan. It was where nothing came for [`CARRIED_MIN_S`], the wheels stood, and the scan, placed at
    /// `pose`, shows something else than the newest reference.
    pub(super) fn was_carried(
        &self,
        stamp: Stamp,
        cloud: &Cloud,
        pose: &TrackedPose,
        continuous_from_base: Option<Pose2>,
    ) -> bool {
        let Some(last) = self.motion.last.filter(|last| stamp - last.stamp > CARRIED_MIN_S) else {
            return false;
        };
        let Some(before) = last.continuous_from_base else { return false };
        let Some(moved) = continuous_from_base.map(|now| before.between(now)) else { return false };
        let distance_m = moved.x_m.hypot(moved.y_m);
        let [most_m, most_rad] = STANDING_MOVED_MAX;
        let stood = distance_m < most_m.min(STANDING_SPEED_MAX_M_S * (stamp - last.stamp))
            && moved.yaw_rad.abs() < most_rad;
        let Some(newest) = self.matcher.references.back().filter(|_| stood) else { return false };
        let clouds = [&*newest.cloud, cloud];
        if clouds.iter().any(|cloud| cloud.points().len() < self.config.tracking.points_min) {
            return false;
        }
        let before_from_now = newest.local_from_base.between(pose.local_from_base);
        let agreeing = [
            clouds[1].compare(clouds[0], before_from_now.inverse(), SEE_THROUGH_M),
            clouds[0].compare(clouds[1], before_from_now, SEE_THROUGH_M),
        ];
        let shares = agreeing
            .iter()
            .zip(clouds)
            .map(|(found, cloud)| found.agree as f32 / cloud.points().len() as f32);
        shares.fold(1.0, f32::min) < SAME_VIEW_SHARE_MIN
    }

    /// The pose of a robot that was carried: it is lost, and the path breaks before the next node.
    pub(super) fn lose(&mut self, pose: TrackedPose) -> TrackedPose {
        self.break_path();
        TrackedPose { state: TrackingState::Lost, is_tracked: false, slipped: false, ..pose }
    }

    /// Breaks the path before the next node, once.
    pub(super) fn break_path(&mut self) {
        let next = self.node_builder.next_node;
        self.counts.odometry_breaks += u64::from(self.frame.last_break != Some(next));
        self.frame.break_at(next);
    }
}
