//! Ways over the floor: the cheapest way from the robot to every cell it fits on, by Dial's bucket queue
//! (Dial 1969), so that a plan's time is linear in the window's cells.

use crate::floor::{Floor, NEIGHBOURS};
use msg::grid::Occupancy;
use std::collections::VecDeque;

/// Cost of a step to a straight neighbour with plenty of room; a diagonal one costs 1.4 times as much.
const STRAIGHT: u32 = 40;
/// Closer to obstacles than this, a step costs more, metres.
const COMFORT_M: f64 = 0.35;
/// The most a step can cost: diagonal, with no room to spare.
const STEP_MAX: u32 = 14 * 16;
/// How far a robot may stand from the nearest cell it fits on and still find its way there, metres.
const ESCAPE_M: f64 = 0.4;
const UNREACHED: u32 = u32::MAX;
const NO_PARENT: u8 = u8::MAX;

/// Ways from one start. Cells where the robot fits are *open*; free cells too narrow for it are reached too, but
/// lead nowhere except to other narrow ones: what lies in them can be looked at, not driven to.
#[derive(Clone, Debug, Default)]
pub struct Routes {
    cost: Vec<u32>,
    /// Direction index from the parent to the cell.
    came_by: Vec<u8>,
    buckets: Vec<Vec<usize>>,
    reached: Vec<usize>,
    open_clearance_m: f64,
}

impl Routes {
    /// Finds the ways from `start_m` for a robot that fits where the clearance is at least `open_clearance_m`.
    /// False if it stands too far from any such place.
    pub fn spread(&mut self, floor: &Floor, start_m: [f64; 2], open_clearance_m: f64) -> bool {
        self.open_clearance_m = open_clearance_m;
        self.cost.clear();
        self.cost.resize(floor.known().len(), UNREACHED);
        self.came_by.clear();
        self.came_by.resize(floor.known().len(), NO_PARENT);
        self.buckets.resize(STEP_MAX as usize + 1, Vec::new());
        self.buckets.iter_mut().for_each(Vec::clear);
        self.reached.clear();
        let Some(start) = self.nearest_open(floor, start_m) else { return false };
        self.cost[start] = 0;
        self.buckets[0].push(start);
        self.drain_buckets(floor);
        true
    }

    /// Every reached cell, cheapest first.
    pub fn reached(&self) -> &[usize] {
        &self.reached
    }

    /// Whether the robot fits there.
    pub fn is_open(&self, floor: &Floor, cell: usize) -> bool {
        floor.known()[cell] == Occupancy::Free && floor.clearance_m(cell) >= self.open_clearance_m
    }

    /// The cost of the way to a reached cell, in metres of free driving.
    pub fn cost_m(&self, floor: &Floor, cell: usize) -> Option<f64> {
        let cost = *self.cost.get(cell)?;
        (cost != UNREACHED).then(|| f64::from(cost) / f64::from(STRAIGHT) * floor.cell_m())
    }

    /// The way from the start to a reached cell, both included.
    pub fn way(&self, floor: &Floor, to: usize, way: &mut Vec<usize>) {
        way.clear();
        let mut cell = to;
        way.push(cell);
        while self.came_by[cell] != NO_PARENT && way.len() < self.reached.len() {
            let (dx, dy) = NEIGHBOURS[usize::from(self.came_by[cell])];
            cell = (cell as i64 - dy * floor.width() - dx) as usize;
            way.push(cell);
        }
        way.reverse();
    }

    /// The open cell nearest by a way that crosses no obstacle. A robot nudged against a chair, or placed there by a
    /// pose some centimetres off, starts from it.
    fn nearest_open(&mut self, floor: &Floor, start_m: [f64; 2]) -> Option<usize> {
        let start = floor.cell_of(start_m)?;
        let steps_max = (ESCAPE_M / floor.cell_m()).ceil() as i64;
        let mut queue = VecDeque::from([(start, 0)]);
        let mut tried = vec![start];
        while let Some((cell, steps)) = queue.pop_front() {
            if self.is_open(floor, cell) {
                return Some(cell);
            }
            if steps == steps_max {
                continue;
            }
            for next in (0..8).filter_map(|direction| floor.neighbour(cell, direction)) {
                if floor.known()[next] != Occupancy::Occupied && !tried.contains(&next) {
                    tried.push(next);
                    queue.push_back((next, steps + 1));
                }
            }
        }
        None
    }

