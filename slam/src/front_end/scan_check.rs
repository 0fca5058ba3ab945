//! Checks scans and rejects those that cannot be used.

use super::pose_estimate::unknown_pose_covariance;
use super::{FrontEnd, ScanResult, TrackedPose};
use crate::clock_reset::ClockResetDetector;
use crate::limits::REACH_M_MAX;
use msg::{Pose2, Scan, Stamp, TrackingState};

/// Why a scan was not used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ScanRejection {
    /// Its stamp is that of the scan before.
    #[error("the scan has the stamp of the one before")]
    StampRepeated,
    /// Its stamp is before that of the scan before. A few such stamps in order are a clock that was
    /// set back: its time is taken over.
    #[error("the scan is stamped before the one before it")]
    StampWentBack,
    /// It has no beam, or more than [`msg::BEAMS_MAX`].
    #[error("the scan has no beams or too many")]
    BeamCount,
    /// Its angles, its range limits or the pose of its LiDAR on the robot are not usable numbers.
    #[error("the scan's angles, range limits or pose on the robot are not usable numbers")]
    Geometry,
}

/// Beams of one revolution do not lie farther apart than this, radians: a little more than a full turn.
const ANGLE_INCREMENT_MAX_RAD: f32 = 7.0;
/// A scan does not begin at a larger angle than this, radians: many turns, which single precision still resolves.
const ANGLE_MIN_MAX_RAD: f32 = 100.0;

/// Whether the LiDAR works: half of the beams or more hit something in range, or nothing (REP 117). A covered one measures nothing,
/// or what is too near.
pub(super) fn lidar_works(scan: &Scan) -> bool {
    let beams = &scan.ranges_m[..(scan.len as usize).min(scan.ranges_m.len())];
    let working = beams.iter().filter(|range| **range > 0.0 && **range >= scan.range_min_m).count();
    2 * working >= beams.len()
}

/// Whether a LiDAR can be there on a robot.
fn is_on_robot(base_from_scan: Pose2) -> bool {
    base_from_scan.is_finite() && base_from_scan.x_m.hypot(base_from_scan.y_m) <= f64::from(REACH_M_MAX)
}

impl FrontEnd {
    /// Why a scan cannot be used, if it cannot. Takes over the time of a clock that was set back.
    pub(super) fn check(&mut self, scan: &Scan) -> Option<ScanRejection> {
        let rejection = self.check_geometry(scan).or_else(|| self.check_stamp(scan.header.stamp));
        if rejection.is_none() {
            self.clock_reset = ClockResetDetector::default();
        }
        rejection
    }

    fn check_geometry(&self, scan: &Scan) -> Option<ScanRejection> {
        let len = scan.len as usize;
        let usable = scan.angle_min_rad.is_finite()
            && scan.angle_increment_rad.is_finite()
            && scan.angle_increment_rad.abs() <= ANGLE_INCREMENT_MAX_RAD
            && scan.angle_min_rad.abs() <= ANGLE_MIN_MAX_RAD
            && scan.mount().is_none_or(is_on_robot)
            && scan.range_min_m >= 0.0
            && scan.range_max_m > scan.range_min_m;
        if len == 0 || len > msg::BEAMS_MAX {
            Some(ScanRejection::BeamCount)
        } else {
            (!usable).then_some(ScanRejection::Geometry)
        }
    }

    fn check_stamp(&mut self, stamp: Stamp) -> Option<ScanRejection> {
        let last = self.motion.last?;
        if stamp == last.stamp {
            return Some(ScanRejection::StampRepeated);
        }
        if stamp > last.stamp {
            return None;
        }
        let Some(begins) = self.clock_reset.observe(stamp) else { return Some(ScanRejection::StampWentBack) };
        self.counts.clock_resets += 1;
        self.motion.reset_clock(begins);
        None
    }

    /// The answer to a scan that is not used: the last pose.
    pub(super) fn reject(&mut self, scan: &Scan, rejection: ScanRejection) -> ScanResult {
        *match rejection {
            ScanRejection::StampRepeated => &mut self.counts.rejected_stamp_repeated,
            ScanRejection::StampWentBack => &mut self.counts.rejected_stamp_went_back,
            ScanRejection::BeamCount => &mut self.counts.rejected_beam_count,
            ScanRejection::Geometry => &mut self.counts.rejected_geometry,
        } += 1;
        let last = self.motion.last;
        let pose = TrackedPose {
            local_from_base: last.map_or(Pose2::IDENTITY, |l| l.local_from_base),
            covariance: last.map_or(unknown_pose_covariance(), |l| l.covariance),
            state: if last.is_some() { TrackingState::Lost } else { TrackingState::Starting },
            is_tracked: false,
            slipped: false,
            worst_position_sigma_m: f64::INFINITY,
        };
        let pose_estimate = self.pose_estimate(scan, &pose, None);
        ScanResult {
            pose_estimate,
            local_covariance: pose.covariance,
            rejected: Some(rejection),
            node: None,
            node_id: None,
        }
    }
}
