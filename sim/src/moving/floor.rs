//! The floor on which people walk and boxes stand, and the search for ways on it.

use super::shape::Outline;
use crate::burger;
use crate::room::{Ground, Room};
use std::collections::VecDeque;

/// Height up to which things are in the way of people, doors and boxes, metres.
const HEIGHT_M: f32 = 1.8;
/// Smallest distance from a person's centre to a wall or furniture in the cells of its ways, metres: the widest person's radius
/// and some more.
const WALK_CLEARANCE_M: f32 = 0.3;
/// Half of the width of the lanes that boxes leave open where the room has them, metres: a robot has room to turn.
const LANE_M: f32 = 0.25;
/// Distance from a robot's centre to a box in cells where the robot fits, metres, as in the room's own drivable cells.
const FIT_M: f32 = burger::RADIUS_M as f32 + 0.02;
/// Largest area that a box may cut off, in cells of 0.05 m: corners beside it.
const CUT_OFF_CELLS_MAX: usize = 20;
/// Largest number of cells that a search for a way visits: an area of 100 m².
const SEARCH_CELLS_MAX: usize = 40_000;
/// Largest number of corners of a way.
const CORNERS_MAX: usize = 64;
/// Distance between two points of a line that are looked at, metres: half a cell.
const LINE_STEP_M: f64 = 0.025;

/// Cells that belong to the newest painting or search only; older ones are cleared by counting on.
struct Marks {
    of: Vec<u32>,
    newest: u32,
}

impl Marks {
    fn new(len: usize) -> Self {
        Self { of: vec![0; len], newest: 0 }
    }

    fn clear(&mut self) {
        if self.newest == u32::MAX {
            self.of.fill(0);
            self.newest = 0;
        }
        self.newest += 1;
    }

    fn set(&mut self, cell: usize) {
        self.of[cell] = self.newest;
    }

    fn has(&self, cell: usize) -> bool {
        self.of[cell] == self.newest
    }
}

/// Something that ways keep a distance to, in metres.
pub(super) type Blocked = (Outline, f64);

/// Floor of a room for people and boxes.
pub(super) struct Floor {
    room: Room,
    /// Distance from each cell's centre to the nearest thing lower than a person, metres.
    clearance_m: Vec<f32>,
    /// Cells of the largest region in which people can walk.
    walkable: Vec<bool>,
    /// The same cells, as a list.
    walkable_cells: Vec<u32>,
    /// Cells of the largest regions that boxes must not divide, with the distance that a box keeps to them.
    undivided: [(Vec<bool>, f32); 2],
    /// Number of the region of floor without obstacles that each cell belongs to; 0 elsewhere.
    regions: Vec<u32>,
    blocked: Marks,
    seen: Marks,
    parents: Vec<u32>,
    queue: VecDeque<u32>,
    reached: Vec<u32>,
}

impl Floor {
    pub(super) fn new(room: &Room) -> Self {
        let ground = room.ground();
        let clearance_m = room.clearance_below_m(HEIGHT_M);
        let free: Vec<bool> = ground.floor.iter().zip(&clearance_m).map(|(f, c)| *f && *c > 0.0).collect();
        let (regions, _) = ground.raster.regions(&free);
        let walkable = largest_region(ground, |cell| free[cell] && clearance_m[cell] >= WALK_CLEARANCE_M);
        let lanes =
            largest_region(ground, |cell| ground.drivable[cell] && ground.clearance_m[cell] >= LANE_M);
        let len = ground.raster.len();
        Self {
            walkable_cells: (0..len as u32).filter(|cell| walkable[*cell as usize]).collect(),
            undivided: [(ground.drivable.clone(), FIT_M), (lanes, LANE_M)],
            room: room.clone(),
            clearance_m,
            walkable,
            regions,
            blocked: Marks::new(len),
            seen: Marks::new(len),
            parents: vec![0; len],
            queue: VecDeque::new(),
            reached: Vec::new(),
        }
    }

