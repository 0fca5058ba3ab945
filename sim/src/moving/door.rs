//! Sliding doors in narrow passages of a room: where they fit, and when they open and close.

use super::floor::Floor;
use super::shape::Outline;
use super::{PERIOD_S, ticks_of};
use crate::burger;
use crate::noise::Draws;
use core::f64::consts::{FRAC_PI_2, TAU};
use msg::Pose2;

/// Width of a passage that gets a door, metres.
const WIDTH_M: [f64; 2] = [0.6, 1.15];
/// Largest distance at which a passage's walls are looked for, metres.
const VIEW_M: f32 = 1.3;
/// Directions in which a passage is measured: one per 15°.
const DIRECTIONS: usize = 12;
/// Largest difference between the distances to both walls in the middle of a passage, metres.
const MIDDLE_M: f64 = 0.06;
/// Distance before and behind a passage at which the floor is wider, metres.
const BEYOND_M: f64 = 0.7;
/// What the floor is wider there than in the passage, to each side, metres.
const WIDER_M: f64 = 0.1;
/// Largest distance along a passage from where it was found to its narrowest place, metres.
const ALONG_M: f64 = 0.3;
/// Steps in which the narrowest place is looked for, metres.
const STEP_M: f64 = 0.01;
/// What the wall may be wider than at its narrowest place, metres.
const EVEN_M: f64 = 0.03;
/// Half of the leaf's thickness, metres: it fits into the walls of the built-in rooms.
const HALF_THICKNESS_M: f64 = 0.015;
/// Part of the leaf that stays in the wall at either end, metres.
const OVERLAP_M: f64 = 0.01;
/// Smallest distance between two doors, and between a door and a starting robot, metres.
const APART_M: f64 = 1.0;
/// Time in which a door opens or closes, seconds.
const SLIDE_S: f64 = 2.0;
/// Time for which a door stays open, seconds.
const OPEN_S: [f64; 2] = [15.0, 45.0];
/// Time for which a door stays closed, seconds.
const CLOSED_S: [f64; 2] = [5.0, 15.0];
/// Gap between the closed leaf and a robot or a person below which a door does not close, metres.
const FREE_GAP_M: f64 = 0.25;

/// Place of a door.
#[derive(Clone, Copy, Debug)]
pub(super) struct Doorway {
    /// Pose of the closed leaf, whose x axis points to the wall into which it slides.
    world_from_closed: Pose2,
    half_length_m: f64,
}

/// A sliding door.
pub(super) struct SlidingDoor {
    draws: Draws,
    doorway: Doorway,
    /// Share of its way into the wall that the leaf has gone: 0 is closed, 1 open.
    openness: f64,
    /// Change of the openness until the next tick.
    step: f64,
    opens: bool,
    /// Ticks until it begins to move the other way.
    stay: u32,
}

impl Doorway {
    /// Finds the places of a room that a door fits into, apart from starting robots.
    pub(super) fn find_all(floor: &Floor, robots_m: &[[f64; 2]]) -> Vec<Self> {
        let mut found: Vec<Self> = Vec::new();
        for cell in 0..floor.len() {
            let at_m = floor.centre_m(cell);
            let clearance_m = floor.clearance_m(at_m);
            let is_narrow = (WIDTH_M[0] / 2.0 - MIDDLE_M..WIDTH_M[1] / 2.0 + MIDDLE_M).contains(&clearance_m);
            let is_apart = |other: &[f64; 2]| (other[0] - at_m[0]).hypot(other[1] - at_m[1]) > APART_M;
            let others = found.iter().map(|door| [door.world_from_closed.x_m, door.world_from_closed.y_m]);
            if is_narrow
                && floor.is_drivable(cell)
                && robots_m.iter().copied().chain(others).all(|other| is_apart(&other))
            {
                found.extend(Self::at(floor, at_m));
            }
        }
        found
    }

