//! Search for the cheapest route from a robot to every cell that it can reach.
//!
//! Dijkstra's algorithm with a bucket queue (Dial 1969), so that its time is linear in the window's cells.

use crate::clearance_map::{ClearanceMap, NEIGHBOURS};
use msg::grid::Occupancy;
use std::collections::VecDeque;

/// Length of a step to a straight neighbour, in tenths of a cell.
const STRAIGHT_LENGTH: u32 = 10;
/// Length of a step to a diagonal neighbour, in tenths of a cell.
const DIAGONAL_LENGTH: u32 = 14;
/// Cost of a tenth of a cell in open space; an integer above 1, so that the cost can rise in fine steps.
const OPEN_COST: u32 = 4;
/// Cost added to a tenth of a cell where the robot just fits: four times as dear, so that it keeps to open space.
const NARROW_COST: u32 = 12;
/// Cost of a straight step in open space: what one cell of the cost in metres stands for.
pub(crate) const STRAIGHT_COST: u32 = STRAIGHT_LENGTH * OPEN_COST;
/// Highest cost of a step: diagonal, with no clearance to spare. Bounds the number of buckets.
const STEP_COST_MAX: u32 = DIAGONAL_LENGTH * (OPEN_COST + NARROW_COST);
/// Clearance from which a step costs no more, metres: about two body widths of a Burger.
const COMFORTABLE_CLEARANCE_M: f64 = 0.35;
/// Smallest difference of clearances over which the cost rises, metres: no division by zero for large robots.
const COST_RAMP_MIN_M: f64 = 0.01;
/// Farthest that a robot may stand from the nearest passable cell and still start there, metres: a robot that a
/// person has pushed against a chair, or whose pose is some centimetres off.
const START_SNAP_MAX_M: f64 = 0.4;
const UNREACHED: u32 = u32::MAX;
const NO_PARENT: u8 = u8::MAX;

/// Tree of cheapest routes from one start.
///
/// Cells where the robot fits are *passable*. Free cells that are too narrow for it are reached too, but lead only
/// to other narrow ones: their surroundings can be looked at, not driven to.
#[derive(Clone, Debug, Default)]
pub struct RouteSearch {
    cost: Vec<u32>,
    /// Direction index from the parent to the cell.
    parent_direction: Vec<u8>,
    buckets: Vec<Vec<usize>>,
    reached: Vec<usize>,
    clearance_min_m: f64,
}

impl RouteSearch {
    /// Searches from `start_m`, a point of the map's frame, for a robot that needs a clearance of `clearance_min_m`.
    ///
    /// Returns false if no passable cell lies within 0.4 m of the start.
    pub fn search_from(&mut self, map: &ClearanceMap, start_m: [f64; 2], clearance_min_m: f64) -> bool {
        self.search(map, start_m, clearance_min_m, None)
    }

    /// Searches as [`RouteSearch::search_from`], and ends soon after it has reached a cell.
    ///
    /// Cells that cost up to `beyond_m` more than `until` are reached too. If `until` cannot be reached, all cells
    /// that can be are.
    pub(crate) fn search_until(
        &mut self,
        map: &ClearanceMap,
        start_m: [f64; 2],
        clearance_min_m: f64,
        (until, beyond_m): (usize, f64),
    ) -> bool {
        let beyond = beyond_m / map.cell_size_m() * f64::from(STRAIGHT_COST);
        self.search(map, start_m, clearance_min_m, Some((until, beyond as u32)))
    }

    fn search(
        &mut self,
        map: &ClearanceMap,
        start_m: [f64; 2],
        clearance_min_m: f64,
        until: Option<(usize, u32)>,
    ) -> bool {
        self.clearance_min_m = clearance_min_m;
        self.cost.clear();
        self.cost.resize(map.cell_count(), UNREACHED);
        self.parent_direction.clear();
        self.parent_direction.resize(map.cell_count(), NO_PARENT);
        self.buckets.resize(STEP_COST_MAX as usize + 1, Vec::new());
        self.buckets.iter_mut().for_each(Vec::clear);
        self.reached.clear();
        let Some(start) = self.nearest_passable(map, start_m) else { return false };
        self.cost[start] = 0;
        self.buckets[0].push(start);
        self.drain_buckets(map, until);
        true
    }

