//! The emergency stop across machines: a robot takes over the stop of every base that it hears, and keeps it.
//!
//! Only a base that set the stop releases it, or a person at the robot; while several bases are stopped, the last of them that is
//! heard. A base that starts anew, or another one, releases nothing: it never said that the robot is stopped. One whose link alone was
//! started again has the same run, and is the same base. A stop that held at the robot before is the robot's own.

use crate::leadership::SILENCE_MAX;
use crate::wire::BaseState;
use msg::Monotonic;
use std::time::Duration;

/// Time after which a stop is requested again that the robot's bridge does not confirm.
const REPEAT_PERIOD: Duration = Duration::from_secs(1);
/// Time that the robot's bridge gets to release a stop of the base.
const RELEASE_MAX: Duration = Duration::from_secs(2);
/// Most bases whose stops are told apart. The stop of one more holds, and a person at the robot releases it.
const HOLDERS_MAX: usize = 8;

/// Request to the robot's own bridge, which keeps the stop on its disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StopRequest {
    /// Set the emergency stop.
    Set,
    /// Release the emergency stop.
    Release,
}

/// A base whose stop a robot has taken over.
#[derive(Clone, Copy, Debug)]
struct Holder {
    session: u64,
    /// Number of its run; 0 if it has none.
    run: u32,
    heard: Monotonic,
}

