//! Restart policy of a process: decisions only, so that lockstep can make the same ones.

use msg::Monotonic;
use std::time::Duration;

/// Time between a second death in a row and the next start. A first death is followed by a start at once: a robot outside
/// the simulator drives on until the next bridge stops it. A child that cannot start does not take a whole core.
const RESTART_DELAY: Duration = Duration::from_millis(200);
/// The longest time between a death and the next start: back-off doubles up to it.
const RESTART_DELAY_MAX: Duration = Duration::from_secs(5);
/// Life time after which a child counts as recovered; its next death starts the back-off anew.
const HEALTHY_AFTER: Duration = Duration::from_secs(10);
/// Deaths in a row from which on a process counts as failing: restarts do not help, but what it lacks may come back.
pub const FAILING_DEATHS: u32 = 9;
/// Time between the death of a failing process and its next start.
pub const FAILING_DELAY: Duration = Duration::from_secs(30);

/// The state of one process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// The process was started and has not ended.
    Running {
        /// When it was started.
        since: Monotonic,
    },
    /// The process waits for its start.
    Waiting {
        /// When it is to be started.
        until: Monotonic,
    },
}

/// Decides when one process is started again.
#[derive(Clone, Debug)]
pub struct RestartPolicy {
    state: State,
    /// Deaths in a row.
    deaths: u32,
    /// How often the process was started.
    starts: u64,
}

impl RestartPolicy {
    /// Creates the policy of a process that is to be started now.
    pub fn new(now: Monotonic) -> Self {
        Self { state: State::Waiting { until: now }, deaths: 0, starts: 0 }
    }

    /// Returns the state of the process.
    pub fn state(&self) -> State {
        self.state
    }

    /// Returns how often the process was started.
    pub fn starts(&self) -> u64 {
        self.starts
    }

    /// Returns whether it is to be started now.
    pub fn is_due(&self, now: Monotonic) -> bool {
        matches!(self.state, State::Waiting { until } if now >= until)
    }

    /// Records that the process was started.
    pub fn on_started(&mut self, now: Monotonic) {
        self.state = State::Running { since: now };
        self.starts += 1;
    }

    /// Records that the process ended or could not be started; returns whether it counts as failing from now on.
    pub fn on_death(&mut self, now: Monotonic) -> bool {
        if self.has_recovered(now) {
            self.deaths = 0;
        }
        self.deaths = self.deaths.saturating_add(1);
        let delay = match self.deaths {
            1 => Duration::ZERO,
            deaths if deaths < FAILING_DEATHS => {
                RESTART_DELAY.saturating_mul(1 << (deaths - 2)).min(RESTART_DELAY_MAX)
            }
            _ => FAILING_DELAY,
        };
        self.state = State::Waiting { until: Monotonic(now.0 + delay.as_nanos() as u64) };
        self.deaths == FAILING_DEATHS
    }

    /// Returns whether the process died again and again, and has not lived for long since.
    pub fn is_failing(&self, now: Monotonic) -> bool {
        self.deaths >= FAILING_DEATHS && !self.has_recovered(now)
    }

    /// Ends the wait of a failing process: what it lacked may be there again.
    pub fn retry_if_failing(&mut self, now: Monotonic) {
        if let State::Waiting { until } = &mut self.state
            && self.deaths >= FAILING_DEATHS
        {
            *until = now.min(*until);
        }
    }

    fn has_recovered(&self, now: Monotonic) -> bool {
        matches!(self.state, State::Running { since } if now.since(since) >= HEALTHY_AFTER.as_nanos() as u64)
    }
}

/// Says that a process counts as failing, to follow its name.
pub fn failing_text() -> String {
    format!(
        "died {FAILING_DEATHS} times in a row; from now on it is started every {} s",
        FAILING_DELAY.as_secs()
    )
}

/// Longest time for which starts wait until another process has removed what a dead one left: that process may hang or die itself.
const CLEANING_MAX: Duration = Duration::from_secs(5);

/// Wait until what dead processes left is removed. Until then their places in channels are taken, and a process that is started in
/// their stead would not get them.
#[derive(Debug, Default)]
pub struct CleaningWait {
    /// End of the wait. It stays in the past while nothing is removed, so that further deaths begin no new wait.
    until: Option<Monotonic>,
}

