//! Errors of a map against the true room (simulation only).

mod alignment;

pub use alignment::AlignedAccuracy;

use crate::distance::squared_distances;
use msg::grid::{Occupancy, occupancy};
use msg::grid_agreement::for_known_cells;
use msg::{Grid, GridView, Pose2};

/// Largest distance of a wall to the other map's walls that counts, metres: one missing room does not hide the rest.
pub const NEAREST_M_MAX: f64 = 1.0;

/// Largest squared distance of a wall that is found, cells: a neighbour or a diagonal neighbour.
const FOUND_SQUARED_CELLS: f64 = 2.0;

/// The part of a room that robots can observe: the floor that they can reach, and the walls visible from there.
#[derive(Clone, Debug)]
pub struct ObservableArea {
    plan: Grid,
    /// Whether each cell of the plan is observable.
    observable: Vec<bool>,
    count: usize,
    /// Whether each cell of the plan is an observable wall,
    walls: Vec<bool>,
    /// and the squared distance to the nearest of them, in cells.
    to_walls: Vec<f64>,
}

impl ObservableArea {
    /// Computes the observable part of a floor plan in frame `world`.
    ///
    /// Floor that cannot be reached from `starts_m` (frame `world`, metres) is not observable. Without a start on free
    /// floor all floor counts as reachable.
    pub fn new(plan: Grid, starts_m: impl IntoIterator<Item = [f64; 2]>) -> Self {
        let mut reached = reachable(plan.view(), starts_m);
        if !reached.contains(&true) {
            reached = plan.cells.iter().map(|cell| occupancy(*cell) == Occupancy::Free).collect();
        }
        let width = (plan.header.width as usize).max(1);
        let visible_wall = |index: usize| {
            let (x, y) = ((index % width) as i64, (index / width) as i64);
            occupancy(plan.cells[index]) == Occupancy::Occupied
                && around(x, y).any(|place| at(&reached, &plan, place))
        };
        let observable: Vec<bool> = (0..plan.cells.len()).map(|i| reached[i] || visible_wall(i)).collect();
        let count = observable.iter().filter(|observable| **observable).count();
        let walls: Vec<bool> = (plan.cells.iter().zip(&observable))
            .map(|(cell, observable)| *observable && occupancy(*cell) == Occupancy::Occupied)
            .collect();
        let to_walls = squared_distances(&walls, width);
        Self { plan, observable, count, walls, to_walls }
    }

    /// The room, frame `world`.
    pub fn plan(&self) -> GridView<'_> {
        self.plan.view()
    }

    /// Share of the observable cells that a map knows, 0 to 1; NaN if nothing is observable.
    ///
    /// A wall's cell is known, too, if a cell beside it is a wall in the map, as in [`MapAccuracy::occupied_f1`]. The
    /// cells of plan and map do not coincide: a map that draws a surface one cell nearer can never know what is behind.
    pub fn room_coverage(&self, map: GridView<'_>, world_from_map: Pose2) -> f64 {
        let map_from_world = world_from_map.inverse();
        let (plan, mut known) = (self.plan.view(), 0_usize);
        let mut cells = self.observable.iter().zip(&self.walls);
        for y in 0..i64::from(plan.header.height) {
            for x in 0..i64::from(plan.header.width) {
                let Some((true, is_wall)) = cells.next() else { continue };
                let (x, y) = map.cell_of(map_from_world.apply(plan.centre_m(x, y)));
                let has_wall = |(x, y)| occupancy(map.cell(x, y)) == Occupancy::Occupied;
                let is_known = occupancy(map.cell(x, y)) != Occupancy::Unknown;
                known += usize::from(is_known || (*is_wall && around(x, y).any(has_wall)));
            }
        }
        known as f64 / self.count as f64
    }

    /// Compares the map's walls with the room's.
    pub fn compare(&self, map: GridView<'_>, world_from_map: Pose2) -> MapAccuracy {
        let walls_map: Vec<bool> =
            map.cells.iter().map(|cell| occupancy(*cell) == Occupancy::Occupied).collect();
        let visible = Grid {
            header: self.plan.header,
            cells: self
                .plan
                .cells
                .iter()
                .zip(&self.walls)
                .map(|(cell, wall)| if *wall { *cell } else { msg::grid::UNKNOWN })
                .collect(),
        };
        let of_map = wall_distances(map, self.plan.view(), &self.to_walls, world_from_map);
        let to_walls_map = squared_distances(&walls_map, map.header.width as usize);
        let of_room = wall_distances(visible.view(), map, &to_walls_map, world_from_map.inverse());
        let sum = of_map.found_share + of_room.found_share;
        MapAccuracy {
            occupied_f1: if sum > 0.0 { 2.0 * of_map.found_share * of_room.found_share / sum } else { 0.0 },
            map_to_room_m: of_map.mean_m,
            room_to_map_m: of_room.mean_m,
            room_coverage: self.room_coverage(map, world_from_map),
            wall_thickness_m: wall_thickness_m(map, &walls_map),
        }
    }
}

