//! Which velocities of the base a robot obeys: those to itself that are recent and know of its last interruption.

use crate::leadership::is_recent;
use crate::series::Series;
use crate::wire::INTERRUPTIONS_UNKNOWN;
use msg::Monotonic;
use std::time::Duration;

/// Time in which no velocity was recent enough after which the link counts as too slow to drive by.
const LATE_AFTER: Duration = Duration::from_secs(2);
/// Pause between two late velocities after which they are not one series.
const LATE_GAP_MAX: Duration = Duration::from_secs(1);
/// Time for which the base answers another machine after which this one counts as refused: a link that is started again is
/// accepted sooner.
const REFUSED_AFTER: Duration = Duration::from_secs(5);

/// Judges velocities of the base that leads.
#[derive(Clone, Copy, Debug, Default)]
pub struct Obedience {
    /// Number of stops and of drives by hand; `None` before it is known.
    interruptions: Option<u32>,
    /// The base has not been told of the last interruption yet.
    is_untold: bool,
    /// When it was told: an older answer does not know of it.
    told: Monotonic,
    late: Option<Series>,
    /// Messages to another machine that bears the robot's name.
    to_other: Option<Series>,
    /// Velocities that came too late.
    pub late_count: u64,
}

impl Obedience {
    /// Sets the number of stops and of drives by hand at this machine; returns whether the base is to be told.
    pub fn set_interruptions(&mut self, count: u32) -> bool {
        let is_new = self.interruptions.replace(count).is_some_and(|before| before != count);
        self.is_untold |= is_new;
        is_new
    }

    /// Returns the number of stops and of drives by hand, which a message of this time tells the base.
    pub fn tell_interruptions(&mut self, now: Monotonic) -> u32 {
        if std::mem::take(&mut self.is_untold) {
            self.told = now;
        }
        self.interruptions.unwrap_or(INTERRUPTIONS_UNKNOWN)
    }

    /// Records a message of the base to the address `to`; returns whether that is this session's, `own`.
    pub fn is_addressed(&mut self, to: u32, own: u32, now: Monotonic) -> bool {
        if to != own && to != 0 {
            self.to_other = Some(Series::with(self.to_other, now));
        } else {
            self.to_other = None;
        }
        to == own
    }

    /// Returns whether the base has accepted another machine that bears this robot's name.
    pub fn is_refused(&self) -> bool {
        self.to_other.is_some_and(|series| series.lasts(REFUSED_AFTER))
    }

    /// Judges a velocity to this session that answers our message of the time `answers`.
    pub fn judge(&mut self, answers: Monotonic, now: Monotonic) -> bool {
        if is_recent(answers, now) {
            self.late = None;
            return !self.is_untold && answers >= self.told;
        }
        self.late_count += 1;
        self.late = Some(Series::with(self.late_series(now), now));
        false
    }

    /// Returns whether velocities arrive, and all of them too late.
    pub fn is_late(&self, now: Monotonic) -> bool {
        self.late_series(now).is_some_and(|series| series.lasts(LATE_AFTER))
    }

    /// The late velocities that go on now.
    fn late_series(&self, now: Monotonic) -> Option<Series> {
        self.late.filter(|series| now.since(series.newest) <= LATE_GAP_MAX.as_nanos() as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64) -> Monotonic {
        Monotonic(1 + ms * 1_000_000)
    }

    #[test]
    fn a_velocity_from_before_an_interruption_is_not_obeyed() {
        let mut obedience = Obedience::default();
        assert!(!obedience.set_interruptions(4), "what was before is no interruption");
        assert!(obedience.judge(at(0), at(100)));
        assert!(obedience.set_interruptions(5));
        assert!(!obedience.judge(at(100), at(110)), "the base cannot know yet");
        assert_eq!(obedience.tell_interruptions(at(120)), 5);
        assert!(!obedience.judge(at(110), at(200)));
        assert!(obedience.judge(at(120), at(220)));
    }

    #[test]
    fn velocities_that_all_come_late_mean_a_slow_link() {
        let mut obedience = Obedience::default();
        (0..=20).for_each(|i| assert!(!obedience.judge(at(100 * i), at(700 + 100 * i))));
        assert!(obedience.is_late(at(2_700)) && !obedience.is_late(at(4_000)));
        assert!(obedience.judge(at(2_700), at(2_800)));
        assert!(!obedience.is_late(at(2_800)));
    }

    #[test]
    fn a_machine_is_refused_when_the_base_answers_another_for_long() {
        let mut obedience = Obedience::default();
        assert!(!obedience.is_addressed(8, 7, at(0)) && !obedience.is_addressed(8, 7, at(4_000)));
        assert!(!obedience.is_refused(), "a former process of the link");
        assert!(!obedience.is_addressed(8, 7, at(5_000)));
        assert!(obedience.is_refused());
        assert!(obedience.is_addressed(7, 7, at(6_000)) && !obedience.is_refused());
    }
}
