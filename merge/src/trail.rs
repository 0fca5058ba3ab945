//! Where one robot's body has been of late.

use crate::merger::is_near;
use msg::grid::{Occupancy, SWEPT_FREE, occupancy};
use msg::{MapTile, Pose2, Rect, SweptDisk};
use std::collections::VecDeque;

/// Points of a trail: it reaches 2 m back and more, so that a robot's own map, drawn to its newest node at least (redrawn by the
/// fleet's graph, to five nodes before), has what it no longer does.
const POINTS_MAX: usize = 40;
/// Between two of them, metres.
const STEP_M: f64 = 0.05;
/// A robot that has moved less is where it was: metres.
const STILL_M: f64 = 0.01;
/// No robot drives so far between two of its poses, metres: its map has moved under it, and the trail is another's.
const JUMP_M: f64 = 0.25;
/// No robot reaches so far around itself, metres.
const RADIUS_M_MAX: f64 = 2.0;

/// See the module; in `robotK/map`, oldest first. The newest is where the robot is.
#[derive(Clone, Debug, Default)]
pub(crate) struct Trail {
    points_m: VecDeque<[f64; 2]>,
    radius_m: f64,
}

impl Trail {
    /// Takes where the robot is. False if that changes nothing.
    pub fn note(&mut self, robot_map_from_base: Pose2, radius_m: f64) -> bool {
        if !(is_near(robot_map_from_base) && radius_m > 0.0 && radius_m <= RADIUS_M_MAX) {
            return false;
        }
        let here = [robot_map_from_base.x_m, robot_map_from_base.y_m];
        let off = |point: Option<&[f64; 2]>| point.map(|p| (p[0] - here[0]).hypot(p[1] - here[1]));
        match off(self.points_m.back()) {
            Some(moved) if moved < STILL_M && self.radius_m == radius_m => return false,
            Some(moved) if moved > JUMP_M => self.points_m.clear(),
            _ => {}
        }
        let count = self.points_m.len();
        let before_newest = count.checked_sub(2).and_then(|k| self.points_m.get(k));
        if off(before_newest).is_some_and(|way| way < STEP_M) {
            self.points_m.pop_back();
        } else if count == POINTS_MAX {
            self.points_m.pop_front();
        }
        self.points_m.push_back(here);
        self.radius_m = radius_m;
        true
    }

    /// From point to point, in cells of the merged map's lattice.
    fn swept(&self, map_from_robot_map: Pose2, resolution_m: f64) -> impl Iterator<Item = SweptDisk> + '_ {
        let to_cells = move |point: &[f64; 2]| map_from_robot_map.apply(*point).map(|m| m / resolution_m);
        // The first to itself: one alone is a disk.
        let befores = self.points_m.front().into_iter().chain(&self.points_m);
        let pairs = befores.zip(&self.points_m);
        pairs.filter_map(move |(a, b)| SweptDisk::new(to_cells(a), to_cells(b), self.radius_m / resolution_m))
    }

    /// Tiles of the lattice that it touches.
    pub fn tiles(&self, map_from_robot_map: Pose2, resolution_m: f64) -> Rect {
        let cells = self.swept(map_from_robot_map, resolution_m).map(|swept| swept.cells());
        cells.fold(Rect::default(), Rect::union).tiles()
    }

    /// Puts floor under it in a tile, where none is known. What is known to be free stays as it was: a robot on its way
    /// through the open changes nothing.
    pub fn clear(&self, map_from_robot_map: Pose2, resolution_m: f64, tile: &mut MapTile) {
        let all = Rect::cells_of_tile(tile.x.into(), tile.y.into());
        for swept in self.swept(map_from_robot_map, resolution_m) {
            for (x, y) in swept.cells().intersect(all).points().filter(|(x, y)| swept.covers(*x, *y)) {
                let cell = &mut tile.cells[all.index(x, y)];
                if occupancy(*cell) != Occupancy::Free {
                    *cell = SWEPT_FREE;
                }
            }
        }
    }
}
