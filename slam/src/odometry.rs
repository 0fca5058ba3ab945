//! Odometry buffer: bounded, interpolated at any stamp.

use crate::clock_reset::ClockResetDetector;
use crate::config::OdometryConfig;
use crate::limits::ODOMETRY_M_MAX;
use msg::{Header, Odometry, Pose2, Stamp, pose::wrap_angle};
use std::collections::VecDeque;

/// One odometry message with its pose in the continuous frame, see [`OdometryBuffer::continuous_from_odom`].
#[derive(Clone, Copy, Debug)]
struct BufferedOdometry {
    header: Header,
    continuous_from_base: Pose2,
    linear_m_s: f64,
    angular_rad_s: f64,
}

impl BufferedOdometry {
    fn new(message: &Odometry, continuous_from_base: Pose2) -> Self {
        let Odometry { header, linear_m_s, angular_rad_s, .. } = *message;
        Self { header, continuous_from_base, linear_m_s, angular_rad_s }
    }

    /// As a session stores it: a message whose `odom` is the continuous frame.
    fn stored(&self) -> Odometry {
        let Self { header, continuous_from_base, linear_m_s, angular_rad_s } = *self;
        Odometry { header, odom_from_base: continuous_from_base, linear_m_s, angular_rad_s }
    }

    /// The element of [`BufferedOdometry::stored`].
    fn from_stored(stored: &Odometry) -> Self {
        Self::new(stored, stored.odom_from_base)
    }
}

/// The newest odometry messages, ordered by stamp.
#[derive(Clone, Debug)]
pub struct OdometryBuffer {
    poses: VecDeque<BufferedOdometry>,
    continuous_from_odom: Pose2,
    config: OdometryConfig,
    rejected: u64,
    clock_reset: ClockResetDetector,
    /// The poses are those of a session: messages may have been missed since.
    is_restored: bool,
    /// The motion since the restored poses is unknown: see [`OdometryBuffer::take_unknown_motion`].
    unknown_motion: bool,
    /// A driver was started again: see [`OdometryBuffer::take_restart`].
    has_restarted: bool,
}

impl OdometryBuffer {
    /// An empty buffer; all memory is allocated here.
    pub fn new(config: OdometryConfig) -> Self {
        let poses = VecDeque::with_capacity(config.buffer_len + 1);
        let clock_reset = ClockResetDetector::default();
        Self {
            poses,
            continuous_from_odom: Pose2::IDENTITY,
            config,
            rejected: 0,
            clock_reset,
            is_restored: false,
            unknown_motion: false,
            has_restarted: false,
        }
    }

    /// Adds a message. Rejects and counts one whose pose is no place on Earth or not newer than the last, unless the clock was set
    /// back. Returns whether it was added.
    pub fn push(&mut self, odometry: &Odometry) -> bool {
        let (last, stamp) = (self.poses.back().copied(), odometry.header.stamp);
        let back = last.is_some_and(|last| stamp < last.header.stamp);
        let repeated = last.is_some_and(|last| stamp == last.header.stamp);
        let restarted = last.filter(|last| last.header.incarnation != odometry.header.incarnation);
        // The restarted driver has a new origin; the robot is assumed to have stood meanwhile.
        let continuous_from_odom = restarted.map_or(self.continuous_from_odom, |last| {
            last.continuous_from_base * odometry.odom_from_base.inverse()
        });
        let continuous_from_base = continuous_from_odom * odometry.odom_from_base;
        if repeated
            || ![odometry.odom_from_base, continuous_from_base].into_iter().all(is_plausible)
            || (back && self.clock_reset.observe(stamp).is_none())
        {
            self.rejected += 1;
            return false;
        }
        self.clock_reset = ClockResetDetector::default();
        if back {
            self.poses.clear();
        }
        if self.poses.len() == self.config.buffer_len {
            self.poses.pop_front();
        }
        if restarted.is_some() && self.is_restored {
            // But after the session was saved and before the driver ended, the robot may have moved.
            self.poses.clear();
            self.unknown_motion = true;
        }
        self.has_restarted |= restarted.is_some();
        self.continuous_from_odom = continuous_from_odom;
        self.is_restored = false;
        self.poses.push_back(BufferedOdometry::new(odometry, continuous_from_base));
        true
    }

    /// Pose of the writer's odometry frame in the continuous frame, which does not jump when the writer restarts.
    /// Identity until then.
    pub fn continuous_from_odom(&self) -> Pose2 {
        self.continuous_from_odom
    }

    /// Returns, once, whether the robot has moved in an unknown way: after a session was restored, odometry comes
    /// from a driver that was started again since.
    pub fn take_unknown_motion(&mut self) -> bool {
        core::mem::take(&mut self.unknown_motion)
    }

