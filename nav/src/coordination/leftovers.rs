//! Unknown space beside known free space that the fleet leaves, and why.

use super::plan::PlanBuffers;
use super::seen::UnseenCells;
use crate::clearance_map::ClearanceMap;
use msg::grid::Occupancy;

/// Fewest cells of a leftover: fewer are noise of the map, as for frontiers.
const CELLS_MIN: usize = 5;
/// Most leftovers that are returned, largest first.
const LEFTOVERS_MAX: usize = 64;

/// Reason why a frontier is left.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum LeftoverReason {
    /// Robots looked there twice in vain.
    NotVisible,
    /// It lies where a robot does not fit, and is not seen from elsewhere.
    TooNarrow,
    /// Obstacles or excluded areas lie between it and all robots.
    Unreachable,
    /// What is expected behind it is not worth a look.
    TooSmall,
}

impl core::fmt::Display for LeftoverReason {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::NotVisible => "looked at twice, and nothing was seen",
            Self::TooNarrow => "too narrow for a robot",
            Self::Unreachable => "cut off from all robots",
            Self::TooSmall => "too small to be worth a look",
        })
    }
}

/// A frontier that is left at the end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leftover {
    /// A free cell in it, in the map, metres.
    pub position_m: [f64; 2],
    /// Its length, metres.
    pub length_m: f64,
    /// Why no robot goes there.
    pub reason: LeftoverReason,
}

/// Finds the frontiers of a map, largest first.
pub(super) fn find(
    map: &ClearanceMap,
    buffers: &PlanBuffers,
    unseen: &UnseenCells,
    clearance_min_m: f64,
) -> Vec<Leftover> {
    let mut is_open: Vec<bool> = (0..map.cell_count())
        .map(|cell| map.occupancy(cell) == Occupancy::Free && unknown_beside(map, cell).is_some())
        .collect();
    let mut found = Vec::new();
    let mut cells = Vec::new();
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
        let is_reached = |cell: &usize| buffers.is_reached(*cell);
        let fits = |cell: &usize| map.clearance_m(*cell) >= clearance_min_m;
        let reason = if cells.iter().filter(|cell| is_given_up(cell)).count() * 2 > cells.len() {
            LeftoverReason::NotVisible
        } else if !cells.iter().any(fits) {
            LeftoverReason::TooNarrow
        } else if !cells.iter().any(is_reached) {
            LeftoverReason::Unreachable
        } else {
            LeftoverReason::TooSmall
        };
        let length_m = cells.len() as f64 * map.cell_size_m();
        found.push(Leftover { position_m: map.cell_centre_m(middle), length_m, reason });
    }
    found.sort_by(|a, b| b.length_m.total_cmp(&a.length_m));
    found.truncate(LEFTOVERS_MAX);
    found
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

fn unknown_beside(map: &ClearanceMap, cell: usize) -> Option<usize> {
    let sides = [0, 2, 4, 6].into_iter().filter_map(|direction| map.neighbour(cell, direction));
    sides.into_iter().find(|side| map.occupancy(*side) == Occupancy::Unknown)
}
