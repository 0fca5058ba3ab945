//! Scans that repeat one measurement while the robot moves: a LiDAR, or its driver, that hangs. A robot would drive by them into what
//! they do not show.

use msg::{Pose2, Scan, pose::wrap_angle};
use std::hash::{DefaultHasher, Hash, Hasher};

/// So many repetitions of a scan, and ...
const REPETITIONS: u32 = 5;
/// ... so much motion meanwhile, metres or radians, are no robot that stands before a LiDAR without noise.
const MOVED_M: f64 = 0.3;
const MOVED_RAD: f64 = 0.2;

/// The measurement that a robot's scans repeat.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RepeatedScan {
    hash: u64,
    repetitions: u32,
    /// Where the robot was at its first scan, by odometry.
    odom_from_base: Option<Pose2>,
}

impl RepeatedScan {
    /// Takes a scan, and the robot's newest pose by odometry; returns whether the scans do not show where the robot is.
    pub(super) fn is_frozen(&mut self, scan: &Scan, odom_from_base: Option<Pose2>) -> bool {
        let mut hasher = DefaultHasher::new();
        let mut has_hit = false;
        for range_m in scan.ranges_m() {
            range_m.to_bits().hash(&mut hasher);
            has_hit |= range_m.is_finite();
        }
        let hash = hasher.finish();
        // On open floor all scans are the same.
        if hash != self.hash || !has_hit {
            *self = Self { hash, repetitions: 0, odom_from_base };
            return false;
        }
        self.repetitions = self.repetitions.saturating_add(1);
        let has_moved = self.odom_from_base.zip(odom_from_base).is_some_and(|(then, now)| {
            then.distance_m(now) > MOVED_M || wrap_angle(now.yaw_rad - then.yaw_rad).abs() > MOVED_RAD
        });
        self.repetitions >= REPETITIONS && has_moved
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scan(range_m: f32) -> Box<Scan> {
        let mut scan: Box<Scan> = Box::new(bytemuck::Zeroable::zeroed());
        scan.len = 3;
        scan.ranges_m[..3].copy_from_slice(&[range_m, f32::INFINITY, range_m]);
        scan
    }

    /// Which of the scans at these places are frozen.
    fn frozen(places_m: impl Iterator<Item = f64>, range_m: impl Fn(usize) -> f32) -> Vec<bool> {
        let mut repeated = RepeatedScan::default();
        let is_frozen = |(index, x_m): (usize, f64)| {
            repeated.is_frozen(&scan(range_m(index)), Some(Pose2::new(x_m, 0.0, 0.0)))
        };
        places_m.enumerate().map(is_frozen).collect()
    }

    #[test]
    fn scans_that_stay_the_same_while_the_robot_moves_are_frozen_until_they_change() {
        let drive = || (0..40).map(|tenth| 0.02 * f64::from(tenth));
        let hangs = frozen(drive(), |index| if index < 30 { 1.5 } else { 1.4 });
        assert_eq!(hangs.iter().position(|is| *is), Some(16), "after 0.3 m");
        assert!(hangs[16..30].iter().all(|is| *is) && !hangs[30]);
        let none = |frozen: Vec<bool>| frozen.iter().all(|is| !is);
        assert!(none(frozen(drive(), |index| 1.5 + index as f32)));
        assert!(none(frozen((0..40).map(|_| 0.0), |_| 1.5)), "it stands");
        assert!(none(frozen(drive(), |_| f32::INFINITY)), "open floor");
        assert!(none(frozen([0.0, 1.0, 2.0].into_iter(), |_| 1.5)), "three scans");
    }
}
