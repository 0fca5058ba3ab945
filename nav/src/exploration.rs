//! Choice of the frontier to look past next, and of the place to visit again once no frontier is left.

use crate::clearance_map::ClearanceMap;
use crate::config::{ExplorationConfig, NavConfig};
use crate::frontier::{Frontier, FrontierSearch};
use crate::geometry::{bearing_rad, distance_m};
use crate::memory::RobotMemory;
use crate::path::Path;
use crate::planner::{Planner, PlanningInput, path_of_cells};
use crate::random::RandomNumbers;
use crate::route_search::RouteSearch;
use msg::{Pose2, Stamp, pose::wrap_angle};

/// Random cells among which the place of a patrol is chosen.
const PATROL_DRAWS: usize = 32;
/// A place not visited for this long counts as never visited, seconds.
const ABSENCE_MAX_S: f64 = 300.0;
/// A place counts as visited from this distance, metres.
const VISIT_RADIUS_M: f64 = 1.0;
/// Driving time beyond which a place counts as far away, seconds ...
const FAR_S: f64 = 30.0;
/// ... and the scale of that time: a far place scores half as much as one that was never visited.
const FAR_SCALE_S: f64 = 60.0;
/// Cells over which the direction of a path is taken: single steps know eight directions only.
const DIRECTION_CELLS: usize = 8;

/// Purpose of a goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GoalKind {
    /// Look past a frontier.
    Explore,
    /// Visit a place again, so that loops close.
    Patrol,
}

/// Goal of a robot: where to drive and what to face there.
#[derive(Clone, Debug, PartialEq)]
pub struct ExplorationGoal {
    /// Purpose of the goal.
    pub kind: GoalKind,
    /// Path from the robot, with at least one waypoint.
    pub path: Path,
    /// Point to face at the end of the path, in the frame of the map, metres. Identifies the goal.
    pub look_at_m: [f64; 2],
    /// Expected time of driving and turning, seconds.
    pub expected_s: f64,
    /// Whether no frontier is left at the current goal of the request: it was seen past.
    pub current_goal_explored: bool,
}

/// Criteria by which a goal is chosen.
#[derive(Clone, Copy, Debug)]
pub struct GoalRequest<'a> {
    /// Time of the request.
    pub stamp: Stamp,
    /// Map, pose, scans and other robots.
    pub input: PlanningInput<'a>,
    /// Attempts and visits of the robot.
    pub memory: &'a RobotMemory,
    /// Goals of the other robots in the map, metres.
    pub assigned_goals_m: &'a [[f64; 2]],
    /// Current goal of this robot in the map, metres.
    pub current_goal_m: Option<[f64; 2]>,
}

/// Chooses exploration goals, in buffers that it keeps.
#[derive(Clone, Debug, Default)]
pub struct ExplorationPlanner {
    config: ExplorationConfig,
    planner: Planner,
    frontiers: FrontierSearch,
    route: Vec<usize>,
    best_route: Vec<usize>,
}

impl ExplorationPlanner {
    /// A planner with these parameters.
    pub fn new(config: &NavConfig) -> Self {
        Self { config: config.exploration, planner: Planner::new(config.body), ..Self::default() }
    }

    /// Chooses the next goal: a frontier, or a patrol if there is none. `None` if the robot can go nowhere.
    pub fn choose_goal(
        &mut self,
        request: &GoalRequest,
        random: &mut RandomNumbers,
    ) -> Option<ExplorationGoal> {
        self.planner.update_map(&request.input);
        self.planner.search_routes(&request.input).ok()?;
        self.choose_frontier(request).or_else(|| self.choose_patrol(request, random))
    }

    /// Path planner with the map that the last goal was chosen on.
    pub fn planner(&mut self) -> &mut Planner {
        &mut self.planner
    }

    /// The frontier with the lowest cost after its utility is taken off.
    fn choose_frontier(&mut self, request: &GoalRequest) -> Option<ExplorationGoal> {
        let Self { config, planner, frontiers, route, best_route } = self;
        let (map, routes) = planner.map_and_routes();
        let mut best: Option<(f64, f64, Frontier)> = None;
        let mut current_goal_explored = true;
        for frontier in frontiers.find_frontiers(map, routes) {
            let beyond_m = map.cell_centre_m(frontier.unknown_cell);
            let is_other = |goal: [f64; 2]| distance_m(goal, beyond_m) >= config.same_goal_m;
            current_goal_explored &= request.current_goal_m.is_none_or(is_other);
            let attempts = request.memory.attempts.count(request.stamp, beyond_m) as usize;
            let Some(distance_max_m) = config.viewing_distances_m.get(attempts) else { continue };
            routes.route_to(map, frontier.free_cell, route);
            let viewpoint = first_viewpoint(map, routes, route, frontier, *distance_max_m);
            let Some(viewpoint) = viewpoint else { continue };
            route.truncate(viewpoint + 1);
            let expected_s =
                expected_time_s(config, map, routes, route, beyond_m, request.input.map_from_base);
            let cost_s = expected_s - utility_s(config, map, frontier, request);
            if best.is_none_or(|(least, ..)| cost_s < least) {
                best = Some((cost_s, expected_s, *frontier));
                core::mem::swap(route, best_route);
            }
        }
        let (_, expected_s, frontier) = best?;
        Some(ExplorationGoal {
            kind: GoalKind::Explore,
            path: path_of_cells(map, best_route),
            look_at_m: map.cell_centre_m(frontier.unknown_cell),
            expected_s,
            current_goal_explored,
        })
    }

