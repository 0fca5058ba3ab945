//! Sensor poses of a scan's beams, for a LiDAR that moves while it turns (motion compensation, deskewing).
//!
//! The motion during the sweep comes from odometry, or from the robot's last speed.

use crate::limits::SWEEP_M_MAX;
use crate::point_transform::PointTransform;
use msg::{Pose2, Scan};

/// Segments of a sweep; the robot's speed is constant within each.
const SEGMENTS: usize = 8;
/// Longest sweep that is plausible, seconds: no LiDAR turns slower.
const SWEEP_MAX_S: f64 = 1.0;

/// Sensor pose of every beam, in the frame `base_footprint` had at the scan's stamp.
#[derive(Clone, Copy, Debug)]
pub struct BeamPoses {
    base_from_scan: Pose2,
    /// Base poses at the segments' ends, in the frame of the base at the stamp; `None` without motion.
    base_poses: Option<[Pose2; SEGMENTS + 1]>,
    beams: usize,
}

impl BeamPoses {
    /// Poses of a scan without motion: all beams share one sensor pose.
    pub fn still(base_from_scan: Pose2) -> Self {
        Self { base_from_scan, base_poses: None, beams: 0 }
    }

    /// Duration of a scan's sweep, seconds: 0 if all beams were measured at once, `None` if the scan's
    /// time increment is implausible.
    pub fn sweep_duration_s(scan: &Scan) -> Option<f64> {
        let duration_s = f64::from(scan.time_increment_s) * f64::from(scan.len.saturating_sub(1));
        (0.0..=SWEEP_MAX_S).contains(&duration_s).then_some(duration_s)
    }

    /// Poses of a scan with motion. `base_at` returns the base pose at a time after the stamp (seconds), in the
    /// frame of the base at the stamp; `None` if it is unknown, or farther than a robot can go in a sweep, at one of the segments' ends.
    pub fn new(
        base_from_scan: Pose2,
        scan: &Scan,
        duration_s: f64,
        base_at: impl Fn(f64) -> Option<Pose2>,
    ) -> Option<Self> {
        let mut base_poses = [Pose2::IDENTITY; SEGMENTS + 1];
        for (segment, pose) in base_poses.iter_mut().enumerate().skip(1) {
            let base = base_at(duration_s * segment as f64 / SEGMENTS as f64)?;
            if base.x_m.hypot(base.y_m) > SWEEP_M_MAX {
                return None;
            }
            *pose = base;
        }
        Some(Self { base_from_scan, base_poses: Some(base_poses), beams: scan.len as usize })
    }

    /// Transform from the sensor's frame at a beam to the base at the stamp.
    pub fn base_from_sensor(&self, beam: usize) -> PointTransform {
        let Some(base_poses) = &self.base_poses else { return PointTransform::new(self.base_from_scan) };
        let along = SEGMENTS as f64 * beam as f64 / (self.beams.max(2) - 1) as f64;
        let segment = (along as usize).min(SEGMENTS - 1);
        let (from, to) = (base_poses[segment], base_poses[segment + 1]);
        let motion = scale_motion(from.between(to), along - segment as f64);
        PointTransform::new(from * motion * self.base_from_scan)
    }

    /// Sensor position in the middle of the sweep, where one position stands for all beams, metres.
    pub fn mid_sweep_position(&self) -> [f32; 2] {
        self.base_from_sensor(self.beams / 2).point([0.0; 2])
    }

    /// Whether the beams have different sensor poses.
    pub fn has_motion(&self) -> bool {
        self.base_poses.is_some()
    }
}

/// Scales a small motion at constant speed by a factor.
pub fn scale_motion(motion: Pose2, share: f64) -> Pose2 {
    Pose2::new(motion.x_m * share, motion.y_m * share, motion.yaw_rad * share)
}
