//! The tour: one operator, several robots. Either one robot in the hand at a time, each in its turn, or, as a
//! fleet, all at once. Pure and deterministic: the same sights and seed give the same deflections.

use crate::driver::{Company, Driver, DriverFigures};
use crate::joystick::{Joystick, Stick};
use crate::plan::Planner;
use crate::sight::{RobotSight, Sight};
use msg::{ROBOTS_MAX, RobotId, Stamp};

/// A robot that cannot be driven keeps the hand no longer than this, seconds.
const IDLE_MAX_S: f64 = 2.0;

/// How a tour goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TourConfig {
    /// How long a robot stays in the hand, seconds.
    pub turn_s: f64,
    /// The stick the robots are driven by.
    pub joystick: Joystick,
    /// Where whims come from.
    pub seed: u64,
}

impl Default for TourConfig {
    fn default() -> Self {
        Self { turn_s: 20.0, joystick: Joystick::default(), seed: 1 }
    }
}

/// What the hand does at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hand {
    /// The robot it holds.
    pub robot: RobotId,
    /// How it deflects the stick.
    pub stick: Stick,
}

/// The operator's policy for a fleet.
#[derive(Clone, Debug)]
pub struct Tour {
    config: TourConfig,
    planner: Planner,
    drivers: Vec<Driver>,
    /// The robot held; in a fleet that drives at once, the one thought about.
    in_hand: usize,
    turn_began: Option<Stamp>,
    turns: [u32; ROBOTS_MAX],
    held_s: [f64; ROBOTS_MAX],
    last: Option<Stamp>,
}

impl Tour {
    /// A tour with these robots, in this order. `None` without any.
    pub fn new(config: TourConfig, robots: impl IntoIterator<Item = RobotId>) -> Option<Self> {
        let mut tour = Self {
            config,
            planner: Planner::default(),
            drivers: Vec::new(),
            in_hand: 0,
            turn_began: None,
            turns: [0; ROBOTS_MAX],
            held_s: [0.0; ROBOTS_MAX],
            last: None,
        };
        robots.into_iter().for_each(|robot| tour.add(robot));
        (!tour.drivers.is_empty()).then_some(tour)
    }

    /// A robot joins: its turn comes after all others'. Nothing changes if it is there already.
    pub fn add(&mut self, robot: RobotId) {
        if self.drivers.iter().all(|driver| driver.robot() != robot) {
            self.drivers.push(Driver::new(robot, self.config.joystick, self.config.seed));
        }
    }

    /// From now on a robot stays in the hand this long, seconds.
    pub fn set_turn_s(&mut self, turn_s: f64) {
        self.config.turn_s = turn_s;
    }

    /// The robots in turn: one moment of the operator's. When the turn ends, the stick is centred for the robot in
    /// hand once, so that it stands before the hand leaves it.
    pub fn step(&mut self, sight: &Sight) -> Hand {
        let now = sight.stamp;
        let elapsed_s = self.last.map_or(0.0, |last| now - last);
        self.last = Some(now);
        let driver = &mut self.drivers[self.in_hand];
        let robot = driver.robot();
        self.held_s[robot.index()] += elapsed_s.clamp(0.0, 1.0);
        let began = *self.turn_began.get_or_insert_with(|| {
            self.turns[robot.index()] += 1;
            now
        });
        let idle = driver.idle_since().is_some_and(|since| now - since > IDLE_MAX_S);
        if self.drivers.len() > 1 && (idle || now - began >= self.config.turn_s) {
            self.drivers[self.in_hand].release();
            self.in_hand = (self.in_hand + 1) % self.drivers.len();
            self.turn_began = None;
            return Hand { robot, stick: Stick::CENTRED };
        }
        Hand { robot, stick: self.drive(self.in_hand, sight, true) }
    }