    /// The best of some random places: far away, and not visited for long.
    fn choose_patrol(
        &mut self,
        request: &GoalRequest,
        random: &mut RandomNumbers,
    ) -> Option<ExplorationGoal> {
        let Self { config, planner, route, .. } = self;
        let (map, routes) = planner.map_and_routes();
        let reached = routes.reached_cells();
        let mut best: Option<(f64, usize)> = None;
        for _ in 0..PATROL_DRAWS {
            let cell = reached[random.index_below(reached.len())];
            let place_m = map.cell_centre_m(cell);
            let near_place = |goal: &[f64; 2]| distance_m(*goal, place_m) < config.assigned_radius_m;
            if request.assigned_goals_m.iter().any(near_place)
                || !routes.is_passable(map, cell)
                || request.memory.attempts.count(request.stamp, place_m) > 0
            {
                continue;
            }
            let since_visit_s = request.memory.visits.since_visit_s(request.stamp, place_m, VISIT_RADIUS_M);
            let absence_s = since_visit_s.unwrap_or(ABSENCE_MAX_S).min(ABSENCE_MAX_S);
            let driving_s = routes.cost_m(map, cell)? / config.expected_speed_m_s;
            let score = absence_s / ABSENCE_MAX_S + driving_s.min(FAR_S) / FAR_SCALE_S;
            if best.is_none_or(|(most, _)| score > most) {
                best = Some((score, cell));
            }
        }
        let (_, cell) = best?;
        routes.route_to(map, cell, route);
        let look_at_m = map.cell_centre_m(cell);
        let expected_s = expected_time_s(config, map, routes, route, look_at_m, request.input.map_from_base);
        let path = path_of_cells(map, route);
        Some(ExplorationGoal {
            kind: GoalKind::Patrol,
            path,
            look_at_m,
            expected_s,
            current_goal_explored: true,
        })
    }
}

/// Index of the first passable cell of a route from where a frontier can be looked past.
fn first_viewpoint(
    map: &ClearanceMap,
    routes: &RouteSearch,
    route: &[usize],
    frontier: &Frontier,
    distance_max_m: f64,
) -> Option<usize> {
    let beyond_m = map.cell_centre_m(frontier.unknown_cell);
    let passable = route.iter().take_while(|cell| routes.is_passable(map, **cell));
    passable
        .enumerate()
        .filter(|(_, cell)| distance_m(map.cell_centre_m(**cell), beyond_m) <= distance_max_m)
        .find(|(_, cell)| {
            map.has_line_of_sight(**cell, frontier.unknown_cell)
                && map.has_line_of_sight(**cell, frontier.deep_cell)
        })
        .map(|(i, _)| i)
}

/// Time to turn towards a route, drive it, and turn to the point to look at, seconds.
fn expected_time_s(
    config: &ExplorationConfig,
    map: &ClearanceMap,
    routes: &RouteSearch,
    route: &[usize],
    look_at_m: [f64; 2],
    map_from_base: Pose2,
) -> f64 {
    let end = route[route.len() - 1];
    let end_m = map.cell_centre_m(end);
    let direction_rad =
        |from: usize, to: usize| bearing_rad(map.cell_centre_m(route[from]), map.cell_centre_m(route[to]));
    let stretch = (route.len() - 1).min(DIRECTION_CELLS);
    let look_rad = bearing_rad(end_m, look_at_m);
    let (first_rad, last_rad) = match stretch {
        0 => (look_rad, look_rad),
        _ => (direction_rad(0, stretch), direction_rad(route.len() - 1 - stretch, route.len() - 1)),
    };
    let is_at_end = distance_m(end_m, look_at_m) < map.cell_size_m();
    let final_rad = if is_at_end { last_rad } else { look_rad };
    let turned_rad =
        wrap_angle(first_rad - map_from_base.yaw_rad).abs() + wrap_angle(final_rad - last_rad).abs();
    routes.cost_m(map, end).unwrap_or(0.0) / config.expected_speed_m_s
        + turned_rad / config.expected_turn_rad_s
}

/// Utility of a frontier, seconds: its length, whether it is the current goal, whether another robot goes there.
fn utility_s(
    config: &ExplorationConfig,
    map: &ClearanceMap,
    frontier: &Frontier,
    request: &GoalRequest,
) -> f64 {
    let beyond_m = map.cell_centre_m(frontier.unknown_cell);
    let is_near = |goal: &[f64; 2], radius_m: f64| distance_m(*goal, beyond_m) < radius_m;
    let mut utility_s = config.utility_s_per_m * frontier.length_m.min(config.utility_length_max_m);
    if request.current_goal_m.is_some_and(|goal| is_near(&goal, config.same_goal_m)) {
        utility_s += config.current_goal_bonus_s;
    }
    if request.assigned_goals_m.iter().any(|goal| is_near(goal, config.assigned_radius_m)) {
        utility_s -= config.assigned_cost_s;
    }
    utility_s
}
