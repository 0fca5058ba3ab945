//! Rectangles on an integer lattice of cells or of tiles.

/// Number of cells along a tile's side: 3.2 m at 0.05 m.
pub const TILE: i64 = 64;

/// Rectangle of the squares `x0..x1` by `y0..y1` of a lattice of cells or tiles.
///
/// It is empty unless `x0 < x1 && y0 < y1`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IndexRect {
    /// Index of the first column.
    pub x0: i64,
    /// Index of the first row.
    pub y0: i64,
    /// Index behind the last column.
    pub x1: i64,
    /// Index behind the last row.
    pub y1: i64,
}

impl IndexRect {
    /// Creates a rectangle of `width` x `height` squares with its first square at (0, 0).
    pub fn with_size(width: u32, height: u32) -> Self {
        Self { x0: 0, y0: 0, x1: width.into(), y1: height.into() }
    }

    /// Creates a rectangle of the one square (x, y).
    pub fn single(x: i64, y: i64) -> Self {
        Self { x0: x, y0: y, x1: x + 1, y1: y + 1 }
    }

    /// Returns the cells of tile (x, y).
    pub fn cells_of_tile(x: i64, y: i64) -> Self {
        Self { x0: x * TILE, y0: y * TILE, x1: (x + 1) * TILE, y1: (y + 1) * TILE }
    }

    /// Returns whether the rectangle has no squares.
    pub fn is_empty(self) -> bool {
        self.x0 >= self.x1 || self.y0 >= self.y1
    }

    /// Returns the number of columns.
    pub fn width(self) -> usize {
        (self.x1 - self.x0).max(0) as usize
    }

    /// Returns the number of rows.
    pub fn height(self) -> usize {
        (self.y1 - self.y0).max(0) as usize
    }

    /// Returns the number of squares; `None` if it overflows.
    pub fn area(self) -> Option<usize> {
        self.width().checked_mul(self.height())
    }

    /// Returns the squares that lie in both rectangles.
    pub fn intersect(self, other: Self) -> Self {
        Self {
            x0: self.x0.max(other.x0),
            y0: self.y0.max(other.y0),
            x1: self.x1.min(other.x1),
            y1: self.y1.min(other.y1),
        }
    }

    /// Returns the smallest rectangle that contains both.
    pub fn union(self, other: Self) -> Self {
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

    /// Returns whether `other` lies completely inside. An empty rectangle lies inside any other.
    pub fn contains(self, other: Self) -> bool {
        other.is_empty() || self.intersect(other) == other
    }

    /// Returns the rectangle shifted by (`dx`, `dy`) squares.
    pub fn translated(self, dx: i64, dy: i64) -> Self {
        Self { x0: self.x0 + dx, y0: self.y0 + dy, x1: self.x1 + dx, y1: self.y1 + dy }
    }

    /// Returns the row-major index of square (x, y), which must lie inside.
    pub fn index(self, x: i64, y: i64) -> usize {
        (y - self.y0) as usize * self.width() + (x - self.x0) as usize
    }

    /// Returns the tiles that overlap these cells.
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

    /// Iterates over the squares, row by row.
    pub fn points(self) -> impl Iterator<Item = (i64, i64)> {
        (self.y0..self.y1).flat_map(move |y| (self.x0..self.x1).map(move |x| (x, y)))
    }
}
