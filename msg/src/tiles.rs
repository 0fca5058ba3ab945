//! Maps stored as tiles, squares of [`TILE`] x [`TILE`] cells of a lattice that never moves.
//!
//! Only known tiles take memory. A map grows in any direction without a copy of its cells. Two versions of
//! a map differ where they do not share a tile.

mod dense_map;
mod patch;

pub use crate::rect::TILE;
pub use dense_map::DenseMap;
pub use patch::{PATCH_TILES_MAX, Patch, PatchHeader, PatchReceiver, PatchSender};

use crate::grid::{CELLS_MAX, MAP_CELLS_MAX, UNKNOWN};
use crate::rect::IndexRect;
use crate::{GridHeader, GridView, Header, Monotonic, Pose2};
use bytemuck::{Pod, Zeroable};
use std::sync::Arc;

/// Number of cells of a tile.
pub const TILE_CELLS: usize = (TILE * TILE) as usize;
/// Largest number of tiles that a robot's map may span, known or not.
pub const ROBOT_TILES_MAX: usize = CELLS_MAX / TILE_CELLS;
/// Largest number of tiles that any map may span, known or not.
pub const MAP_TILES_MAX: usize = MAP_CELLS_MAX / TILE_CELLS;
/// Largest distance of a tile from the lattice's origin along each axis, tiles: 3355 km at 0.05 m.
const TILE_PLACE_MAX: i64 = 1 << 20;

/// One tile of a map.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct MapTile {
    /// Column of the tile: its first column of cells is `x * TILE`.
    pub x: i32,
    /// Row of the tile: its first row of cells is `y * TILE`.
    pub y: i32,
    /// Row-major cells as in [`crate::grid`].
    pub cells: [i8; TILE_CELLS],
}

impl MapTile {
    /// Creates a tile of unknown cells. Its column and row must fit into an `i32`.
    pub fn unknown(x: i64, y: i64) -> Self {
        Self { x: x as i32, y: y as i32, cells: [UNKNOWN; TILE_CELLS] }
    }

    /// Returns whether all cells are unknown.
    pub fn is_unknown(&self) -> bool {
        self.cells.iter().all(|cell| *cell == UNKNOWN)
    }

    /// Returns the smallest rectangle around the known cells, in cells of the lattice.
    pub fn known(&self) -> IndexRect {
        let mut columns = [false; TILE as usize];
        let (mut first, mut end) = (TILE, 0);
        for (y, row) in self.cells.as_chunks::<{ TILE as usize }>().0.iter().enumerate() {
            let mut any = false;
            for (column, cell) in columns.iter_mut().zip(row) {
                *column |= *cell != UNKNOWN;
                any |= *cell != UNKNOWN;
            }
            if any {
                (first, end) = (first.min(y as i64), y as i64 + 1);
            }
        }
        let Some(left) = columns.iter().position(|known| *known) else { return IndexRect::default() };
        let right = columns.iter().rposition(|known| *known).unwrap_or(left) + 1;
        let inside = IndexRect { x0: left as i64, y0: first, x1: right as i64, y1: end };
        inside.translated(i64::from(self.x) * TILE, i64::from(self.y) * TILE)
    }
}

/// Stamp, resolution and origin of a tiled map.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct MapHeader {
    /// Header whose `stamp` is that of the newest scan in the map.
    pub header: Header,
    /// Time at which that scan left its simulator. Scan-to-map latency is counted from it.
    pub scan_sent: Monotonic,
    /// Pose of the lattice's point (0, 0), the lower left corner of cell (0, 0), in the map's frame.
    pub origin: Pose2,
    /// Length of a cell's side, metres.
    pub resolution_m: f64,
}

impl MapHeader {
    /// Returns whether the origin is finite and the resolution is positive.
    pub fn is_valid(&self) -> bool {
        self.origin.is_finite() && self.resolution_m.is_finite() && self.resolution_m > 0.0
    }

