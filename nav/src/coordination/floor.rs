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
    /// Known cells where the centre of a robot can be that is there or drives there: the number of their connected component, from 1; 0 elsewhere.
    component: Vec<u8>,
    components: u8,
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
        let Self { component, components, is_centre, is_covered, stack } = self;
        for cells in [&mut *is_centre, &mut *is_covered] {
            cells.clear();
            cells.resize(map.cell_count(), false);
        }
        component.clear();
        component.resize(map.cell_count(), 0);
        *components = 0;
        let fits = |cell: usize| map.clearance_m(cell) >= clearance_min_m && !is_excluded(cell);
        let is_known = |cell: usize| map.occupancy(cell) == Occupancy::Free && fits(cell);
        for start in places_m.filter_map(|at_m| map.nearest_cell(at_m, START_SNAP_MAX_M, is_known)) {
            if component[start] == 0 {
                *components = components.saturating_add(1);
                flood(map, stack, start, |cell| {
                    let is_new = component[cell] == 0 && is_known(cell);
                    if is_new {
                        component[cell] = *components;
                    }
                    is_new
                });
            }
        }
        let is_possible = |cell: usize| map.occupancy(cell) != Occupancy::Occupied && fits(cell);
        for start in (0..map.cell_count()).filter(|cell| component[*cell] > 0) {
            flood(map, stack, start, |cell| {
                let is_new = !is_centre[cell] && is_possible(cell);
                is_centre[cell] |= is_new;
                is_new
            });
        }
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
        self.component(cell) > 0
    }

    /// Number of the connected component of cells that robots reach, from 1; 0 if none reaches the cell.
    pub(super) fn component(&self, cell: usize) -> u8 {
        self.component.get(cell).copied().unwrap_or(0)
    }

    /// Number of components between which no robot can drive through known space.
    pub(super) fn components(&self) -> u8 {
        self.components
    }

    /// Component that a robot at a place is in; `None` if it stands too far from where a robot fits.
    pub(super) fn component_near(&self, map: &ClearanceMap, at_m: [f64; 2]) -> Option<u8> {
        let near = map.nearest_cell(at_m, START_SNAP_MAX_M, |cell| self.is_reached(cell))?;
        Some(self.component(near))
    }

    /// Whether a robot could cover a cell of the map of the last update if unknown space is free.
    pub(super) fn is_possible(&self, cell: usize) -> bool {
        self.is_covered.get(cell).is_some_and(|is_covered| *is_covered)
    }
}

/// Calls `mark` with a cell, and with the neighbours of each cell for which it returns true. The stack is empty before and after.
fn flood(map: &ClearanceMap, stack: &mut Vec<usize>, start: usize, mut mark: impl FnMut(usize) -> bool) {
    if mark(start) {
        stack.push(start);
    }
    while let Some(cell) = stack.pop() {
        let neighbours = (0..NEIGHBOURS.len()).filter_map(|direction| map.neighbour(cell, direction));
        stack.extend(neighbours.filter(|next| mark(*next)));
    }
}
