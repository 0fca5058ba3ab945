//! Frontiers, where known free space meets unknown space (Yamauchi 1997).

use crate::clearance_map::ClearanceMap;
use crate::route_search::RouteSearch;
use msg::grid::Occupancy;

/// Most cells of one frontier: a longer one is divided, because it cannot be seen past from one place.
const CELLS_MAX: usize = 24;
/// Fewest cells of a frontier: shorter ones are noise of the map.
const CELLS_MIN: usize = 5;
/// Distance past a frontier that has to be visible from where the robot looks, metres.
const DEPTH_M: f64 = 0.3;
/// Most frontiers returned, nearest first. Bounds the time of a plan.
const FRONTIERS_MAX: usize = 192;

/// Connected cells of free space beside unknown space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frontier {
    /// Free cell in the middle of the frontier.
    pub free_cell: usize,
    /// Unknown cell beside it.
    pub unknown_cell: usize,
    /// Cell 0.3 m deep in unknown space, across the frontier.
    pub deep_cell: usize,
    /// Length of the frontier, metres.
    pub length_m: f64,
}

/// Finds frontiers among the cells that a route search has reached, in buffers that it keeps.
///
/// ```
/// use msg::Pose2;
/// use nav::{ClearanceMap, FrontierSearch, MapView, RouteSearch};
///
/// // 2 m by 2 m: the left half is free, the right half is unknown.
/// let cells: Vec<i8> = (0..1600).map(|i| if i % 40 < 20 { 0 } else { -1 }).collect();
/// let view = MapView::from_percent(Pose2::IDENTITY, 0.05, (40, 40), &cells).unwrap();
/// let robot_m = [0.5, 1.0];
/// let mut map = ClearanceMap::default();
/// map.copy_window(&view, robot_m);
/// map.compute_clearance();
///
/// let mut routes = RouteSearch::default();
/// assert!(routes.search_from(&map, robot_m, 0.15));
/// let mut search = FrontierSearch::default();
/// let middle = search
///     .find_frontiers(&map, &routes)
///     .iter()
///     .map(|frontier| map.cell_centre_m(frontier.free_cell))
///     .find(|[x, _]| (x - 0.975).abs() < 1e-9);
/// assert!(middle.is_some(), "the last free column has a frontier");
/// ```
#[derive(Clone, Debug, Default)]
pub struct FrontierSearch {
    is_frontier: Vec<bool>,
    /// Cells of the frontier that is collected now.
    cells: Vec<usize>,
    found: Vec<Frontier>,
}

impl FrontierSearch {
    /// Returns the frontiers, nearest first.
    pub fn find_frontiers(&mut self, map: &ClearanceMap, routes: &RouteSearch) -> &[Frontier] {
        self.found.clear();
        self.is_frontier.clear();
        self.is_frontier.resize(map.cell_count(), false);
        for cell in routes.reached_cells() {
            self.is_frontier[*cell] = unknown_neighbour(map, *cell).is_some();
        }
        for seed in routes.reached_cells() {
            if self.found.len() == FRONTIERS_MAX {
                break;
            }
            if self.is_frontier[*seed] {
                self.collect_cells(map, *seed);
                self.found.extend(self.describe(map));
            }
        }
        &self.found
    }

    /// Collects the frontier cells connected with `seed` and takes them out of the set.
    fn collect_cells(&mut self, map: &ClearanceMap, seed: usize) {
        self.cells.clear();
        self.cells.push(seed);
        self.is_frontier[seed] = false;
        let mut next = 0;
        while next < self.cells.len() && self.cells.len() < CELLS_MAX {
            let cell = self.cells[next];
            for neighbour in (0..8).filter_map(|d| map.neighbour(cell, d)) {
                if self.is_frontier[neighbour] && self.cells.len() < CELLS_MAX {
                    self.is_frontier[neighbour] = false;
                    self.cells.push(neighbour);
                }
            }
            next += 1;
        }
    }

