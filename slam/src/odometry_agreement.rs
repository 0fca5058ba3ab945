//! How the motion in the map compares with odometry's over the whole path: what a wrong description of the LiDAR or of odometry does
//! to all of it.
//!
//! Scans that are mirrored, ranges in another unit, or a mount with a wrong yaw fit each other as well as right ones: the map has no
//! walls twice. Odometry alone shows it: it turns the other way, is longer or shorter, or points elsewhere, all the time.

use msg::Pose2;
use serde::{Deserialize, Serialize};

/// A turn counts from here on, radians: five times the noise of two headings by scans.
const TURN_MIN_RAD: f64 = 0.1;
/// A distance counts from here on, metres: ten times the noise of two positions by scans.
const DISTANCE_MIN_M: f64 = 0.1;
/// So many steps at least, before anything is said of them.
const STEPS_MIN: usize = 8;
/// Directions that agree with each other so much say where they point: length of the mean of their unit vectors.
const RESULTANT_MIN: f64 = 0.6;

/// Turns of the map are less than this share of odometry's, with the other sign: scans are mirrored, or odometry's yaw is.
const MIRRORED_TURN_RATIO_MAX: f64 = -0.3;
/// Ratios between map and odometry that are plausible. Wheels of generated logs are 5 % too long or short.
const TURN_RATIO: core::ops::RangeInclusive<f64> = 0.67..=1.5;
/// The same for distances.
const DISTANCE_RATIO: core::ops::RangeInclusive<f64> = 0.67..=1.5;
/// A direction from here on is evidence, radians.
const DIRECTION_MAX_RAD: f64 = 0.15;

/// One motion between two nodes, by odometry and in the map, each in the frame of the first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct MotionPair {
    /// The motion by odometry.
    pub by_odometry: Pose2,
    /// The motion in the map.
    pub in_map: Pose2,
}

/// How the motion in the map compares with odometry's over the whole path. `None`: too few motions say it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct OdometryAgreement {
    /// Turn in the map for each radian of odometry, the median over all turns; 1 is right, -1 mirrored.
    pub turn_ratio: Option<f64>,
    /// Distance in the map for each metre of odometry, the median over all motions; 1 is right.
    pub distance_ratio: Option<f64>,
    /// Direction of the motion in the map, from odometry's, the mean over all motions, radians: how much the yaw of the LiDAR's mount is
    /// given too large; 0 is right.
    pub direction_rad: Option<f64>,
}

impl OdometryAgreement {
    /// Compares all motions of a path.
    pub(crate) fn new(motions: &[MotionPair]) -> Self {
        let turns = motions.iter().filter(|pair| pair.by_odometry.yaw_rad.abs() >= TURN_MIN_RAD);
        let turn_ratios = turns.map(|pair| pair.in_map.yaw_rad / pair.by_odometry.yaw_rad).collect();
        let length_m = |motion: Pose2| motion.x_m.hypot(motion.y_m);
        let driven: Vec<&MotionPair> =
            motions.iter().filter(|pair| length_m(pair.by_odometry) >= DISTANCE_MIN_M).collect();
        let distance_ratios =
            driven.iter().map(|pair| length_m(pair.in_map) / length_m(pair.by_odometry)).collect();
        Self {
            turn_ratio: median(turn_ratios),
            distance_ratio: median(distance_ratios),
            direction_rad: mean_direction_rad(&driven),
        }
    }

    /// What is wrong, in words.
    pub fn reasons(&self) -> impl Iterator<Item = &'static str> + use<> {
        let is_mirrored = self.turn_ratio.is_some_and(|ratio| ratio < MIRRORED_TURN_RATIO_MAX);
        let has_other_turns = self.turn_ratio.is_some_and(|ratio| !TURN_RATIO.contains(&ratio));
        let has_other_lengths = self.distance_ratio.is_some_and(|ratio| !DISTANCE_RATIO.contains(&ratio));
        let has_other_direction = self.direction_rad.is_some_and(|angle| angle.abs() > DIRECTION_MAX_RAD);
        let reasons = [
            (
                is_mirrored,
                "scans turn the other way than odometry: the LiDAR is mounted upside down or its angles are mirrored, or \
                 odometry's yaw has the wrong sign",
            ),
            (
                has_other_turns && !is_mirrored,
                "scans turn by another angle than odometry: check the angle between beams, and odometry's yaw",
            ),
            (
                has_other_lengths,
                "scans move by another distance than odometry: check the unit of the ranges, and the radius of the wheels",
            ),
            // Mirrored scans have no direction to compare.
            (
                has_other_direction && !is_mirrored,
                "scans move in another direction than odometry: check the yaw of the LiDAR's mount, and which way is forward",
            ),
        ];
        reasons.into_iter().filter(|(is_wrong, _)| *is_wrong).map(|(_, reason)| reason)
    }
}