/// Errors of a map's walls against the room's.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MapAccuracy {
    /// F1 of occupied cells at a tolerance of one cell (and its diagonal), 0 to 1.
    pub occupied_f1: f64,
    /// Mean distance from the map's occupied cells to the room's nearest visible wall, metres,
    /// each at most [`NEAREST_M_MAX`]: large if the map invents walls. NaN without walls.
    pub map_to_room_m: f64,
    /// Mean distance from the room's visible walls to the map's nearest occupied cell, metres, each
    /// at most [`NEAREST_M_MAX`]: large if the map misses walls.
    pub room_to_map_m: f64,
    /// Share of the observable cells that the map knows, 0 to 1.
    pub room_coverage: f64,
    /// Mean thickness of the map's walls, metres: large if walls are doubled.
    pub wall_thickness_m: f64,
}

impl MapAccuracy {
    /// Nothing is known: all figures are NaN.
    pub(crate) const UNKNOWN: Self = Self {
        occupied_f1: f64::NAN,
        map_to_room_m: f64::NAN,
        room_to_map_m: f64::NAN,
        room_coverage: f64::NAN,
        wall_thickness_m: f64::NAN,
    };
}

/// How near the walls of one map lie to those of another.
struct WallDistances {
    found_share: f64,
    mean_m: f64,
}

/// Measures from each occupied cell of `from` to the nearest wall of `to`. `squared` holds the squared distances to the
/// walls of `to`, in cells.
fn wall_distances(
    from: GridView<'_>,
    to: GridView<'_>,
    squared: &[f64],
    to_from_from: Pose2,
) -> WallDistances {
    let width = to.header.width as usize;
    let (mut count, mut found, mut sum_m) = (0_u64, 0_u64, 0.0);
    for_known_cells(from, to, to_from_from, |here, x, y| {
        if here != Occupancy::Occupied {
            return;
        }
        count += 1;
        let inside =
            (0..i64::from(to.header.width)).contains(&x) && (0..i64::from(to.header.height)).contains(&y);
        let cells = if inside { squared[y as usize * width + x as usize] } else { f64::INFINITY };
        found += u64::from(cells <= FOUND_SQUARED_CELLS);
        sum_m += (cells.sqrt() * to.header.resolution_m).min(NEAREST_M_MAX);
    });
    WallDistances {
        found_share: if count == 0 { 0.0 } else { found as f64 / count as f64 },
        mean_m: sum_m / count as f64,
    }
}

/// Mean thickness of walls from the mean depth of their cells, which is the distance to the nearest cell that is no wall.
///
/// Across a wall of n cells the depth rises from 1 at both sides: its mean is about (n + 1)^2 / 4n, which is solved for n.
fn wall_thickness_m(map: GridView<'_>, walls: &[bool]) -> f64 {
    let open: Vec<bool> = walls.iter().map(|wall| !wall).collect();
    let depths = squared_distances(&open, map.header.width as usize);
    let of_walls = depths.iter().zip(walls).filter(|(_, wall)| **wall).map(|(squared, _)| squared.sqrt());
    let (sum, count) = of_walls.fold((0.0, 0.0), |(sum, count), depth| (sum + depth, count + 1.0));
    let mean: f64 = sum / count;
    let cells = 2.0 * mean - 1.0 + 2.0 * (mean * mean - mean).max(0.0).sqrt();
    cells * map.header.resolution_m
}

fn around(x: i64, y: i64) -> impl Iterator<Item = (i64, i64)> {
    let three = |at: i64| at.saturating_sub(1)..=at.saturating_add(1);
    three(y).flat_map(move |y| three(x).map(move |x| (x, y)))
}

fn at(cells: &[bool], grid: &Grid, (x, y): (i64, i64)) -> bool {
    let inside =
        (0..i64::from(grid.header.width)).contains(&x) && (0..i64::from(grid.header.height)).contains(&y);
    inside && cells[y as usize * grid.header.width as usize + x as usize]
}