    fn drain_buckets(&mut self, floor: &Floor) {
        let buckets = self.buckets.len() as u32;
        let (mut now, mut empty_in_a_row) = (0_u32, 0);
        while empty_in_a_row < buckets {
            let Some(cell) = self.buckets[(now % buckets) as usize].pop() else {
                now += 1;
                empty_in_a_row += 1;
                continue;
            };
            empty_in_a_row = 0;
            // A cheaper way was found after this entry was made.
            if self.cost[cell] == now {
                self.reached.push(cell);
                self.expand(floor, cell, now);
            }
        }
    }

    fn expand(&mut self, floor: &Floor, cell: usize, cost: u32) {
        let from_open = self.is_open(floor, cell);
        for direction in 0..8 {
            let Some(next) = floor.neighbour(cell, direction) else { return };
            if floor.known()[next] != Occupancy::Free || (!from_open && self.is_open(floor, next)) {
                continue;
            }
            let reached = cost + step_cost(direction, floor.clearance_m(next), self.open_clearance_m);
            if reached < self.cost[next] {
                self.cost[next] = reached;
                self.came_by[next] = direction as u8;
                let bucket = reached as usize % self.buckets.len();
                self.buckets[bucket].push(next);
            }
        }
    }
}

/// Four times as dear without room to spare as with comfort, linearly between.
fn step_cost(direction: usize, clearance_m: f64, open_clearance_m: f64) -> u32 {
    let length = if direction.is_multiple_of(2) { STRAIGHT / 4 } else { STRAIGHT / 4 * 14 / 10 };
    let lack = ((COMFORT_M - clearance_m) / (COMFORT_M - open_clearance_m).max(0.01)).clamp(0.0, 1.0);
    length * (4 + (lack * 12.0) as u32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sight::MapView;
    use msg::Pose2;
    use proptest::prelude::*;

    /// Free 2 m x 2 m with a random half-wall; checks each way found.
    fn floor(wall_column: usize, gap_row: usize, gap: usize) -> Floor {
        let mut cells = vec![0_i8; 1600];
        for row in (0..40).filter(|row| !(gap_row..gap_row + gap).contains(row)) {
            cells[row * 40 + wall_column] = 100;
        }
        let map = MapView::percent(Pose2::IDENTITY, 0.05, (40, 40), &cells).unwrap();
        let mut floor = Floor::default();
        floor.survey(&map, [1.0, 1.0]);
        floor.measure_clearance();
        floor
    }

    proptest! {
        #[test]
        fn ways_are_connected_and_keep_their_distance(column in 12..28_usize, row in 0..30_usize, gap in 0..10_usize) {
            let floor = floor(column, row, gap);
            let mut routes = Routes::default();
            prop_assert!(routes.spread(&floor, [0.2, 0.2], 0.15));
            let mut way = Vec::new();
            for goal in routes.reached().to_vec() {
                routes.way(&floor, goal, &mut way);
                let narrow = way.iter().position(|cell| !routes.is_open(&floor, *cell)).unwrap_or(way.len());
                prop_assert!(way[narrow..].iter().all(|cell| !routes.is_open(&floor, *cell)));
                for pair in way.windows(2) {
                    prop_assert!((0..8).any(|d| floor.neighbour(pair[0], d) == Some(pair[1])));
                }
            }
            // Three cells to each side of the way: a gap of five is the first that lets it through, one of two at
            // the edge of the map, where nothing else is known to stand.
            let beyond = floor.cell_of([1.9, 1.0]).unwrap();
            let at_edge = row == 0;
            let reached = routes.cost_m(&floor, beyond).is_some() && routes.is_open(&floor, beyond);
            prop_assert_eq!(reached, gap >= 5 || (at_edge && gap >= 3), "gap {}", gap);
        }
    }

    #[test]
    fn a_robot_against_a_wall_finds_its_way_out() {
        let floor = floor(20, 0, 0);
        let mut routes = Routes::default();
        assert!(routes.spread(&floor, [0.95, 1.0], 0.15));
        assert!(routes.cost_m(&floor, floor.cell_of([0.2, 0.2]).unwrap()).is_some());
        assert!(routes.cost_m(&floor, floor.cell_of([1.5, 1.0]).unwrap()).is_none());
    }
}
