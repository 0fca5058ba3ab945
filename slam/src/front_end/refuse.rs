//! Scans that are not used, and why.

use super::{FrontEnd, LastScan, ScanResult, TrackedPose};
use msg::{Pose2, Scan, Stamp, TrackingState};
use nalgebra::Matrix3;

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
    /// Its angles or range limits are not usable numbers.
    #[error("the scan's angles or range limits are not usable numbers")]
    Geometry,
}

impl FrontEnd {
    /// Why a scan cannot be used, if it cannot.
    pub(super) fn refuse(&mut self, scan: &Scan) -> Option<ScanRejection> {
        let len = scan.len as usize;
        let usable = scan.angle_min_rad.is_finite()
            && scan.angle_increment_rad.is_finite()
            && scan.angle_increment_rad.abs() <= 7.0
            && scan.angle_min_rad.abs() <= 100.0
            && scan.range_min_m >= 0.0
            && scan.range_max_m > scan.range_min_m;
        match self.last {
            _ if len == 0 || len > msg::BEAMS_MAX => Some(ScanRejection::BeamCount),
            _ if !usable => Some(ScanRejection::Geometry),
            Some(last) if scan.header.stamp == last.stamp => Some(ScanRejection::StampRepeated),
            Some(last) if scan.header.stamp < last.stamp => match self.backward.note(scan.header.stamp) {
                Some(begins) => (self.clock_was_set_back(begins), None).1,
                None => Some(ScanRejection::StampWentBack),
            },
            _ => None,
        }
    }

    /// Time goes on from `begins`. Odometry's poses go on as they were: what they say of the way since
    /// the newest node stands.
    fn clock_was_set_back(&mut self, begins: Stamp) {
        self.counts.clock_set_back += 1;
        self.last =
            self.last.map(|last| LastScan { stamp: begins, odom_from_base: None, motion: None, ..last });
    }

    /// The answer to it.
    pub(super) fn refused(&mut self, scan: &Scan, refusal: ScanRejection) -> ScanResult {
        *match refusal {
            ScanRejection::StampRepeated => &mut self.counts.stamp_repeated,
            ScanRejection::StampWentBack => &mut self.counts.stamp_went_back,
            ScanRejection::BeamCount => &mut self.counts.beam_count,
            ScanRejection::Geometry => &mut self.counts.geometry,
        } += 1;
        let last = self.last;
        let found = TrackedPose {
            local_from_base: last.map_or(Pose2::IDENTITY, |l| l.local_from_base),
            covariance: last.map_or(Matrix3::zeros(), |l| l.covariance),
            state: if last.is_some() { TrackingState::Lost } else { TrackingState::Starting },
            slipped: false,
        };
        let correction = self.correction(scan, &found, last.and_then(|l| l.odom_from_base));
        ScanResult { correction, rejected: Some(refusal), node: None, node_id: None }
    }
}