/// Free cells connected to a start by their sides.
fn reachable(plan: GridView<'_>, starts_m: impl IntoIterator<Item = [f64; 2]>) -> Vec<bool> {
    let width = i64::from(plan.header.width);
    let mut reached = vec![false; plan.cells.len()];
    let mut open: Vec<(i64, i64)> = starts_m.into_iter().map(|start| plan.cell_of(start)).collect();
    while let Some((x, y)) = open.pop() {
        let index = (y * width + x) as usize;
        if occupancy(plan.cell(x, y)) != Occupancy::Free || reached[index] {
            continue;
        }
        reached[index] = true;
        open.extend([(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)]);
    }
    reached
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{house, within};
    use msg::grid::UNKNOWN;

    #[test]
    fn the_rooms_own_plan_has_no_errors() {
        let room = ObservableArea::new(house(), [[1.0, 1.0]]);
        let perfect = room.compare(house().view(), Pose2::IDENTITY);
        assert_eq!((perfect.occupied_f1, perfect.map_to_room_m), (1.0, 0.0));
        assert_eq!((perfect.room_to_map_m, perfect.room_coverage), (0.0, 1.0));
        let beside = room.compare(house().view(), Pose2::new(0.2, 0.0, 0.0));
        assert!(beside.occupied_f1 < 0.7 && beside.map_to_room_m > 0.05, "{beside:?}");
    }

    #[test]
    fn half_a_map_covers_half_the_room() {
        let mut half = house();
        let width = half.header.width as usize;
        half.cells
            .iter_mut()
            .enumerate()
            .filter(|(i, _)| i / width < 100)
            .for_each(|(_, cell)| *cell = UNKNOWN);
        let room = ObservableArea::new(house(), []);
        let seen = room.compare(half.view(), Pose2::IDENTITY);
        within(seen.room_coverage, 0.5, 0.02);
        assert!(seen.map_to_room_m < 0.02 && seen.room_to_map_m > 0.2, "{seen:?}");
    }

    #[test]
    fn a_wall_is_known_if_the_map_draws_it_one_cell_nearer_but_not_two() {
        let plan = house();
        let width = plan.header.width as usize;
        // The room's lower wall, moved into the room; behind it nothing is known.
        let coverage = |nearer: usize| {
            let mut map = plan.clone();
            (10..10 + nearer).for_each(|y| map.cells[y * width + 10..y * width + 250].fill(UNKNOWN));
            map.cells[(10 + nearer) * width + 10..(10 + nearer) * width + 250].fill(90);
            ObservableArea::new(plan.clone(), []).room_coverage(map.view(), Pose2::IDENTITY)
        };
        assert_eq!((coverage(0), coverage(1)), (1.0, 1.0));
        assert!(coverage(2) < 0.999, "{}", coverage(2));
    }

    #[test]
    fn unreachable_floor_does_not_count() {
        let mut plan = house();
        // A closed cupboard: free inside a ring of wall.
        let width = plan.header.width as usize;
        for (x, y) in (130..150).flat_map(|x| (70..90).map(move |y| (x, y))) {
            let ring = x == 130 || x == 149 || y == 70 || y == 89;
            plan.cells[y * width + x] = if ring { 90 } else { -90 };
        }
        let mut map = plan.clone();
        (71..89).for_each(|y| map.cells[y * width + 131..y * width + 149].fill(UNKNOWN));
        let coverage = |starts: &[[f64; 2]]| {
            ObservableArea::new(plan.clone(), starts.iter().copied())
                .room_coverage(map.view(), Pose2::IDENTITY)
        };
        assert_eq!(coverage(&[[1.0, 1.0]]), 1.0);
        assert!(coverage(&[]) < 1.0);
    }

    #[test]
    fn a_doubled_wall_is_thicker() {
        let strip = |thick: usize| {
            let mut map = house();
            let width = map.header.width as usize;
            let cells = map.cells.iter_mut().enumerate();
            cells.for_each(|(i, cell)| {
                *cell = if (100..100 + thick).contains(&(i / width)) { 90 } else { -90 }
            });
            let walls: Vec<bool> = map.cells.iter().map(|cell| *cell > 0).collect();
            wall_thickness_m(map.view(), &walls)
        };
        within(strip(1), 0.05, 1e-9);
        within(strip(2), 0.05, 0.06);
        within(strip(5), 0.25, 0.02);
    }
}