    /// Returns the place of a door in the passage at a point; `None` if there is none.
    fn at(floor: &Floor, at_m: [f64; 2]) -> Option<Self> {
        let headings = (0..DIRECTIONS).map(|i| TAU / 2.0 * i as f64 / DIRECTIONS as f64);
        let widths = headings.map(|yaw_rad| (yaw_rad, walls_m(floor, at_m, yaw_rad)));
        let (yaw_rad, [ahead_m, behind_m]) =
            widths.min_by(|(_, a), (_, b)| (a[0] + a[1]).total_cmp(&(b[0] + b[1])))?;
        if (ahead_m - behind_m).abs() > MIDDLE_M {
            return None;
        }
        let beyond = [1.0, -1.0].map(|side| moved(at_m, yaw_rad + FRAC_PI_2, side * BEYOND_M));
        let is_wider = |point: &[f64; 2]| floor.clearance_m(*point) > floor.clearance_m(at_m) + WIDER_M;
        if !beyond.iter().all(|point| is_wider(point) && floor.is_open_from(at_m, *point)) {
            return None;
        }
        let middle_m = narrowest_m(floor, at_m, yaw_rad)?;
        let [ahead_m, behind_m] = walls_m(floor, middle_m, yaw_rad);
        if !(WIDTH_M[0]..=WIDTH_M[1]).contains(&(ahead_m + behind_m)) {
            return None;
        }
        let centre_m = moved(middle_m, yaw_rad, (ahead_m - behind_m) / 2.0);
        let half_length_m = (ahead_m + behind_m) / 2.0 + OVERLAP_M;
        let into_wall = |turn_rad: f64| {
            let pose = Pose2::new(centre_m[0], centre_m[1], msg::pose::wrap_angle(yaw_rad + turn_rad));
            Self { world_from_closed: pose, half_length_m }
        };
        [0.0, TAU / 2.0].map(into_wall).into_iter().find(|doorway| doorway.has_pocket(floor))
    }

    /// Returns whether the wall takes up the whole leaf.
    fn has_pocket(&self, floor: &Floor) -> bool {
        let Pose2 { x_m, y_m, yaw_rad } = self.world_from_closed;
        let steps = (2.0 * self.half_length_m / STEP_M) as usize;
        (4..steps).all(|step| {
            let point_m = moved([x_m, y_m], yaw_rad, self.half_length_m + step as f64 * STEP_M);
            !floor.is_open_from([x_m, y_m], point_m)
        })
    }

    fn leaf(&self, openness: f64) -> Pose2 {
        self.world_from_closed * Pose2::new(2.0 * self.half_length_m * openness, 0.0, 0.0)
    }

    /// Returns the outline of the closed leaf.
    pub(super) fn outline(&self) -> Outline {
        Outline::rectangle(self.world_from_closed, self.half_size_m())
    }

    pub(super) fn half_size_m(&self) -> [f64; 2] {
        [self.half_length_m, HALF_THICKNESS_M]
    }
}

impl SlidingDoor {
    /// Creates an open door.
    pub(super) fn new(mut draws: Draws, doorway: Doorway) -> Self {
        let stay = ticks_of(draws.between(OPEN_S));
        Self { draws, doorway, openness: 1.0, step: 0.0, opens: true, stay }
    }

    /// Puts the leaf where a process before had it; from there it opens, with other draws.
    pub(super) fn resume(&mut self, world_from_leaf: Pose2, draws: Draws) {
        let moved_m = self.doorway.world_from_closed.distance_m(world_from_leaf);
        self.openness = (moved_m / (2.0 * self.doorway.half_length_m)).clamp(0.0, 1.0);
        (self.draws, self.step, self.opens) = (draws, 0.0, true);
        self.stay = ticks_of(self.draws.between(OPEN_S));
    }

    pub(super) fn doorway(&self) -> &Doorway {
        &self.doorway
    }

