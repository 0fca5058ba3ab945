//! The area that one robot's body swept most recently.

use crate::limits::is_plausible;
use msg::grid::{Occupancy, SWEPT_FREE, occupancy};
use msg::{IndexRect, MapTile, Pose2, SweptDisk};
use std::collections::VecDeque;

/// Most points of a path. At [`SPACING_M`] they reach back at least 2 m: past the newest pose-graph node of the robot's
/// own map, and past the fifth newest, to which a redrawn map reaches. From there back the map itself has the path.
const POINTS_MAX: usize = 40;
/// Least distance between two points, metres: the resolution of maps, so that disks leave no gaps.
const SPACING_M: f64 = 0.05;
/// A robot that has moved less than this stands still, metres: pose noise does not redraw tiles.
const STANDSTILL_M: f64 = 0.01;
/// A longer step between two poses means that the robot's map has moved under it, metres: the path is then invalid. At
/// 10 poses a second it would be 2.5 m/s.
const JUMP_M: f64 = 0.25;
/// Largest plausible radius of a robot, metres.
const RADIUS_M_MAX: f64 = 2.0;

/// The newest poses of one robot in `robotK/map`, oldest first, and the radius of its body.
#[derive(Clone, Debug, Default)]
pub(crate) struct SweptArea {
    points_m: VecDeque<[f64; 2]>,
    radius_m: f64,
}

impl SweptArea {
    /// Appends the robot's newest pose. False if the path stays as it was.
    pub fn add_pose(&mut self, robot_map_from_base: Pose2, radius_m: f64) -> bool {
        if !(is_plausible(robot_map_from_base) && radius_m > 0.0 && radius_m <= RADIUS_M_MAX) {
            return false;
        }
        let here = [robot_map_from_base.x_m, robot_map_from_base.y_m];
        let distance_m = |point: Option<&[f64; 2]>| point.map(|p| (p[0] - here[0]).hypot(p[1] - here[1]));
        match distance_m(self.points_m.back()) {
            Some(moved_m) if moved_m < STANDSTILL_M && self.radius_m == radius_m => return false,
            Some(moved_m) if moved_m > JUMP_M => self.points_m.clear(),
            _ => {}
        }
        let count = self.points_m.len();
        let before_newest = count.checked_sub(2).and_then(|k| self.points_m.get(k));
        if distance_m(before_newest).is_some_and(|distance_m| distance_m < SPACING_M) {
            self.points_m.pop_back();
        } else if count == POINTS_MAX {
            self.points_m.pop_front();
        }
        self.points_m.push_back(here);
        self.radius_m = radius_m;
        true
    }

    /// Tiles of the merged map's lattice that the path touches.
    pub fn tiles(&self, map_from_robot_map: Pose2, resolution_m: f64) -> IndexRect {
        let cells = self.segments(map_from_robot_map, resolution_m).map(|segment| segment.cells());
        cells.fold(IndexRect::default(), IndexRect::union).tiles()
    }

    /// Sets the cells of a tile under the path to floor, unless they are known to be free already. A robot that drives
    /// through known free space thus changes no tile.
    pub fn clear_tile(&self, map_from_robot_map: Pose2, resolution_m: f64, tile: &mut MapTile) {
        let tile_cells = IndexRect::cells_of_tile(tile.x.into(), tile.y.into());
        for segment in self.segments(map_from_robot_map, resolution_m) {
            let cells = segment.cells().intersect(tile_cells).points();
            for (x, y) in cells.filter(|(x, y)| segment.covers(*x, *y)) {
                let cell = &mut tile.cells[tile_cells.index(x, y)];
                if occupancy(*cell) != Occupancy::Free {
                    *cell = SWEPT_FREE;
                }
            }
        }
    }

    /// The body swept from each point to the next, in cells of the merged map's lattice.
    fn segments(&self, map_from_robot_map: Pose2, resolution_m: f64) -> impl Iterator<Item = SweptDisk> + '_ {
        let to_cells = move |point: &[f64; 2]| map_from_robot_map.apply(*point).map(|m| m / resolution_m);
        // The first segment is from the first point to itself: a path of one point is a disk.
        let from = self.points_m.front().into_iter().chain(&self.points_m);
        let pairs = from.zip(&self.points_m);
        pairs.filter_map(move |(a, b)| SweptDisk::new(to_cells(a), to_cells(b), self.radius_m / resolution_m))
    }
}
