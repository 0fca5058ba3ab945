//! Cooperative search in space and time, which leads a robot around the planned ways of others.
//!
//! Windowed hierarchical cooperative A* (Silver 2005): robots plan one after another in the order of their priority,
//! and each keeps clear of the reservations of those before it, for a window of time. The cost of the rest of the way
//! is that of the static routes to the goal, so that the search expands little more than the way itself while no
//! other robot is near. A robot may wait, step aside, or be pushed back; it moves along its own heading only, so the
//! turn before its first step takes time.

use super::goal_map::GoalMap;
use crate::clearance_map::{ClearanceMap, NEIGHBOURS};
use crate::geometry::{bearing_rad, distance_m};
use crate::route_search::STRAIGHT_COST;
use core::cmp::Reverse;
use msg::{Pose2, RobotId, pose::wrap_angle};
use std::collections::BinaryHeap;

/// Steps of the window: 16 s on maps of 0.05 m.
pub(super) const WINDOW_STEPS: usize = 40;
/// Speed that plans assume, m/s: below cruise speed, because diagonal steps are longer and curves are slower.
pub(super) const PLANNED_SPEED_M_S: f64 = 0.125;
/// Turning speed that plans assume, rad/s: a little below that of the follower.
const PLANNED_TURN_RAD_S: f64 = 0.8;
/// Turns below this heading error are driven as curves, radians.
const CURVE_RAD: f64 = 0.8;
/// Farthest cell of the window from its start, along either axis.
const REACH: i64 = WINDOW_STEPS as i64;
const SIDE: i64 = 2 * REACH + 1;
/// Most states that a search expands, so that a step of the navigator stays short: some milliseconds.
const EXPANSIONS_MAX: usize = 40_000;
/// Steps for which a robot that no way leads clear of the others takes them to stand, and to give way meanwhile: a turn
/// and a step aside.
const EXEMPT_STEPS: usize = 16;
/// Steps beyond those of its turn for which a robot may stay in its first cell without waiting: it is late by rounding.
const LATE_STEPS: usize = 2;
/// Cost of waiting for a step: that of an open straight step.
const WAIT_COST: u32 = STRAIGHT_COST;
/// Cost of waiting for a step on the way of a robot with priority: a robot that steps aside early is not in its way
/// when it is late itself.
const WAIT_ON_WAY_COST: u32 = 3 * WAIT_COST;
/// Cost of beginning to drive away from where the last plan led, beside the way's own: of two sides to step aside to that
/// are nearly equal, the one that was begun is kept. It is less than that of waiting for a robot to pass.
const SWITCH_COST: u32 = 8 * STRAIGHT_COST;
/// Move that is no direction: waiting.
const WAIT: u8 = 8;
const START: u8 = 9;

/// Where a robot will be: its position at each step of the window, in the frame of the map.
#[derive(Clone, Debug)]
pub(super) struct Reservation {
    pub(super) robot: RobotId,
    /// At least one; the last one holds after the end.
    pub(super) positions_m: Vec<[f64; 2]>,
}

/// Way of a robot through the window: its cell at each step.
#[derive(Clone, Debug)]
pub(super) struct TimedRoute {
    pub(super) cells: Vec<usize>,
    /// Steps that a turn before the first move takes, by direction.
    turn_steps: [usize; 8],
    /// The robot that turned it from the static route most often.
    pub(super) given_way_to: Option<RobotId>,
    /// Whether it keeps clear of all others.
    pub(super) is_clear: bool,
}

/// Buffers of the search.
#[derive(Clone, Debug, Default)]
pub(super) struct CooperativeSearch {
    /// Generation in which each state was reached; it saves clearing.
    reached_in: Vec<u32>,
    generation: u32,
    cost: Vec<u32>,
    came_by: Vec<u8>,
    queue: BinaryHeap<Reverse<(u32, u32, u32)>>,
}

/// One search: a robot among reservations.
struct Problem<'a> {
    goal_map: &'a GoalMap,
    start: usize,
    start_xy: (i64, i64),
    /// Positions of each reservation by step, in cells.
    reserved: Vec<(RobotId, Vec<[f64; 2]>)>,
    separation_cells: f64,
    /// Steps that a turn before the first move takes, by direction.
    turn_steps: [usize; 8],
    exempt_steps: usize,
    /// Cells of the window that lie on the reserved ways, row-major.
    on_way: Vec<bool>,
    /// Cost of the first move beside the way's own, by direction.
    switch_cost: [u32; 8],
}

