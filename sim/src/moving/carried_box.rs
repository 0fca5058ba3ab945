//! Boxes that stand along walls and furniture, and are placed elsewhere from time to time.

use super::floor::Floor;
use super::shape::Outline;
use super::ticks_of;
use crate::burger;
use crate::noise::Draws;
use core::f64::consts::{FRAC_PI_2, TAU};
use msg::Pose2;

/// Length of a box's sides, metres.
const SIDE_M: [f64; 2] = [0.3, 0.6];
/// Time for which a box stands at a place, seconds.
const STAND_S: [f64; 2] = [30.0, 90.0];
/// Time after which a box without another place is tried again, seconds.
const RETRY_S: f64 = 2.0;
/// Gap between a box and the wall behind it, metres.
const WALL_GAP_M: [f64; 2] = [0.03, 0.12];
/// Smallest distance from a box's outline to other things than that wall, metres: the length of a cell's diagonal.
const CLEARANCE_M: f64 = 0.04;
/// Gap to robots and people at which a box is placed, metres.
const APART_M: f64 = 0.5;
/// Gap to the places where robots start, metres.
const START_APART_M: f64 = 0.8;
/// Gap to other boxes and to doors, metres: a robot has room to turn.
const LANE_M: f64 = 0.6;
/// Draws of a place before a box stays where it is.
const DRAWS_MAX: usize = 64;
/// Places of these for which it is computed whether the floor is divided, which takes longest.
const DIVISIONS_MAX: usize = 3;
/// Directions in which the nearest wall is looked for: one per 15°.
const DIRECTIONS: usize = 24;

/// A box that is carried to other places.
pub(super) struct CarriedBox {
    draws: Draws,
    half_m: [f64; 2],
    pub(super) world_from_box: Pose2,
    /// Ticks until it is placed elsewhere.
    stay: u32,
}

/// What a box is placed apart from.
pub(super) struct Others<'a> {
    /// Centres of the robots, metres.
    pub(super) robots_m: &'a [[f64; 2]],
    /// Whether these are the places where the robots start.
    pub(super) is_start: bool,
    pub(super) people: &'a [Outline],
    /// Outlines of the closed doors.
    pub(super) doors: &'a [Outline],
    /// Outlines of the other boxes.
    pub(super) boxes: &'a [Outline],
}

impl CarriedBox {
    /// Draws a box and its place; `None` if no place is found.
    pub(super) fn draw(mut draws: Draws, floor: &mut Floor, others: &Others<'_>) -> Option<Self> {
        let half_m = [(); 2].map(|()| draws.between(SIDE_M) / 2.0);
        let world_from_box = draw_place(&mut draws, floor, half_m, others)?;
        let stay = ticks_of(draws.between(STAND_S));
        Some(Self { draws, half_m, world_from_box, stay })
    }

    /// Puts the box where a process before had it; it is moved by other draws.
    pub(super) fn resume(&mut self, world_from_box: Pose2, draws: Draws) {
        (self.world_from_box, self.draws) = (world_from_box, draws);
        self.stay = ticks_of(self.draws.between(STAND_S));
    }

    pub(super) fn half_size_m(&self) -> [f64; 2] {
        self.half_m
    }

    pub(super) fn outline(&self) -> Outline {
        Outline::rectangle(self.world_from_box, self.half_m)
    }

    /// Returns whether the box is to be placed elsewhere now.
    pub(super) fn is_due(&mut self) -> bool {
        self.stay = self.stay.saturating_sub(1);
        self.stay == 0
    }

    /// Places the box elsewhere, if there is a place.
    pub(super) fn carry(&mut self, floor: &mut Floor, others: &Others<'_>) {
        let place = draw_place(&mut self.draws, floor, self.half_m, others);
        let stand_s = if place.is_some() { self.draws.between(STAND_S) } else { RETRY_S };
        self.world_from_box = place.unwrap_or(self.world_from_box);
        self.stay = ticks_of(stand_s);
    }
}

/// Draws a place along a wall where the box is in nobody's way; `None` if none of the draws is one.
fn draw_place(draws: &mut Draws, floor: &mut Floor, half_m: [f64; 2], others: &Others<'_>) -> Option<Pose2> {
    let mut divisions = 0;
    for _ in 0..DRAWS_MAX {
        let cells = floor.walkable_cells();
        let cell = *cells.get(draws.below(cells.len()))? as usize;
        let gap_m = draws.between(WALL_GAP_M);
        let Some(place) = beside_wall(floor, floor.centre_m(cell), half_m, gap_m) else { continue };
        let outline = Outline::rectangle(place, half_m);
        if !fits(floor, &outline) || !others.are_apart(&outline) {
            continue;
        }
        let all: Vec<Outline> = others.boxes.iter().copied().chain([outline]).collect();
        if floor.is_undivided_by(&all) {
            return Some(place);
        }
        divisions += 1;
        if divisions == DIVISIONS_MAX {
            return None;
        }
    }
    None
}

/// Returns the pose of a box between a point and the nearest wall, with a gap to the wall.
fn beside_wall(floor: &Floor, at_m: [f64; 2], half_m: [f64; 2], gap_m: f64) -> Option<Pose2> {
    const VIEW_M: f32 = 2.0;
    let view_m = |yaw_rad: f64| {
        let (sin, cos) = yaw_rad.sin_cos();
        f64::from(floor.room().view_m(at_m, [cos, sin], VIEW_M))
    };
    let headings = (0..DIRECTIONS).map(|i| TAU * i as f64 / DIRECTIONS as f64);
    let (yaw_rad, wall_m) =
        headings.map(|yaw_rad| (yaw_rad, view_m(yaw_rad))).min_by(|(_, a), (_, b)| a.total_cmp(b))?;
    if wall_m >= f64::from(VIEW_M) {
        return None;
    }
    let (sin, cos) = yaw_rad.sin_cos();
    let ahead_m = wall_m - gap_m - half_m[1];
    let turned_rad = msg::pose::wrap_angle(yaw_rad - FRAC_PI_2);
    Some(Pose2::new(at_m[0] + ahead_m * cos, at_m[1] + ahead_m * sin, turned_rad))
}

/// Returns whether a box stands on free floor and touches nothing of the room.
fn fits(floor: &Floor, outline: &Outline) -> bool {
    floor.clearance_m(outline.centre_m) > CLEARANCE_M
        && outline.border_m(CLEARANCE_M).all(|point_m| {
            floor.clearance_m(point_m) >= CLEARANCE_M && floor.is_open_from(outline.centre_m, point_m)
        })
}

impl Others<'_> {
    /// Returns whether a box is apart from robots, people, doors and other boxes.
    fn are_apart(&self, outline: &Outline) -> bool {
        let robot_m = burger::RADIUS_M + if self.is_start { START_APART_M } else { APART_M };
        self.robots_m.iter().all(|robot| outline.distance_m(*robot) > robot_m)
            && self
                .people
                .iter()
                .all(|person| outline.distance_m(person.centre_m) > person.bound_m() + APART_M)
            && self.doors.iter().chain(self.boxes).all(|other| gap_m(outline, other) > LANE_M)
    }
}

/// Returns the gap between two rectangles, metres, to a few centimetres; not above their true one.
fn gap_m(a: &Outline, b: &Outline) -> f64 {
    const STEP_M: f64 = 0.05;
    let to = |from: &Outline, to: &Outline| {
        from.border_m(STEP_M).map(|point| to.distance_m(point)).fold(f64::INFINITY, f64::min)
    };
    to(a, b).min(to(b, a)) - STEP_M / 2.0
}
