//! Which velocities of the base a robot admits: those to itself that are recent and know of its last interruption.

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

/// Admits velocities of the base that leads.
#[derive(Clone, Copy, Debug, Default)]
pub struct VelocityAdmission {
    /// Number of stops and of drives by hand; `None` before it is known.
    interruptions: Option<u32>,
    /// The base does not know of the last interruption yet.
    is_unreported: bool,
    /// When it was reported: an older answer does not know of it.
    reported_at: Monotonic,
    late: Option<Series>,
    /// Messages to another machine that bears the robot's name.
    to_other: Option<Series>,
    /// Velocities that came too late.
    pub late_count: u64,
}

impl VelocityAdmission {
    /// Sets the number of stops and of drives by hand at this machine; returns whether the base is to know.
    pub fn set_interruptions(&mut self, count: u32) -> bool {
        let is_new = self.interruptions.replace(count).is_some_and(|before| before != count);
        self.is_unreported |= is_new;
        is_new
    }

    /// Returns the number of stops and of drives by hand, which a message of this time reports to the base.
    pub fn report_interruptions(&mut self, now: Monotonic) -> u32 {
        if std::mem::take(&mut self.is_unreported) {
            self.reported_at = now;
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

    /// Returns whether a velocity to this session is admitted, which answers our message of the time `answers`.
    pub fn admit(&mut self, answers: Monotonic, now: Monotonic) -> bool {
        if is_recent(answers, now) {
            self.late = None;
            return !self.is_unreported && answers >= self.reported_at;
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
    fn a_velocity_from_before_an_interruption_is_not_admitted() {
        let mut admission = VelocityAdmission::default();
        assert!(!admission.set_interruptions(4), "what was before is no interruption");
        assert!(admission.admit(at(0), at(100)));
        assert!(admission.set_interruptions(5));
        assert!(!admission.admit(at(100), at(110)), "the base cannot know yet");
        assert_eq!(admission.report_interruptions(at(120)), 5);
        assert!(!admission.admit(at(110), at(200)));
        assert!(admission.admit(at(120), at(220)));
    }

    #[test]
    fn velocities_that_all_come_late_mean_a_slow_link() {
        let mut admission = VelocityAdmission::default();
        (0..=20).for_each(|i| assert!(!admission.admit(at(100 * i), at(700 + 100 * i))));
        assert!(admission.is_late(at(2_700)) && !admission.is_late(at(4_000)));
        assert!(admission.admit(at(2_700), at(2_800)));
        assert!(!admission.is_late(at(2_800)));
    }

    #[test]
    fn a_machine_is_refused_when_the_base_answers_another_for_long() {
        let mut admission = VelocityAdmission::default();
        assert!(!admission.is_addressed(8, 7, at(0)) && !admission.is_addressed(8, 7, at(4_000)));
        assert!(!admission.is_refused(), "a former process of the link");
        assert!(!admission.is_addressed(8, 7, at(5_000)));
        assert!(admission.is_refused());
        assert!(admission.is_addressed(7, 7, at(6_000)) && !admission.is_refused());
    }
}