impl Problem<'_> {
    fn map(&self) -> &ClearanceMap {
        self.goal_map.map()
    }

    /// The reservation that a move within one step comes too near to.
    fn conflict(&self, from: usize, to: usize, step: usize) -> Option<RobotId> {
        let centre = |cell: usize| {
            let (x, y) = self.map().column_row(cell);
            [x as f64 + 0.5, y as f64 + 0.5]
        };
        let (before, after) = (centre(from), centre(to));
        // Robots that are too near already are taken to stand where they are, until they have moved apart.
        let at = |positions: &[[f64; 2]], step: usize| {
            let step = if step < self.exempt_steps { 0 } else { step };
            positions[step.min(positions.len() - 1)]
        };
        let is_conflict = |positions: &[[f64; 2]]| {
            let gap = distance_m(after, at(positions, step + 1));
            if gap >= self.separation_cells {
                return false;
            }
            // Robots that are near each other may move apart.
            let gap_before = distance_m(before, at(positions, step));
            gap_before >= self.separation_cells || gap < gap_before - 1e-6
        };
        self.reserved.iter().find(|(_, positions)| is_conflict(positions)).map(|(robot, _)| *robot)
    }

    /// The static route by steps, with the turn at its start.
    fn static_route(&self) -> Vec<usize> {
        let routes = self.goal_map.routes();
        let mut cells = vec![self.start];
        if let Some(first) = routes.parent(self.map(), self.start) {
            let direction = (0..8).find(|d| self.map().neighbour(self.start, *d) == Some(first));
            let turn = direction.map_or(0, |direction| self.turn_steps[direction]);
            cells.extend(core::iter::repeat_n(self.start, turn));
        }
        while cells.len() <= WINDOW_STEPS {
            let last = cells[cells.len() - 1];
            cells.push(routes.parent(self.map(), last).unwrap_or(last));
        }
        cells.truncate(WINDOW_STEPS + 1);
        cells
    }

    fn state(&self, cell: usize, step: usize) -> Option<u32> {
        let (x, y) = self.map().column_row(cell);
        let (dx, dy) = (x - self.start_xy.0 + REACH, y - self.start_xy.1 + REACH);
        let is_inside = (0..SIDE).contains(&dx) && (0..SIDE).contains(&dy) && step <= WINDOW_STEPS;
        is_inside.then_some(((step as i64 * SIDE + dy) * SIDE + dx) as u32)
    }

    /// Marks the cells within the separation of a reserved position.
    fn mark_ways(&mut self) {
        self.on_way.clear();
        self.on_way.resize((SIDE * SIDE) as usize, false);
        let reach = self.separation_cells.ceil() as i64;
        let corner = [self.start_xy.0 - REACH, self.start_xy.1 - REACH].map(|v| v as f64);
        for [x, y] in self.reserved.iter().flat_map(|(_, positions)| positions) {
            let (x, y) = (x - corner[0], y - corner[1]);
            let rows = (y as i64 - reach).max(0)..=(y as i64 + reach).min(SIDE - 1);
            for row in rows {
                for column in (x as i64 - reach).max(0)..=(x as i64 + reach).min(SIDE - 1) {
                    let off = (column as f64 + 0.5 - x).hypot(row as f64 + 0.5 - y);
                    self.on_way[(row * SIDE + column) as usize] |= off < self.separation_cells;
                }
            }
        }
    }

    fn is_on_way(&self, state: u32) -> bool {
        self.on_way[state as usize % (SIDE * SIDE) as usize]
    }

    fn cell_step(&self, state: u32) -> (usize, usize) {
        let state = i64::from(state);
        let (step, dy, dx) = (state / (SIDE * SIDE), state / SIDE % SIDE, state % SIDE);
        let (x, y) = (self.start_xy.0 + dx - REACH, self.start_xy.1 + dy - REACH);
        ((y * self.map().width() + x) as usize, step as usize)
    }
}

