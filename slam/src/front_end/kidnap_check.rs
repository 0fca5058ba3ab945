//! Check for a kidnapped robot: it was carried while no scan came, its wheels hardly moved, and it sees something else than before.
//!
//! Two comparisons tell that. One asks what a scan saw through, which needs beams in each degree, and holds whatever way odometry measured since the last
//! scan. The other asks what is nearer and what is farther than before; it needs fewer beams, and wheels that stood.
//!
//! A driver that is started again may stand elsewhere, as in a simulation that begins anew, without a pause that shows it. Then
//! the scan is compared with another place near by, too.
//!
//! A robot that sees the same may have been carried, too, as along a corridor: then only the next scans tell where it is, and odometry does not.

use super::FrontEnd;
use super::scan_matcher::TrackedPose;
use crate::cloud::{Agreement, Cloud, RangeComparison, SEE_THROUGH_M};
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
/// Wheels that turned by less than this since the last scan, metres and radians, moved the robot by no more than that, however they slip.
const STOOD_MAX_M: f64 = 0.3;
const STOOD_MAX_RAD: f64 = 0.2;
/// A robot was carried if less than this share of one scan's points lies on surfaces of the other scan, and each of them has at least
/// [`CHANGED_SHARE`] of its points before what the other one saw in their direction, and as many behind it. A person who comes changes one of
/// these, and so does one who goes. Of 22 generated runs in which a robot stood (`--logs stood --seeds 0..48`) the first is 0.68 or more and the
/// second 0.00; of 25 in which it was carried, 11 are beyond both.
const SAME_PLACE_SHARE_MIN: f32 = 0.5;
const CHANGED_SHARE: f32 = 0.1;

impl FrontEnd {
    /// Marks the robot as lost if it was kidnapped since the last scan, and records if it may have been. Returns its pose, and whether it was.
    pub(super) fn check_for_kidnapping(
        &mut self,
        stamp: Stamp,
        cloud: &Cloud,
        pose: TrackedPose,
        continuous_from_base: Option<Pose2>,
    ) -> (TrackedPose, bool) {
        let restarted = self.motion.odometry.take_restart();
        let Some(last) = self.motion.last else { return (pose, false) };
        if restarted && pose.is_tracked && self.was_moved(cloud, &pose, continuous_from_base) {
            return (self.mark_kidnapped(pose), true);
        }
        if stamp - last.stamp <= KIDNAP_MIN_S {
            return (pose, false);
        }
        let moved_m = last.continuous_from_base.zip(continuous_from_base).map(|(a, b)| a.distance_m(b));
        // Without odometry it is not known whether the robot stood.
        let stood_for_s = |time_s: f64| moved_m.is_some_and(|m| m < STANDING_SPEED_MAX_M_S * time_s);
        let silence_s = self.motion.odometry.longest_silence_s(last.stamp, stamp);
        self.node_builder.possibly_kidnapped |= silence_s > KIDNAP_MIN_S && stood_for_s(silence_s);
        let is_kidnapped = stood_for_s(stamp - last.stamp)
            && (self.sees_another_view(cloud, &pose) || self.sees_another_place(cloud, continuous_from_base));
        (if is_kidnapped { self.mark_kidnapped(pose) } else { pose }, is_kidnapped)
    }

    /// Whether the first scan after a driver was started again shows another view or place than before, or fits another place of the
    /// local map clearly better.
    fn was_moved(&mut self, cloud: &Cloud, pose: &TrackedPose, continuous_from_base: Option<Pose2>) -> bool {
        self.sees_another_view(cloud, pose)
            || self.sees_another_place(cloud, continuous_from_base)
            || self.matcher.fits_elsewhere(cloud, pose.local_from_base, &self.config.tracking)
    }

    /// Whether a scan, placed at `pose`, and the newest reference contradict each other, which are near each other.
    fn sees_another_view(&self, cloud: &Cloud, pose: &TrackedPose) -> bool {
        let Some(reference) = self.matcher.references.back() else { return false };
        let reference_from_now = reference.local_from_base.between(pose.local_from_base);
        is_within(reference_from_now, MOVED_MAX_M, TURNED_MAX_RAD)
            && shows_another_view(&reference.cloud, cloud, reference_from_now)
    }

    /// Whether a scan and the newest reference are of two places: each is nearer than the other one in some directions and farther in
    /// others. Judged only if the wheels hardly turned since the last scan, which then stands where this one does: over a longer
    /// way and in turns odometry's errors look the same.
    fn sees_another_place(&self, cloud: &Cloud, continuous_from_base: Option<Pose2>) -> bool {
        let (Some(reference), Some(last)) = (self.matcher.references.back(), self.motion.last) else {
            return false;
        };
        let moved = last.continuous_from_base.zip(continuous_from_base).map(|(last, now)| last.between(now));
        let Some(moved) = moved.filter(|moved| is_within(*moved, STOOD_MAX_M, STOOD_MAX_RAD)) else {
            return false;
        };
        let reference_from_now = reference.local_from_base.between(last.local_from_base * moved);
        is_within(reference_from_now, MOVED_MAX_M, TURNED_MAX_RAD)
            && show_two_places([
                reference.cloud.compare_ranges(cloud, reference_from_now),
                cloud.compare_ranges(&reference.cloud, reference_from_now.inverse()),
            ])
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

/// Whether a motion is shorter than this, and turns by less.
fn is_within(motion: Pose2, distance_m: f64, turn_rad: f64) -> bool {
    motion.x_m.hypot(motion.y_m) < distance_m && motion.yaw_rad.abs() < turn_rad
}

/// Whether the comparisons of two scans with each other show two places.
fn show_two_places(both: [RangeComparison; 2]) -> bool {
    let share = |part: usize, of: &RangeComparison| part as f32 / of.points.max(1) as f32;
    let is_changed = |found: &RangeComparison| {
        [found.before, found.behind]
            .iter()
            .all(|part| *part >= CONTRADICTED_POINTS_MIN && share(*part, found) >= CHANGED_SHARE)
    };
    both.iter().all(is_changed)
        && both.iter().any(|found| share(found.on_surface, found) < SAME_PLACE_SHARE_MIN)
}

/// Whether two scans see hardly any surface of each other, and each of them sees through points of the other one.
fn shows_another_view(a: &Cloud, b: &Cloud, a_from_b: Pose2) -> bool {
    let of_b = a.compare(b, a_from_b, SEE_THROUGH_M);
    let of_a = b.compare(a, a_from_b.inverse(), SEE_THROUGH_M);
    let share = |found: Agreement, cloud: &Cloud| found.agree as f32 / cloud.points().len().max(1) as f32;
    share(of_a, a).min(share(of_b, b)) < SAME_VIEW_SHARE_MIN
        && [of_a, of_b].iter().all(|found| found.is_contradicted(CONTRADICTED_SHARE, CONTRADICTED_POINTS_MIN))
}
