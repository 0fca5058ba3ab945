//! Progress of a robot towards its goal, and what it does when there is none.

use super::config::NavigatorConfig;
use crate::backing_up::BackingUp;
use core::time::Duration;
use msg::{Pose2, Stamp};

/// Decrease of the remaining cost that counts as progress, metres: two cells of the map.
const PROGRESS_M: f64 = 0.1;
/// Increase of the remaining cost from which the robot is on another way, metres.
const DETOUR_M: f64 = 0.5;
/// A goal may take this multiple of its expected time, and this many seconds more: a robot that is sent to and fro
/// by a door that opens and closes ends too.
const OVERDUE_FACTOR: f64 = 5.0;
const OVERDUE_EXTRA_S: f64 = 120.0;
/// Robots that wait for others may do so this many times as long as they stand for obstacles.
const WAITING_FACTOR: f64 = 3.0;
/// Longest time of turning to look around, seconds: about 100 degrees.
const TURN_S: f64 = 2.0;

/// A way to get free.
#[derive(Clone, Copy, Debug)]
pub(super) enum Recovery {
    /// Backing up, with positions in the frame of the odometry.
    BackUp(BackingUp),
    Turn {
        side: f64,
        until: Stamp,
    },
}

impl Recovery {
    pub(super) fn back_up(now: Stamp, odom_from_base: Pose2, distance_m: f64) -> Self {
        Self::BackUp(BackingUp::new(now, [odom_from_base.x_m, odom_from_base.y_m], distance_m))
    }

    pub(super) fn turn(now: Stamp, side: f64) -> Self {
        Self::Turn { side, until: now + Duration::from_secs_f64(TURN_S) }
    }

    pub(super) fn is_done(&self, now: Stamp, odom_from_base: Pose2) -> bool {
        match self {
            Self::BackUp(backing_up) => backing_up.is_done(now, [odom_from_base.x_m, odom_from_base.y_m]),
            Self::Turn { until, .. } => now >= *until,
        }
    }
}

/// Progress towards one pose of a goal.
#[derive(Clone, Copy, Debug)]
pub(super) struct Progress {
    best_m: f64,
    /// When there was progress last, or the goal was set.
    since: Stamp,
    /// When there was progress last, towards this goal or one that it replaced without a pause.
    stands_since: Stamp,
    deadline: Stamp,
    recoveries: u32,
}

impl Progress {
    pub(super) fn new(now: Stamp) -> Self {
        let deadline = now + Duration::from_secs_f64(OVERDUE_EXTRA_S);
        Self { best_m: f64::INFINITY, since: now, stands_since: now, deadline, recoveries: 0 }
    }

    /// The progress towards a goal that replaces this one. A robot that has not left its place is helped as if nothing was new, but
    /// has the whole time before it gives up.
    pub(super) fn to_new_goal(self, now: Stamp, place_since: Stamp) -> Self {
        let stands_since = self.stands_since.max(place_since);
        let recoveries = if stands_since == self.stands_since { self.recoveries } else { 0 };
        Self { stands_since, recoveries, ..Self::new(now) }
    }

    /// Records the remaining cost of the route, metres; returns whether it is progress.
    pub(super) fn record(&mut self, now: Stamp, config: &NavigatorConfig, remaining_m: f64) -> bool {
        if self.best_m == f64::INFINITY {
            let expected_s =
                (remaining_m / config.follower.cruise_m_s).min(OVERDUE_EXTRA_S * OVERDUE_EXTRA_S);
            self.deadline = now + Duration::from_secs_f64(OVERDUE_FACTOR * expected_s + OVERDUE_EXTRA_S);
            self.best_m = remaining_m;
            return false;
        }
        let is_progress = remaining_m < self.best_m - PROGRESS_M;
        if is_progress {
            (self.best_m, self.recoveries) = (remaining_m, 0);
            (self.since, self.stands_since) = (now, now);
        } else if remaining_m > self.best_m + DETOUR_M {
            self.best_m = remaining_m;
        }
        is_progress
    }

    /// Starts the times again, after a pause or a turn at the goal.
    pub(super) fn restart(&mut self, now: Stamp) {
        *self = Self::new(now);
    }

    /// Whether it is time for the next attempt to get free, later by `patience`; counts it.
    pub(super) fn take_recovery(&mut self, now: Stamp, config: &NavigatorConfig, patience: f64) -> bool {
        let wait_s = patience * config.recover_after_s * f64::from(self.recoveries + 1);
        let is_due = now - self.stands_since > wait_s;
        self.recoveries += u32::from(is_due);
        is_due
    }

    /// Whether to give up.
    pub(super) fn is_hopeless(&self, now: Stamp, config: &NavigatorConfig, is_waiting: bool) -> bool {
        let factor = if is_waiting { WAITING_FACTOR } else { 1.0 };
        now - self.since > factor * config.give_up_after_s || now > self.deadline
    }
}