    /// Returns whether two maps have the same lattice, so that their cells are the same squares.
    pub fn same_lattice(&self, other: &Self) -> bool {
        self.origin == other.origin && self.resolution_m == other.resolution_m
    }

    /// Returns the header of a grid that shows these cells.
    pub fn grid_header(&self, cells: IndexRect) -> GridHeader {
        let corner = [cells.x0, cells.y0].map(|cell| cell as f64 * self.resolution_m);
        GridHeader {
            header: self.header,
            scan_sent: self.scan_sent,
            origin: self.origin * Pose2::new(corner[0], corner[1], 0.0),
            resolution_m: self.resolution_m,
            width: cells.width() as u32,
            height: cells.height() as u32,
        }
    }
}

/// Occupancy map stored as shared tiles.
///
/// A clone shares its tiles until one of the two maps changes them. Cloning therefore keeps a version
/// cheaply, and two versions are compared tile by tile without reading cells.
///
/// ```
/// use msg::tiles::MAP_TILES_MAX;
/// use msg::{MapHeader, IndexRect, TileMap};
///
/// let mut map = TileMap::new(MapHeader { resolution_m: 0.05, ..MapHeader::default() });
/// assert!(map.grow_to(IndexRect::single(-1, 0), MAP_TILES_MAX));
/// map.get_mut(-1, 0).unwrap().cells[0] = msg::grid::LOG_ODDS_MAX;
/// assert_eq!(map.cell(-64, 0), msg::grid::LOG_ODDS_MAX);
///
/// let before = map.clone();
/// map.get_mut(-1, 0).unwrap().cells[1] = msg::grid::LOG_ODDS_MIN;
/// assert_eq!(map.changed_since(&before).collect::<Vec<_>>(), [(-1, 0)]);
/// ```
#[derive(Clone, Debug, Default)]
pub struct TileMap {
    /// Stamp, resolution and origin of the map.
    pub header: MapHeader,
    /// Rectangle of tiles that `tiles` has slots for.
    extent: IndexRect,
    tiles: Vec<Option<Arc<MapTile>>>,
}

impl TileMap {
    /// Creates a map without known cells.
    pub fn new(header: MapHeader) -> Self {
        Self { header, extent: IndexRect::default(), tiles: Vec::new() }
    }

    /// Copies a grid into tiles. The grid's cell (0, 0) becomes the lattice's cell `corner` (column, row).
    /// `None` if the map would exceed [`MAP_TILES_MAX`] or the largest distance from the origin.
    pub fn from_grid(header: MapHeader, corner: [i64; 2], grid: GridView<'_>) -> Option<Self> {
        let mut map = Self::new(header);
        let [dx, dy] = corner;
        let near = corner.iter().all(|c| c.abs() < TILE * TILE_PLACE_MAX);
        let whole = IndexRect::with_size(grid.header.width, grid.header.height);
        let whole = if near { whole.translated(dx, dy) } else { return None };
        if !map.grow_to(whole.tiles(), MAP_TILES_MAX) {
            return None;
        }
        for (x, y) in whole.tiles().points() {
            let mut tile = MapTile::unknown(x, y);
            let part = IndexRect::cells_of_tile(x, y).intersect(whole);
            for row in part.y0..part.y1 {
                let start = whole.index(part.x0, row);
                let to = ((row - y * TILE) * TILE + part.x0 - x * TILE) as usize;
                tile.cells[to..to + part.width()].copy_from_slice(&grid.cells[start..start + part.width()]);
            }
            if !tile.is_unknown() {
                map.set(x, y, Some(Arc::new(tile)));
            }
        }
        Some(map)
    }

    /// Returns the rectangle of tiles that contains all known cells.
    pub fn extent(&self) -> IndexRect {
        self.extent
    }

