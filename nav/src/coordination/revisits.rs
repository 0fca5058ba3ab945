//! Robots of an exploration whose places have become uncertain return to places that they know, where SLAM can close a loop
//! (active loop closing: Stachniss, Hähnel, Burgard 2004, "Exploration with active loop-closing for FastSLAM").
//!
//! Without it a robot that crosses a hall in which its LiDAR sees no wall goes on until SLAM gives its place up.

use super::types::GoalProgress;
use crate::geometry::distance_m;
use crate::navigation::PlaceCertainty;
use msg::{Pose2, Stamp};

/// Standard deviation of the position from which a robot returns, metres: SLAM gives a place up at 1.5 m, and the way back adds to it. With 0.7 m fleets
/// in halls spent a quarter of their time on ways back.
const UNCERTAIN_SIGMA_M: f64 = 1.0;
/// Standard deviation of the position from which it explores on, metres.
const CERTAIN_SIGMA_M: f64 = 0.8;
/// Standard deviation of a position that is worth returning to, metres.
const KNOWN_SIGMA_M: f64 = 0.35;
/// Distance between remembered places, metres.
const PLACES_APART_M: f64 = 2.0;
/// Places remembered of a robot.
const PLACES_MAX: usize = 64;
/// Least distance of a place that a robot returns to, metres: a loop is closed by scans on the way.
const WAY_MIN_M: f64 = 1.0;
/// Places that a robot tries before it explores on.
const TRIES_MAX: usize = 3;
/// What the standard deviation must have grown by until it returns again, if the known area has not grown since it returned last, metres: what lies
/// far from all known places is explored in the end.
const RETRY_SIGMA_M: f64 = 0.2;
/// Growth of the known area that is worth a way back, square metres.
const GROWTH_MIN_M2: f64 = 2.0;
/// Time at a place in which SLAM may close a loop, seconds.
const STAY_S: f64 = 3.0;

/// The way back of a robot.
#[derive(Clone, Debug)]
struct Return {
    /// Where it goes, in its own map.
    to: Pose2,
    /// Places that were tried, of those remembered.
    tried: Vec<usize>,
    /// When it arrived there, or gave up.
    ended: Option<Stamp>,
}

/// Places that one robot knows, and its way back to one of them.
#[derive(Clone, Debug)]
pub(super) struct Revisits {
    /// Poses in the robot's own map at which a scan told the position in every direction.
    places: Vec<Pose2>,
    current: Option<Return>,
    /// Standard deviation from which the robot returns next, metres.
    from_sigma_m: f64,
    /// The largest known area when it returned, square metres.
    known_m2: f64,
}

impl Default for Revisits {
    fn default() -> Self {
        Self { places: Vec::new(), current: None, from_sigma_m: UNCERTAIN_SIGMA_M, known_m2: 0.0 }
    }
}

impl Revisits {
    /// Where a robot returns to, in its own map; `None`: it explores. `progress` is that of the way back, `known_m2` what the map shows, square metres.
    pub(super) fn step(
        &mut self,
        now: Stamp,
        robot_map_from_base: Pose2,
        certainty: PlaceCertainty,
        progress: GoalProgress,
        known_m2: f64,
    ) -> Option<Pose2> {
        self.remember(robot_map_from_base, certainty);
        if certainty.sigma_m < CERTAIN_SIGMA_M {
            self.current = None;
            return None;
        }
        let Some(current) = &mut self.current else {
            let has_grown = known_m2 >= self.known_m2 + GROWTH_MIN_M2;
            let from_sigma_m = if has_grown { UNCERTAIN_SIGMA_M } else { self.from_sigma_m };
            if certainty.sigma_m >= from_sigma_m {
                self.from_sigma_m =
                    if has_grown { UNCERTAIN_SIGMA_M } else { certainty.sigma_m + RETRY_SIGMA_M };
                self.known_m2 = self.known_m2.max(known_m2);
                self.begin(robot_map_from_base, certainty, Vec::new());
            }
            return self.current.as_ref().map(|current| current.to);
        };
        if progress.has_ended() {
            current.ended = current.ended.or(Some(now));
        }
        if current.ended.is_some_and(|ended| now - ended >= STAY_S) {
            let tried = core::mem::take(&mut current.tried);
            self.begin(robot_map_from_base, certainty, tried);
        }
        self.current.as_ref().map(|current| current.to)
    }

    /// Ends the way back of a robot that is lost, or that somebody took.
    pub(super) fn interrupt(&mut self) {
        self.current = None;
    }

