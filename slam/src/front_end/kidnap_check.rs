//! Check for a kidnapped robot: it was carried while no scan came, its wheels hardly moved, and it sees something else than before.
//!
//! A robot that sees the same may have been carried, too, as along a corridor: then only the next scans tell where it is, and odometry does not.

use super::FrontEnd;
use super::scan_matcher::TrackedPose;
use crate::cloud::{Agreement, Cloud, SEE_THROUGH_M};
use msg::{Pose2, Stamp, TrackingState};

/// In less time between two scans nobody carries a robot, seconds.
const KIDNAP_MIN_S: f64 = 4.0;
/// Wheels that moved faster than this in the mean of that time drove the robot, m/s.
const STANDING_SPEED_MAX_M_S: f64 = 0.15;
/// A robot that moved farther than this since the newest reference looks at something else, metres.
const MOVED_MAX_M: f64 = 1.0;
/// A robot that turned by more than this since then, too, radians.
const TURNED_MAX_RAD: f64 = 0.5;
/// Least share of each scan's points that lie on surfaces of the other one if the robot stood. At the 139 stops of the recorded logs it is 0.36 or more.
/// Where generated robots were carried out of their view it is 0.17 or less. Cropped to 90°, three of 77 stops of recorded logs are below:
/// there at most one of the scans sees through [`CONTRADICTED_POINTS_MIN`] points of the other.
const SAME_VIEW_SHARE_MIN: f32 = 0.22;
/// Each scan has to see through more than this share of the compared points of the other one, and through this many. A person who comes hides
/// points, and one scan alone sees through those of the person.
const CONTRADICTED_SHARE: f32 = 0.25;
const CONTRADICTED_POINTS_MIN: usize = 5;

impl FrontEnd {
    /// Marks the robot as lost if it was kidnapped since the last scan, and records if it may have been. Returns its pose, and whether it was.
    pub(super) fn check_for_kidnapping(
        &mut self,
        stamp: Stamp,
        cloud: &Cloud,
        pose: TrackedPose,
        continuous_from_base: Option<Pose2>,
    ) -> (TrackedPose, bool) {
        let Some(last) = self.motion.last.filter(|last| stamp - last.stamp > KIDNAP_MIN_S) else {
            return (pose, false);
        };
        let moved_m = last.continuous_from_base.zip(continuous_from_base).map(|(a, b)| a.distance_m(b));
        // Without odometry it is not known whether the robot stood.
        let stood_for_s = |time_s: f64| moved_m.is_some_and(|m| m < STANDING_SPEED_MAX_M_S * time_s);
        let silence_s = self.motion.odometry.longest_silence_s(last.stamp, stamp);
        self.node_builder.possibly_kidnapped |= silence_s > KIDNAP_MIN_S && stood_for_s(silence_s);
        let is_kidnapped = stood_for_s(stamp - last.stamp) && self.sees_another_view(cloud, &pose);
        (if is_kidnapped { self.mark_kidnapped(pose) } else { pose }, is_kidnapped)
    }

    /// Whether a scan, placed at `pose`, and the newest reference contradict each other, which are near each other.
    fn sees_another_view(&self, cloud: &Cloud, pose: &TrackedPose) -> bool {
        let Some(reference) = self.matcher.references.back() else { return false };
        let reference_from_now = reference.local_from_base.between(pose.local_from_base);
        let is_near = reference_from_now.x_m.hypot(reference_from_now.y_m) < MOVED_MAX_M
            && reference_from_now.yaw_rad.abs() < TURNED_MAX_RAD;
        is_near && shows_another_view(&reference.cloud, cloud, reference_from_now)
    }

    /// Marks the robot as lost, with an odometry break before the next node.
    fn mark_kidnapped(&mut self, pose: TrackedPose) -> TrackedPose {
        self.add_odometry_break();
        TrackedPose { state: TrackingState::Lost, is_tracked: false, slipped: false, ..pose }
    }

    /// Adds an odometry break before the next node, and counts it once.
    pub(super) fn add_odometry_break(&mut self) {
        let next = self.node_builder.next_node;
        self.counts.odometry_breaks += u64::from(self.frame.last_odometry_break != Some(next));
        self.frame.add_odometry_break(next);
    }
}

/// Whether two scans see hardly any surface of each other, and each of them sees through points of the other one.
fn shows_another_view(a: &Cloud, b: &Cloud, a_from_b: Pose2) -> bool {
    let of_b = a.compare(b, a_from_b, SEE_THROUGH_M);
    let of_a = b.compare(a, a_from_b.inverse(), SEE_THROUGH_M);
    let share = |found: Agreement, cloud: &Cloud| found.agree as f32 / cloud.points().len().max(1) as f32;
    share(of_a, a).min(share(of_b, b)) < SAME_VIEW_SHARE_MIN
        && [of_a, of_b].iter().all(|found| found.is_contradicted(CONTRADICTED_SHARE, CONTRADICTED_POINTS_MIN))
}
