//! Random drawing of walls and furniture that keeps lanes free for robots.

use crate::room::builder::{Builder, WALL_HEIGHT_M};
use crate::room::mesh::Mesh;
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

/// Half the thickness of walls, metres.
pub(super) const WALL_HALF_M: f32 = 0.06;
/// Width of a lane between two pieces of furniture, metres: a robot passes with 0.25 m to each side.
const LANE_M: f32 = 0.7;
/// Depth of the free space at each side of a door, metres.
const DOOR_FREE_M: f32 = 0.9;
/// Attempts to place one piece of furniture; after them it is left out.
const ATTEMPTS: usize = 12;
/// Share of furniture that stands against a wall.
const WALL_SHARE: f32 = 0.65;

/// An axis-parallel rectangle, metres.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rect {
    pub(super) min: [f32; 2],
    pub(super) max: [f32; 2],
}

impl Rect {
    pub(super) fn new(min: [f32; 2], max: [f32; 2]) -> Self {
        Self { min, max }
    }

    pub(super) fn size(&self) -> [f32; 2] {
        [self.max[0] - self.min[0], self.max[1] - self.min[1]]
    }

    pub(super) fn centre(&self) -> [f32; 2] {
        [(self.min[0] + self.max[0]) / 2.0, (self.min[1] + self.max[1]) / 2.0]
    }

    fn grown(&self, by_m: f32) -> Self {
        Self { min: self.min.map(|v| v - by_m), max: self.max.map(|v| v + by_m) }
    }

    fn intersects(&self, other: &Self) -> bool {
        (0..2).all(|axis| self.min[axis] < other.max[axis] && other.min[axis] < self.max[axis])
    }
}

/// A piece of furniture to place.
#[derive(Clone, Copy, Debug)]
pub(super) enum Piece {
    /// Cuboid that stands on the floor, of random size between these two, metres.
    Block { min: [f32; 2], max: [f32; 2], height_m: f32 },
    /// Round column of a radius, metres.
    Column { radius_m: f32, height_m: f32 },
    /// Table on four legs.
    Table,
    /// Chair at a random angle.
    Chair,
}

/// Drawing of one room: its mesh, random numbers, and the places that are taken.
pub(super) struct Draw {
    pub(super) build: Builder,
    random: SplitMix64,
    taken: Vec<Rect>,
    doors: Vec<Rect>,
}

impl Draw {
    pub(super) fn new(seed: u64) -> Self {
        let random = SplitMix64::seed_from_u64(seed);
        Self { build: Builder::default(), random, taken: Vec::new(), doors: Vec::new() }
    }

    pub(super) fn into_mesh(self) -> Mesh {
        self.build.into_mesh()
    }

    /// Draws a number from 0 to 1.
    pub(super) fn uniform(&mut self) -> f32 {
        (self.random.next_u64() >> 40) as f32 / (1_u64 << 24) as f32
    }