    /// Cost of the route to a cell, in fortieths of a straight step in open space. `None` if it was not reached.
    pub(crate) fn cost(&self, cell: usize) -> Option<u32> {
        self.cost.get(cell).copied().filter(|cost| *cost != UNREACHED)
    }

    /// The cell before a reached one on its route; `None` at the start.
    pub(crate) fn parent(&self, map: &ClearanceMap, cell: usize) -> Option<usize> {
        let (dx, dy) = NEIGHBOURS.get(usize::from(*self.parent_direction.get(cell)?))?;
        Some((cell as i64 - dy * map.width() - dx) as usize)
    }

    /// Cost of a step into a cell, in the unit of [`RouteSearch::cost`].
    pub(crate) fn step_cost(&self, map: &ClearanceMap, direction: usize, next: usize) -> u32 {
        step_cost(direction, map.clearance_m(next), self.clearance_min_m)
    }

    /// All cells reached, cheapest first.
    pub fn reached_cells(&self) -> &[usize] {
        &self.reached
    }

    /// Whether the robot fits at a cell.
    pub fn is_passable(&self, map: &ClearanceMap, cell: usize) -> bool {
        map.occupancy(cell) == Occupancy::Free && map.clearance_m(cell) >= self.clearance_min_m
    }

    /// Cost of the route to a cell, in metres of driving in open space. `None` if the cell was not reached.
    pub fn cost_m(&self, map: &ClearanceMap, cell: usize) -> Option<f64> {
        let cost = *self.cost.get(cell)?;
        (cost != UNREACHED).then(|| f64::from(cost) / f64::from(STRAIGHT_COST) * map.cell_size_m())
    }

    /// Writes the cells of the route to a reached cell into `route`, start and end included.
    pub fn route_to(&self, map: &ClearanceMap, to: usize, route: &mut Vec<usize>) {
        route.clear();
        let mut cell = to;
        route.push(cell);
        while self.parent_direction[cell] != NO_PARENT && route.len() < self.reached.len() {
            let (dx, dy) = NEIGHBOURS[usize::from(self.parent_direction[cell])];
            cell = (cell as i64 - dy * map.width() - dx) as usize;
            route.push(cell);
        }
        route.reverse();
    }

    /// The passable cell nearest to the start by a route that crosses no obstacle.
    fn nearest_passable(&mut self, map: &ClearanceMap, start_m: [f64; 2]) -> Option<usize> {
        let start = map.cell_at(start_m)?;
        let steps_max = (START_SNAP_MAX_M / map.cell_size_m()).ceil() as i64;
        let mut queue = VecDeque::from([(start, 0)]);
        let mut visited = vec![start];
        while let Some((cell, steps)) = queue.pop_front() {
            if self.is_passable(map, cell) {
                return Some(cell);
            }
            if steps == steps_max {
                continue;
            }
            for next in (0..8).filter_map(|direction| map.neighbour(cell, direction)) {
                if map.occupancy(next) != Occupancy::Occupied && !visited.contains(&next) {
                    visited.push(next);
                    queue.push_back((next, steps + 1));
                }
            }
        }
        None
    }

    fn drain_buckets(&mut self, map: &ClearanceMap, until: Option<(usize, u32)>) {
        let buckets = self.buckets.len() as u32;
        let (mut cost, mut empty_in_a_row, mut cost_max) = (0_u32, 0, UNREACHED);
        while empty_in_a_row < buckets && cost <= cost_max {
            let Some(cell) = self.buckets[(cost % buckets) as usize].pop() else {
                cost += 1;
                empty_in_a_row += 1;
                continue;
            };
            empty_in_a_row = 0;
            // An entry is stale if a cheaper route to its cell was found later.
            if self.cost[cell] == cost {
                self.reached.push(cell);
                if let Some((_, beyond)) = until.filter(|(until, _)| *until == cell) {
                    cost_max = cost.saturating_add(beyond);
                }
                self.expand(map, cell, cost);
            }
        }
    }

