//! Scans whose beams were measured one after the other: the robot's motion meanwhile is taken out,
//! as the wheels say it, or, where there are none, together with the pose.

use super::{CARRIED_MAX_S, FrontEnd, PosePrediction, TrackedPose, carried};
use crate::beam_poses::{BeamPoses, part};
use crate::cloud::Cloud;
use crate::stages::Stage;
use msg::{Pose2, Scan, TrackingState, pose::wrap_angle};
use std::sync::Arc;

/// Poses found for one scan when its motion has to be found with it.
const PASSES: usize = 3;
/// So much of a motion's correction is taken over: half a turn's motion looks like a change of the
/// pose, so a pass that assumes too much finds half of that too little.
const SHARE: f64 = 2.0 / 3.0;

impl FrontEnd {
    /// A scan's surfaces, and where the robot is by them.
    pub(super) fn look(
        &mut self,
        scan: &Scan,
        expected: &PosePrediction,
        odom_from_base: Option<Pose2>,
    ) -> (BeamPoses, Arc<Cloud>, TrackedPose) {
        self.stages.stage_started(Stage::Cloud);
        let still = BeamPoses::still(self.config.base_from_scan());
        let seconds = BeamPoses::seconds(scan);
        let by_wheels = match seconds {
            Some(0.0) => Some(still),
            Some(seconds) => self.by_wheels(scan, seconds, odom_from_base),
            None => None,
        };
        let interval_s = self.last.map(|last| scan.header.stamp - last.stamp);
        let along = seconds.zip(interval_s.filter(|s| *s < CARRIED_MAX_S));
        if let (None, Some((seconds, interval_s))) = (by_wheels, along) {
            return self.look_along(scan, expected, seconds, interval_s);
        }
        self.counts.not_deskewed += u64::from(by_wheels.is_none());
        let sweep = by_wheels.unwrap_or(still);
        let cloud = self.pool.cloud(scan, &sweep, &self.config);
        let found = self.locate(&cloud, expected);
        (sweep, cloud, found)
    }

    fn by_wheels(&self, scan: &Scan, seconds: f64, odom_from_base: Option<Pose2>) -> Option<BeamPoses> {
        let before = odom_from_base?;
        BeamPoses::new(self.config.base_from_scan(), scan, seconds, |after_s| {
            let then = scan.header.stamp + core::time::Duration::from_secs_f64(after_s);
            Some(before.between(self.odometry.at(then)?))
        })
    }

    /// Without wheels: the motion over the interval since the scan before goes on through this one.
    /// It follows from the pose, and the pose from it.
    fn look_along(
        &mut self,
        scan: &Scan,
        expected: &PosePrediction,
        seconds: f64,
        interval_s: f64,
    ) -> (BeamPoses, Arc<Cloud>, TrackedPose) {
        let before = self.last.map_or(Pose2::IDENTITY, |last| last.local_from_base);
        let known = self.last.and_then(|last| last.motion);
        let mut motion = known.map_or(Pose2::IDENTITY, |(motion, s)| carried(motion, s, interval_s));
        let mut pass = 1;
        loop {
            let so_far = |after_s: f64| Some(part(motion, after_s / interval_s));
            let still = BeamPoses::still(self.config.base_from_scan());
            let sweep = BeamPoses::new(self.config.base_from_scan(), scan, seconds, so_far).unwrap_or(still);
            self.stages.stage_started(Stage::Cloud);
            let cloud = self.pool.cloud(scan, &sweep, &self.config);
            let found = self.locate(&cloud, expected);
            let lost = matches!(found.state, TrackingState::Lost | TrackingState::Starting);
            if lost || pass == PASSES {
                return (sweep, cloud, found);
            }
            let seen = before.between(found.local_from_base);
            motion = Pose2::new(
                motion.x_m + SHARE * (seen.x_m - motion.x_m),
                motion.y_m + SHARE * (seen.y_m - motion.y_m),
                motion.yaw_rad + SHARE * wrap_angle(seen.yaw_rad - motion.yaw_rad),
            );
            pass += 1;
        }
    }
}
