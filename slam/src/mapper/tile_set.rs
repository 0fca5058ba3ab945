//! Set of tiles that a new version of the map draws again.

use msg::IndexRect;

/// A set of tiles within two extents, which may lie far apart.
pub(super) struct TileSet {
    /// Each extent, and for every tile of it whether it is in the set.
    parts: [(IndexRect, Vec<bool>); 2],
}

impl TileSet {
    /// The empty set within two extents.
    pub fn empty_within(extents: [IndexRect; 2]) -> Self {
        Self { parts: extents.map(|all| (all, vec![false; all.width() * all.height()])) }
    }

    /// Adds tiles, as far as they lie within the extents.
    pub fn insert(&mut self, tiles: IndexRect) {
        for (all, marked) in &mut self.parts {
            for (x, y) in tiles.intersect(*all).points() {
                marked[all.index(x, y)] = true;
            }
        }
    }

    /// Whether a tile is in the set.
    pub fn contains(&self, x: i64, y: i64) -> bool {
        self.intersects(IndexRect::single(x, y))
    }

    /// Whether any of these tiles is in the set.
    pub fn intersects(&self, tiles: IndexRect) -> bool {
        let any_marked = |(all, marked): &(IndexRect, Vec<bool>)| {
            tiles.intersect(*all).points().any(|(x, y)| marked[all.index(x, y)])
        };
        self.parts.iter().any(any_marked)
    }
}
