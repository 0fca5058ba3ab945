//! Growth of the known area: an exploration that shows nothing more comes to an end, however its robots drive.

use msg::Stamp;

/// Growth that attempts have to bring, square metres: less is the noise of a map of SLAM.
const GROWTH_MIN_M2: f64 = 0.1;
/// Loss of known area from which the map is another one, square metres: corrections of SLAM take less.
const SHRUNK_MIN_M2: f64 = 1.0;
/// Attempts without growth in a row after which exploration ends. Errors of SLAM open small gaps in walls again and again.
const VAIN_ATTEMPTS_MAX: u32 = 12;
/// Time without growth after which exploration ends: this multiple of the longest time that a goal was expected to take,
/// and this many seconds. Robots that are sent to and fro never end an attempt.
const VAIN_FACTOR: f64 = 3.0;
const VAIN_EXTRA_S: f64 = 180.0;

/// Why an exploration ends although something is left to see.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Exhaustion {
    /// Many attempts in a row have shown nothing: the rest is noise of the map.
    Attempts,
    /// Robots drove for a long time and have shown nothing.
    Time,
}

/// The known area, and what was done since it grew.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct KnownArea {
    /// Largest known area, square metres.
    known_m2: f64,
    vain_attempts: u32,
    /// Time of the newest plan, and that of the last growth or of the last plan without a robot.
    now: Stamp,
    grown_at: Stamp,
    /// Longest time that a goal since then was expected to take, seconds.
    longest_goal_s: f64,
}

impl KnownArea {
    /// Records the area after an attempt of some robot to see more.
    pub(super) fn record_attempt(&mut self, now: Stamp, known_m2: f64) {
        if !self.record(now, known_m2) {
            self.vain_attempts += 1;
        }
    }

    /// Records the area; returns whether it has grown, so that attempts are worth their time again.
    pub(super) fn record(&mut self, now: Stamp, known_m2: f64) -> bool {
        let has_grown = known_m2 > self.known_m2 + GROWTH_MIN_M2;
        // A map that has lost a part, as when robots are separated again, grows from what is left.
        let has_shrunk = known_m2 < self.known_m2 - SHRUNK_MIN_M2;
        self.now = now;
        if has_grown || has_shrunk {
            *self = Self { known_m2, now, grown_at: now, ..Self::default() };
        }
        has_grown
    }

    /// Records that no robot can be given goals: this time does not count.
    pub(super) fn record_no_robot(&mut self, now: Stamp) {
        (self.now, self.grown_at) = (now, now);
    }

    /// Records the time that a goal is expected to take, seconds.
    pub(super) fn record_goal(&mut self, expected_s: f64) {
        self.longest_goal_s = self.longest_goal_s.max(expected_s);
    }

    /// Whether the rest is not worth more time, and why.
    pub(super) fn exhaustion(&self) -> Option<Exhaustion> {
        let vain_max_s = VAIN_EXTRA_S + VAIN_FACTOR * self.longest_goal_s;
        if self.vain_attempts >= VAIN_ATTEMPTS_MAX {
            Some(Exhaustion::Attempts)
        } else {
            (self.now - self.grown_at > vain_max_s).then_some(Exhaustion::Time)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: f64) -> Stamp {
        Stamp::from_seconds(seconds)
    }

    #[test]
    fn attempts_that_show_nothing_in_a_row_exhaust_the_map() {
        let mut area = KnownArea::default();
        area.record_attempt(at(0.0), 10.0);
        for _ in 1..VAIN_ATTEMPTS_MAX {
            area.record_attempt(at(1.0), 10.09);
        }
        assert_eq!(area.exhaustion(), None);
        area.record_attempt(at(2.0), 10.11);
        (0..VAIN_ATTEMPTS_MAX).for_each(|_| area.record_attempt(at(3.0), 10.15));
        assert_eq!(area.exhaustion(), Some(Exhaustion::Attempts));
        area.record(at(4.0), 10.3);
        assert_eq!(area.exhaustion(), None, "a map that is merged late opens new space");
    }

    #[test]
    fn what_is_seen_after_a_part_of_the_map_was_lost_is_not_in_vain() {
        let mut area = KnownArea::default();
        area.record_attempt(at(0.0), 100.0);
        area.record(at(0.0), 40.0);
        for attempt in 1..=u32::from(u8::MAX) {
            area.record_attempt(at(1.0), 40.0 + 0.2 * f64::from(attempt));
            assert_eq!(area.exhaustion(), None);
        }
    }

    #[test]
    fn time_without_growth_exhausts_the_map_but_not_a_long_way_or_a_pause() {
        let mut area = KnownArea::default();
        area.record(at(100.0), 10.0);
        area.record_goal(50.0);
        area.record(at(100.0 + VAIN_EXTRA_S + 149.0), 10.05);
        assert_eq!(area.exhaustion(), None, "the way takes 50 s");
        area.record(at(100.0 + VAIN_EXTRA_S + 151.0), 10.05);
        assert_eq!(area.exhaustion(), Some(Exhaustion::Time));
        area.record_no_robot(at(1000.0));
        area.record(at(1000.0 + VAIN_EXTRA_S), 10.05);
        assert_eq!(area.exhaustion(), None, "a person had the robots");
    }
}