    fn expand(&mut self, map: &ClearanceMap, cell: usize, cost: u32) {
        let from_passable = self.is_passable(map, cell);
        for direction in 0..8 {
            let Some(next) = map.neighbour(cell, direction) else { return };
            if map.occupancy(next) != Occupancy::Free || (!from_passable && self.is_passable(map, next)) {
                continue;
            }
            let next_cost = cost + step_cost(direction, map.clearance_m(next), self.clearance_min_m);
            if next_cost < self.cost[next] {
                self.cost[next] = next_cost;
                self.parent_direction[next] = direction as u8;
                let bucket = next_cost as usize % self.buckets.len();
                self.buckets[bucket].push(next);
            }
        }
    }
}

/// Cost of a step; it falls linearly from where the robot just fits to a comfortable clearance.
fn step_cost(direction: usize, clearance_m: f64, clearance_min_m: f64) -> u32 {
    let length = if direction.is_multiple_of(2) { STRAIGHT_LENGTH } else { DIAGONAL_LENGTH };
    let ramp_m = (COMFORTABLE_CLEARANCE_M - clearance_min_m).max(COST_RAMP_MIN_M);
    let narrowness = ((COMFORTABLE_CLEARANCE_M - clearance_m) / ramp_m).clamp(0.0, 1.0);
    length * (OPEN_COST + (narrowness * f64::from(NARROW_COST)) as u32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observation::MapView;
    use msg::Pose2;
    use proptest::prelude::*;

    /// Free space of 2 m by 2 m with a wall along one column that has one gap.
    fn map_with_wall(wall_column: usize, gap_row: usize, gap: usize) -> ClearanceMap {
        let mut cells = vec![0_i8; 1600];
        for row in (0..40).filter(|row| !(gap_row..gap_row + gap).contains(row)) {
            cells[row * 40 + wall_column] = 100;
        }
        let view = MapView::from_percent(Pose2::IDENTITY, 0.05, (40, 40), &cells).unwrap();
        let mut map = ClearanceMap::default();
        map.copy_window(&view, [1.0, 1.0]);
        map.compute_clearance();
        map
    }

    proptest! {
        #[test]
        fn routes_are_connected_and_keep_the_clearance(column in 12..28_usize, row in 0..30_usize, gap in 0..10_usize) {
            let map = map_with_wall(column, row, gap);
            let mut routes = RouteSearch::default();
            prop_assert!(routes.search_from(&map, [0.2, 0.2], 0.15));
            let mut route = Vec::new();
            for goal in routes.reached_cells().to_vec() {
                routes.route_to(&map, goal, &mut route);
                let narrow = route.iter().position(|cell| !routes.is_passable(&map, *cell)).unwrap_or(route.len());
                prop_assert!(route[narrow..].iter().all(|cell| !routes.is_passable(&map, *cell)));
                for pair in route.windows(2) {
                    prop_assert!((0..8).any(|d| map.neighbour(pair[0], d) == Some(pair[1])));
                }
            }
            // A clearance of 0.15 m is three cells to each side: a gap needs five cells, or three at the edge of the
            // map, beyond which nothing is known to stand.
            let beyond = map.cell_at([1.9, 1.0]).unwrap();
            let at_edge = row == 0;
            let reached = routes.cost_m(&map, beyond).is_some() && routes.is_passable(&map, beyond);
            prop_assert_eq!(reached, gap >= 5 || (at_edge && gap >= 3), "gap {}", gap);
        }
    }

    #[test]
    fn a_robot_against_a_wall_finds_a_passable_cell_beside_it() {
        let map = map_with_wall(20, 0, 0);
        let mut routes = RouteSearch::default();
        assert!(routes.search_from(&map, [0.95, 1.0], 0.15));
        assert!(routes.cost_m(&map, map.cell_at([0.2, 0.2]).unwrap()).is_some());
        assert!(routes.cost_m(&map, map.cell_at([1.5, 1.0]).unwrap()).is_none());
    }
}
