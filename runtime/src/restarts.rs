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
/// Deaths in a row at which a process is given up, because restarts do not help.
pub const DEATHS_MAX: u32 = 9;

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
    /// The process is not started again, because it died too often.
    GivenUp,
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

    /// Records that the process ended or could not be started; returns the new state.
    pub fn on_death(&mut self, now: Monotonic) -> State {
        if let State::Running { since } = self.state
            && now.since(since) >= HEALTHY_AFTER.as_nanos() as u64
        {
            self.deaths = 0;
        }
        self.deaths += 1;
        self.state = if self.deaths >= DEATHS_MAX {
            State::GivenUp
        } else {
            let delay = match self.deaths {
                1 => Duration::ZERO,
                deaths => RESTART_DELAY.saturating_mul(1 << (deaths - 2)).min(RESTART_DELAY_MAX),
            };
            State::Waiting { until: Monotonic(now.0 + delay.as_nanos() as u64) }
        };
        self.state
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000_000;

    /// Returns the wait after each death in a row, milliseconds, until the process is held.
    fn delays(lives: u64) -> Vec<u64> {
        let (mut policy, mut now) = (RestartPolicy::new(Monotonic(0)), 0);
        let mut delays = Vec::new();
        for _ in 0..2 * DEATHS_MAX {
            policy.on_started(Monotonic(now));
            now += lives;
            let State::Waiting { until } = policy.on_death(Monotonic(now)) else { break };
            assert!(policy.is_due(until) && (until.0 == now || !policy.is_due(Monotonic(until.0 - 1))));
            delays.push((until.0 - now) / 1_000_000);
            now = until.0;
        }
        delays
    }

    #[test]
    fn back_off_doubles_to_five_seconds_and_ends_at_the_ninth_death() {
        assert_eq!(delays(SECOND), [0, 200, 400, 800, 1600, 3200, 5000, 5000]);
    }

    #[test]
    fn a_process_that_lived_ten_seconds_is_started_at_once() {
        assert_eq!(delays(10 * SECOND), vec![0; 2 * DEATHS_MAX as usize]);
    }
}