impl CleaningWait {
    /// Removes by `clean` what the dead left, if a process `died` or another one was removing it before; `clean` returns whether
    /// another one is. Returns whether processes may be started.
    pub fn may_start(&mut self, died: bool, now: Monotonic, clean: impl FnOnce() -> bool) -> bool {
        if died || self.until.is_some_and(|until| now < until) {
            let until = self.until.unwrap_or(now + CLEANING_MAX);
            self.until = clean().then_some(until);
        }
        self.until.is_none_or(|until| now >= until)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000_000;
    const DEATHS: usize = 2 * FAILING_DEATHS as usize;

    /// Returns the wait after each death in a row, milliseconds, and the death at which the process began to fail.
    fn delays(life: u64) -> (Vec<u64>, Option<usize>) {
        let (mut policy, mut now) = (RestartPolicy::new(Monotonic(0)), 0);
        let (mut delays, mut failing) = (Vec::new(), None);
        for death in 1..=DEATHS {
            policy.on_started(Monotonic(now));
            now += life;
            if policy.on_death(Monotonic(now)) {
                assert_eq!(failing.replace(death), None, "it is told once");
            }
            let State::Waiting { until } = policy.state() else { panic!("it is not started again") };
            assert!(policy.is_due(until) && (until.0 == now || !policy.is_due(Monotonic(until.0 - 1))));
            assert_eq!(policy.is_failing(until), failing.is_some());
            delays.push((until.0 - now) / 1_000_000);
            now = until.0;
        }
        (delays, failing)
    }

    #[test]
    fn back_off_doubles_to_five_seconds_and_from_the_ninth_death_on_a_start_is_tried_for_ever() {
        let (delays, failing) = delays(SECOND);
        assert_eq!(delays[..8], [0, 200, 400, 800, 1600, 3200, 5000, 5000]);
        assert!(delays[8..].iter().all(|delay| *delay == 30_000));
        assert_eq!(failing, Some(9));
    }

    #[test]
    fn a_process_that_lived_ten_seconds_is_started_at_once() {
        assert_eq!(delays(10 * SECOND), (vec![0; DEATHS], None));
    }

    #[test]
    fn a_failing_process_is_started_at_once_when_there_is_room_again_and_then_recovers() {
        let mut policy = RestartPolicy::new(Monotonic(0));
        for _ in 1..FAILING_DEATHS {
            policy.on_death(Monotonic(0));
            policy.retry_if_failing(Monotonic(0));
        }
        assert!(!policy.is_due(Monotonic(0)), "a process that does not fail keeps its back-off");
        policy.on_death(Monotonic(0));
        let room = Monotonic(SECOND);
        assert!(!policy.is_due(room));
        policy.retry_if_failing(room);
        assert!(policy.is_due(room) && policy.is_failing(room));
        policy.on_started(room);
        let well = Monotonic(12 * SECOND);
        assert!(policy.is_failing(Monotonic(2 * SECOND)) && !policy.is_failing(well));
        policy.on_death(well);
        assert!(!policy.is_failing(well) && policy.is_due(well));
    }

    #[test]
    fn nothing_is_started_while_another_process_cleans_up_after_a_dead_one() {
        let mut wait = CleaningWait::default();
        let at = |s: u64| Monotonic(s * 1_000_000_000);
        assert!(wait.may_start(false, at(0), || unreachable!("nobody died")));
        assert!(wait.may_start(true, at(1), || false));
        assert!(!wait.may_start(true, at(2), || true), "another process cleans up");
        assert!(!wait.may_start(false, at(3), || true));
        assert!(wait.may_start(false, at(4), || false), "it is done");
        assert!(!wait.may_start(true, at(10), || true));
        assert!(!wait.may_start(true, at(13), || true), "one more died");
        assert!(
            wait.may_start(false, at(15), || unreachable!("it hangs")),
            "the wait is not longer for that"
        );
        assert!(wait.may_start(true, at(16), || true), "it hangs for good");
        assert!(wait.may_start(true, at(30), || false));
        assert!(!wait.may_start(true, at(31), || true), "another one cleans up");
    }
}
