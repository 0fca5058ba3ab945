//! A clock that was set back, as a simulation that begins anew or a machine whose time is corrected does it; and a driver whose odometry
//! begins at a new origin, because it was started again or reset.
//!
//! Stamps of ROS 2 are taken as they are. Without this, all scans would be refused until the time has caught up.

use super::checks::{TransformError, planar_pose};
use super::frozen::RepeatedScan;
use super::publishers::PublisherId;
use super::suspects::STEP_MESSAGES;
use super::{ExternalWorld, MessageContext, RobotState, SentPose, SourceId};
use msg::{Pose2, RobotFrameTransform, RobotId, Stamp, pose::wrap_angle};
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
/// Odometry of another publisher than before goes on from the robot's last pose if the robot was not faster than this since,
/// metres and radians a second.
const NEXT_DRIVER_M_S: f64 = 1.0;
const NEXT_DRIVER_RAD_S: f64 = 2.0;

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
        let jump = Self::between(before, sent, odom_from_base)?;
        let begins_anew = jump.span_s > DRIVER_SILENCE_S
            && is_at_origin(odom_from_base, BEGIN_M, BEGIN_RAD)
            && !is_at_origin(&before.odom_from_base, JUMP_M, JUMP_RAD);
        (jump.is_faster_than(SPEED_MAX_M_S, TURN_MAX_RAD_S) || begins_anew).then_some(jump)
    }

    /// Returns the change from one pose to a later one; `None` if it is not later.
    fn between(before: &SentPose, sent: Stamp, odom_from_base: &Pose2) -> Option<Self> {
        let last = before.odom_from_base;
        let span_s = sent - before.sent;
        (span_s > 0.0).then(|| Self {
            distance_m: last.distance_m(*odom_from_base),
            turn_rad: wrap_angle(odom_from_base.yaw_rad - last.yaw_rad).abs(),
            span_s,
        })
    }

    fn is_faster_than(&self, speed_m_s: f64, turn_rad_s: f64) -> bool {
        self.distance_m > JUMP_M + speed_m_s * self.span_s
            || self.turn_rad > JUMP_RAD + turn_rad_s * self.span_s
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

/// Who sends a robot's odometry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum DriverId {
    /// A publisher on DDS.
    Publisher(PublisherId),
    /// A connection of a client on TCP.
    Client(SourceId),
}

impl DriverId {
    /// The sender of a message.
    pub fn of(context: &MessageContext<'_>) -> Self {
        context.publisher.map_or(Self::Client(context.source), Self::Publisher)
    }
}

/// Who sends a robot's odometry: the topic, and the transform odom -> base.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Drivers([Driver; 2]);

/// The sender whose poses are taken, and the first pose of one that waits until it is known whether that one has ended.
#[derive(Clone, Copy, Debug, Default)]
struct Driver {
    taken: Option<DriverId>,
    waiting: Option<(DriverId, FirstPose)>,
    /// The clock was set back since its last pose: a simulation may have begun anew.
    is_time_new: bool,
}

/// The first pose that was heard of a sender.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FirstPose {
    /// Its stamp by the robot's clock.
    pub sent: Stamp,
    /// Pose of the base in its odometry's frame.
    pub odom_from_base: Pose2,
}

impl Drivers {
    /// Takes a pose of a sender whose poses are not taken yet.
    pub fn add_waiting(&mut self, id: DriverId, is_of_transform: bool, pose: FirstPose) {
        let waiting = &mut self.0[usize::from(is_of_transform)].waiting;
        if waiting.is_none_or(|(known, _)| known != id) {
            *waiting = Some((id, pose));
        }
    }

    /// Takes a pose; returns the first one that was heard of its sender, if that is another one than before, or since the clock was set back.
    pub fn take(&mut self, id: DriverId, is_of_transform: bool, pose: FirstPose) -> Option<FirstPose> {
        let driver = &mut self.0[usize::from(is_of_transform)];
        let is_time_new = std::mem::take(&mut driver.is_time_new);
        // One that waits while this one sends has begun long before it is taken.
        let first = driver.waiting.take().filter(|(waiting, _)| *waiting == id);
        let before = driver.taken.replace(id)?;
        (before != id || is_time_new).then(|| first.map_or(pose, |(_, first)| first))
    }

    /// Records that the clock was set back.
    pub fn begin_time_anew(&mut self) {
        self.0.iter_mut().for_each(|driver| driver.is_time_new = true);
    }

    /// Forgets who waits: two publishers send at once, and one that is left of them has begun long before.
    pub fn forget_waiting(&mut self) {
        self.0.iter_mut().for_each(|driver| driver.waiting = None);
    }
}

/// Returns whether the odometry of another sender than before begins anew: at its origin, or where the robot cannot have got since its last
/// pose. Odometry that goes on where it was, as of robot_localization before a driver that runs on, does not.
fn is_restart(first: &Pose2, from_last: Option<Jump>) -> bool {
    is_at_origin(first, ORIGIN_M, ORIGIN_RAD)
        || from_last.is_some_and(|way| way.is_faster_than(NEXT_DRIVER_M_S, NEXT_DRIVER_RAD_S))
}