impl CooperativeSearch {
    /// Finds the cheapest way through the window that keeps clear of the reservations.
    ///
    /// `intended_m`: where the last plan leads next.
    /// If there is none, it may come near the others at first; if there is none even so, the robot stands.
    pub(super) fn search(
        &mut self,
        goal_map: &GoalMap,
        map_from_base: Pose2,
        intended_m: Option<[f64; 2]>,
        separation_m: f64,
        reservations: &[Reservation],
    ) -> Option<TimedRoute> {
        let map = goal_map.map();
        let start = goal_map.start_cell([map_from_base.x_m, map_from_base.y_m])?;
        let in_cells = |reservation: &Reservation| {
            let positions = reservation.positions_m.iter().map(|at_m| map.in_cells(*at_m));
            (reservation.robot, positions.collect())
        };
        let turn_steps = turn_steps(map, start, map_from_base.yaw_rad);
        let mut problem = Problem {
            goal_map,
            start,
            start_xy: map.column_row(start),
            reserved: reservations.iter().map(in_cells).collect(),
            separation_cells: separation_m / map.cell_size_m(),
            turn_steps,
            exempt_steps: 0,
            on_way: Vec::new(),
            switch_cost: switch_cost(map, start, map_from_base, intended_m),
        };
        let cells = problem.static_route();
        let conflict = |(step, pair): (usize, &[usize])| problem.conflict(pair[0], pair[1], step);
        let Some(in_the_way) = cells.windows(2).enumerate().find_map(conflict) else {
            return Some(TimedRoute { cells, turn_steps, given_way_to: None, is_clear: true });
        };
        let given_way_to = Some(in_the_way);
        problem.mark_ways();
        if let Some(cells) = self.find(&problem) {
            return Some(TimedRoute { cells, turn_steps, given_way_to, is_clear: true });
        }
        problem.exempt_steps = EXEMPT_STEPS;
        let cells = self.find(&problem).unwrap_or_else(|| vec![start; WINDOW_STEPS + 1]);
        Some(TimedRoute { cells, turn_steps, given_way_to, is_clear: false })
    }

    fn find(&mut self, problem: &Problem) -> Option<Vec<usize>> {
        let states = (SIDE * SIDE) as usize * (WINDOW_STEPS + 1);
        self.reached_in.resize(states, 0);
        self.cost.resize(states, 0);
        self.came_by.resize(states, START);
        self.generation = self.generation.wrapping_add(1).max(1);
        self.queue.clear();
        let routes = problem.goal_map.routes();
        self.push(problem, (problem.start, 0), 0, START, routes.cost(problem.start)?);
        for _ in 0..EXPANSIONS_MAX {
            let Reverse((total, _, state)) = self.queue.pop()?;
            let (cell, step) = problem.cell_step(state);
            let cost = self.cost[state as usize];
            let to_go = routes.cost(cell)?;
            if cost + to_go < total {
                continue;
            }
            if step == WINDOW_STEPS {
                return Some(self.trace(problem, state));
            }
            let wait_cost = match to_go {
                0 => 0,
                _ if problem.is_on_way(state) => WAIT_ON_WAY_COST,
                _ => WAIT_COST,
            };
            if problem.conflict(cell, cell, step).is_none() {
                self.push(problem, (cell, step + 1), cost + wait_cost, WAIT, to_go);
            }
            self.expand(problem, cell, step, cost);
        }
        None
    }

    fn expand(&mut self, problem: &Problem, cell: usize, step: usize, cost: u32) {
        let (map, routes) = (problem.map(), problem.goal_map.routes());
        let from_passable = routes.is_passable(map, cell);
        for direction in 0..8 {
            let Some(next) = map.neighbour(cell, direction) else { return };
            let Some(to_go) = routes.cost(next) else { continue };
            let is_turning = cell == problem.start && step < problem.turn_steps[direction];
            let is_free = routes.is_passable(map, next) || !from_passable;
            if is_turning || !is_free || problem.conflict(cell, next, step).is_some() {
                continue;
            }
            let switch_cost = if cell == problem.start { problem.switch_cost[direction] } else { 0 };
            let step_cost = routes.step_cost(map, direction, next) + switch_cost;
            self.push(problem, (next, step + 1), cost + step_cost, direction as u8, to_go);
        }
    }