    /// The whole fleet at once: one moment, a deflection for each robot. One robot thinks at a time, in turn, so
    /// that a moment never takes longer than one plan.
    pub fn step_all(&mut self, sight: &Sight, hands: &mut Vec<Hand>) {
        hands.clear();
        self.last = Some(sight.stamp);
        let count = self.drivers.len();
        let in_turn = (1..=count).map(|i| (self.in_hand + i) % count);
        let due = |i: &usize| self.drivers[*i].thinks_at() <= sight.stamp;
        self.in_hand = in_turn.into_iter().find(due).unwrap_or(self.in_hand);
        for i in 0..count {
            let stick = self.drive(i, sight, self.in_hand == i);
            hands.push(Hand { robot: self.drivers[i].robot(), stick });
        }
    }

    /// The robot in the hand.
    pub fn in_hand(&self) -> RobotId {
        self.drivers[self.in_hand].robot()
    }

    /// Each robot: how often it was in the hand, how long (seconds), and what it did.
    pub fn figures(&self) -> impl Iterator<Item = (RobotId, u32, f64, DriverFigures)> + '_ {
        self.drivers.iter().map(|driver| {
            let robot = driver.robot();
            (robot, self.turns[robot.index()], self.held_s[robot.index()], driver.figures())
        })
    }

    /// What the robots are on their way to.
    pub fn drivers(&self) -> &[Driver] {
        &self.drivers
    }

    fn drive(&mut self, index: usize, sight: &Sight, may_think: bool) -> Stick {
        let robot = self.drivers[index].robot();
        let nothing = RobotSight { robot, map: None, merged: false, map_from_base: None, scan: None };
        let own = sight.robots.iter().find(|seen| seen.robot == robot).unwrap_or(&nothing);
        let mut others_m = Vec::with_capacity(ROBOTS_MAX);
        let mut held_m = Vec::with_capacity(ROBOTS_MAX);
        // Only in the merged map are the others' places known.
        for other in sight.robots.iter().filter(|other| other.robot != robot && other.merged && own.merged) {
            others_m.extend(other.map_from_base.filter(|p| p.is_finite()).map(|p| [p.x_m, p.y_m]));
            let driver = self.drivers.iter().find(|driver| driver.robot() == other.robot);
            held_m.extend(driver.and_then(Driver::goal_m));
        }
        let company = Company { others_m: &others_m, held_m: &held_m };
        self.drivers[index].step(sight.stamp, own, &company, &mut self.planner, may_think)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sight::{BURGER_BASE_FROM_SCAN, MapView, ScanView};
    use msg::Pose2;
    use proptest::prelude::*;

    const OPEN: [f32; 91] = [3.0; 91];

    fn open_scan(now_s: f64) -> ScanView<'static> {
        ScanView {
            seen: Stamp::from_seconds(now_s),
            base_from_scan: BURGER_BASE_FROM_SCAN,
            angle_min_rad: -0.8,
            angle_increment_rad: 1.6 / 90.0,
            range_min_m: 0.12,
            range_max_m: 3.5,
            ranges_m: &OPEN,
        }
    }

    fn robot(number: usize) -> RobotId {
        RobotId::new(number).unwrap()
    }

    /// The robots in hand over some seconds at 20 Hz; those in `blind` show no scan.
    fn hands(tour: &mut Tour, seconds: f64, blind: &[usize]) -> Vec<Hand> {
        let step = |i: u64| {
            let now_s = i as f64 * 0.05;
            let seen: Vec<RobotSight> = (1..=3)
                .map(|number| RobotSight {
                    robot: robot(number),
                    map: None,
                    merged: false,
                    map_from_base: None,
                    scan: (!blind.contains(&number)).then(|| open_scan(now_s)),
                })
                .collect();
            tour.step(&Sight { stamp: Stamp::from_seconds(now_s), robots: &seen })
        };
        (0..(seconds / 0.05) as u64).map(step).collect()
    }

    #[test]
    fn takes_turns_and_lets_go_before_it_changes_hands() {
        let config = TourConfig { turn_s: 5.0, ..Default::default() };
        let mut tour = Tour::new(config, RobotId::first(3)).unwrap();
        let hands = hands(&mut tour, 30.0, &[]);
        let mut order: Vec<usize> = hands.iter().map(|hand| hand.robot.number()).collect();
        order.dedup();
        assert_eq!(&order[..6], [1, 2, 3, 1, 2, 3]);
        for pair in hands.windows(2).filter(|pair| pair[0].robot != pair[1].robot) {
            assert_eq!(pair[0].stick, Stick::CENTRED);
        }
        assert!(hands.iter().any(|hand| hand.stick.forward > 0.5), "without a map it drives by the scan");
    }

    #[test]
    fn passes_over_a_robot_that_shows_nothing() {
        let config = TourConfig { turn_s: 10.0, ..Default::default() };
        let mut tour = Tour::new(config, RobotId::first(3)).unwrap();
        let hands = hands(&mut tour, 60.0, &[2]);
        let blind: Vec<&Hand> = hands.iter().filter(|hand| hand.robot == robot(2)).collect();
        assert!(blind.iter().all(|hand| hand.stick == Stick::CENTRED));
        assert!(blind.len() < 3 * 45, "held for {} steps", blind.len());
        let turns: Vec<u32> = tour.figures().map(|(_, turns, ..)| turns).collect();
        assert!(turns.iter().all(|turns| *turns >= 2), "{turns:?}");
    }

    #[test]
    fn robots_join_once() {
        assert!(Tour::new(TourConfig::default(), []).is_none());
        let mut tour = Tour::new(TourConfig::default(), [robot(1), robot(1)]).unwrap();
        tour.add(robot(2));
        tour.add(robot(2));
        assert_eq!(tour.drivers().len(), 2);
    }

    fn number() -> impl Strategy<Value = f64> {
        prop_oneof![6 => -6.0..6.0, 1 => Just(f64::NAN), 1 => Just(f64::INFINITY), 1 => any::<f64>()]
    }

    fn pose() -> impl Strategy<Value = Pose2> {
        (number(), number(), number()).prop_map(|(x, y, yaw)| Pose2::new(x, y, yaw))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        /// Whatever it is shown, it does not fall over and the stick stays within its gate.
        #[test]
        fn any_sight_gives_a_deflection(
            cells in prop::collection::vec(any::<i8>(), 900),
            poses in prop::collection::vec(prop::option::of(pose()), 40),
            ranges in prop::collection::vec(any::<f32>(), 0..60),
            angles in (number(), number()),
            limits in (number(), number()),
            (merged, at_once) in (any::<bool>(), any::<bool>()),
        ) {
            let mut tour = Tour::new(TourConfig { turn_s: 1.0, ..Default::default() }, RobotId::first(2)).unwrap();
            let map = MapView::percent(Pose2::new(-0.7, -0.7, 0.3), 0.05, (30, 30), &cells);
            let mut hands = Vec::new();
            for (i, pair) in poses.chunks(2).enumerate() {
                let stamp = Stamp::from_seconds(i as f64 * 0.3);
                let scan = ScanView {
                    seen: stamp,
                    angle_min_rad: angles.0,
                    angle_increment_rad: angles.1,
                    range_min_m: limits.0,
                    range_max_m: limits.1,
                    ranges_m: &ranges,
                    ..open_scan(0.0)
                };
                let see = |k: usize| RobotSight { robot: robot(k + 1), map, merged, map_from_base: pair[k], scan: Some(scan) };
                let sight = Sight { stamp, robots: &[see(0), see(1)] };
                if at_once {
                    tour.step_all(&sight, &mut hands);
                } else {
                    hands.clear();
                    hands.push(tour.step(&sight));
                }
                for hand in &hands {
                    prop_assert!(hand.stick.forward.abs() <= 1.0 && hand.stick.left.abs() <= 1.0, "{hand:?}");
                }
            }
        }
    }
}
