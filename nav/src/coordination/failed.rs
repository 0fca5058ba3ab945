//! Places that one robot gave up to drive to. Others may get there, and the robot itself later, when who stood in its way has left.

use crate::geometry::distance_m;
use crate::memory::push_bounded;
use msg::Stamp;
use std::collections::VecDeque;

/// Distance within which two places are the same, metres: the lattice of viewpoints moves with the map.
const SAME_M: f64 = 0.5;
/// Time for which the robot does not try a place again, seconds: robots that stand around it leave meanwhile.
const RETRY_S: f64 = 20.0;
/// Times that something stood at a place which count as one failure: who stood there may have left.
const OCCUPIED_PER_FAILURE: u32 = 4;
/// Most places of a robot; the oldest is forgotten.
const PLACES_MAX: usize = 32;

#[derive(Clone, Copy, Debug)]
struct FailedPlace {
    place_m: [f64; 2],
    at: Stamp,
    /// Times that something stood there, where a failure counts as [`OCCUPIED_PER_FAILURE`] of them.
    occupied_times: u32,
}

/// Places that one robot gave up, the newest last.
#[derive(Clone, Debug, Default)]
pub(super) struct FailedGoals(VecDeque<FailedPlace>);

impl FailedGoals {
    /// Records that the robot gave a place up; returns how often it has.
    pub(super) fn record(&mut self, at: Stamp, place_m: [f64; 2]) -> u32 {
        self.add(at, place_m, OCCUPIED_PER_FAILURE)
    }

    /// Records that something stands at a place, which the robot leaves alone for a while; returns how often it gave it up.
    pub(super) fn record_occupied(&mut self, at: Stamp, place_m: [f64; 2]) -> u32 {
        self.add(at, place_m, 1)
    }

    fn add(&mut self, at: Stamp, place_m: [f64; 2], times: u32) -> u32 {
        let known = self.0.iter().position(|failed| distance_m(failed.place_m, place_m) < SAME_M);
        let before = known.and_then(|index| self.0.remove(index)).map_or(0, |failed| failed.occupied_times);
        let occupied_times = before.saturating_add(times);
        push_bounded(&mut self.0, FailedPlace { place_m, at, occupied_times }, PLACES_MAX);
        occupied_times / OCCUPIED_PER_FAILURE
    }

    /// Whether the robot gave a place up a short time ago.
    pub(super) fn is_avoided(&self, now: Stamp, place_m: [f64; 2]) -> bool {
        self.0.iter().any(|failed| now - failed.at < RETRY_S && distance_m(failed.place_m, place_m) < SAME_M)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_avoided_for_a_while_and_its_failures_are_counted() {
        let mut failed = FailedGoals::default();
        let at = Stamp::from_seconds;
        assert_eq!(failed.record(at(1.0), [2.0, 0.0]), 1);
        assert!(failed.is_avoided(at(20.0), [2.1, 0.1]) && !failed.is_avoided(at(22.0), [2.1, 0.1]));
        assert!(!failed.is_avoided(at(2.0), [3.0, 0.0]), "another place");
        assert_eq!(failed.record(at(30.0), [2.2, 0.0]), 2);
        let occupied = [(); 4].map(|()| failed.record_occupied(at(30.0), [2.2, 0.0]));
        assert_eq!(occupied, [2, 2, 2, 3]);
        assert!(failed.is_avoided(at(45.0), [2.2, 0.0]));
        (0..2 * PLACES_MAX).for_each(|place| _ = failed.record(at(31.0), [10.0 + place as f64, 0.0]));
        assert_eq!(failed.0.len(), PLACES_MAX);
    }
}