/// Returns the median of enough values.
fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    let middle = values.get(values.len() / 2).copied();
    middle.filter(|value| values.len() >= STEPS_MIN && value.is_finite())
}

/// Returns the mean direction of the motions in the map, from odometry's, radians; `None` if they are few or point everywhere. Each
/// counts the same, so that some that slip change little.
fn mean_direction_rad(motions: &[&MotionPair]) -> Option<f64> {
    let mut sum = [0.0; 2];
    for MotionPair { by_odometry: a, in_map: b } in motions {
        let (along, across) = (a.x_m * b.x_m + a.y_m * b.y_m, a.x_m * b.y_m - a.y_m * b.x_m);
        let length = along.hypot(across);
        if length > 0.0 {
            sum = [sum[0] + along / length, sum[1] + across / length];
        }
    }
    let resultant = sum[0].hypot(sum[1]) / motions.len().max(1) as f64;
    (motions.len() >= STEPS_MIN && resultant >= RESULTANT_MIN).then(|| sum[1].atan2(sum[0]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    /// A path of 40 motions as odometry has it, and what the map makes of each.
    fn path(in_map: impl Fn(Pose2) -> Pose2) -> OdometryAgreement {
        let motions: Vec<MotionPair> = (0..40)
            .map(|k| Pose2::new(0.3, 0.0, if k % 3 == 0 { 0.3 } else { -0.15 }))
            .map(|by_odometry| MotionPair { by_odometry, in_map: in_map(by_odometry) })
            .collect();
        OdometryAgreement::new(&motions)
    }

    #[test]
    fn what_is_right_has_no_words_and_each_error_its_own() {
        let right = path(|motion| motion);
        assert_eq!(right.reasons().count(), 0, "{right:?}");
        let mirrored = path(|m| Pose2::new(m.x_m, -m.y_m, -m.yaw_rad));
        let longer = path(|m| Pose2::new(2.0 * m.x_m, m.y_m, m.yaw_rad));
        let turns_more = path(|m| Pose2::new(m.x_m, m.y_m, 1.9 * m.yaw_rad));
        let backwards = path(|m| Pose2::new(-m.x_m, -m.y_m, m.yaw_rad));
        let aside = path(|m| Pose2::new(0.3 * 0.3_f64.cos(), 0.3 * 0.3_f64.sin(), m.yaw_rad));
        let words = |it: &OdometryAgreement| it.reasons().collect::<Vec<_>>();
        for one in [&mirrored, &longer, &turns_more, &backwards, &aside] {
            assert_eq!(one.reasons().count(), 1, "{one:?}");
        }
        assert_eq!(words(&backwards), words(&aside));
        assert!((backwards.direction_rad.unwrap().abs() - PI).abs() < 1e-6);
        assert!((aside.direction_rad.unwrap() - 0.3).abs() < 1e-6);
        assert!((mirrored.turn_ratio.unwrap() + 1.0).abs() < 1e-6);
        assert!((longer.distance_ratio.unwrap() - 2.0).abs() < 1e-6);
        let kinds = [&mirrored, &longer, &turns_more, &aside].map(words);
        assert!((0..4).all(|a| (0..a).all(|b| kinds[a] != kinds[b])), "{kinds:?}");
    }

    #[test]
    fn few_motions_say_nothing_and_wheels_that_slip_now_and_then_change_nothing() {
        let one = MotionPair { by_odometry: Pose2::new(0.3, 0.0, 0.3), in_map: Pose2::new(0.3, 0.0, -0.3) };
        assert_eq!(OdometryAgreement::new(&[one; STEPS_MIN - 1]), OdometryAgreement::default());
        assert_eq!(OdometryAgreement::new(&[]), OdometryAgreement::default());
        let right = MotionPair { in_map: one.by_odometry, ..one };
        let slipping = [[right; 30].as_slice(), &[one; 12]].concat();
        assert_eq!(OdometryAgreement::new(&slipping).reasons().count(), 0);
        // Directions that point everywhere have no mean.
        let everywhere: Vec<MotionPair> = (0..40)
            .map(|k| f64::from(k) * PI / 20.0)
            .map(|angle| MotionPair { in_map: Pose2::new(0.3 * angle.cos(), 0.3 * angle.sin(), 0.3), ..one })
            .collect();
        assert_eq!(OdometryAgreement::new(&everywhere).direction_rad, None);
    }
}
