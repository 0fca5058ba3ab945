//! Where to go next: to the frontier that is soonest looked past, or, once none is left, back to places not
//! seen for long, so that loops close.

use crate::floor::Floor;
use crate::frontier::{Frontier, FrontierSearch};
use crate::memory::{Memory, distance_m};
use crate::rng::Rng;
use crate::routes::Routes;
use crate::sight::{MapView, ScanView};
use crate::steering::Waypoint;
use msg::grid::Occupancy;
use msg::{Pose2, Stamp, pose::wrap_angle};

/// The Burger turns within this circle (ROBOTIS: 138 mm x 178 mm, axis off the middle), metres.
pub const BODY_RADIUS_M: f64 = 0.105;
/// Kept free around the body, metres.
const MARGIN_M: f64 = 0.06;
/// What a robot may leave in the map where it stood, and what is drawn where another stands, metres.
const GHOST_RADIUS_M: f64 = 0.14;
/// Hits further away are left to the map: the pose they were seen from is not exactly known, metres.
const FRESH_HIT_MAX_M: f64 = 1.0;
/// From how far a frontier is looked at: at the first try, at the second. Then it is let be.
const VIEW_M: [f64; 2] = [1.8, 0.6];
/// What the operator reckons with, m/s and rad/s.
const SPEED_M_S: f64 = 0.14;
const TURN_RAD_S: f64 = 0.8;
/// A metre of frontier is worth this detour, seconds, up to `WORTH_MAX_M` of it.
const WORTH_S_PER_M: f64 = 5.0;
const WORTH_MAX_M: f64 = 1.2;
/// Going on to the same goal saves a change of mind, seconds.
const LOYALTY_S: f64 = 4.0;
/// Goals this close are the same one, metres.
pub const SAME_GOAL_M: f64 = 0.4;
/// A frontier this close to another robot's goal is left to it unless all else is this much dearer.
const HELD_RADIUS_M: f64 = 1.2;
const HELD_S: f64 = 12.0;
/// Patrol: places drawn to choose from.
const PATROL_DRAWS: usize = 32;
/// A place not visited for this long counts as never visited, seconds.
const ABSENT_MAX_S: f64 = 300.0;

/// What a plan is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Look past a frontier.
    Explore,
    /// See a place again.
    Patrol,
}

/// Where to drive and where to look from there.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// What for.
    pub purpose: Purpose,
    /// The way; at least one place.
    pub way: Vec<Waypoint>,
    /// In the map's frame, metres.
    pub look_at_m: [f64; 2],
    /// Time it should take, seconds.
    pub cost_s: f64,
    /// The goal asked about is a frontier no more: it was seen past, or so it looks.
    pub goal_gone: bool,
}

/// What the planner answers.
#[derive(Clone, Debug, PartialEq)]
pub enum Answer {
    /// Go there.
    Go(Plan),
    /// There is nowhere to go.
    Stranded,
}

/// What the planner is asked about.
#[derive(Clone, Copy, Debug)]
pub struct Question<'a> {
    /// Now.
    pub stamp: Stamp,
    /// The map to plan on.
    pub map: MapView<'a>,
    /// The robot in it.
    pub map_from_base: Pose2,
    /// Its newest scan.
    pub scan: ScanView<'a>,
    /// The robot's past.
    pub memory: &'a Memory,
    /// Where the other robots stand, in the map.
    pub others_m: &'a [[f64; 2]],
    /// What the other robots are on their way to, in the map.
    pub held_m: &'a [[f64; 2]],
    /// What this robot was on its way to.
    pub goal_m: Option<[f64; 2]>,
}

/// Plans, in buffers that it keeps. Time and memory are linear in the window's cells
/// ([`crate::floor::WINDOW_CELLS_MAX`]), whatever the map's size.
#[derive(Clone, Debug, Default)]
pub struct Planner {
    floor: Floor,
    routes: Routes,
    search: FrontierSearch,
    way: Vec<usize>,
    best_way: Vec<usize>,
}