    pub(super) fn room(&self) -> &Room {
        &self.room
    }

    /// Returns the distance from the centre of the cell under a point to the nearest thing lower than a person, metres; 0 outside.
    pub(super) fn clearance_m(&self, point_m: [f64; 2]) -> f64 {
        self.index(point_m).map_or(0.0, |cell| self.clearance_m[cell].into())
    }

    /// Returns whether a point lies on the same free floor as another one.
    pub(super) fn is_open_from(&self, from_m: [f64; 2], to_m: [f64; 2]) -> bool {
        let region = |point| self.index(point).map_or(0, |cell| self.regions[cell]);
        region(from_m) != 0 && region(from_m) == region(to_m)
    }

    /// Returns the cells over which people walk.
    pub(super) fn walkable_cells(&self) -> &[u32] {
        &self.walkable_cells
    }

    /// Returns the number of cells of the floor.
    pub(super) fn len(&self) -> usize {
        self.walkable.len()
    }

    /// Returns whether a robot can drive to a cell from the largest region of the room.
    pub(super) fn is_drivable(&self, cell: usize) -> bool {
        self.room.ground().drivable[cell]
    }

    /// Returns the centre of a cell, metres.
    pub(super) fn centre_m(&self, cell: usize) -> [f64; 2] {
        self.room.ground().raster.centre_m(cell)
    }

    fn index(&self, point_m: [f64; 2]) -> Option<usize> {
        self.room.ground().raster.index(point_m)
    }

    /// Marks the cells near these outlines as blocked, and no others.
    fn block(&mut self, outlines: impl IntoIterator<Item = Blocked>) {
        self.blocked.clear();
        let raster = &self.room.ground().raster;
        for (outline, margin_m) in outlines {
            let reach_m = outline.bound_m() + margin_m;
            let range = |axis: usize, limit: usize| {
                let low_m = outline.centre_m[axis] - reach_m - raster.origin_m[axis];
                let first = (low_m / raster.resolution_m).floor().clamp(0.0, limit as f64) as usize;
                let last = ((low_m + 2.0 * reach_m) / raster.resolution_m).ceil().clamp(0.0, limit as f64);
                first..last as usize
            };
            for row in range(1, raster.height) {
                for column in range(0, raster.width) {
                    let cell = row * raster.width + column;
                    if outline.distance_m(raster.centre_m(cell)) < margin_m {
                        self.blocked.set(cell);
                    }
                }
            }
        }
    }

    /// Finds a way that keeps its distance to `blocked`, to `goal_m` or to the place that `choose` takes of a number of reached ones, the
    /// farthest of them last. Writes its corners without the first into `way`. Returns false, and an empty way, if there is none.
    pub(super) fn find_way(
        &mut self,
        from_m: [f64; 2],
        goal_m: Option<[f64; 2]>,
        blocked: impl IntoIterator<Item = Blocked>,
        choose: impl FnOnce(usize) -> usize,
        way: &mut Vec<[f64; 2]>,
    ) -> bool {
        way.clear();
        let goal = goal_m.and_then(|goal_m| self.index(goal_m));
        let Some(from) = self.index(from_m) else { return false };
        self.block(blocked);
        self.search(from, goal);
        let target = match goal {
            Some(goal) => Some(goal).filter(|goal| self.seen.has(*goal)),
            None => self.reached.get(choose(self.reached.len())).map(|cell| *cell as usize),
        };
        let Some(target) = target.filter(|target| *target != from) else { return false };
        self.trace(from, target, way);
        !way.is_empty()
    }

    /// Visits cells in the order of their distance from a start, in steps over edges and corners, until it comes to the goal.
    fn search(&mut self, from: usize, goal: Option<usize>) {
        self.seen.clear();
        self.reached.clear();
        self.queue.clear();
        self.seen.set(from);
        self.parents[from] = from as u32;
        self.queue.push_back(from as u32);
        let raster = &self.room.ground().raster;
        while let Some(cell) = self.queue.pop_front() {
            self.reached.push(cell);
            if goal == Some(cell as usize) || self.reached.len() >= SEARCH_CELLS_MAX {
                return;
            }
            for (next, _) in raster.neighbours(cell as usize) {
                if self.walkable[next] && !self.blocked.has(next) && !self.seen.has(next) {
                    self.seen.set(next);
                    self.parents[next] = cell;
                    self.queue.push_back(next as u32);
                }
            }
        }
    }

