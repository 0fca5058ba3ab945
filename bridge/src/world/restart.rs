//! A clock that was set back, as a simulation that begins anew or a machine whose time is corrected does it; and a driver whose odometry
//! begins at a new origin, because it was started again or reset.
//!
//! Stamps of ROS 2 are taken as they are. Without this, all scans would be refused until the time has caught up.

use super::frozen::RepeatedScan;
use super::publishers::PublisherId;
use super::suspects::STEP_MESSAGES;
use super::{ExternalWorld, Origin, RobotState, SentPose, SourceId};
use msg::{Pose2, RobotId, Stamp, pose::wrap_angle};
use std::fmt;

/// Scans stamped so much earlier than the newest one mean that the source's clock was set back, if several in a row agree, seconds.
const SET_BACK_S: f64 = 1.0;

/// Within this distance and turn from its origin odometry begins, metres and radians.
const ORIGIN_M: f64 = 0.2;
const ORIGIN_RAD: f64 = 0.2;

/// Wheels move no robot faster than this, metres and radians a second ...
const SPEED_MAX_M_S: f64 = 5.0;
const TURN_MAX_RAD_S: f64 = 10.0;
/// ... beyond what stamps that are not exact make of it.
const JUMP_M: f64 = 0.3;
const JUMP_RAD: f64 = 0.3;
/// After such a silence of odometry, seconds, a driver that begins anew is told by its first pose, which is so near its origin, metres and
/// radians, while the robot was not.
const DRIVER_SILENCE_S: f64 = 0.5;
const BEGIN_M: f64 = 0.05;
const BEGIN_RAD: f64 = 0.05;

/// A change of odometry that is no motion: REP-105 asks for odometry without jumps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Jump {
    pub distance_m: f64,
    pub turn_rad: f64,
    /// Time between the two poses.
    pub span_s: f64,
}

impl Jump {
    /// Returns the jump from one pose of a publisher to its next, if that is no motion. A driver can lose its origin though its publisher
    /// goes on, as when a robot's microcontroller is reset.
    pub(super) fn find(before: &SentPose, sent: Stamp, odom_from_base: &Pose2) -> Option<Self> {
        let last = before.odom_from_base;
        let jump = Self {
            distance_m: last.distance_m(*odom_from_base),
            turn_rad: wrap_angle(odom_from_base.yaw_rad - last.yaw_rad).abs(),
            span_s: sent - before.sent,
        };
        if jump.span_s <= 0.0 {
            return None;
        }
        let is_too_fast = jump.distance_m > JUMP_M + SPEED_MAX_M_S * jump.span_s
            || jump.turn_rad > JUMP_RAD + TURN_MAX_RAD_S * jump.span_s;
        let begins_anew = jump.span_s > DRIVER_SILENCE_S
            && is_at_origin(odom_from_base, BEGIN_M, BEGIN_RAD)
            && !is_at_origin(&last, JUMP_M, JUMP_RAD);
        (is_too_fast || begins_anew).then_some(jump)
    }
}

impl fmt::Display for Jump {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { distance_m, turn_rad, span_s } = self;
        write!(to, "jumps {distance_m:.2} m and {:.0} degrees in {span_s:.3} s", turn_rad.to_degrees())
    }
}

fn is_at_origin(pose: &Pose2, within_m: f64, within_rad: f64) -> bool {
    pose.x_m.hypot(pose.y_m) < within_m && pose.yaw_rad.abs() < within_rad
}

/// The publishers on DDS of a robot's odometry: of the topic, and of the transform odom -> base.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Drivers([Option<PublisherId>; 2]);

impl Drivers {
    /// Takes the publisher of a pose; returns whether it is another one than before and its odometry begins at the origin. The robot's
    /// driver was then started again. One whose odometry goes on where it was, as of robot_localization before a driver that runs on,
    /// was not.
    pub fn is_restart(
        &mut self,
        publisher: Option<PublisherId>,
        is_of_transform: bool,
        odom_from_base: &Pose2,
    ) -> bool {
        let Some(publisher) = publisher else { return false };
        let before = self.0[usize::from(is_of_transform)].replace(publisher);
        before.is_some_and(|before| before != publisher) && is_at_origin(odom_from_base, ORIGIN_M, ORIGIN_RAD)
    }
}

impl ExternalWorld {
    /// Returns whether a pose is the first of odometry with a new origin, and tells the operator of a jump.
    ///
    /// A client on TCP may be a simulation whose odometry is the truth: there a jump is a robot that was put elsewhere.
    pub(super) fn begins_anew(
        &mut self,
        origin: &Origin<'_>,
        robot: RobotId,
        sent: Stamp,
        odom_from_base: &Pose2,
        is_of_transform: bool,
    ) -> bool {
        let state = &mut self.robots[robot.index()];
        if state.drivers.is_restart(origin.publisher, is_of_transform, odom_from_base) {
            self.notices.push(format!("{robot}: its driver was started again: odometry has a new origin"));
            state.repeated_scan = RepeatedScan::default();
            return true;
        }
        let before = state.last_pose.filter(|last| last.is_of_transform == is_of_transform);
        let Some(jump) = before.and_then(|before| Jump::find(&before, sent, odom_from_base)) else {
            return false;
        };
        // That is no motion before a LiDAR that hangs.
        state.repeated_scan = RepeatedScan::default();
        let begins_anew = origin.publisher.is_some();
        state.watch.add_jump(robot, &jump, begins_anew, origin.received, &mut self.notices);
        begins_anew
    }

