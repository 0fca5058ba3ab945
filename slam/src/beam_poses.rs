//! How the robot moved while the LiDAR turned: what must be taken out of a scan whose beams were
//! measured one after the other. The wheels say it, or the robot's last speed.

use crate::cloud::PointTransform;
use msg::{Pose2, Scan};

/// Pieces a turn is cut into; within one the robot keeps its speed.
const PIECES: usize = 8;
/// No LiDAR takes longer for a turn, seconds.
const SWEEP_MAX_S: f64 = 1.0;

/// Where the sensor was at every beam, in `base_footprint` as it lay at the scan's stamp.
#[derive(Clone, Copy, Debug)]
pub struct BeamPoses {
    base_from_scan: Pose2,
    /// The base at the pieces' ends, as seen from the base at the stamp; `None`: all at once.
    knots: Option<[Pose2; PIECES + 1]>,
    beams: usize,
}

impl BeamPoses {
    /// All beams at once, or the robot stood still.
    pub fn still(base_from_scan: Pose2) -> Self {
        Self { base_from_scan, knots: None, beams: 0 }
    }

    /// How long a scan's beams took, seconds: 0 if all were measured at once; `None` if what the scan
    /// says of it cannot be.
    pub fn seconds(scan: &Scan) -> Option<f64> {
        let seconds = f64::from(scan.time_increment_s) * f64::from(scan.len.saturating_sub(1));
        (0.0..=SWEEP_MAX_S).contains(&seconds).then_some(seconds)
    }

    /// `base_at` tells the base so many seconds after the stamp, as seen from the base at the stamp.
    pub fn new(
        base_from_scan: Pose2,
        scan: &Scan,
        seconds: f64,
        base_at: impl Fn(f64) -> Option<Pose2>,
    ) -> Option<Self> {
        let mut knots = [Pose2::IDENTITY; PIECES + 1];
        for (piece, knot) in knots.iter_mut().enumerate().skip(1) {
            *knot = base_at(seconds * piece as f64 / PIECES as f64)?;
        }
        Some(Self { base_from_scan, knots: Some(knots), beams: scan.len as usize })
    }

    /// The sensor when it measured a beam.
    pub fn place(&self, beam: usize) -> PointTransform {
        let Some(knots) = &self.knots else { return PointTransform::new(self.base_from_scan) };
        let along = PIECES as f64 * beam as f64 / (self.beams.max(2) - 1) as f64;
        let piece = (along as usize).min(PIECES - 1);
        let (from, to) = (knots[piece], knots[piece + 1]);
        PointTransform::new(from * part(from.between(to), along - piece as f64) * self.base_from_scan)
    }

    /// The sensor in the middle of the turn, where one place must do for all beams.
    pub fn middle(&self) -> [f32; 2] {
        self.place(self.beams / 2).point([0.0; 2])
    }

    /// Whether beams were measured from different places.
    pub fn moves(&self) -> bool {
        self.knots.is_some()
    }
}

/// A share of a small motion at constant speed.
pub fn part(motion: Pose2, share: f64) -> Pose2 {
    Pose2::new(motion.x_m * share, motion.y_m * share, motion.yaw_rad * share)
}
