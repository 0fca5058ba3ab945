//! Coarse routes between viewpoints: Dijkstra's algorithm on squares of 0.2 m with a cell that robots reach.

use crate::clearance_map::{ClearanceMap, NEIGHBOURS};
use std::collections::BinaryHeap;

/// Side of a square, cells of the clearance map: 0.2 m at 0.05 m. Walls with a robot's clearance are wider.
const SQUARE_CELLS: i64 = 4;
/// Farthest that a robot may stand from the nearest square where it fits, squares: 0.6 m.
const SNAP_SQUARES: i64 = 3;
/// Length of a step to a straight and to a diagonal neighbour, tenths of a square.
const STEP_LENGTHS: [u32; 2] = [10, 14];
/// Most by which a step in the narrowest space costs more, as a factor: robots slow down there.
const NARROW_FACTOR: u32 = 2;
/// Clearance from which a step costs no more, metres.
const WIDE_CLEARANCE_M: f64 = 0.3;
/// Cost of a square that was not reached.
pub(super) const UNREACHED: u32 = u32::MAX;

/// Squares of the clearance map in which a robot fits.
#[derive(Clone, Debug, Default)]
pub(super) struct CoarseMap {
    width: i64,
    height: i64,
    square_m: f64,
    fine_width: i64,
    /// Cost factor of each square; 0 where no robot fits.
    factor: Vec<u8>,
    queue: BinaryHeap<core::cmp::Reverse<(u32, u32)>>,
}

impl CoarseMap {
    /// Reads the squares of a clearance map: those with cells that robots reach.
    pub(super) fn update(&mut self, map: &ClearanceMap, is_reached: impl Fn(usize) -> bool) {
        self.fine_width = map.width();
        let fine_height = map.cell_count() as i64 / map.width().max(1);
        self.width = (map.width() + SQUARE_CELLS - 1) / SQUARE_CELLS;
        self.height = (fine_height + SQUARE_CELLS - 1) / SQUARE_CELLS;
        self.square_m = map.cell_size_m() * SQUARE_CELLS as f64;
        self.factor.clear();
        self.factor.resize((self.width * self.height) as usize, 0);
        for cell in (0..map.cell_count()).filter(|cell| is_reached(*cell)) {
            let factor = if map.clearance_m(cell) < WIDE_CLEARANCE_M { NARROW_FACTOR as u8 } else { 1 };
            let square = &mut self.factor[Self::square(self.width, self.fine_width, cell)];
            *square = if *square == 0 { factor } else { factor.min(*square) };
        }
    }

    /// Square that contains a cell of the clearance map.
    pub(super) fn square_of(&self, cell: usize) -> usize {
        Self::square(self.width, self.fine_width, cell)
    }

    fn square(width: i64, fine_width: i64, cell: usize) -> usize {
        let (x, y) = (cell as i64 % fine_width, cell as i64 / fine_width);
        (y / SQUARE_CELLS * width + x / SQUARE_CELLS) as usize
    }

    /// Nearest square to `from` in which a robot fits, within 0.6 m.
    pub(super) fn nearest_passable(&self, from: usize) -> Option<usize> {
        let (x, y) = (from as i64 % self.width, from as i64 / self.width);
        let offsets = (-SNAP_SQUARES..=SNAP_SQUARES)
            .flat_map(|dy| (-SNAP_SQUARES..=SNAP_SQUARES).map(move |dx| (dx, dy)));
        offsets
            .filter_map(|(dx, dy)| {
                let (u, v) = (x + dx, y + dy);
                let is_inside = u >= 0 && v >= 0 && u < self.width && v < self.height;
                let square = is_inside.then_some((v * self.width + u) as usize)?;
                (self.factor[square] > 0).then_some((dx * dx + dy * dy, square))
            })
            .min()
            .map(|(_, square)| square)
    }

    /// Writes the cost of the route from a square to each other into `costs`, in tenths of a square.
    pub(super) fn search_from(&mut self, start: usize, costs: &mut Vec<u32>) {
        costs.clear();
        costs.resize(self.factor.len(), UNREACHED);
        self.queue.clear();
        costs[start] = 0;
        self.queue.push(core::cmp::Reverse((0, start as u32)));
        while let Some(core::cmp::Reverse((cost, square))) = self.queue.pop() {
            if costs[square as usize] != cost {
                continue;
            }
            let (x, y) = (i64::from(square) % self.width, i64::from(square) / self.width);
            for (direction, (dx, dy)) in NEIGHBOURS.into_iter().enumerate() {
                let (u, v) = (x + dx, y + dy);
                if u < 0 || v < 0 || u >= self.width || v >= self.height {
                    continue;
                }
                let next = (v * self.width + u) as usize;
                let factor = u32::from(self.factor[next]);
                let next_cost = cost + STEP_LENGTHS[direction % 2] * factor;
                if factor > 0 && next_cost < costs[next] {
                    costs[next] = next_cost;
                    self.queue.push(core::cmp::Reverse((next_cost, next as u32)));
                }
            }
        }
    }

    /// Length that a cost stands for, metres; `None` if unreached.
    pub(super) fn length_m(&self, cost: u32) -> Option<f64> {
        (cost != UNREACHED).then(|| f64::from(cost) / f64::from(STEP_LENGTHS[0]) * self.square_m)
    }
}