    /// Returns, once, whether a driver was started again. That the robot stood meanwhile is an assumption: it may have been put
    /// elsewhere.
    pub fn take_restart(&mut self) -> bool {
        core::mem::take(&mut self.has_restarted)
    }

    /// Parts of the buffer for a session: messages whose `odom` is the continuous frame, [`OdometryBuffer::continuous_from_odom`], and the
    /// number rejected.
    pub fn parts(&self) -> (Vec<Odometry>, Pose2, u64) {
        (self.poses.iter().map(BufferedOdometry::stored).collect(), self.continuous_from_odom, self.rejected)
    }

    /// The buffer of [`OdometryBuffer::parts`].
    pub fn from_parts(
        config: OdometryConfig,
        poses: &[Odometry],
        continuous_from_odom: Pose2,
        rejected: u64,
    ) -> Self {
        let mut buffer = Self::new(config);
        let newest = &poses[poses.len().saturating_sub(buffer.config.buffer_len)..];
        buffer.poses.extend(newest.iter().map(BufferedOdometry::from_stored));
        let is_restored = !buffer.poses.is_empty();
        Self { continuous_from_odom, rejected, is_restored, ..buffer }
    }

    /// Number of messages rejected.
    pub fn rejected(&self) -> u64 {
        self.rejected
    }

    /// The longest time without a message between two stamps, seconds. Of the time before the oldest message of a full buffer nothing is
    /// known, and it does not count.
    pub fn longest_silence_s(&self, from: Stamp, to: Stamp) -> f64 {
        let oldest = self.poses.front().filter(|_| self.poses.len() >= self.config.buffer_len);
        let from = oldest.map_or(from, |oldest| oldest.header.stamp.clamp(from, to));
        let (mut longest_s, mut last) = (0.0_f64, from);
        for stamp in self.poses.iter().map(|o| o.header.stamp).filter(|stamp| (from..to).contains(stamp)) {
            longest_s = longest_s.max(stamp - last);
            last = stamp;
        }
        longest_s.max(to - last)
    }

    /// The motion from one stamp to another as far as messages between them measured it, though odometry was missing at one of the
    /// stamps. `None`: no message came between.
    pub fn motion_between(&self, from: Stamp, to: Stamp) -> Option<MeasuredMotion> {
        let after = |stamp: Stamp| self.poses.partition_point(|o| o.header.stamp <= stamp);
        let (first, end) = (after(from), after(to));
        if !self.config.used || first >= end {
            return None;
        }
        let (next, newest) = (self.poses.get(first)?, self.poses.get(end - 1)?);
        let limit_s = self.config.extrapolation_max_s;
        let behind_s = to - newest.header.stamp;
        let at_end = extrapolate(newest, behind_s.min(limit_s), limit_s)?;
        // Messages that have come since the scan tell where it was taken.
        let before = first.checked_sub(1).and_then(|index| self.poses.get(index));
        let (at_begin, ahead_s) = match before {
            Some(before) => {
                let nearest_s = (from - before.header.stamp).min(next.header.stamp - from);
                (interpolate(before, next, from), nearest_s)
            }
            None => (next.continuous_from_base, next.header.stamp - from),
        };
        Some(MeasuredMotion { moved: at_begin.between(at_end), unmeasured_s: ahead_s + behind_s })
    }

    /// The robot's pose in the continuous frame of [`OdometryBuffer::continuous_from_odom`] at a stamp: interpolated, or
    /// extrapolated at the last speed for up to `odometry.extrapolation_max_s`. `None` outside, and where no message is that near: between
    /// two messages far apart the robot may have driven anywhere.
    pub fn at(&self, stamp: Stamp) -> Option<Pose2> {
        if !self.config.used {
            return None;
        }
        let after = self.poses.partition_point(|o| o.header.stamp < stamp);
        match (after.checked_sub(1).map(|i| &self.poses[i]), self.poses.get(after)) {
            (_, Some(b)) if b.header.stamp == stamp => Some(b.continuous_from_base),
            (Some(a), Some(b)) => {
                let nearest_s = (stamp - a.header.stamp).min(b.header.stamp - stamp);
                (nearest_s <= self.config.extrapolation_max_s).then(|| interpolate(a, b, stamp))
            }
            (Some(a), None) => extrapolate(a, stamp - a.header.stamp, self.config.extrapolation_max_s),
            (None, _) => None,
        }
    }
}

/// Motion between two stamps as far as odometry measured it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredMotion {
    /// Motion between the stamps: interpolated, and after the newest message at its speed for up to `odometry.extrapolation_max_s`.
    pub moved: Pose2,
    /// Time at the two ends for which no message tells the motion, seconds.
    pub unmeasured_s: f64,
}

/// Whether a pose by odometry can be one: its numbers are finite, and its position is within [`ODOMETRY_M_MAX`].
fn is_plausible(pose: Pose2) -> bool {
    pose.is_finite() && pose.x_m.abs().max(pose.y_m.abs()) <= ODOMETRY_M_MAX
}