    fn push(&mut self, problem: &Problem, (cell, step): (usize, usize), cost: u32, by: u8, to_go: u32) {
        let Some(state) = problem.state(cell, step) else { return };
        let index = state as usize;
        if self.reached_in[index] == self.generation && self.cost[index] <= cost {
            return;
        }
        self.reached_in[index] = self.generation;
        (self.cost[index], self.came_by[index]) = (cost, by);
        // Of equal totals the latest step is expanded first.
        self.queue.push(Reverse((cost + to_go, (WINDOW_STEPS - step) as u32, state)));
    }

    fn trace(&self, problem: &Problem, end: u32) -> Vec<usize> {
        let (mut cell, mut step) = problem.cell_step(end);
        let mut cells = vec![cell];
        while step > 0 {
            let state = problem.state(cell, step).map_or(0, |state| state as usize);
            if let Some((dx, dy)) = NEIGHBOURS.get(usize::from(self.came_by[state])) {
                cell = (cell as i64 - dy * problem.map().width() - dx) as usize;
            }
            step -= 1;
            cells.push(cell);
        }
        cells.reverse();
        cells
    }
}

/// Cost of a first move in each direction that leads away from where the last plan led.
fn switch_cost(map: &ClearanceMap, start: usize, at: Pose2, intended_m: Option<[f64; 2]>) -> [u32; 8] {
    core::array::from_fn(|direction| {
        let Some((intended_m, next)) = intended_m.zip(map.neighbour(start, direction)) else { return 0 };
        let intended_rad = bearing_rad([at.x_m, at.y_m], intended_m);
        let bearing_rad = bearing_rad(map.cell_centre_m(start), map.cell_centre_m(next));
        let is_away = wrap_angle(bearing_rad - intended_rad).cos() < 0.0;
        if is_away { SWITCH_COST } else { 0 }
    })
}

/// Steps that turning on the spot takes before a move in each direction.
fn turn_steps(map: &ClearanceMap, start: usize, yaw_rad: f64) -> [usize; 8] {
    let step_s = map.cell_size_m() / PLANNED_SPEED_M_S;
    core::array::from_fn(|direction| {
        let Some(next) = map.neighbour(start, direction) else { return 0 };
        let bearing_rad = bearing_rad(map.cell_centre_m(start), map.cell_centre_m(next));
        let turn_rad = wrap_angle(bearing_rad - yaw_rad).abs();
        if turn_rad < CURVE_RAD { 0 } else { (turn_rad / PLANNED_TURN_RAD_S / step_s).ceil() as usize }
    })
}

impl TimedRoute {
    /// Number of leading cells to drive, and whether the robot then waits or turns back for another one.
    pub(super) fn first_stretch(&self, goal_map: &GoalMap) -> (usize, bool) {
        let (map, cells) = (goal_map.map(), &self.cells);
        let waits_at = |i: usize| (i + 1, goal_map.routes().cost(cells[i]) != Some(0));
        let Some(first_move) = cells.iter().position(|cell| *cell != cells[0]) else { return waits_at(0) };
        // A turn at the start takes time, and is no waiting.
        let direction = (0..8).find(|d| map.neighbour(cells[0], *d) == Some(cells[first_move]));
        if direction.is_none_or(|direction| first_move > self.turn_steps[direction] + LATE_STEPS) {
            return waits_at(0);
        }
        let step = |i: usize| {
            let ((ax, ay), (bx, by)) = (map.column_row(cells[i]), map.column_row(cells[i + 1]));
            (bx - ax, by - ay)
        };
        let mut last = step(first_move - 1);
        for i in first_move..cells.len() - 1 {
            let (dx, dy) = step(i);
            let waits = (dx, dy) == (0, 0) && i + 2 < cells.len() && step(i + 1) == (0, 0);
            let turns_back = dx * last.0 + dy * last.1 < 0;
            if waits || turns_back {
                return waits_at(i);
            }
            if (dx, dy) != (0, 0) {
                last = (dx, dy);
            }
        }
        (cells.len(), false)
    }
}
