//! Robots of an exploration whose places have become uncertain return to places that they know, where SLAM can close a loop
//! (active loop closing: Stachniss, Hähnel, Burgard 2004, "Exploration with active loop-closing for FastSLAM").
//!
//! Without it a robot that crosses a hall in which its LiDAR sees no wall goes on until SLAM gives its place up.

use super::types::GoalProgress;
use crate::geometry::distance_m;
use crate::navigation::LocalizationUncertainty;
use msg::{Pose2, Stamp};

/// Standard deviation of the position, in its least certain direction, from which a robot returns, metres. SLAM gives a place up where the root of both
/// directions' variances is 1.5 m: 1.5 m in one direction, or 1.06 m in each. With 0.7 m fleets in halls spent a quarter of their time on ways back.
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
/// Largest distance of such a place, metres: navigation plans no farther.
const WAY_MAX_M: f64 = 20.0;
/// Time after which a way back is given up, seconds: more than 20 m take.
const WAY_MAX_S: f64 = 180.0;
/// Time at a place in which SLAM may close a loop, seconds.
const STAY_S: f64 = 3.0;

/// What decides on a robot's way back.
pub(super) struct RevisitInput<'a> {
    pub stamp: Stamp,
    /// Pose of the robot in its own map.
    pub robot_map_from_base: Pose2,
    pub uncertainty: LocalizationUncertainty,
    /// Progress of the way back.
    pub progress: GoalProgress,
    /// What the map shows, square metres.
    pub known_m2: f64,
    /// Whether a place in the robot's own map lies where no robot may go.
    pub is_excluded: &'a dyn Fn(&Pose2) -> bool,
}

/// The way back of a robot.
#[derive(Clone, Debug)]
struct Return {
    /// Where it goes, in its own map.
    to: Pose2,
    /// Places that were tried, of those remembered.
    tried: Vec<usize>,
    /// When it was sent there.
    since: Stamp,
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
    /// Whether it has tried all places in vain since its place was certain last.
    has_given_up: bool,
}

impl Default for Revisits {
    fn default() -> Self {
        Self {
            places: Vec::new(),
            current: None,
            from_sigma_m: UNCERTAIN_SIGMA_M,
            known_m2: 0.0,
            has_given_up: false,
        }
    }
}

impl Revisits {
    /// Where the robot returns to, in its own map; `None`: it explores.
    pub(super) fn destination(&self) -> Option<Pose2> {
        self.current.as_ref().map(|current| current.to)
    }

    /// Begins, continues or ends a way back, and returns where it leads.
    pub(super) fn step(&mut self, input: &RevisitInput) -> Option<Pose2> {
        let RevisitInput { stamp: now, uncertainty, known_m2, .. } = *input;
        self.remember(input.robot_map_from_base, uncertainty);
        if uncertainty.sigma_m < CERTAIN_SIGMA_M {
            (self.current, self.has_given_up) = (None, false);
            return None;
        }
        let Some(current) = &mut self.current else {
            let has_grown = !self.has_given_up && known_m2 >= self.known_m2 + GROWTH_MIN_M2;
            let from_sigma_m = if has_grown { UNCERTAIN_SIGMA_M } else { self.from_sigma_m };
            if uncertainty.sigma_m >= from_sigma_m {
                self.from_sigma_m =
                    if has_grown { UNCERTAIN_SIGMA_M } else { uncertainty.sigma_m + RETRY_SIGMA_M };
                self.known_m2 = self.known_m2.max(known_m2);
                self.begin(input, Vec::new());
            }
            return self.destination();
        };
        if input.progress.has_ended() || now - current.since >= WAY_MAX_S {
            current.ended = current.ended.or(Some(now));
        }
        if current.ended.is_some_and(|ended| now - ended >= STAY_S) {
            let tried = core::mem::take(&mut current.tried);
            self.begin(input, tried);
        }
        self.destination()
    }

    /// Ends the way back of a robot that is lost, or that somebody took.
    pub(super) fn interrupt(&mut self) {
        self.current = None;
    }

    /// Sends a robot to the nearest allowed place that was not tried; without one it explores on.
    fn begin(&mut self, input: &RevisitInput, mut tried: Vec<usize>) {
        let base_m = position_m(&input.robot_map_from_base);
        let distance = |place: &Pose2| distance_m(position_m(place), base_m);
        let is_new = |(index, place): &(usize, &Pose2)| {
            !tried.contains(index)
                && (WAY_MIN_M..=WAY_MAX_M).contains(&distance(place))
                && !(input.is_excluded)(place)
        };
        let nearest = self
            .places
            .iter()
            .enumerate()
            .filter(is_new)
            .min_by(|a, b| distance(a.1).total_cmp(&distance(b.1)));
        self.current = nearest.filter(|_| tried.len() < TRIES_MAX).map(|(index, place)| {
            tried.push(index);
            Return { to: *place, tried, since: input.stamp, ended: None }
        });
        if self.current.is_none() {
            self.has_given_up = true;
            self.from_sigma_m = input.uncertainty.sigma_m + RETRY_SIGMA_M;
        }
    }