impl Planner {
    /// Where to go next.
    pub fn plan(&mut self, question: &Question, rng: &mut Rng) -> Answer {
        self.look(question);
        let here = [question.map_from_base.x_m, question.map_from_base.y_m];
        let open_clearance_m = BODY_RADIUS_M + MARGIN_M + self.floor.cell_m() / 2.0;
        if !self.routes.spread(&self.floor, here, open_clearance_m) {
            return Answer::Stranded;
        }
        match self.explore(question).or_else(|| self.patrol(question, rng)) {
            Some(plan) => Answer::Go(plan),
            None => Answer::Stranded,
        }
    }

    /// Whether nothing known stands within the body's reach around a point of the last [`Planner::look`].
    pub fn has_room(&self, point_m: [f64; 2]) -> bool {
        let needed_m = BODY_RADIUS_M + self.floor.cell_m() / 2.0;
        self.floor.cell_of(point_m).is_some_and(|cell| self.floor.clearance_m(cell) >= needed_m)
    }

    /// Lays what the scans show and where the robots stand over the map.
    pub fn look(&mut self, question: &Question) {
        let here = [question.map_from_base.x_m, question.map_from_base.y_m];
        self.floor.survey(&question.map, here);
        question.memory.draw_glimpses(&mut self.floor);
        // Where it stands is free, whatever the others' scans drew of it there.
        self.floor.mark_disc(here, GHOST_RADIUS_M, Occupancy::Free);
        for hit in question.scan.hits_in_base_m().filter(|hit| hit[0].hypot(hit[1]) < FRESH_HIT_MAX_M) {
            self.floor.mark_hit(question.map_from_base.apply(hit));
        }
        for other in question.others_m {
            self.floor.mark_disc(*other, GHOST_RADIUS_M, Occupancy::Occupied);
        }
        self.floor.measure_clearance();
    }

    /// The frontier that is soonest looked past.
    fn explore(&mut self, question: &Question) -> Option<Plan> {
        let Self { floor, routes, search, way, best_way } = self;
        let mut best: Option<(f64, f64, Frontier)> = None;
        let mut goal_gone = true;
        for frontier in search.find(floor, routes) {
            let beyond_m = floor.centre_m(frontier.beyond);
            goal_gone &= question.goal_m.is_none_or(|goal| distance_m(goal, beyond_m) >= SAME_GOAL_M);
            let tries = question.memory.tries(question.stamp, beyond_m) as usize;
            let Some(view_m) = VIEW_M.get(tries) else { continue };
            routes.way(floor, frontier.cell, way);
            let Some(viewpoint) = viewpoint(floor, routes, way, frontier, *view_m) else { continue };
            way.truncate(viewpoint + 1);
            let cost_s = time_s(floor, routes, way, beyond_m, question.map_from_base);
            let score_s = cost_s - worth_s(floor, frontier, question);
            if best.is_none_or(|(least, ..)| score_s < least) {
                best = Some((score_s, cost_s, *frontier));
                core::mem::swap(way, best_way);
            }
        }
        let (_, cost_s, frontier) = best?;
        let way = waypoints(floor, best_way);
        let look_at_m = floor.centre_m(frontier.beyond);
        Some(Plan { purpose: Purpose::Explore, way, look_at_m, cost_s, goal_gone })
    }