    /// Sends a robot to the nearest place that was not tried; without one it explores on.
    fn begin(&mut self, robot_map_from_base: Pose2, certainty: PlaceCertainty, mut tried: Vec<usize>) {
        let distance = |place: &Pose2| distance_m(position_m(place), position_m(&robot_map_from_base));
        let is_new =
            |(index, place): &(usize, &Pose2)| !tried.contains(index) && distance(place) >= WAY_MIN_M;
        let nearest = self
            .places
            .iter()
            .enumerate()
            .filter(is_new)
            .min_by(|a, b| distance(a.1).total_cmp(&distance(b.1)));
        self.current = nearest.filter(|_| tried.len() < TRIES_MAX).map(|(index, place)| {
            tried.push(index);
            Return { to: *place, tried, ended: None }
        });
        if self.current.is_none() {
            self.from_sigma_m = certainty.sigma_m + RETRY_SIGMA_M;
        }
    }

    fn remember(&mut self, robot_map_from_base: Pose2, certainty: PlaceCertainty) {
        let is_far =
            |place: &Pose2| distance_m(position_m(place), position_m(&robot_map_from_base)) >= PLACES_APART_M;
        let is_known = certainty.is_fixed_by_scan && certainty.sigma_m < KNOWN_SIGMA_M;
        if is_known && self.places.len() < PLACES_MAX && self.places.iter().all(is_far) {
            self.places.push(robot_map_from_base);
        }
    }
}

fn position_m(pose: &Pose2) -> [f64; 2] {
    [pose.x_m, pose.y_m]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn known(sigma_m: f64) -> PlaceCertainty {
        PlaceCertainty { sigma_m, is_fixed_by_scan: true }
    }

    fn at(x_m: f64) -> Pose2 {
        Pose2::new(x_m, 0.0, 0.0)
    }

    /// A robot that has seen places at 0, 2, 4, 6 and 8 m.
    fn with_places() -> Revisits {
        let mut revisits = Revisits::default();
        for x_m in 0..10 {
            let place = revisits.step(Stamp(0), at(f64::from(x_m)), known(0.1), GoalProgress::Idle, 0.0);
            assert_eq!(place, None);
        }
        revisits
    }

    #[test]
    fn three_places_are_tried_from_the_nearest_on_and_then_the_robot_explores_until_it_knows_less() {
        let mut revisits = with_places();
        let mut step = |second: f64, sigma_m: f64, progress| {
            let stamp = Stamp::from_seconds(second);
            revisits.step(stamp, at(12.0), known(sigma_m), progress, 10.0).map(|place| place.x_m)
        };
        assert_eq!(step(1.0, 1.1, GoalProgress::Idle), Some(8.0));
        assert_eq!(step(2.0, 1.1, GoalProgress::Active), Some(8.0));
        assert_eq!(step(3.0, 1.1, GoalProgress::Reached), Some(8.0), "a loop may be closed now");
        assert_eq!(step(7.0, 1.1, GoalProgress::Reached), Some(6.0));
        assert_eq!(step(8.0, 1.1, GoalProgress::Failed), Some(6.0));
        assert_eq!(step(12.0, 1.1, GoalProgress::Failed), Some(4.0));
        assert_eq!(step(13.0, 1.1, GoalProgress::Reached), Some(4.0));
        assert_eq!(step(17.0, 1.1, GoalProgress::Reached), None);
        assert_eq!(step(18.0, 1.25, GoalProgress::Idle), None);
        assert_eq!(step(19.0, 1.35, GoalProgress::Idle), Some(8.0));
    }

    #[test]
    fn a_robot_returns_later_and_later_while_the_known_area_does_not_grow() {
        let mut revisits = with_places();
        let mut is_returning = |sigma_m: f64, known_m2: f64| {
            revisits.step(Stamp(0), at(12.0), known(sigma_m), GoalProgress::Idle, known_m2).is_some()
        };
        assert!(is_returning(1.0, 10.0));
        assert!(!is_returning(0.7, 10.0));
        assert!(is_returning(1.0, 11.0), "the first return counts as one with growth");
        assert!(!is_returning(0.7, 11.0));
        assert!(!is_returning(1.1, 11.0));
        assert!(is_returning(1.2, 11.0));
        assert!(!is_returning(0.7, 11.0));
        assert!(!is_returning(1.3, 11.0));
        assert!(is_returning(1.0, 14.0), "the known area has grown");
    }

    #[test]
    fn a_robot_without_known_places_explores() {
        let mut revisits = Revisits::default();
        assert_eq!(revisits.step(Stamp(0), at(0.0), known(2.0), GoalProgress::Idle, 0.0), None);
    }

    #[test]
    fn places_are_bounded_and_apart() {
        let mut revisits = Revisits::default();
        for step in 0..1000 {
            revisits.step(Stamp(0), at(f64::from(step)), known(0.1), GoalProgress::Idle, 0.0);
        }
        assert_eq!(revisits.places.len(), PLACES_MAX);
        assert!(revisits.places.windows(2).all(|pair| pair[1].x_m - pair[0].x_m >= PLACES_APART_M));
    }
}
