//! A clock that was set back, as a simulation that begins anew or a machine whose time is corrected does it; and a driver that was started
//! again.
//!
//! Stamps of ROS 2 are taken as they are. Without this, all scans would be refused until the time has caught up.

use super::publishers::PublisherId;
use super::suspects::STEP_MESSAGES;
use super::{ExternalWorld, RobotState, SourceId};
use msg::{Pose2, RobotId, Stamp};

/// Scans stamped so much earlier than the newest one mean that the source's clock was set back, if several in a row agree, seconds.
const SET_BACK_S: f64 = 1.0;

/// Within this distance and turn from its origin odometry begins, metres and radians.
const ORIGIN_M: f64 = 0.2;
const ORIGIN_RAD: f64 = 0.2;

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
        let is_at_origin = odom_from_base.x_m.hypot(odom_from_base.y_m) < ORIGIN_M
            && odom_from_base.yaw_rad.abs() < ORIGIN_RAD;
        before.is_some_and(|before| before != publisher) && is_at_origin
    }
}

impl ExternalWorld {
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

    /// Takes the times of a source anew: its clock was set.
    pub(super) fn restart(&mut self, source: SourceId, step_s: f64) {
        let of_source = |robot: &&mut RobotState| robot.source.is_some_and(|(of, _)| of == source);
        for robot in self.robots.iter_mut().filter(of_source) {
            (robot.last_scan, robot.last_pose, robot.set_back) = (None, None, None);
        }
        if self.clock_source.is_some_and(|(of, _)| of == source) {
            self.clock = Stamp(i64::MIN);
        }
        self.step_s = Some(step_s);
    }

    /// Returns by how many seconds a clock was found to be set back since the last call.
    pub fn take_step(&mut self) -> Option<f64> {
        self.step_s.take()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
