//! Floor that the fleet reaches, and that it may still reach: what a robot's body could cover if all unknown space were free.
//!
//! A wall that SLAM has drawn has gaps of a cell or two, and unknown space shows through them. No robot fits there, so
//! that what lies behind is no reason to look: it is seen through a door, or it is outside of the building.

use crate::clearance_map::{ClearanceMap, NEIGHBOURS};
use crate::config::RobotBody;
use crate::navigation::START_SNAP_MAX_M;
use msg::grid::Occupancy;

/// Cells that robots reach, and that they could cover, in buffers that it keeps.
#[derive(Clone, Debug, Default)]
pub(super) struct Floor {
    /// Known cells where the centre of a robot can be that is there or drives there.
    is_reached: Vec<bool>,
    /// Cells where it could be if unknown space is free.
    is_centre: Vec<bool>,
    /// Cells that its body with its margin could cover then.
    is_covered: Vec<bool>,
    stack: Vec<usize>,
}

impl Floor {
    /// Computes the floor for robots of a size that need a clearance and stand at `places_m`; their centres keep out of what
    /// `is_excluded` says.
    pub(super) fn update(
        &mut self,
        map: &ClearanceMap,
        (body, clearance_min_m): (RobotBody, f64),
        places_m: impl Iterator<Item = [f64; 2]>,
        is_excluded: impl Fn(usize) -> bool,
    ) {
        let Self { is_reached, is_centre, is_covered, stack } = self;
        for cells in [&mut *is_reached, &mut *is_centre, &mut *is_covered] {
            cells.clear();
            cells.resize(map.cell_count(), false);
        }
        let fits = |cell: usize| map.clearance_m(cell) >= clearance_min_m && !is_excluded(cell);
        let is_known = |cell: usize| map.occupancy(cell) == Occupancy::Free && fits(cell);
        stack.clear();
        stack.extend(places_m.filter_map(|at_m| map.nearest_cell(at_m, START_SNAP_MAX_M, is_known)));
        flood(map, stack, is_reached, is_known);
        stack.extend((0..map.cell_count()).filter(|cell| is_reached[*cell]));
        flood(map, stack, is_centre, |cell| map.occupancy(cell) != Occupancy::Occupied && fits(cell));
        self.cover(map, body.radius_m + body.margin_m);
    }

    /// Marks what lies within a radius of the centres. The discs of those at the border of their area are enough.
    fn cover(&mut self, map: &ClearanceMap, radius_m: f64) {
        self.is_covered.copy_from_slice(&self.is_centre);
        let width = map.width();
        let height = map.cell_count() as i64 / width.max(1);
        let radius_cells = radius_m / map.cell_size_m();
        let reach = radius_cells as i64;
        let disc: Vec<(i64, i64)> = (-reach..=reach)
            .flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy)))
            .filter(|(dx, dy)| (dx * dx + dy * dy) as f64 <= radius_cells * radius_cells)
            .collect();
        for cell in (0..map.cell_count()).filter(|cell| self.is_centre[*cell]) {
            let neighbours = (0..NEIGHBOURS.len()).map(|direction| map.neighbour(cell, direction));
            if neighbours.into_iter().all(|next| next.is_some_and(|next| self.is_centre[next])) {
                continue;
            }
            let (x, y) = map.column_row(cell);
            for (dx, dy) in &disc {
                let (u, v) = (x + dx, y + dy);
                if (0..width).contains(&u) && (0..height).contains(&v) {
                    self.is_covered[(v * width + u) as usize] = true;
                }
            }
        }
    }

    /// Whether some robot fits in a cell of the map of the last update, and drives there through known space.
    pub(super) fn is_reached(&self, cell: usize) -> bool {
        self.is_reached.get(cell).is_some_and(|is_reached| *is_reached)
    }

    /// Whether a robot could cover a cell of the map of the last update if unknown space is free.
    pub(super) fn is_possible(&self, cell: usize) -> bool {
        self.is_covered.get(cell).is_some_and(|is_covered| *is_covered)
    }
}

/// Marks the cells on the stack, and all that are connected with them through cells that fit. Empties the stack.
fn flood(map: &ClearanceMap, stack: &mut Vec<usize>, is_marked: &mut [bool], fits: impl Fn(usize) -> bool) {
    stack.iter().for_each(|cell| is_marked[*cell] = true);
    while let Some(cell) = stack.pop() {
        for next in (0..NEIGHBOURS.len()).filter_map(|direction| map.neighbour(cell, direction)) {
            if !is_marked[next] && fits(next) {
                is_marked[next] = true;
                stack.push(next);
            }
        }
    }
}
