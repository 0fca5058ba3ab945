//! Moves a map onto the room. A map whose first robot started anywhere begins in a frame of its own, whose heading is that of a few
//! scans: half a degree moves a wall that is 20 m away by 0.17 m, and the map is as good as before.

use super::{MapAccuracy, NEAREST_M_MAX, ObservableArea};
use msg::grid::{Occupancy, occupancy};
use msg::pose::{best_rigid_transform, wrap_angle};
use msg::{GridView, Pose2};

/// Most iterations of the closest points. A map of 40 m that is turned by 3 degrees takes 60.
const ITERATIONS_MAX: usize = 100;
/// Change of the transform at which the iterations end, metres and radians: far below a cell.
const CONVERGED: f64 = 1e-5;
/// Most walls of the map that are paired, evenly taken: more do not change the transform by a tenth of a cell.
const PAIRS_MAX: usize = 4000;

/// Errors of a map that is moved onto the room first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AlignedAccuracy {
    /// Errors of the map where it lies best.
    pub accuracy: MapAccuracy,
    /// By how much the map's origin is moved for that, metres.
    pub moved_m: f64,
    /// By how much the map is turned for that, radians, 0 to pi.
    pub turned_rad: f64,
}

impl AlignedAccuracy {
    /// Nothing is known: all figures are NaN.
    pub(crate) const UNKNOWN: Self =
        Self { accuracy: MapAccuracy::UNKNOWN, moved_m: f64::NAN, turned_rad: f64::NAN };
}

impl ObservableArea {
    /// Compares a map with the room where it lies best near `world_from_map`.
    pub fn compare_aligned(&self, map: GridView<'_>, world_from_map: Pose2) -> AlignedAccuracy {
        let aligned = self.align(map, world_from_map);
        AlignedAccuracy {
            accuracy: self.compare(map, aligned),
            moved_m: aligned.distance_m(world_from_map),
            turned_rad: wrap_angle(aligned.yaw_rad - world_from_map.yaw_rad).abs(),
        }
    }

    /// Returns the transform near `world_from_map` that puts the map's walls on the room's: iterative closest points (Besl and McKay,
    /// "A method for registration of 3-D shapes", IEEE PAMI 1992) with walls that are at most [`NEAREST_M_MAX`] apart.
    fn align(&self, map: GridView<'_>, world_from_map: Pose2) -> Pose2 {
        let walls_m = walls_m(map);
        let mut found = world_from_map;
        let mut pairs = Vec::with_capacity(walls_m.len());
        for _ in 0..ITERATIONS_MAX {
            pairs.clear();
            pairs.extend(walls_m.iter().filter_map(|wall| {
                let nearest = self.nearest_wall_m(found.apply(*wall))?;
                Some([*wall, nearest])
            }));
            let Some(next) = best_rigid_transform(&pairs) else { return world_from_map };
            let change = next.between(found);
            found = next;
            if change.x_m.abs() + change.y_m.abs() + change.yaw_rad.abs() < CONVERGED {
                break;
            }
        }
        let errors_m = |transform: Pose2| -> f64 {
            walls_m.iter().map(|wall| self.wall_distance_m(transform.apply(*wall))).sum()
        };
        if errors_m(found) < errors_m(world_from_map) { found } else { world_from_map }
    }

    /// Distance of a point, frame `world`, to the nearest visible wall's cell, metres, at most [`NEAREST_M_MAX`].
    fn wall_distance_m(&self, point_m: [f64; 2]) -> f64 {
        let (x, y) = self.plan.view().cell_of(point_m);
        (self.cells_to_wall(x, y) * self.plan.header.resolution_m).min(NEAREST_M_MAX)
    }

