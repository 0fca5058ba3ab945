//! A clock that was set back, as a simulation that begins anew or a machine whose time is corrected does it.
//!
//! Stamps of ROS 2 are taken as they are. Without this, all scans would be refused until the time has caught up.

use super::suspects::STEP_MESSAGES;
use super::{ExternalWorld, RobotState, SourceId};
use msg::{RobotId, Stamp};

/// Scans stamped so much earlier than the newest one mean that the source's clock was set back, if several in a row agree, seconds.
const SET_BACK_S: f64 = 1.0;

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