    /// A far place not visited for long, drawn by lot.
    fn patrol(&mut self, question: &Question, rng: &mut Rng) -> Option<Plan> {
        let Self { floor, routes, way, .. } = self;
        let reached = routes.reached();
        let mut best: Option<(f64, usize)> = None;
        for _ in 0..PATROL_DRAWS {
            let cell = reached[rng.below(reached.len())];
            let place = floor.centre_m(cell);
            let held = question.held_m.iter().any(|held| distance_m(*held, place) < HELD_RADIUS_M);
            if held || !routes.is_open(floor, cell) || question.memory.tries(question.stamp, place) > 0 {
                continue;
            }
            let absent_s = question.memory.absent_s(question.stamp, place, 1.0).unwrap_or(ABSENT_MAX_S);
            let far_s = routes.cost_m(floor, cell)? / SPEED_M_S;
            let score = absent_s.min(ABSENT_MAX_S) / ABSENT_MAX_S + far_s.min(30.0) / 60.0;
            if best.is_none_or(|(most, _)| score > most) {
                best = Some((score, cell));
            }
        }
        let (_, cell) = best?;
        routes.way(floor, cell, way);
        let look_at_m = floor.centre_m(cell);
        let cost_s = time_s(floor, routes, way, look_at_m, question.map_from_base);
        let way = waypoints(floor, way);
        Some(Plan { purpose: Purpose::Patrol, way, look_at_m, cost_s, goal_gone: true })
    }
}

fn waypoints(floor: &Floor, cells: &[usize]) -> Vec<Waypoint> {
    let waypoint = |cell: &usize| Waypoint { at_m: floor.centre_m(*cell), room_m: floor.clearance_m(*cell) };
    cells.iter().map(waypoint).collect()
}

/// The first place on the way from where the frontier can be looked past; `None` if only narrow places are.
fn viewpoint(
    floor: &Floor,
    routes: &Routes,
    way: &[usize],
    frontier: &Frontier,
    view_m: f64,
) -> Option<usize> {
    let beyond_m = floor.centre_m(frontier.beyond);
    let open = way.iter().take_while(|cell| routes.is_open(floor, **cell));
    open.enumerate()
        .filter(|(_, cell)| distance_m(floor.centre_m(**cell), beyond_m) <= view_m)
        .find(|(_, cell)| floor.sees(**cell, frontier.beyond) && floor.sees(**cell, frontier.deep))
        .map(|(i, _)| i)
}

/// Turning to the way, driving it, turning to what is to be seen.
fn time_s(floor: &Floor, routes: &Routes, way: &[usize], look_at_m: [f64; 2], map_from_base: Pose2) -> f64 {
    let end = way[way.len() - 1];
    let bearing = |from: [f64; 2], to: [f64; 2]| (to[1] - from[1]).atan2(to[0] - from[0]);
    let ahead = |from: usize, to: usize| bearing(floor.centre_m(way[from]), floor.centre_m(way[to]));
    // Over some cells, for single steps only know eight directions.
    let stretch = (way.len() - 1).min(8);
    let look_rad = bearing(floor.centre_m(end), look_at_m);
    let (first_rad, last_rad) = match stretch {
        0 => (look_rad, look_rad),
        _ => (ahead(0, stretch), ahead(way.len() - 1 - stretch, way.len() - 1)),
    };
    let final_rad =
        if distance_m(floor.centre_m(end), look_at_m) < floor.cell_m() { last_rad } else { look_rad };
    let turned_rad =
        wrap_angle(first_rad - map_from_base.yaw_rad).abs() + wrap_angle(final_rad - last_rad).abs();
    routes.cost_m(floor, end).unwrap_or(0.0) / SPEED_M_S + turned_rad / TURN_RAD_S
}

/// What speaks for a frontier beside its cost, seconds.
fn worth_s(floor: &Floor, frontier: &Frontier, question: &Question) -> f64 {
    let beyond_m = floor.centre_m(frontier.beyond);
    let near = |goal: &[f64; 2], radius_m: f64| distance_m(*goal, beyond_m) < radius_m;
    let mut worth_s = WORTH_S_PER_M * frontier.length_m.min(WORTH_MAX_M);
    if question.goal_m.is_some_and(|goal| near(&goal, SAME_GOAL_M)) {
        worth_s += LOYALTY_S;
    }
    if question.held_m.iter().any(|goal| near(goal, HELD_RADIUS_M)) {
        worth_s -= HELD_S;
    }
    worth_s
}