/// What a robot's emergency stop owes to the bases that are heard.
#[derive(Debug, Default)]
pub struct StopFollower {
    /// Bases whose stop this robot took over and that have not released it.
    holders: Vec<Holder>,
    /// Whether the robot's own stop was set when that was known last.
    was_stopped: bool,
    requested: Option<Monotonic>,
    /// When the last base's stop was released.
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
        // One whose bridge does not answer is heard all the same: its stop is not another's to release.
        let is_of_run = |holder: &Holder| state.run != 0 && holder.run == state.run;
        if let Some(holder) =
            self.holders.iter_mut().find(|holder| holder.session == base || is_of_run(holder))
        {
            (holder.session, holder.heard) = (base, now);
        }
        if !state.is_known {
            return None;
        }
        let was_stopped = self.was_stopped;
        self.was_stopped = is_stopped.unwrap_or(was_stopped);
        if was_stopped && !self.was_stopped {
            // Somebody at the robot has released it. A base that is still stopped sets it again.
            self.holders.clear();
        }
        let known = self.holders.iter().position(|holder| holder.session == base);
        if !state.is_stopped {
            self.holders.remove(known?);
            // A base that is no more cannot release its stop: another that has set one can.
            let is_heard = |of: &Holder| now.since(of.heard) < SILENCE_MAX.as_nanos() as u64;
            if self.holders.iter().any(is_heard) {
                return None;
            }
            self.holders.clear();
            (self.requested, self.released) = (None, Some(now));
            return Some(StopRequest::Release);
        }
        // Somebody at the robot stopped it, for reasons of his own: a base that stops its fleet meanwhile does not own that stop.
        if self.holders.is_empty() && is_stopped == Some(true) {
            return None;
        }
        self.released = None;
        match known {
            Some(_) => {}
            None if self.holders.len() < HOLDERS_MAX => {
                self.holders.push(Holder { session: base, run: state.run, heard: now });
            }
            None => {}
        }
        let is_due = self.requested.is_none_or(|at| now.since(at) >= REPEAT_PERIOD.as_nanos() as u64);
        let is_requested = is_stopped != Some(true) && (is_due || known.is_none());
        if is_requested {
            self.requested = Some(now);
        }
        is_requested.then_some(StopRequest::Set)
    }

    /// Returns whether a stop that holds is not of the base of this session, which cannot release it. A stop that was just
    /// released holds for a moment longer.
    pub fn is_own(&self, base: Option<u64>, now: Monotonic) -> bool {
        let is_being_released = self.released.is_some_and(|at| now.since(at) < RELEASE_MAX.as_nanos() as u64);
        !is_being_released && !self.holders.iter().any(|holder| Some(holder.session) == base)
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

    #[test]
    fn the_stops_of_two_bases_hold_until_both_are_released() {
        let mut follower = StopFollower::default();
        let mut follow = |base, is_base_stopped, is_stopped, ms: u64| {
            follower.follow(base, said(is_base_stopped), Some(is_stopped), Monotonic(ms * 1_000_000))
        };
        assert_eq!(follow(1, true, false, 1), Some(StopRequest::Set));
        assert_eq!(follow(2, true, true, 2), None, "it is stopped");
        assert_eq!(follow(1, false, true, 3), None, "the other one is still stopped");
        assert_eq!(follow(1, false, true, 4), None);
        assert_eq!(follow(2, false, true, 5), Some(StopRequest::Release));
        // One of them is no more.
        assert_eq!(follow(1, true, false, 3_000), Some(StopRequest::Set));
        assert_eq!(follow(2, true, true, 3_001), None);
        assert_eq!(follow(2, false, true, 9_000), Some(StopRequest::Release));
    }

    #[test]
    fn a_base_whose_link_was_started_again_releases_its_stop() {
        let at = |ms: u64| Monotonic(ms * 1_000_000);
        for (is_still_stopped, release_ms) in [(true, 600), (false, 600), (true, 9_000)] {
            let mut follower = StopFollower::default();
            let of_run = |is_stopped| BaseState { run: 7, ..said(is_stopped) };
            assert_eq!(follower.follow(1, of_run(true), Some(false), at(1)), Some(StopRequest::Set));
            // Another process of the same base, soon after.
            if is_still_stopped {
                assert_eq!(follower.follow(2, of_run(true), Some(true), at(500)), None);
                assert!(!follower.is_own(Some(2), at(501)));
            }
            let other_run = BaseState { run: 8, ..said(false) };
            assert_eq!(follower.follow(3, other_run, Some(true), at(550)), None, "another base");
            let request = follower.follow(2, of_run(false), Some(true), at(release_ms));
            assert_eq!(request, Some(StopRequest::Release));
        }
    }

    #[test]
    fn a_person_at_the_robot_releases_the_stop_of_a_base_that_is_no_more_for_good() {
        let mut follower = StopFollower::default();
        let mut follow = |base, is_base_stopped, is_stopped, s: u64| {
            follower.follow(base, said(is_base_stopped), Some(is_stopped), Monotonic(s * 1_000_000_000))
        };
        assert_eq!(follow(1, true, false, 1), Some(StopRequest::Set));
        assert_eq!(follow(2, false, true, 10), None, "it set nothing");
        assert_eq!(follow(2, false, false, 11), None, "released at the robot");
        assert_eq!(follow(2, true, false, 12), Some(StopRequest::Set));
        assert_eq!(follow(2, false, true, 13), Some(StopRequest::Release));
    }

    #[test]
    fn the_stop_of_a_base_whose_bridge_does_not_answer_is_not_another_bases_to_release() {
        let mut follower = StopFollower::default();
        let at = |seconds: u64| Monotonic(seconds * 1_000_000_000);
        assert_eq!(follower.follow(1, said(true), Some(false), at(1)), Some(StopRequest::Set));
        assert_eq!(follower.follow(2, said(true), Some(true), at(1)), None);
        // The first one's bridge hangs, and its link goes on.
        (2..20).for_each(|second| {
            assert_eq!(follower.follow(1, BaseState::default(), Some(true), at(second)), None);
        });
        assert_eq!(follower.follow(2, said(false), Some(true), at(20)), None, "the first one is heard");
        assert_eq!(follower.follow(1, said(false), Some(true), at(21)), Some(StopRequest::Release));
    }

    #[test]
    fn of_too_many_bases_each_stop_holds() {
        let mut follower = StopFollower::default();
        let count = HOLDERS_MAX as u64 + 3;
        for base in 1..=count {
            let request = follower.follow(base, said(true), Some(base > 1), Monotonic(base));
            assert_eq!(request, (base == 1).then_some(StopRequest::Set));
        }
        assert_eq!(follower.holders.len(), HOLDERS_MAX);
    }
}