    /// Returns whether the leaf is out of the wall.
    pub(super) fn is_present(&self) -> bool {
        self.openness < 1.0 || self.step != 0.0
    }

    pub(super) fn world_from_leaf(&self) -> Pose2 {
        self.doorway.leaf(self.openness)
    }

    /// Returns the outline of the leaf at the end of the next tick.
    pub(super) fn next_outline(&self) -> Outline {
        Outline::rectangle(self.doorway.leaf(self.openness + self.step), self.doorway.half_size_m())
    }

    /// Returns the velocity of the leaf until the next tick, m/s.
    pub(super) fn velocity_m_s(&self) -> [f64; 2] {
        let speed_m_s = 2.0 * self.doorway.half_length_m * self.step / PERIOD_S;
        let (sin, cos) = self.doorway.world_from_closed.yaw_rad.sin_cos();
        [speed_m_s * cos, speed_m_s * sin]
    }

    /// Moves the leaf to the end of the tick.
    pub(super) fn end_tick(&mut self) {
        self.openness += self.step;
    }

    /// Decides the motion of the next tick: it closes, or goes on closing, only if nobody is near.
    pub(super) fn begin_tick(&mut self, robots_m: &[[f64; 2]], people: &[Outline]) {
        let closed = self.doorway.outline();
        let is_near = |at_m: &[f64; 2], radius_m: f64| closed.distance_m(*at_m) < radius_m + FREE_GAP_M;
        let is_free = !robots_m.iter().any(|robot| is_near(robot, burger::RADIUS_M))
            && !people.iter().any(|person| is_near(&person.centre_m, person.bound_m()));
        self.stay = self.stay.saturating_sub(1);
        if self.stay == 0 && (is_free || !self.opens) {
            self.opens = !self.opens;
            self.stay = ticks_of(SLIDE_S + self.draws.between(if self.opens { OPEN_S } else { CLOSED_S }));
        } else if !self.opens && !is_free && self.openness > 0.0 {
            self.opens = true;
            self.stay = ticks_of(SLIDE_S + self.draws.between(OPEN_S));
        }
        let step = PERIOD_S / SLIDE_S;
        self.step = if self.opens { step.min(1.0 - self.openness) } else { -step.min(self.openness) };
    }
}

/// Returns the distances to the walls in a direction and against it, metres.
fn walls_m(floor: &Floor, at_m: [f64; 2], yaw_rad: f64) -> [f64; 2] {
    let (sin, cos) = yaw_rad.sin_cos();
    [[cos, sin], [-cos, -sin]].map(|direction| floor.room().view_m(at_m, direction, VIEW_M).into())
}

/// Returns the middle of the narrowest part of a passage, along it, metres.
fn narrowest_m(floor: &Floor, at_m: [f64; 2], yaw_rad: f64) -> Option<[f64; 2]> {
    let steps = (ALONG_M / STEP_M) as i32;
    let width_m = |step: i32| {
        let point_m = moved(at_m, yaw_rad + FRAC_PI_2, f64::from(step) * STEP_M);
        walls_m(floor, point_m, yaw_rad).iter().sum::<f64>()
    };
    let narrowest_m = (-steps..=steps).map(width_m).min_by(f64::total_cmp)?;
    let is_even = |step: &i32| width_m(*step) < narrowest_m + EVEN_M;
    let first = (-steps..=steps).find(is_even)?;
    let last = (first..=steps).take_while(is_even).last()?;
    // A part that goes on beyond what was looked at is a corridor.
    let is_whole = first > -steps && last < steps;
    is_whole.then(|| moved(at_m, yaw_rad + FRAC_PI_2, f64::from(first + last) / 2.0 * STEP_M))
}

fn moved(at_m: [f64; 2], yaw_rad: f64, way_m: f64) -> [f64; 2] {
    let (sin, cos) = yaw_rad.sin_cos();
    [at_m[0] + way_m * cos, at_m[1] + way_m * sin]
}
