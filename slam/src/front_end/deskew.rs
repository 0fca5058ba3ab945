//! Motion compensation (deskewing): removes the robot's motion during the sweep from a scan.
//!
//! The motion comes from odometry or, without it, is estimated together with the pose.

use super::motion::{
    CONSTANT_MOTION_MAX_S, ODOMETRY_JUMP_FACTOR, OdometryStep, PosePrediction, continue_motion,
};
use super::scan_matcher::{CLEARLY_SHARE, has_jumped};
use super::{FrontEnd, TrackedPose};
use crate::beam_poses::{BeamPoses, scale_motion};
use crate::cloud::Cloud;
use crate::config::OdometryConfig;
use crate::stages::Stage;
use msg::{Pose2, Scan, Stamp, TrackingState, pose::wrap_angle};
use std::sync::Arc;

/// Alignments of one scan whose motion is estimated with its pose: one or two leave errors that swing from scan
/// to scan, three end that.
const PASSES: usize = 3;
/// Largest share of a motion's correction that a pass applies.
const CORRECTION_SHARE_MAX: f64 = 2.0 / 3.0;

/// Share of a motion's correction that each pass applies, for a sweep of `scan_s`. Half a sweep's motion looks like a change of the pose, so that a
/// pass that assumes too much motion in an interval finds half of that too little in a sweep as long: 2/3 cancels the swing. In a longer
/// sweep more is found too little, and a smaller share cancels it.
fn correction_share(scan_s: f64, interval_s: f64) -> f64 {
    (1.0 / (1.0 + 0.5 * scan_s / interval_s)).min(CORRECTION_SHARE_MAX)
}

/// The motion over a time, no more than [`ODOMETRY_JUMP_FACTOR`] times as fast as the robot can be.
fn limit_speed(motion: Pose2, seconds: f64, config: &OdometryConfig) -> Pose2 {
    let [most_m, most_rad] =
        [config.speed_max_m_s, config.turn_max_rad_s].map(|speed| ODOMETRY_JUMP_FACTOR * speed * seconds);
    let share = (most_m / motion.x_m.hypot(motion.y_m)).min(1.0);
    Pose2::new(motion.x_m * share, motion.y_m * share, motion.yaw_rad.clamp(-most_rad, most_rad))
}

impl FrontEnd {
    /// The scan's sensor poses, its surfaces without the robot's motion, and the pose that matches them.
    pub(super) fn deskew_and_match(
        &mut self,
        scan: &Scan,
        prediction: &PosePrediction,
        continuous_from_base: Option<Pose2>,
    ) -> (BeamPoses, Arc<Cloud>, TrackedPose) {
        self.stages.stage_started(Stage::Cloud);
        let base_from_scan = scan.mount().unwrap_or(self.config.base_from_scan());
        let fixed = BeamPoses::still(base_from_scan);
        let seconds = BeamPoses::sweep_duration_s(scan);
        let from_odometry = match seconds {
            Some(0.0) => Some(fixed),
            Some(seconds) => {
                let config = &self.config.odometry;
                self.motion.beam_poses(base_from_scan, scan, seconds, continuous_from_base, config)
            }
            None => None,
        };
        let interval_s = self.motion.last.map(|last| scan.header.stamp - last.stamp);
        let durations = seconds.zip(interval_s.filter(|s| *s < CONSTANT_MOTION_MAX_S));
        if let (None, Some(durations)) = (from_odometry, durations) {
            return self.estimate_motion_and_match(scan, prediction, durations);
        }
        self.counts.not_deskewed += u64::from(from_odometry.is_none());
        let beam_poses = from_odometry.unwrap_or(fixed);
        let cloud = self.scan_buffers.cloud(scan, &beam_poses, &self.config);
        let pose = self.match_cloud(scan.header.stamp, &cloud, prediction);
        (beam_poses, cloud, pose)
    }

    /// Matches a scan around its predicted pose; where odometry may have jumped, also around the pose without it.
    fn match_cloud(&mut self, stamp: Stamp, cloud: &Cloud, prediction: &PosePrediction) -> TrackedPose {
        let after_loss =
            self.node_builder.last_scan_lost || self.matcher.newest_saw_nothing(&self.config.tracking);
        let matched = self.matcher.match_scan(cloud, prediction, after_loss, &self.config, &mut *self.stages);
        if prediction.step == OdometryStep::Motion {
            return matched;
        }
        let contradicted = self.matcher.contradicted_share(cloud, &matched);
        if prediction.step == OdometryStep::Unclear && matched.is_tracked && contradicted <= CLEARLY_SHARE {
            return matched;
        }
        let Some(stood) = self.motion.predict_without_odometry(stamp, &self.config.odometry) else {
            return matched;
        };
        let other = self.matcher.match_scan(cloud, &stood, after_loss, &self.config, &mut *self.stages);
        let contradicted_without = self.matcher.contradicted_share(cloud, &other);
        if !has_jumped(prediction.step, (&matched, contradicted), (&other, contradicted_without)) {
            return matched;
        }
        // Odometry counts from the matched pose.
        self.motion.continuous_from_reference = None;
        self.counts.slips += 1;
        other
    }

    /// Without odometry: the motion since the last scan is assumed to continue through this one. It follows
    /// from the pose, and the pose from it.
    fn estimate_motion_and_match(
        &mut self,
        scan: &Scan,
        prediction: &PosePrediction,
        (scan_s, interval_s): (f64, f64),
    ) -> (BeamPoses, Arc<Cloud>, TrackedPose) {
        let base_from_scan = scan.mount().unwrap_or(self.config.base_from_scan());
        let before = self.motion.last.map_or(Pose2::IDENTITY, |last| last.local_from_base);
        let known = self.motion.last.and_then(|last| last.motion);
        let mut motion = known.map_or(Pose2::IDENTITY, |(motion, s)| continue_motion(motion, s, interval_s));
        let share = correction_share(scan_s, interval_s);
        let mut pass = 1;
        loop {
            let so_far = |after_s: f64| Some(scale_motion(motion, after_s / interval_s));
            let beam_poses = BeamPoses::new(base_from_scan, scan, scan_s, so_far)
                .unwrap_or(BeamPoses::still(base_from_scan));
            self.stages.stage_started(Stage::Cloud);
            let cloud = self.scan_buffers.cloud(scan, &beam_poses, &self.config);
            let pose = self.match_cloud(scan.header.stamp, &cloud, prediction);
            let lost = !pose.is_tracked || pose.state == TrackingState::Starting;
            if lost || pass == PASSES {
                return (beam_poses, cloud, pose);
            }
            let seen = before.between(pose.local_from_base);
            let corrected = Pose2::new(
                motion.x_m + share * (seen.x_m - motion.x_m),
                motion.y_m + share * (seen.y_m - motion.y_m),
                motion.yaw_rad + share * wrap_angle(seen.yaw_rad - motion.yaw_rad),
            );
            motion = limit_speed(corrected, interval_s, &self.config.odometry);
            pass += 1;
        }
    }
}