    /// Writes the corners of the way that the newest search has found to a cell: straight lines as long as they are free.
    fn trace(&mut self, from: usize, target: usize, way: &mut Vec<[f64; 2]>) {
        self.reached.clear();
        let mut cell = target;
        while cell != from {
            self.reached.push(cell as u32);
            cell = self.parents[cell] as usize;
        }
        let raster = &self.room.ground().raster;
        let mut corner_m = raster.centre_m(from);
        let mut remaining = self.reached.len();
        while remaining > 0 && way.len() < CORNERS_MAX {
            let mut next = remaining - 1;
            while next > 0 && self.is_line_free(corner_m, raster.centre_m(self.reached[next - 1] as usize)) {
                next -= 1;
            }
            corner_m = raster.centre_m(self.reached[next] as usize);
            way.push(corner_m);
            remaining = next;
        }
    }

    /// Returns whether all cells of a line are walkable and not blocked.
    fn is_line_free(&self, from_m: [f64; 2], to_m: [f64; 2]) -> bool {
        let length_m = (to_m[0] - from_m[0]).hypot(to_m[1] - from_m[1]);
        let steps = (length_m / LINE_STEP_M).ceil().max(1.0) as usize;
        (1..=steps).all(|step| {
            let share = step as f64 / steps as f64;
            let point_m = [0, 1].map(|axis| from_m[axis] + share * (to_m[axis] - from_m[axis]));
            self.index(point_m).is_some_and(|cell| self.walkable[cell] && !self.blocked.has(cell))
        })
    }

    /// Returns whether robots still reach all floor with these boxes on it, but for corners beside them.
    pub(super) fn is_undivided_by(&mut self, boxes: &[Outline]) -> bool {
        for kind in 0..self.undivided.len() {
            let margin_m = f64::from(self.undivided[kind].1);
            self.block(boxes.iter().map(|outline| (*outline, margin_m)));
            let cells = &self.undivided[kind].0;
            let is_open = |cell: usize| cells[cell] && !self.blocked.has(cell);
            let count = (0..cells.len()).filter(|cell| is_open(*cell)).count();
            self.seen.clear();
            self.queue.clear();
            // A corner that is cut off may come first: as many starts as it may have cells.
            let starts = (0..cells.len()).filter(|cell| is_open(*cell)).take(CUT_OFF_CELLS_MAX + 1);
            let mut largest = 0;
            for start in starts {
                let mut reached = 0;
                if !self.seen.has(start) {
                    self.seen.set(start);
                    self.queue.push_back(start as u32);
                }
                while let Some(cell) = self.queue.pop_front() {
                    reached += 1;
                    for (next, over_edge) in self.room.ground().raster.neighbours(cell as usize) {
                        if over_edge && is_open(next) && !self.seen.has(next) {
                            self.seen.set(next);
                            self.queue.push_back(next as u32);
                        }
                    }
                }
                largest = largest.max(reached);
            }
            if largest + CUT_OFF_CELLS_MAX < count {
                return false;
            }
        }
        true
    }
}

/// Returns the cells of the largest connected region of those that are `open`.
fn largest_region(ground: &Ground, open: impl Fn(usize) -> bool) -> Vec<bool> {
    let cells: Vec<bool> = (0..ground.raster.len()).map(open).collect();
    let (regions, sizes) = ground.raster.regions(&cells);
    let largest = (1..sizes.len()).max_by_key(|region| (sizes[*region], core::cmp::Reverse(*region)));
    regions.iter().map(|region| Some(*region as usize) == largest).collect()
}
