//! People: each walks to a drawn place, stays there for a while, and walks on. It stops before what is in its way.

use super::floor::{Blocked, Floor};
use super::shape::Outline;
use super::{PERIOD_S, ticks_of};
use crate::burger;
use crate::noise::Draws;

/// Radius of the outline of a person's legs and feet while walking, metres.
const RADIUS_M: [f64; 2] = [0.15, 0.25];
/// Speed of a walk, m/s.
const SPEED_M_S: [f64; 2] = [0.6, 1.4];
/// Time for which a person stays at a place, seconds.
const STAY_S: [f64; 2] = [1.0, 10.0];
/// Time for which a person waits for what is in its way before it looks for another way, seconds.
const PATIENCE_S: [f64; 2] = [2.0, 5.0];
/// Gap between a person and a robot ahead at which the person stops, metres.
const ROBOT_AHEAD_M: f64 = 0.5;
/// Gap to a robot on any side that a person does not make smaller, metres.
const ROBOT_GAP_M: f64 = 0.2;
/// Gap to another person ahead at which a person stops, metres.
const PERSON_AHEAD_M: f64 = 0.3;
/// Gap to anything else that a person does not make smaller, metres.
const GAP_M: f64 = 0.05;
/// What the gap beside a way is wider than the gap that stops a person, metres.
const WAY_MARGIN_M: f64 = 0.1;
/// Smallest gap between two people, and between a person and a robot, at the start, metres.
const START_GAP_M: f64 = 0.8;
/// Distance from a corner at which a person has come to it, metres: errors of rounding.
const ARRIVED_M: f64 = 1e-6;
/// Draws of a place after which a person is left out, or stays where it is.
const DRAWS_MAX: usize = 64;

/// A person who walks.
pub(super) struct Person {
    draws: Draws,
    pub(super) at_m: [f64; 2],
    /// Velocity until the next tick, m/s.
    pub(super) velocity_m_s: [f64; 2],
    pub(super) radius_m: f64,
    /// Speed of the present walk, m/s.
    speed_m_s: f64,
    /// Corners of the way that are left, the last one first.
    way: Vec<[f64; 2]>,
    /// Ticks for which the person still stays where it is.
    stay: u32,
    /// Ticks for which the person still waits for what is in its way.
    patience: u32,
    /// Whether the present way leads around something.
    is_around: bool,
}

/// What is in a person's way at the end of the tick.
pub(super) struct Surroundings<'a> {
    /// Centres of the robots, metres.
    pub(super) robots_m: &'a [[f64; 2]],
    /// Outlines of doors' leaves and of boxes.
    pub(super) obstacles: &'a [Outline],
    /// Outlines of the other people.
    pub(super) people: &'a [Outline],
}

impl Person {
    /// Draws a person and its place, apart from robots and from others; `None` if there is no place.
    pub(super) fn draw(mut draws: Draws, floor: &Floor, around: &Surroundings<'_>) -> Option<Self> {
        let radius_m = draws.between(RADIUS_M);
        let cells = floor.walkable_cells();
        let mut place = || Some(floor.centre_m(*cells.get(draws.below(cells.len()))? as usize));
        let at_m = (0..DRAWS_MAX).filter_map(|_| place()).find(|at_m| {
            let robots = around.robots_m.iter().map(|robot| Outline::disc(*robot, burger::RADIUS_M));
            let mut all = robots.chain(around.people.iter().chain(around.obstacles).copied());
            all.all(|outline| outline.distance_m(*at_m) > radius_m + START_GAP_M)
        })?;
        let stay = ticks_of(draws.between([0.0, STAY_S[0]]));
        let (way, speed_m_s, patience) = (Vec::new(), SPEED_M_S[0], 0);
        Some(Self {
            draws,
            at_m,
            velocity_m_s: [0.0; 2],
            radius_m,
            speed_m_s,
            way,
            stay,
            patience,
            is_around: false,
        })
    }

    /// Puts the person where a process before had it; it walks on from there with other draws.
    pub(super) fn resume(&mut self, at_m: [f64; 2], draws: Draws) {
        (self.at_m, self.draws, self.stay) = (at_m, draws, 0);
        (self.velocity_m_s, self.is_around) = ([0.0; 2], false);
        self.way.clear();
    }

    pub(super) fn outline(&self) -> Outline {
        Outline::disc(self.at_m, self.radius_m)
    }

    /// Moves the person to the end of the tick. It stays for a while at the last corner of its way.
    pub(super) fn end_tick(&mut self) {
        self.at_m = self.next_m();
        let [x, y] = self.at_m;
        if self.way.last().is_some_and(|corner| (corner[0] - x).hypot(corner[1] - y) < ARRIVED_M) {
            self.way.pop();
            if self.way.is_empty() {
                self.stay = ticks_of(self.draws.between(STAY_S));
            }
        }
    }

    /// Returns the outline at the end of the next tick.
    pub(super) fn next_outline(&self) -> Outline {
        Outline::disc(self.next_m(), self.radius_m)
    }