    /// Remembers a place that a scan tells in every direction. If there are too many, the farthest one is forgotten.
    fn remember(&mut self, robot_map_from_base: Pose2, uncertainty: LocalizationUncertainty) {
        let distance = |place: &Pose2| distance_m(position_m(place), position_m(&robot_map_from_base));
        let is_known = uncertainty.is_fixed_by_scan && uncertainty.sigma_m < KNOWN_SIGMA_M;
        if !is_known || self.places.iter().any(|place| distance(place) < PLACES_APART_M) {
            return;
        }
        if self.places.len() < PLACES_MAX {
            self.places.push(robot_map_from_base);
        } else if let Some(farthest) =
            self.places.iter_mut().max_by(|a, b| distance(a).total_cmp(&distance(b)))
        {
            *farthest = robot_map_from_base;
        }
    }
}

fn position_m(pose: &Pose2) -> [f64; 2] {
    [pose.x_m, pose.y_m]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn known(sigma_m: f64) -> LocalizationUncertainty {
        LocalizationUncertainty { sigma_m, is_fixed_by_scan: true }
    }

    fn at(x_m: f64) -> Pose2 {
        Pose2::new(x_m, 0.0, 0.0)
    }

    /// A robot at `x_m` whose position has this standard deviation.
    fn input(
        stamp: Stamp,
        x_m: f64,
        sigma_m: f64,
        progress: GoalProgress,
        known_m2: f64,
    ) -> RevisitInput<'static> {
        let (robot_map_from_base, uncertainty) = (at(x_m), known(sigma_m));
        RevisitInput { stamp, robot_map_from_base, uncertainty, progress, known_m2, is_excluded: &|_| false }
    }

    /// A robot that has seen places at 0, 2, 4, 6 and 8 m.
    fn with_places() -> Revisits {
        let mut revisits = Revisits::default();
        for x_m in 0..10 {
            let place = revisits.step(&input(Stamp(0), f64::from(x_m), 0.1, GoalProgress::Idle, 0.0));
            assert_eq!(place, None);
        }
        revisits
    }

    #[test]
    fn three_places_are_tried_from_the_nearest_on_and_then_the_robot_explores_until_it_knows_less() {
        let mut revisits = with_places();
        let mut step = |second: f64, sigma_m: f64, progress| {
            let stamp = Stamp::from_seconds(second);
            revisits.step(&input(stamp, 12.0, sigma_m, progress, 10.0 * second)).map(|place| place.x_m)
        };
        assert_eq!(step(1.0, 1.1, GoalProgress::Idle), Some(8.0));
        assert_eq!(step(2.0, 1.1, GoalProgress::Active), Some(8.0));
        assert_eq!(step(3.0, 1.1, GoalProgress::Reached), Some(8.0), "a loop may be closed now");
        assert_eq!(step(7.0, 1.1, GoalProgress::Reached), Some(6.0));
        assert_eq!(step(8.0, 1.1, GoalProgress::Failed), Some(6.0));
        assert_eq!(step(12.0, 1.1, GoalProgress::Failed), Some(4.0));
        assert_eq!(step(13.0, 1.1, GoalProgress::Reached), Some(4.0));
        assert_eq!(step(17.0, 1.1, GoalProgress::Reached), None);
        assert_eq!(step(18.0, 1.25, GoalProgress::Idle), None, "although others have made the map larger");
        assert_eq!(step(19.0, 1.35, GoalProgress::Idle), Some(8.0));
    }

    #[test]
    fn a_robot_returns_later_and_later_while_the_known_area_does_not_grow() {
        let mut revisits = with_places();
        let mut is_returning = |sigma_m: f64, known_m2: f64| {
            revisits.step(&input(Stamp(0), 12.0, sigma_m, GoalProgress::Idle, known_m2)).is_some()
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
    fn a_way_back_that_does_not_end_is_given_up() {
        let mut revisits = with_places();
        let mut step = |second: f64| {
            let place =
                revisits.step(&input(Stamp::from_seconds(second), 12.0, 1.1, GoalProgress::Active, 10.0));
            place.map(|place| place.x_m)
        };
        assert_eq!([0.0, 179.0, 181.0, 185.0].map(&mut step), [Some(8.0), Some(8.0), Some(8.0), Some(6.0)]);
    }

    #[test]
    fn no_place_in_an_excluded_area_is_tried() {
        let mut revisits = with_places();
        let uncertain = input(Stamp(0), 12.0, 1.1, GoalProgress::Idle, 10.0);
        let place = revisits.step(&RevisitInput { is_excluded: &|place| place.x_m > 5.0, ..uncertain });
        assert_eq!(place.map(|place| place.x_m), Some(4.0));
    }

    #[test]
    fn a_robot_without_known_places_explores() {
        let mut revisits = Revisits::default();
        assert_eq!(revisits.step(&input(Stamp(0), 0.0, 2.0, GoalProgress::Idle, 0.0)), None);
    }

    #[test]
    fn places_are_bounded_and_apart() {
        let mut revisits = Revisits::default();
        for step in 0..1000 {
            revisits.step(&input(Stamp(0), f64::from(step), 0.1, GoalProgress::Idle, 0.0));
        }
        assert_eq!(revisits.places.len(), PLACES_MAX);
        assert!(revisits.places.windows(2).all(|pair| (pair[1].x_m - pair[0].x_m).abs() >= PLACES_APART_M));
        assert!(revisits.places.iter().any(|place| place.x_m == 998.0), "the newest are kept");
    }
}