    /// Whether a scan stamped `step_s` later than the newest one, and those in a row before it, show that the clock was set back.
    pub(super) fn was_set_back(&mut self, robot: RobotId, step_s: f64, stamp: Stamp) -> bool {
        let state = &mut self.robots[robot.index()];
        if step_s > -SET_BACK_S {
            return false;
        }
        let in_row = state.set_back.filter(|(newest, _)| stamp > *newest).map_or(0, |(_, scans)| scans);
        state.set_back = Some((stamp, in_row + 1));
        in_row + 1 >= STEP_MESSAGES
    }

    /// Takes the times of a source anew: its clock was set, as this robot's scans show.
    pub(super) fn restart(&mut self, source: SourceId, robot: RobotId, step_s: f64) {
        let of_source = |robot: &&mut RobotState| robot.source.is_some_and(|(of, _)| of == source);
        for robot in self.robots.iter_mut().filter(of_source) {
            (robot.last_scan, robot.last_pose, robot.set_back) = (None, None, None);
        }
        if self.clock_source.is_some_and(|(of, _)| of == source) {
            self.clock = Stamp(i64::MIN);
        }
        self.step = Some((robot, step_s));
    }

    /// Returns by how many seconds a clock was found to be set back since the last call, and by whose scans.
    pub fn take_step(&mut self) -> Option<(RobotId, f64)> {
        self.step.take()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const DRIVER: PublisherId = [1; 16];
    const NEXT: PublisherId = [2; 16];

    #[test]
    fn a_new_publisher_whose_odometry_begins_at_the_origin_is_a_restarted_driver() {
        let at = |x_m| Pose2::new(x_m, 0.0, 0.1);
        let mut drivers = Drivers::default();
        assert!(!drivers.is_restart(Some(DRIVER), true, &at(0.0)), "the first one");
        assert!(!drivers.is_restart(Some(DRIVER), true, &at(3.0)));
        assert!(!drivers.is_restart(Some(DRIVER), true, &at(0.0)), "the same one is back at its origin");
        assert!(
            !drivers.is_restart(Some(NEXT), false, &at(0.0)),
            "the topic is another estimate than the transform"
        );
        assert!(drivers.is_restart(Some(NEXT), true, &at(0.1)));
        assert!(!drivers.is_restart(Some(NEXT), true, &at(0.1)), "once");
        assert!(!drivers.is_restart(Some(DRIVER), true, &at(2.0)), "its odometry goes on");
        assert!(!drivers.is_restart(None, true, &at(0.0)), "a client on TCP has no publisher");
    }

    fn jump(before: [f64; 3], after: [f64; 3], span_s: f64) -> bool {
        let pose = |[x_m, y_m, yaw_rad]: [f64; 3]| Pose2::new(x_m, y_m, yaw_rad);
        let sent = SentPose {
            sent: Stamp::from_seconds(5.0),
            stamp: Stamp::from_seconds(5.0),
            odom_from_base: pose(before),
            is_of_transform: true,
        };
        Jump::find(&sent, Stamp::from_seconds(5.0 + span_s), &pose(after)).is_some()
    }

    #[test]
    fn a_jump_is_what_no_wheels_can_do() {
        let far = [2.0, -1.0, 2.0];
        assert!(jump(far, [0.0; 3], 0.05), "a microcontroller that was reset");
        assert!(jump(far, [2.0, -1.0, -1.0], 0.05), "its heading alone");
        assert!(jump(far, [0.0; 3], 20.0), "it needs time to start");
        assert!(jump(far, [0.02, 0.0, 0.01], 0.6), "it drives on at once");
        assert!(!jump(far, [0.08, 0.0, 0.0], 20.0), "a robot that was driven back meanwhile");
        assert!(!jump([0.0, 0.005, 0.0], [0.0; 3], 20.0), "it has not moved");
        assert!(!jump(far, [0.0; 3], -0.05) && !jump(far, [0.0; 3], 0.0), "an old or repeated pose");
        assert!(!jump([0.0, 0.0, 3.1], [0.0, 0.0, -3.1], 0.05), "half a turn is passed");
    }

    proptest! {
        /// Whatever a robot within the limits of any TurtleBot does, it is no jump, unless it returns to its very origin unseen.
        #[test]
        fn motion_is_no_jump(
            start in prop::array::uniform3(-3.0..3.0_f64), speed_m_s in -2.0..2.0_f64, turn_rad_s in -4.0..4.0_f64,
            span_s in 0.005..0.5_f64,
        ) {
            let [x_m, y_m, yaw_rad] = start;
            let turn = turn_rad_s * span_s;
            let step = Pose2::new(speed_m_s * span_s * (turn / 2.0).cos(), speed_m_s * span_s * (turn / 2.0).sin(), turn);
            let after = Pose2::new(x_m, y_m, yaw_rad) * step;
            prop_assert!(!jump(start, [after.x_m, after.y_m, after.yaw_rad], span_s));
        }
    }
}
