//! The emergency stop across machines: a robot takes over the stop of the base that leads, and keeps it.
//!
//! Only the base that set the stop releases it, or a person at the robot. A base that starts anew, or another one, releases
//! nothing: it never said that the robot is stopped. A stop that held at the robot before is the robot's own.

use crate::wire::BaseState;
use msg::Monotonic;
use std::time::Duration;

/// Time after which a stop is requested again that the robot's bridge does not confirm.
const REPEAT_PERIOD: Duration = Duration::from_secs(1);
/// Time that the robot's bridge gets to release a stop of the base.
const RELEASE_MAX: Duration = Duration::from_secs(2);

/// Request to the robot's own bridge, which keeps the stop on its disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StopRequest {
    /// Set the emergency stop.
    Set,
    /// Release the emergency stop.
    Release,
}

/// What a robot's emergency stop owes to the base that leads.
#[derive(Debug, Default)]
pub struct StopFollower {
    /// Session of the base whose stop this robot took over.
    stopped_by: Option<u64>,
    requested: Option<Monotonic>,
    /// When the base's stop was released last.
    released: Option<Monotonic>,
}

impl StopFollower {
    /// Applies the state of the base of this session. `is_stopped`: whether the robot's own stop is set, if that is known.
    pub fn follow(
        &mut self,
        base: u64,
        state: BaseState,
        is_stopped: Option<bool>,
        now: Monotonic,
    ) -> Option<StopRequest> {
        if !state.is_known {
            return None;
        }
        if !state.is_stopped {
            let is_released = self.stopped_by == Some(base);
            if is_released {
                (self.stopped_by, self.requested, self.released) = (None, None, Some(now));
            }
            return is_released.then_some(StopRequest::Release);
        }
        // Somebody at the robot stopped it, for reasons of his own: a base that stops its fleet meanwhile does not own that stop.
        if self.stopped_by.is_none() && is_stopped == Some(true) {
            return None;
        }
        self.released = None;
        let is_new = self.stopped_by.replace(base) != Some(base);
        let is_due = self.requested.is_none_or(|at| now.since(at) >= REPEAT_PERIOD.as_nanos() as u64);
        let is_requested = is_new || (is_stopped != Some(true) && is_due);
        if is_requested {
            self.requested = Some(now);
        }
        is_requested.then_some(StopRequest::Set)
    }

    /// Returns whether a stop that holds is the robot's own: the base of this session cannot release it. A stop that was just
    /// released holds for a moment longer.
    pub fn is_own(&self, base: Option<u64>, now: Monotonic) -> bool {
        let is_being_released = self.released.is_some_and(|at| now.since(at) < RELEASE_MAX.as_nanos() as u64);
        !is_being_released && (self.stopped_by.is_none() || self.stopped_by != base)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(is_stopped: bool) -> BaseState {
        BaseState { is_stopped, is_known: true, ..BaseState::default() }
    }

    #[test]
    fn a_stop_that_somebody_at_the_robot_has_set_is_not_released_by_the_base() {
        let mut follower = StopFollower::default();
        assert_eq!(follower.follow(1, said(true), Some(true), Monotonic(1)), None, "it is stopped");
        assert_eq!(follower.follow(1, said(false), Some(true), Monotonic(2)), None, "and not by the base");
        assert!(follower.is_own(Some(1), Monotonic(3)));
    }

    #[test]
    fn the_stop_of_the_base_is_taken_over_and_released_by_that_base_alone() {
        let mut follower = StopFollower::default();
        assert_eq!(follower.follow(1, said(false), Some(false), Monotonic(1)), None, "nothing to release");
        assert_eq!(follower.follow(1, said(true), Some(false), Monotonic(2)), Some(StopRequest::Set));
        assert_eq!(follower.follow(1, said(true), Some(true), Monotonic(3)), None, "once while it holds");
        assert!(!follower.is_own(Some(1), Monotonic(3)) && follower.is_own(Some(2), Monotonic(3)));
        // Another base leads now, which never stopped anything.
        assert_eq!(follower.follow(2, said(false), Some(true), Monotonic(4)), None);
        assert_eq!(follower.follow(1, BaseState::default(), Some(true), Monotonic(5)), None, "not known");
        assert_eq!(follower.follow(1, said(false), Some(true), Monotonic(6)), Some(StopRequest::Release));
        assert!(!follower.is_own(Some(1), Monotonic(7)), "its bridge is about to release it");
        assert!(follower.is_own(Some(1), Monotonic(3_000_000_000)), "it does not");
    }

    #[test]
    fn a_stop_that_is_not_confirmed_is_requested_again() {
        let mut follower = StopFollower::default();
        follower.follow(1, said(true), None, Monotonic(1));
        assert_eq!(follower.follow(1, said(true), None, Monotonic(2)), None, "not in every message");
        let later = Monotonic(2_000_000_000);
        assert_eq!(follower.follow(1, said(true), None, later), Some(StopRequest::Set));
    }
}