    /// Returns where the person is at the end of the next tick, metres.
    fn next_m(&self) -> [f64; 2] {
        [0, 1].map(|axis| self.at_m[axis] + PERIOD_S * self.velocity_m_s[axis])
    }

    /// Decides the velocity of the next tick.
    pub(super) fn begin_tick(&mut self, floor: &mut Floor, around: &Surroundings<'_>) {
        self.velocity_m_s = [0.0; 2];
        if self.stay > 0 {
            self.stay -= 1;
            return;
        }
        if self.way.is_empty() {
            self.begin_way(floor, around, None);
            return;
        }
        self.velocity_m_s = self.towards_next_corner();
        if !self.is_stopped_by(around) {
            return;
        }
        self.velocity_m_s = [0.0; 2];
        self.patience = self.patience.saturating_sub(1);
        if self.patience == 0 {
            // Around what is in the way; the second time to another place.
            let goal = self.way.first().copied().filter(|_| !self.is_around);
            self.begin_way(floor, around, goal);
        }
    }

    /// Returns the velocity towards the next corner of the way, m/s. The tick does not lead beyond it.
    fn towards_next_corner(&self) -> [f64; 2] {
        let Some(corner_m) = self.way.last() else { return [0.0; 2] };
        let ahead_m = [0, 1].map(|axis| corner_m[axis] - self.at_m[axis]);
        let distance_m = ahead_m[0].hypot(ahead_m[1]);
        if distance_m > self.speed_m_s * PERIOD_S {
            return ahead_m.map(|m| m / distance_m * self.speed_m_s);
        }
        ahead_m.map(|m| m / PERIOD_S)
    }

    /// Returns whether something keeps the person from walking with its velocity.
    fn is_stopped_by(&self, around: &Surroundings<'_>) -> bool {
        let robots = around.robots_m.iter().map(|robot| Outline::disc(*robot, burger::RADIUS_M));
        robots.into_iter().any(|robot| self.is_stopped(&robot, ROBOT_GAP_M, ROBOT_AHEAD_M))
            || around.people.iter().any(|person| self.is_stopped(person, WAY_MARGIN_M, PERSON_AHEAD_M))
            || around.obstacles.iter().any(|obstacle| self.is_stopped(obstacle, GAP_M, GAP_M))
    }

    /// Returns whether the person comes nearer to an outline than it may: ahead, or on any side.
    fn is_stopped(&self, outline: &Outline, gap_m: f64, ahead_gap_m: f64) -> bool {
        let [now_m, next_m] = [self.at_m, self.next_m()].map(|at_m| outline.distance_m(at_m) - self.radius_m);
        if next_m >= now_m || next_m >= ahead_gap_m {
            return false;
        }
        next_m < gap_m || self.is_ahead(outline, gap_m)
    }

    /// Returns whether a disc is ahead in the strip that the person walks through, which has this gap on both sides.
    fn is_ahead(&self, disc: &Outline, gap_m: f64) -> bool {
        let speed_m_s = self.velocity_m_s[0].hypot(self.velocity_m_s[1]);
        if speed_m_s == 0.0 {
            return false;
        }
        let [x, y] = [0, 1].map(|axis| disc.centre_m[axis] - self.at_m[axis]);
        let [u, v] = self.velocity_m_s.map(|m_s| m_s / speed_m_s);
        x * u + y * v > 0.0 && (x * v - y * u).abs() < self.radius_m + disc.bound_m() + gap_m
    }

    /// Begins a way to a place, or to a drawn one if there is none to it.
    fn begin_way(&mut self, floor: &mut Floor, around: &Surroundings<'_>, goal_m: Option<[f64; 2]>) {
        let (at_m, radius_m) = (self.at_m, self.radius_m);
        // What is nearer already must not enclose the person.
        let keep = |outline: Outline, gap_m: f64| -> Blocked {
            let margin_m = radius_m + gap_m + WAY_MARGIN_M;
            (outline, margin_m.min(outline.distance_m(at_m) - WAY_MARGIN_M / 2.0))
        };
        let robots =
            around.robots_m.iter().map(|robot| keep(Outline::disc(*robot, burger::RADIUS_M), ROBOT_GAP_M));
        let people = around.people.iter().map(|person| keep(*person, WAY_MARGIN_M));
        let obstacles = around.obstacles.iter().map(|obstacle| keep(*obstacle, GAP_M));
        let blocked = robots.chain(people).chain(obstacles);
        let draws = &mut self.draws;
        // The farther three quarters of the places.
        let choose = |count: usize| count / 4 + draws.below(count - count / 4);
        let found = floor.find_way(at_m, goal_m, blocked, choose, &mut self.way);
        self.way.reverse();
        self.is_around = found && goal_m.is_some();
        self.patience = ticks_of(self.draws.between(PATIENCE_S));
        if !found {
            self.stay = ticks_of(self.draws.between([0.5, 1.0]));
        } else if !self.is_around {
            self.speed_m_s = self.draws.between(SPEED_M_S);
        }
    }
}