impl ExternalWorld {
    /// Returns whether a pose is the first of odometry with a new origin, and tells the operator of a jump.
    ///
    /// A client on TCP may be a simulation whose odometry is the truth: there a jump within one connection is a robot that was put elsewhere. A
    /// connection that begins is a simulation that may have begun anew.
    pub(super) fn begins_anew(
        &mut self,
        context: &MessageContext<'_>,
        robot: RobotId,
        sent: Stamp,
        odom_from_base: &Pose2,
        is_of_transform: bool,
    ) -> bool {
        let state = &mut self.robots[robot.index()];
        let before = state.last_pose.filter(|last| last.is_of_transform == is_of_transform);
        let pose = FirstPose { sent, odom_from_base: *odom_from_base };
        let first_of_next = state.drivers.take(DriverId::of(context), is_of_transform, pose);
        let way_to = |first: &FirstPose| Jump::between(&before?, first.sent, &first.odom_from_base);
        if first_of_next.is_some_and(|first| is_restart(&first.odom_from_base, way_to(&first))) {
            self.notices.push(format!("{robot}: its driver was started again: odometry has a new origin"));
            state.repeated_scan = RepeatedScan::default();
            return true;
        }
        let Some(jump) = before.and_then(|before| Jump::find(&before, sent, odom_from_base)) else {
            return false;
        };
        // That is no motion before a LiDAR that hangs.
        state.repeated_scan = RepeatedScan::default();
        let begins_anew = context.publisher.is_some();
        state.watch.add_jump(robot, &jump, begins_anew, context.received, &mut self.notices);
        begins_anew
    }

    /// Takes a pose of odometry that waits until it is known whether the publisher before has ended.
    pub(super) fn note_waiting(
        &mut self,
        context: &MessageContext<'_>,
        robot: RobotId,
        sent: Stamp,
        transform: &RobotFrameTransform,
        is_of_transform: bool,
    ) -> Result<(), TransformError> {
        let pose = FirstPose { sent, odom_from_base: planar_pose(transform)? };
        self.robots[robot.index()].drivers.add_waiting(DriverId::of(context), is_of_transform, pose);
        Ok(())
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
            robot.drivers.begin_time_anew();
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

    const DRIVER: DriverId = DriverId::Publisher([1; 16]);
    const NEXT: DriverId = DriverId::Publisher([2; 16]);

    #[test]
    fn a_new_publisher_whose_odometry_begins_at_the_origin_is_a_restarted_driver() {
        let at = |x_m| Pose2::new(x_m, 0.0, 0.1);
        let mut drivers = Drivers::default();
        let mut is_restart = |publisher, is_of_transform, x_m| {
            let pose = FirstPose { sent: Stamp(0), odom_from_base: at(x_m) };
            let first = drivers.take(publisher, is_of_transform, pose);
            first.is_some_and(|first| super::is_restart(&first.odom_from_base, None))
        };
        assert!(!is_restart(DRIVER, true, 0.0), "the first one");
        assert!(!is_restart(DRIVER, true, 3.0));
        assert!(!is_restart(DRIVER, true, 0.0), "the same one is back at its origin");
        assert!(!is_restart(NEXT, false, 0.0), "the topic is another estimate than the transform");
        assert!(is_restart(NEXT, true, 0.1));
        assert!(!is_restart(NEXT, true, 0.1), "once");
        assert!(!is_restart(DRIVER, true, 2.0), "its odometry goes on");
        assert!(is_restart(DriverId::Client(3), true, 0.0), "a simulation that has connected");
        assert!(!is_restart(DriverId::Client(3), true, 0.0) && !is_restart(DriverId::Client(4), true, 2.0));
    }

    #[test]
    fn a_robot_that_drives_on_while_its_next_driver_waits_is_told_by_the_first_pose_that_was_heard() {
        let at = |x_m| FirstPose { sent: Stamp(0), odom_from_base: Pose2::new(x_m, 0.0, 0.0) };
        let mut drivers = Drivers::default();
        assert_eq!(drivers.take(DRIVER, true, at(3.0)), None);
        drivers.add_waiting(NEXT, true, at(0.1));
        drivers.add_waiting(NEXT, true, at(0.5));
        assert_eq!(drivers.take(NEXT, true, at(0.9)), Some(at(0.1)));
        assert_eq!(drivers.take(NEXT, true, at(1.0)), None);
        // One that began while the other went on sending is no driver that was started again.
        drivers.add_waiting(DRIVER, true, at(0.0));
        assert_eq!(drivers.take(NEXT, true, at(1.1)), None);
        assert_eq!(drivers.take(DRIVER, true, at(2.0)), Some(at(2.0)));
        drivers.add_waiting(NEXT, true, at(0.0));
        drivers.forget_waiting();
        assert_eq!(drivers.take(NEXT, true, at(2.0)), Some(at(2.0)));
    }

    #[test]
    fn a_new_publisher_that_begins_where_the_robot_cannot_have_got_is_a_restarted_driver() {
        let way = |distance_m, span_s| Some(Jump { distance_m, turn_rad: 0.0, span_s });
        let first = Pose2::new(1.0, 0.0, 0.0);
        assert!(is_restart(&first, way(3.0, 2.1)), "it was heard late");
        assert!(!is_restart(&first, way(1.0, 2.1)) && !is_restart(&first, None));
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