/// Pose between two messages, linear in position and heading.
fn interpolate(a: &BufferedOdometry, b: &BufferedOdometry, stamp: Stamp) -> Pose2 {
    let share = (stamp - a.header.stamp) / (b.header.stamp - a.header.stamp);
    let (from, to) = (a.continuous_from_base, b.continuous_from_base);
    Pose2 {
        x_m: from.x_m + share * (to.x_m - from.x_m),
        y_m: from.y_m + share * (to.y_m - from.y_m),
        yaw_rad: wrap_angle(from.yaw_rad + share * wrap_angle(to.yaw_rad - from.yaw_rad)),
    }
}

/// Pose after the last message at its speed; `None` beyond `max_s` seconds.
fn extrapolate(last: &BufferedOdometry, ahead_s: f64, max_s: f64) -> Option<Pose2> {
    if ahead_s > max_s {
        return None;
    }
    let driven_m = last.linear_m_s * ahead_s;
    let moving = driven_m.abs() <= ODOMETRY_M_MAX && last.angular_rad_s.is_finite();
    let turn = if moving { last.angular_rad_s * ahead_s } else { 0.0 };
    let distance_m = if moving { driven_m } else { 0.0 };
    let step = Pose2::new(distance_m * (turn / 2.0).cos(), distance_m * (turn / 2.0).sin(), turn);
    Some(last.continuous_from_base * step)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: f64) -> Stamp {
        Stamp::from_seconds(seconds)
    }

    fn buffer_of(stamps_s: &[f64], buffer_len: usize) -> OdometryBuffer {
        let mut buffer = OdometryBuffer::new(OdometryConfig { buffer_len, ..OdometryConfig::default() });
        for stamp_s in stamps_s {
            let header = Header { stamp: at(*stamp_s), ..Header::default() };
            buffer.push(&Odometry { header, ..Odometry::default() });
        }
        buffer
    }

    #[test]
    fn the_longest_silence_is_between_two_messages_or_at_an_end() {
        let buffer = buffer_of(&[1.0, 2.0, 5.0, 6.0], 8);
        let silence_s = |from_s, to_s| buffer.longest_silence_s(at(from_s), at(to_s));
        assert_eq!([silence_s(0.5, 6.5), silence_s(5.0, 9.0), silence_s(-3.0, 5.0)], [3.0, 3.0, 4.0]);
        assert_eq!(silence_s(7.0, 9.0), 2.0);
        assert_eq!(buffer_of(&[], 8).longest_silence_s(at(0.0), at(9.0)), 9.0);
    }

    #[test]
    fn the_pose_in_a_long_gap_is_known_near_its_ends_alone() {
        let buffer = buffer_of(&[1.0, 1.5, 4.0], 8);
        let known =
            |stamps_s: &[f64]| stamps_s.iter().map(|s| buffer.at(at(*s)).is_some()).collect::<Vec<_>>();
        assert_eq!(known(&[1.0, 1.25, 1.5, 1.75, 3.75, 4.0, 4.25]), [true; 7]);
        assert_eq!(known(&[0.9, 1.9, 2.7, 3.6, 4.4]), [false; 5]);
    }

    #[test]
    fn messages_that_a_full_buffer_has_dropped_are_no_silence() {
        let stamps_s: Vec<f64> = (0..20).map(f64::from).collect();
        assert_eq!(buffer_of(&stamps_s, 4).longest_silence_s(at(0.0), at(19.0)), 1.0);
    }

    #[test]
    fn a_motion_is_known_as_far_as_messages_between_two_scans_tell_it() {
        let mut buffer = OdometryBuffer::new(OdometryConfig::default());
        for (stamp_s, x_m) in [(1.0, 1.0), (1.1, 1.1), (2.0, 2.0), (2.1, 2.1)] {
            let header = Header { stamp: at(stamp_s), ..Header::default() };
            let odom_from_base = Pose2::new(x_m, 0.0, 0.0);
            buffer.push(&Odometry { header, odom_from_base, linear_m_s: 1.0, ..Odometry::default() });
        }
        let motion = |from_s: f64, to_s: f64| {
            let measured = buffer.motion_between(at(from_s), at(to_s))?;
            Some([measured.moved.x_m, measured.unmeasured_s].map(|value| (1e3 * value).round() / 1e3))
        };
        assert_eq!(motion(1.0, 2.1), Some([1.1, 0.0]));
        assert_eq!(motion(1.0, 2.3), Some([1.3, 0.2]), "at the last speed");
        assert_eq!(motion(1.3, 2.1), Some([0.8, 0.2]), "interpolated afterwards");
        assert_eq!(motion(0.5, 2.1), Some([1.1, 0.5]), "the beginning was never measured");
        assert_eq!((motion(1.2, 1.9), motion(2.1, 3.0)), (None, None));
    }
}