    /// Extends the map to these tiles. `false`, without a change, if it would then span more than
    /// `tiles_max` tiles or exceed the largest distance from the origin.
    pub fn grow_to(&mut self, tiles: IndexRect, tiles_max: usize) -> bool {
        if self.extent.contains(tiles) {
            return true;
        }
        let extent = self.extent.union(tiles);
        let near = [extent.x0, extent.y0, extent.x1, extent.y1].iter().all(|v| v.abs() <= TILE_PLACE_MAX);
        if !near || extent.area().is_none_or(|area| area > tiles_max.min(MAP_TILES_MAX)) {
            return false;
        }
        let mut moved = vec![None; extent.width() * extent.height()];
        for ((x, y), tile) in self.extent.points().zip(self.tiles.drain(..)) {
            moved[extent.index(x, y)] = tile;
        }
        (self.extent, self.tiles) = (extent, moved);
        true
    }

    fn index(&self, x: i64, y: i64) -> Option<usize> {
        let e = self.extent;
        (x >= e.x0 && x < e.x1 && y >= e.y0 && y < e.y1).then(|| e.index(x, y))
    }

    /// Returns the tile in column `x`, row `y`; `None` if it has no known cells.
    pub fn get(&self, x: i64, y: i64) -> Option<&Arc<MapTile>> {
        self.tiles[self.index(x, y)?].as_ref()
    }

    /// Opens the tiles in `part` that `wanted` selects, for writing cell by cell.
    pub fn open(&mut self, part: IndexRect, wanted: impl Fn(i64, i64) -> bool) -> OpenTiles<'_> {
        let part = part.intersect(self.extent);
        let mut slots = Vec::with_capacity(part.area().unwrap_or(0));
        let width = self.extent.width().max(1);
        let rows = self.tiles.chunks_mut(width).zip(self.extent.y0..);
        for (row, y) in rows.filter(|(_, y)| (part.y0..part.y1).contains(y)) {
            for (slot, x) in row.iter_mut().zip(self.extent.x0..) {
                if (part.x0..part.x1).contains(&x) {
                    slots.push(if wanted(x, y) { OpenTile::Slot(slot) } else { OpenTile::Closed });
                }
            }
        }
        OpenTiles { part, slots }
    }

    /// Returns a tile for writing and creates it if needed; `None` outside of the extent.
    pub fn get_mut(&mut self, x: i64, y: i64) -> Option<&mut MapTile> {
        let index = self.index(x, y)?;
        Some(tile_mut(&mut self.tiles[index], x, y))
    }

    /// Replaces a tile inside the extent. Outside of it nothing happens.
    pub fn set(&mut self, x: i64, y: i64, tile: Option<Arc<MapTile>>) {
        if let Some(index) = self.index(x, y) {
            self.tiles[index] = tile;
        }
    }

    /// Iterates over the stored tiles, row by row.
    pub fn tiles(&self) -> impl Iterator<Item = &Arc<MapTile>> {
        self.tiles.iter().flatten()
    }

    /// Returns the cell in column `x`, row `y` of the lattice.
    pub fn cell(&self, x: i64, y: i64) -> i8 {
        let tile = self.get(x.div_euclid(TILE), y.div_euclid(TILE));
        tile.map_or(UNKNOWN, |tile| tile.cells[(y.rem_euclid(TILE) * TILE + x.rem_euclid(TILE)) as usize])
    }

    /// Iterates over the tiles that `before` does not share and that may therefore differ, row by row.
    pub fn changed_since<'a>(&'a self, before: &'a Self) -> impl Iterator<Item = (i64, i64)> + 'a {
        let same = |a: Option<&Arc<MapTile>>, b: Option<&Arc<MapTile>>| match (a, b) {
            (Some(a), Some(b)) => Arc::ptr_eq(a, b),
            (None, None) => true,
            _ => false,
        };
        let all = self.extent.union(before.extent);
        all.points().filter(move |(x, y)| !same(self.get(*x, *y), before.get(*x, *y)))
    }
}

