//! Rectangles of cells, and the tiles they are cut into.

/// Cells along a tile's side: a tile is what is compared, redrawn and fused at a time.
pub(crate) const TILE: i64 = 64;

/// Cells `x0..x1` by `y0..y1`, of whatever grid the context says. Empty unless `x0 < x1 && y0 < y1`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Rect {
    pub x0: i64,
    pub y0: i64,
    pub x1: i64,
    pub y1: i64,
}

impl Rect {
    /// `width` x `height` cells from (0, 0).
    pub fn of_size(width: u32, height: u32) -> Self {
        Self { x0: 0, y0: 0, x1: width.into(), y1: height.into() }
    }

    pub fn is_empty(self) -> bool {
        self.x0 >= self.x1 || self.y0 >= self.y1
    }

    pub fn width(self) -> usize {
        (self.x1 - self.x0).max(0) as usize
    }

    pub fn height(self) -> usize {
        (self.y1 - self.y0).max(0) as usize
    }

    /// Cells inside; `None` if a machine cannot count them.
    pub fn area(self) -> Option<usize> {
        self.width().checked_mul(self.height())
    }

    /// What both cover.
    pub fn intersect(self, other: Self) -> Self {
        Self {
            x0: self.x0.max(other.x0),
            y0: self.y0.max(other.y0),
            x1: self.x1.min(other.x1),
            y1: self.y1.min(other.y1),
        }
    }

    /// The smallest that holds both.
    pub fn unite(self, other: Self) -> Self {
        if self.is_empty() {
            return other;
        }
        if other.is_empty() {
            return self;
        }
        Self {
            x0: self.x0.min(other.x0),
            y0: self.y0.min(other.y0),
            x1: self.x1.max(other.x1),
            y1: self.y1.max(other.y1),
        }
    }

    pub fn holds(self, other: Self) -> bool {
        other.is_empty() || self.intersect(other) == other
    }

    /// Where cell (x, y) of this window lies in its row-major cells.
    pub fn index(self, x: i64, y: i64) -> usize {
        (y - self.y0) as usize * self.width() + (x - self.x0) as usize
    }

    /// The tiles that touch it, counted on the grid's own lattice (so that they stay when it grows).
    pub fn tiles(self) -> Self {
        if self.is_empty() {
            return Self::default();
        }
        Self {
            x0: self.x0.div_euclid(TILE),
            y0: self.y0.div_euclid(TILE),
            x1: (self.x1 - 1).div_euclid(TILE) + 1,
            y1: (self.y1 - 1).div_euclid(TILE) + 1,
        }
    }

    /// The cells of tile (x, y).
    pub fn of_tile(x: i64, y: i64) -> Self {
        Self { x0: x * TILE, y0: y * TILE, x1: (x + 1) * TILE, y1: (y + 1) * TILE }
    }

    /// Its points, row by row.
    pub fn points(self) -> impl Iterator<Item = (i64, i64)> {
        (self.y0..self.y1).flat_map(move |y| (self.x0..self.x1).map(move |x| (x, y)))
    }
}

/// Some of the tiles that touch a window.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tiles {
    /// Which tiles can be in it, in tiles.
    all: Rect,
    marked: Vec<bool>,
}

impl Tiles {
    /// None of the tiles that touch `window`, which is in cells.
    pub fn none_of(window: Rect) -> Self {
        let all = window.tiles();
        Self { all, marked: vec![false; all.width() * all.height()] }
    }

    /// Marks the tiles that touch `cells`.
    pub fn mark(&mut self, cells: Rect) {
        for (x, y) in cells.tiles().intersect(self.all).points() {
            self.marked[self.all.index(x, y)] = true;
        }
    }

    /// The marked tiles' cells, row by row of tiles.
    pub fn marked(&self) -> impl Iterator<Item = Rect> + '_ {
        let marks = self.all.points().zip(&self.marked);
        marks.filter(|(_, marked)| **marked).map(|((x, y), _)| Rect::of_tile(x, y))
    }
}
