//! Unknown space beside known free space that the fleet leaves, and why.

use super::growth::Exhaustion;
use super::plan::PlanBuffers;
use super::seen::UnseenCells;
use crate::clearance_map::ClearanceMap;
use msg::LeftoverReason;
use msg::grid::Occupancy;

/// Fewest cells of a leftover: fewer are noise of the map, as for frontiers.
const CELLS_MIN: usize = 5;
/// Most leftovers that are returned, largest first.
const LEFTOVERS_MAX: usize = 64;
/// Directions of the four cells beside one, see [`ClearanceMap::neighbour`].
const SIDES: [usize; 4] = [0, 2, 4, 6];

/// A frontier that is left at the end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leftover {
    /// A free cell in it, in the map, metres.
    pub position_m: [f64; 2],
    /// Its length, metres.
    pub length_m: f64,
    /// Area of the unknown space behind it, square metres; `None` if known space does not enclose it.
    pub area_m2: Option<f64>,
    /// Why no robot goes there.
    pub reason: LeftoverReason,
}

/// Finds the frontiers of a map, largest first.
pub(super) fn find(
    map: &ClearanceMap,
    buffers: &PlanBuffers,
    unseen: &UnseenCells,
    exhaustion: Option<Exhaustion>,
    clearance_min_m: f64,
) -> Vec<Leftover> {
    let mut is_open: Vec<bool> = (0..map.cell_count())
        .map(|cell| map.occupancy(cell) == Occupancy::Free && unknown_beside(map, cell).is_some())
        .collect();
    let mut found = Vec::new();
    let mut cells = Vec::new();
    let mut areas = UnknownAreas::new(map);
    for seed in 0..map.cell_count() {
        if !is_open[seed] {
            continue;
        }
        collect(map, seed, &mut is_open, &mut cells);
        if cells.len() < CELLS_MIN {
            continue;
        }
        let middle = cells[cells.len() / 2];
        let is_given_up = |cell: &usize| {
            unknown_beside(map, *cell).is_some_and(|unknown| unseen.is_given_up(map.cell_centre_m(unknown)))
        };
        let was_looked_at = |cell: &usize| {
            unknown_beside(map, *cell).is_some_and(|unknown| unseen.has_looked(map.cell_centre_m(unknown)))
        };
        let is_reached = |cell: &usize| buffers.is_reached(*cell);
        let leads_to_floor = |cell: &usize| {
            unknown_beside(map, *cell).is_some_and(|unknown| buffers.floor.is_possible(unknown))
        };
        let fits = |cell: &usize| map.clearance_m(*cell) >= clearance_min_m;
        let reason = if cells.iter().filter(|cell| is_given_up(cell)).count() * 2 > cells.len() {
            if cells.iter().any(was_looked_at) {
                LeftoverReason::NotVisible
            } else {
                LeftoverReason::Unreachable
            }
        } else if !cells.iter().any(fits) {
            LeftoverReason::TooNarrow
        } else if !cells.iter().any(is_reached) {
            LeftoverReason::Unreachable
        } else if !cells.iter().any(leads_to_floor) {
            LeftoverReason::TooNarrow
        } else {
            reason_of_rest(exhaustion)
        };
        let length_m = cells.len() as f64 * map.cell_size_m();
        let unknown = cells.iter().find_map(|cell| unknown_beside(map, *cell));
        let area_m2 = unknown.and_then(|cell| areas.enclosed_m2(map, cell));
        found.push(Leftover { position_m: map.cell_centre_m(middle), length_m, area_m2, reason });
    }
    found.sort_by(|a, b| b.length_m.total_cmp(&a.length_m));
    found.truncate(LEFTOVERS_MAX);
    found
}

/// Why what robots could reach and see is left.
fn reason_of_rest(exhaustion: Option<Exhaustion>) -> LeftoverReason {
    match exhaustion {
        Some(Exhaustion::Attempts) => LeftoverReason::NotVisible,
        Some(Exhaustion::Time) => LeftoverReason::TookTooLong,
        None => LeftoverReason::TooSmall,
    }
}

/// Collects the open cells connected with `seed` and takes them out of the set.
fn collect(map: &ClearanceMap, seed: usize, is_open: &mut [bool], cells: &mut Vec<usize>) {
    cells.clear();
    cells.push(seed);
    is_open[seed] = false;
    let mut next = 0;
    while next < cells.len() {
        let cell = cells[next];
        for neighbour in (0..8).filter_map(|direction| map.neighbour(cell, direction)) {
            if core::mem::take(&mut is_open[neighbour]) {
                cells.push(neighbour);
            }
        }
        next += 1;
    }
}

/// Areas of connected unknown cells, each counted once.
struct UnknownAreas {
    /// Number of the area that a cell is part of, from 1; 0 if it is not counted yet.
    area_of: Vec<u32>,
    /// Enclosed area, square metres, by number minus 1.
    areas_m2: Vec<Option<f64>>,
    stack: Vec<usize>,
}

impl UnknownAreas {
    fn new(map: &ClearanceMap) -> Self {
        Self { area_of: vec![0; map.cell_count()], areas_m2: Vec::new(), stack: Vec::new() }
    }

    /// Area of the unknown cells connected with one, square metres; `None` if they reach the edge of the map.
    fn enclosed_m2(&mut self, map: &ClearanceMap, cell: usize) -> Option<f64> {
        if self.area_of[cell] == 0 {
            let area_m2 = self.count(map, cell);
            self.areas_m2.push(area_m2);
        }
        self.areas_m2[self.area_of[cell] as usize - 1]
    }

    fn count(&mut self, map: &ClearanceMap, seed: usize) -> Option<f64> {
        let number = self.areas_m2.len() as u32 + 1;
        let (mut count, mut is_enclosed) = (0_u32, true);
        self.area_of[seed] = number;
        self.stack.push(seed);
        while let Some(cell) = self.stack.pop() {
            count += 1;
            for direction in SIDES {
                let Some(side) = map.neighbour(cell, direction) else {
                    is_enclosed = false;
                    continue;
                };
                if map.occupancy(side) == Occupancy::Unknown && self.area_of[side] == 0 {
                    self.area_of[side] = number;
                    self.stack.push(side);
                }
            }
        }
        is_enclosed.then(|| f64::from(count) * map.cell_size_m().powi(2))
    }
}

fn unknown_beside(map: &ClearanceMap, cell: usize) -> Option<usize> {
    let sides = SIDES.into_iter().filter_map(|direction| map.neighbour(cell, direction));
    sides.into_iter().find(|side| map.occupancy(*side) == Occupancy::Unknown)
}