/// Returns the tile of a slot for writing. It is copied first if another map shares it.
fn tile_mut(slot: &mut Option<Arc<MapTile>>, x: i64, y: i64) -> &mut MapTile {
    Arc::make_mut(slot.get_or_insert_with(|| Arc::new(MapTile::unknown(x, y))))
}

/// Tiles of a map that are open for writing cell by cell.
///
/// A shared tile is copied once at its first access, not at each access.
pub struct OpenTiles<'a> {
    part: IndexRect,
    slots: Vec<OpenTile<'a>>,
}

enum OpenTile<'a> {
    Closed,
    Slot(&'a mut Option<Arc<MapTile>>),
    Tile(&'a mut MapTile),
}

impl OpenTiles<'_> {
    /// Returns the cells of a tile and creates it if needed; `None` if the tile is not open.
    #[inline]
    pub fn cells(&mut self, x: i64, y: i64) -> Option<&mut [i8; TILE_CELLS]> {
        let e = self.part;
        if x < e.x0 || x >= e.x1 || y < e.y0 || y >= e.y1 {
            return None;
        }
        let slot = &mut self.slots[e.index(x, y)];
        if let OpenTile::Slot(_) = slot
            && let OpenTile::Slot(tile) = std::mem::replace(slot, OpenTile::Closed)
        {
            *slot = OpenTile::Tile(tile_mut(tile, x, y));
        }
        match slot {
            OpenTile::Tile(tile) => Some(&mut tile.cells),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_grows_in_any_direction_and_keeps_its_tiles() {
        let mut map = TileMap::new(MapHeader { resolution_m: 0.05, ..Default::default() });
        assert!(map.grow_to(IndexRect::single(0, 0), ROBOT_TILES_MAX));
        map.get_mut(0, 0).unwrap().cells[0] = 5;
        let kept = map.clone();
        for (x, y) in [(-3, 0), (0, -2), (4, 4)] {
            assert!(map.grow_to(IndexRect::single(x, y), ROBOT_TILES_MAX));
        }
        assert_eq!(map.extent(), IndexRect { x0: -3, y0: -2, x1: 5, y1: 5 });
        assert_eq!((map.cell(0, 0), map.cell(-1, 0), map.cell(1_000_000, 0)), (5, UNKNOWN, UNKNOWN));
        assert_eq!(map.changed_since(&kept).count(), 0);
        assert!(Arc::ptr_eq(map.get(0, 0).unwrap(), kept.get(0, 0).unwrap()));
        map.get_mut(0, 0).unwrap().cells[0] = 6;
        assert_eq!(map.changed_since(&kept).collect::<Vec<_>>(), [(0, 0)]);
        assert_eq!(kept.cell(0, 0), 5);
    }

    #[test]
    fn a_map_does_not_grow_beyond_its_bounds() {
        let mut map = TileMap::default();
        assert!(map.grow_to(IndexRect::single(0, 0), ROBOT_TILES_MAX));
        assert!(map.grow_to(IndexRect::single(63, 63), ROBOT_TILES_MAX));
        assert!(!map.grow_to(IndexRect::single(64, 0), ROBOT_TILES_MAX));
        assert!(!map.grow_to(IndexRect::single(i64::from(i32::MAX), 0), usize::MAX));
        assert_eq!(map.extent(), IndexRect { x0: 0, y0: 0, x1: 64, y1: 64 });
        assert!(map.get_mut(64, 0).is_none());
    }

    #[test]
    fn the_known_rectangle_is_the_smallest_around_known_cells() {
        let mut tile = MapTile::unknown(-1, 2);
        assert!(tile.known().is_empty() && tile.is_unknown());
        tile.cells[3 * TILE as usize + 7] = 0;
        tile.cells[9 * TILE as usize + 2] = -5;
        assert_eq!(tile.known(), IndexRect { x0: -62, y0: 131, x1: -56, y1: 138 });
    }
}
