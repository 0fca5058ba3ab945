//! Standstill of a robot that drives to goals: since when, for whom, and the priority that it has got. It outlasts goals that are
//! replaced, as those of an exploration are each second: else a robot that stands would never be helped.

use msg::{Pose2, RobotId, Stamp};

/// Distance from a place from which a robot has left it, metres: as for progress, a little more than two cells of the map.
const LEFT_PLACE_M: f64 = 0.12;

/// Standstill of one robot.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Standstill {
    /// Where it has been since when, in `odom`.
    place: Option<(Pose2, Stamp)>,
    /// The robot that it stands for although its own plan leads on, and since when.
    stopped_by: Option<(RobotId, Stamp)>,
    /// How often it was put before all others because it could not get out of their way.
    pub(super) promoted: u32,
}

impl Standstill {
    /// Records where the robot is.
    pub(super) fn observe(&mut self, now: Stamp, odom_from_base: Pose2) {
        let is_there = |(place, _): &(Pose2, Stamp)| place.distance_m(odom_from_base) < LEFT_PLACE_M;
        if !self.place.as_ref().is_some_and(is_there) {
            self.place = Some((odom_from_base, now));
        }
    }

    /// Since when it has not left its place; `now` if that is not known.
    pub(super) fn since(&self, now: Stamp) -> Stamp {
        self.place.map_or(now, |(_, since)| since)
    }

    /// Records whom it stands for although its own plan leads on; `None`: something else.
    pub(super) fn record_stop(&mut self, now: Stamp, robot: Option<RobotId>) {
        let known = self.stopped_by.filter(|(known, _)| Some(*known) == robot);
        self.stopped_by = known.or(robot.map(|robot| (robot, now)));
    }

    /// Records that it drives, or that the other robot goes first from now on.
    pub(super) fn forget_stop(&mut self) {
        self.stopped_by = None;
    }

    /// The robot that it has stood for as long as this, although its own plan leads on.
    pub(super) fn stopped_by(&self, now: Stamp, least_s: f64) -> Option<RobotId> {
        self.stopped_by.filter(|(_, since)| now - *since >= least_s).map(|(robot, _)| robot)
    }

    /// Puts it before robots that were promoted less often; it has stood for nobody yet.
    pub(super) fn promote(&mut self, promoted: u32) {
        (self.promoted, self.stopped_by) = (promoted, None);
    }
}