    /// Returns the point of the nearest visible wall, frame `world`, metres; `None` if that is farther than [`NEAREST_M_MAX`].
    fn nearest_wall_m(&self, point_m: [f64; 2]) -> Option<[f64; 2]> {
        let plan = self.plan.view();
        let (x, y) = plan.cell_of(point_m);
        let distance_m = self.cells_to_wall(x, y) * plan.header.resolution_m;
        if distance_m > NEAREST_M_MAX {
            return None;
        }
        if distance_m == 0.0 {
            return Some(point_m);
        }
        // Towards the wall the distance falls by a cell per cell.
        let slope =
            |ahead: f64, back: f64| if (ahead - back).is_finite() { 0.5 * (ahead - back) } else { 0.0 };
        let along_x = slope(self.cells_to_wall(x + 1, y), self.cells_to_wall(x - 1, y));
        let along_y = slope(self.cells_to_wall(x, y + 1), self.cells_to_wall(x, y - 1));
        let steepness = along_x.hypot(along_y);
        if steepness < f64::EPSILON {
            return None;
        }
        let plan_from_grid = Pose2::new(0.0, 0.0, plan.header.origin.yaw_rad);
        let away = plan_from_grid.apply([along_x / steepness, along_y / steepness]);
        let centre_m = plan.centre_m(x, y);
        let from_centre_m = (point_m[0] - centre_m[0]) * away[0] + (point_m[1] - centre_m[1]) * away[1];
        Some([0, 1].map(|axis| point_m[axis] - (distance_m + from_centre_m) * away[axis]))
    }

    /// Distance of a cell to the nearest visible wall's, in cells; infinite outside the plan.
    fn cells_to_wall(&self, x: i64, y: i64) -> f64 {
        let [width, height] = [self.plan.header.width, self.plan.header.height].map(i64::from);
        let is_inside = (0..width).contains(&x) && (0..height).contains(&y);
        if is_inside { self.to_walls[(y * width + x) as usize].sqrt() } else { f64::INFINITY }
    }
}

/// Centres of the map's occupied cells, in its frame, metres; at most [`PAIRS_MAX`].
fn walls_m(map: GridView<'_>) -> Vec<[f64; 2]> {
    let width = (map.header.width as usize).max(1);
    let is_wall = |(_, cell): &(usize, &i8)| occupancy(**cell) == Occupancy::Occupied;
    let count = map.cells.iter().enumerate().filter(is_wall).count();
    let walls = map.cells.iter().enumerate().filter(is_wall).step_by(count.div_ceil(PAIRS_MAX).max(1));
    walls.map(|(index, _)| map.centre_m((index % width) as i64, (index / width) as i64)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::house;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn a_map_that_lies_beside_the_room_is_moved_onto_it(
            x_m in -0.3..0.3, y_m in -0.3..0.3, turned_rad in -0.05..0.05,
        ) {
            let room = ObservableArea::new(house(), [[1.0, 1.0]]);
            let beside = Pose2::new(x_m, y_m, turned_rad);
            let aligned = room.compare_aligned(house().view(), beside);
            // Within a cell nothing is known of a wall's place.
            prop_assert!((aligned.moved_m - x_m.hypot(y_m)).abs() < 0.04, "{aligned:?}");
            prop_assert!((aligned.turned_rad - turned_rad.abs()).abs() < 0.006, "{aligned:?}");
            prop_assert!(aligned.accuracy.occupied_f1 > 0.99, "{aligned:?}");
            prop_assert!(aligned.accuracy.room_coverage > 0.99, "{aligned:?}");
        }
    }

    #[test]
    fn a_map_without_walls_near_the_rooms_stays_where_it_is() {
        let room = ObservableArea::new(house(), [[1.0, 1.0]]);
        let elsewhere = Pose2::new(100.0, 0.0, 0.0);
        let aligned = room.compare_aligned(house().view(), elsewhere);
        assert_eq!((aligned.moved_m, aligned.turned_rad), (0.0, 0.0));
        assert_eq!(aligned.accuracy, room.compare(house().view(), elsewhere));
    }

    #[test]
    fn a_wrong_map_stays_wrong() {
        // A wall that is drawn twice lies on the room's once at most.
        let mut doubled = house();
        let width = doubled.header.width as usize;
        (22..24).for_each(|y| doubled.cells[y * width + 10..y * width + 250].fill(90));
        let room = ObservableArea::new(house(), [[1.0, 1.0]]);
        let aligned = room.compare_aligned(doubled.view(), Pose2::new(0.05, 0.1, 0.01));
        let placed = room.compare(doubled.view(), Pose2::IDENTITY);
        assert!(aligned.accuracy.occupied_f1 < placed.occupied_f1 + 0.02 && placed.occupied_f1 < 0.9);
    }
}