    /// The collected cells as a frontier; `None` if they are too few.
    fn describe(&self, map: &ClearanceMap) -> Option<Frontier> {
        if self.cells.len() < CELLS_MIN {
            return None;
        }
        let count = self.cells.len() as f64;
        let centres_m = || self.cells.iter().map(|cell| map.cell_centre_m(*cell));
        let sum = centres_m().fold([0.0, 0.0], |sum, c| [sum[0] + c[0], sum[1] + c[1]]);
        let mean_m = [sum[0] / count, sum[1] / count];
        let offset_m = |cell: &usize| {
            let [x, y] = map.cell_centre_m(*cell);
            (x - mean_m[0]).hypot(y - mean_m[1])
        };
        let free_cell = *self.cells.iter().min_by(|a, b| offset_m(a).total_cmp(&offset_m(b)))?;
        let unknown_cell = unknown_neighbour(map, free_cell)?;
        let deep_cell = self.cell_across(map, free_cell).unwrap_or(unknown_cell);
        Some(Frontier { free_cell, unknown_cell, deep_cell, length_m: count * map.cell_size_m() })
    }

    /// Cell at [`DEPTH_M`] from `cell` in the mean direction from the collected cells into unknown space.
    fn cell_across(&self, map: &ClearanceMap, cell: usize) -> Option<usize> {
        let mut direction = [0.0, 0.0];
        for cell in &self.cells {
            let from = map.cell_centre_m(*cell);
            let unknown = unknown_neighbour(map, *cell).map_or(from, |unknown| map.cell_centre_m(unknown));
            direction = [direction[0] + unknown[0] - from[0], direction[1] + unknown[1] - from[1]];
        }
        let length = direction[0].hypot(direction[1]);
        let [x, y] = map.cell_centre_m(cell);
        let step = DEPTH_M / length;
        step.is_finite().then(|| map.cell_at([x + direction[0] * step, y + direction[1] * step])).flatten()
    }
}

/// An unknown cell at one of the four sides of a cell.
fn unknown_neighbour(map: &ClearanceMap, cell: usize) -> Option<usize> {
    let sides = [0, 2, 4, 6].into_iter().filter_map(|direction| map.neighbour(cell, direction));
    sides.into_iter().find(|side| map.occupancy(*side) == Occupancy::Unknown)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observation::MapView;
    use msg::Pose2;

    #[test]
    fn a_half_seen_room_has_its_frontier_where_unknown_space_begins() {
        // Free up to column 30, unknown beyond, walls above and below.
        let mut cells = vec![-1_i8; 60 * 40];
        for (x, y) in (0..31).flat_map(|x| (0..40).map(move |y| (x, y))) {
            cells[y * 60 + x] = if x == 0 || y == 0 || y == 39 { 100 } else { 0 };
        }
        let view = MapView::from_percent(Pose2::IDENTITY, 0.05, (60, 40), &cells).unwrap();
        let mut map = ClearanceMap::default();
        map.copy_window(&view, [0.5, 1.0]);
        map.compute_clearance();
        let mut routes = RouteSearch::default();
        assert!(routes.search_from(&map, [0.5, 1.0], 0.15));
        let mut search = FrontierSearch::default();
        let found = search.find_frontiers(&map, &routes);
        let length_m: f64 = found.iter().map(|f| f.length_m).sum();
        assert!((1.7..=2.0).contains(&length_m), "{length_m}: {found:?}");
        for frontier in found {
            assert!((map.cell_centre_m(frontier.free_cell)[0] - 1.525).abs() < 1e-9);
            assert!((map.cell_centre_m(frontier.unknown_cell)[0] - 1.575).abs() < 1e-9);
        }
        // No frontier is left once everything is known.
        let cells: Vec<i8> = cells.iter().map(|cell| if *cell == -1 { 100 } else { *cell }).collect();
        let view = MapView::from_percent(Pose2::IDENTITY, 0.05, (60, 40), &cells).unwrap();
        map.copy_window(&view, [0.5, 1.0]);
        map.compute_clearance();
        assert!(routes.search_from(&map, [0.5, 1.0], 0.15));
        assert!(search.find_frontiers(&map, &routes).is_empty());
    }
}
