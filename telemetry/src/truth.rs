//! A map against the room as it is (simulation only).

use crate::consistency::for_known;
use crate::distance::squared_distances;
use msg::grid::{Occupancy, occupancy};
use msg::{Grid, GridView, Pose2};

/// A wall farther from any in the other map than this counts as this far, metres: one missing room
/// shall not hide what the rest looks like.
pub const NEAREST_M_MAX: f64 = 1.0;

/// What of a room a robot can ever know: the floor it can reach and the walls it can see from there.
#[derive(Clone, Debug)]
pub struct ObservableArea {
    plan: Grid,
    /// By the plan's cells.
    knowable: Vec<bool>,
    count: usize,
    /// The walls that can be seen, and squared distances to the nearest of them, by the plan's cells.
    walls: Vec<bool>,
    to_walls: Vec<f64>,
}

impl ObservableArea {
    /// `plan` is the room, frame `world`. Floor that cannot be reached from `starts_m` (world,
    /// metres) cannot be known; without a start on free floor all of it counts as reachable.
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
        let knowable: Vec<bool> = (0..plan.cells.len()).map(|i| reached[i] || visible_wall(i)).collect();
        let count = knowable.iter().filter(|knowable| **knowable).count();
        let walls: Vec<bool> = (plan.cells.iter().zip(&knowable))
            .map(|(cell, knowable)| *knowable && occupancy(*cell) == Occupancy::Occupied)
            .collect();
        let to_walls = squared_distances(&walls, width);
        Self { plan, knowable, count, walls, to_walls }
    }

    /// The room, frame `world`.
    pub fn plan(&self) -> GridView<'_> {
        self.plan.view()
    }

    /// The share of the knowable cells that a map knows, 0 to 1; NaN if nothing is knowable.
    pub fn coverage(&self, map: GridView<'_>, world_from_map: Pose2) -> f64 {
        let map_from_world = world_from_map.inverse();
        let (plan, mut known) = (self.plan.view(), 0_usize);
        let mut index = self.knowable.iter();
        for y in 0..i64::from(plan.header.height) {
            for x in 0..i64::from(plan.header.width) {
                if index.next() == Some(&true) {
                    let (x, y) = map.cell_of(map_from_world.apply(plan.centre_m(x, y)));
                    known += usize::from(occupancy(map.cell(x, y)) != Occupancy::Unknown);
                }
            }
        }
        known as f64 / self.count as f64
    }

    /// The map's walls against the room's.
    pub fn compare(&self, map: GridView<'_>, world_from_map: Pose2) -> MapErrors {
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
        let of_map = nearest(map, self.plan.view(), &self.to_walls, world_from_map);
        let to_walls_map = squared_distances(&walls_map, map.header.width as usize);
        let of_room = nearest(visible.view(), map, &to_walls_map, world_from_map.inverse());
        let sum = of_map.found_share + of_room.found_share;
        MapErrors {
            occupied_f1: if sum > 0.0 { 2.0 * of_map.found_share * of_room.found_share / sum } else { 0.0 },
            map_to_room_m: of_map.mean_m,
            room_to_map_m: of_room.mean_m,
            coverage: self.coverage(map, world_from_map),
            wall_thickness_m: wall_thickness_m(map, &walls_map),
        }
    }
}

/// How a map's walls lie to the room's.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MapErrors {
    /// F1 of occupied cells at a tolerance of one cell (and its diagonal), 0 to 1.
    pub occupied_f1: f64,
    /// Mean distance from the map's occupied cells to the room's nearest visible wall, metres,
    /// each at most [`NEAREST_M_MAX`]: large if the map invents walls. NaN without walls.
    pub map_to_room_m: f64,
    /// Mean distance from the room's visible walls to the map's nearest occupied cell, metres, each
    /// at most [`NEAREST_M_MAX`]: large if the map misses walls.
    pub room_to_map_m: f64,
    /// Share of what can be known that is known, 0 to 1.
    pub coverage: f64,
    /// Mean thickness of the map's walls, metres: doubled walls show.
    pub wall_thickness_m: f64,
}

struct Nearest {
    found_share: f64,
    mean_m: f64,
}

/// From each occupied cell of `from` to the nearest wall of `to`, to which `squared` has the distances.
fn nearest(from: GridView<'_>, to: GridView<'_>, squared: &[f64], to_from_from: Pose2) -> Nearest {
    let width = to.header.width as usize;
    let (mut count, mut found, mut sum_m) = (0_u64, 0_u64, 0.0);
    for_known(from, to, to_from_from, |here, x, y| {
        if here != Occupancy::Occupied {
            return;
        }
        count += 1;
        let inside =
            (0..i64::from(to.header.width)).contains(&x) && (0..i64::from(to.header.height)).contains(&y);
        let cells = if inside { squared[y as usize * width + x as usize] } else { f64::INFINITY };
        found += u64::from(cells <= 2.0);
        sum_m += (cells.sqrt() * to.header.resolution_m).min(NEAREST_M_MAX);
    });
    Nearest {
        found_share: if count == 0 { 0.0 } else { found as f64 / count as f64 },
        mean_m: sum_m / count as f64,
    }
}

/// Twice the mean depth of wall cells would be the thickness of a smooth ridge whose depth rises
/// one cell a cell from 1 at its edges: for n cells the mean depth is about (n + 1)^2 / 4n; solved for n.
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
    (y - 1..=y + 1).flat_map(move |y| (x - 1..=x + 1).map(move |x| (x, y)))
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
    fn the_room_itself_is_a_perfect_map() {
        let room = ObservableArea::new(house(), [[1.0, 1.0]]);
        let perfect = room.compare(house().view(), Pose2::IDENTITY);
        assert_eq!((perfect.occupied_f1, perfect.map_to_room_m), (1.0, 0.0));
        assert_eq!((perfect.room_to_map_m, perfect.coverage), (0.0, 1.0));
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
        within(seen.coverage, 0.5, 0.02);
        assert!(seen.map_to_room_m < 0.02 && seen.room_to_map_m > 0.2, "{seen:?}");
    }

    #[test]
    fn what_no_robot_can_reach_does_not_count() {
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
            ObservableArea::new(plan.clone(), starts.iter().copied()).coverage(map.view(), Pose2::IDENTITY)
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