    pub(super) fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.uniform()
    }

    pub(super) fn below(&mut self, count: usize) -> usize {
        ((self.uniform() * count as f32) as usize).min(count.saturating_sub(1))
    }

    pub(super) fn chance(&mut self, share: f32) -> bool {
        self.uniform() < share
    }

    /// Divides a length into parts of `low` to `high`, metres. Returns the parts' borders, ends included.
    pub(super) fn divide(&mut self, from: f32, to: f32, low: f32, high: f32) -> Vec<f32> {
        let mut borders = vec![from];
        let mut at = from;
        while to - at > high {
            let rest = to - at;
            at += self.between(low, high.min(rest - low).max(low));
            borders.push(at);
        }
        borders.push(to);
        borders
    }

    /// Adds a wall with doors: `doors` are their centres along the wall and their widths, metres, in rising order.
    pub(super) fn wall(&mut self, from: [f32; 2], to: [f32; 2], doors: &[(f32, f32)]) {
        let axis = usize::from((to[0] - from[0]).abs() < (to[1] - from[1]).abs());
        let point = |along: f32| {
            let mut point = from;
            point[axis] = along;
            point
        };
        let mut begin = from[axis].min(to[axis]) - WALL_HALF_M;
        for (centre, width) in doors {
            self.wall_part(point(begin), point(centre - width / 2.0));
            begin = centre + width / 2.0;
            let mut door = Rect::new(point(centre - width / 2.0), point(centre + width / 2.0));
            door.min[1 - axis] -= DOOR_FREE_M;
            door.max[1 - axis] += DOOR_FREE_M;
            self.doors.push(door);
        }
        self.wall_part(point(begin), point(from[axis].max(to[axis]) + WALL_HALF_M));
    }

    fn wall_part(&mut self, from: [f32; 2], to: [f32; 2]) {
        let axis = usize::from((to[0] - from[0]).abs() < (to[1] - from[1]).abs());
        if to[axis] - from[axis] < 0.01 {
            return;
        }
        let (mut min, mut max) = (from, to);
        min[1 - axis] -= WALL_HALF_M;
        max[1 - axis] += WALL_HALF_M;
        self.build.wall(min, max);
    }

    /// Adds outer walls around a rectangle, and its floor.
    pub(super) fn shell(&mut self, rect: Rect) {
        let ([x0, y0], [x1, y1]) = (rect.min, rect.max);
        self.build.floor(rect.min, rect.max);
        for (from, to) in
            [([x0, y0], [x1, y0]), ([x0, y1], [x1, y1]), ([x0, y0], [x0, y1]), ([x1, y0], [x1, y1])]
        {
            self.wall(from, to, &[]);
        }
    }

    /// Keeps a rectangle free of furniture.
    pub(super) fn keep_free(&mut self, rect: Rect) {
        self.doors.push(rect);
    }

    /// Adds a block at a place, and takes the place.
    pub(super) fn block(&mut self, rect: Rect, height_m: f32) {
        self.build.block(rect.centre(), rect.size(), 0.0, 0.0, height_m);
        self.taken.push(rect);
    }

    /// Places pieces at random in a region bounded by walls, as far as lanes stay free.
    pub(super) fn furnish(&mut self, region: Rect, pieces: &[Piece]) {
        let inner = region.grown(-WALL_HALF_M);
        pieces.iter().for_each(|piece| self.place(inner, *piece));
    }

    fn place(&mut self, region: Rect, piece: Piece) {
        let mut size = match piece {
            Piece::Block { min, max, .. } => [self.between(min[0], max[0]), self.between(min[1], max[1])],
            Piece::Column { radius_m, .. } => [2.0 * radius_m; 2],
            Piece::Table => [self.between(1.2, 1.6), self.between(0.7, 0.9)],
            Piece::Chair => [0.6, 0.6],
        };
        for _ in 0..ATTEMPTS {
            if self.chance(0.5) {
                size.swap(0, 1);
            }
            if let Some(rect) = self.find_place(region, size) {
                self.add_piece(rect, piece);
                self.taken.push(rect);
                return;
            }
        }
    }

    /// Draws one place for a piece: against a wall or free in the region. `None` if it is taken.
    fn find_place(&mut self, region: Rect, size: [f32; 2]) -> Option<Rect> {
        let mut min = [0.0; 2];
        for axis in 0..2 {
            let (low, high) = (region.min[axis] + LANE_M, region.max[axis] - size[axis] - LANE_M);
            if high < low {
                return None;
            }
            min[axis] = self.between(low, high);
        }
        if self.chance(WALL_SHARE) {
            let axis = self.below(2);
            min[axis] = if self.chance(0.5) { region.min[axis] } else { region.max[axis] - size[axis] };
        }
        let rect = Rect::new(min, [min[0] + size[0], min[1] + size[1]]);
        let is_free = self.taken.iter().all(|taken| !taken.grown(LANE_M).intersects(&rect))
            && self.doors.iter().all(|door| !door.intersects(&rect));
        is_free.then_some(rect)
    }

    fn add_piece(&mut self, rect: Rect, piece: Piece) {
        let (centre, size) = (rect.centre(), rect.size());
        match piece {
            Piece::Block { height_m, .. } => {
                self.build.block(centre, size, 0.0, 0.0, height_m.min(WALL_HEIGHT_M));
            }
            Piece::Column { radius_m, height_m } => self.build.column(centre, radius_m, height_m),
            Piece::Table => self.build.table(centre, size, 0.0, 0.74, 0.06),
            Piece::Chair => {
                let yaw_deg = self.between(-180.0, 180.0);
                self.build.chair(centre, yaw_deg);
            }
        }
    }
}
