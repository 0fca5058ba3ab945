//! A map as tiles: squares of [`TILE`] x [`TILE`] cells of a lattice that never moves. Only what is
//! known takes memory, the map grows in any direction without being copied, and what changed is
//! told by which tiles are no longer the same.

mod dense_map;
mod patch;

pub use dense_map::DenseMap;
pub use patch::{PATCH_TILES_MAX, Patch, PatchHeader, PatchReceiver, PatchSender};

use crate::grid::{CELLS_MAX, MAP_CELLS_MAX, UNKNOWN};
use crate::rect::Rect;
use crate::{GridHeader, GridView, Header, Monotonic, Pose2};
use bytemuck::{Pod, Zeroable};
use std::sync::Arc;

/// Cells along a tile's side: 3.2 m at 0.05 m.
pub const TILE: i64 = 64;
/// Cells of a tile.
pub const TILE_CELLS: usize = (TILE * TILE) as usize;
/// The most tiles a robot's map may span, known or not.
pub const ROBOT_TILES_MAX: usize = CELLS_MAX / TILE_CELLS;
/// The most tiles any map may span, known or not.
pub const MAP_TILES_MAX: usize = MAP_CELLS_MAX / TILE_CELLS;
/// Tiles lie this close to the lattice's origin along each axis: 3355 km at 0.05 m.
const TILE_PLACE_MAX: i64 = 1 << 20;

/// One tile.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct MapTile {
    /// It holds the lattice's columns from `x * TILE` on,
    pub x: i32,
    /// and the rows from `y * TILE` on.
    pub y: i32,
    /// Row-major evidence as in [`crate::grid`].
    pub cells: [i8; TILE_CELLS],
}

impl MapTile {
    /// Nothing known. The place must be near enough for an `i32`.
    pub fn unknown(x: i64, y: i64) -> Self {
        Self { x: x as i32, y: y as i32, cells: [UNKNOWN; TILE_CELLS] }
    }

    /// Nothing is known in it.
    pub fn is_unknown(&self) -> bool {
        self.cells.iter().all(|cell| *cell == UNKNOWN)
    }

    /// The smallest box around the known cells, in cells of the lattice.
    pub fn known(&self) -> Rect {
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
        let Some(left) = columns.iter().position(|known| *known) else { return Rect::default() };
        let right = columns.iter().rposition(|known| *known).unwrap_or(left) + 1;
        let inside = Rect { x0: left as i64, y0: first, x1: right as i64, y1: end };
        inside.translated(i64::from(self.x) * TILE, i64::from(self.y) * TILE)
    }
}

/// What holds for a map as a whole.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct MapHeader {
    /// `stamp` is that of the newest scan drawn in.
    pub header: Header,
    /// When that scan left its simulator: what scan-to-map latency is counted from.
    pub scan_sent: Monotonic,
    /// Pose of the lattice's point (0, 0), the lower left corner of cell (0, 0), in the map's frame.
    pub origin: Pose2,
    /// Side of a cell, metres.
    pub resolution_m: f64,
}

impl MapHeader {
    /// Numbers that can be worked with.
    pub fn is_valid(&self) -> bool {
        self.origin.is_finite() && self.resolution_m.is_finite() && self.resolution_m > 0.0
    }

    /// The cells are the same squares.
    pub fn same_lattice(&self, other: &Self) -> bool {
        self.origin == other.origin && self.resolution_m == other.resolution_m
    }

    /// The header of a grid of these cells.
    pub fn of_grid(&self, cells: Rect) -> GridHeader {
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

/// A map. A clone shares its tiles until one of the two changes them, so that a version is kept by
/// cloning, and two versions are compared tile by tile without looking at cells.
#[derive(Clone, Debug, Default)]
pub struct TileMap {
    /// Of the whole map.
    pub header: MapHeader,
    /// In tiles: what there is room for.
    extent: Rect,
    tiles: Vec<Option<Arc<MapTile>>>,
}

impl TileMap {
    /// Nothing known.
    pub fn new(header: MapHeader) -> Self {
        Self { header, extent: Rect::default(), tiles: Vec::new() }
    }

    /// A grid's cells on a lattice on which its own cell (0, 0) is the one in column and row `corner`;
    /// `None` if it spans too many tiles or lies absurdly far away.
    pub fn from_grid(header: MapHeader, corner: [i64; 2], grid: GridView<'_>) -> Option<Self> {
        let mut map = Self::new(header);
        let [dx, dy] = corner;
        let near = corner.iter().all(|c| c.abs() < TILE * TILE_PLACE_MAX);
        let whole = Rect::with_size(grid.header.width, grid.header.height);
        let whole = if near { whole.translated(dx, dy) } else { return None };
        if !map.grow_to(whole.tiles(), MAP_TILES_MAX) {
            return None;
        }
        for (x, y) in whole.tiles().points() {
            let mut tile = MapTile::unknown(x, y);
            let part = Rect::cells_of_tile(x, y).intersect(whole);
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

    /// In tiles: all that is known lies within.
    pub fn extent(&self) -> Rect {
        self.extent
    }

    /// Makes room for these tiles; `false`, and nothing changes, if the map would then span more than
    /// `tiles_max` of them or lie absurdly far away.
    pub fn grow_to(&mut self, tiles: Rect, tiles_max: usize) -> bool {
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

    /// The tile in column `x`, row `y` of tiles, if something is known there.
    pub fn get(&self, x: i64, y: i64) -> Option<&Arc<MapTile>> {
        self.tiles[self.index(x, y)?].as_ref()
    }

    /// Opens the tiles in `part` for which `wanted` holds, to be written.
    pub fn open(&mut self, part: Rect, wanted: impl Fn(i64, i64) -> bool) -> OpenTiles<'_> {
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

    /// The tile to be written, made if need be; `None` where there is no room.
    pub fn get_mut(&mut self, x: i64, y: i64) -> Option<&mut MapTile> {
        let index = self.index(x, y)?;
        Some(own(&mut self.tiles[index], x, y))
    }

    /// Puts a tile, or `None`, where there is room; elsewhere nothing happens.
    pub fn set(&mut self, x: i64, y: i64, tile: Option<Arc<MapTile>>) {
        if let Some(index) = self.index(x, y) {
            self.tiles[index] = tile;
        }
    }

    /// Every tile in which something is or was known, row by row.
    pub fn tiles(&self) -> impl Iterator<Item = &Arc<MapTile>> {
        self.tiles.iter().flatten()
    }

    /// The cell in column `x`, row `y` of the lattice.
    pub fn cell(&self, x: i64, y: i64) -> i8 {
        let tile = self.get(x.div_euclid(TILE), y.div_euclid(TILE));
        tile.map_or(UNKNOWN, |tile| tile.cells[(y.rem_euclid(TILE) * TILE + x.rem_euclid(TILE)) as usize])
    }

    /// The tiles that may differ from those of `before`, row by row: all that are not shared.
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

/// The tile in a slot, for this map alone.
fn own(slot: &mut Option<Arc<MapTile>>, x: i64, y: i64) -> &mut MapTile {
    Arc::make_mut(slot.get_or_insert_with(|| Arc::new(MapTile::unknown(x, y))))
}

/// Some tiles of a map, to be written cell by cell: what a tile costs is paid once, not at each visit.
pub struct OpenTiles<'a> {
    part: Rect,
    slots: Vec<OpenTile<'a>>,
}

enum OpenTile<'a> {
    Closed,
    Slot(&'a mut Option<Arc<MapTile>>),
    Tile(&'a mut MapTile),
}

impl OpenTiles<'_> {
    /// The cells of a tile, made if need be; `None` if it was not opened.
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
            *slot = OpenTile::Tile(own(tile, x, y));
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
    fn grows_in_any_direction_and_keeps_its_tiles() {
        let mut map = TileMap::new(MapHeader { resolution_m: 0.05, ..Default::default() });
        assert!(map.grow_to(Rect::single(0, 0), ROBOT_TILES_MAX));
        map.get_mut(0, 0).unwrap().cells[0] = 5;
        let kept = map.clone();
        for (x, y) in [(-3, 0), (0, -2), (4, 4)] {
            assert!(map.grow_to(Rect::single(x, y), ROBOT_TILES_MAX));
        }
        assert_eq!(map.extent(), Rect { x0: -3, y0: -2, x1: 5, y1: 5 });
        assert_eq!((map.cell(0, 0), map.cell(-1, 0), map.cell(1_000_000, 0)), (5, UNKNOWN, UNKNOWN));
        assert_eq!(map.changed_since(&kept).count(), 0);
        assert!(Arc::ptr_eq(map.get(0, 0).unwrap(), kept.get(0, 0).unwrap()));
        map.get_mut(0, 0).unwrap().cells[0] = 6;
        assert_eq!(map.changed_since(&kept).collect::<Vec<_>>(), [(0, 0)]);
        assert_eq!(kept.cell(0, 0), 5);
    }

    #[test]
    fn has_its_bounds() {
        let mut map = TileMap::default();
        assert!(map.grow_to(Rect::single(0, 0), ROBOT_TILES_MAX));
        assert!(map.grow_to(Rect::single(63, 63), ROBOT_TILES_MAX));
        assert!(!map.grow_to(Rect::single(64, 0), ROBOT_TILES_MAX));
        assert!(!map.grow_to(Rect::single(i64::from(i32::MAX), 0), usize::MAX));
        assert_eq!(map.extent(), Rect { x0: 0, y0: 0, x1: 64, y1: 64 });
        assert!(map.get_mut(64, 0).is_none());
    }

    #[test]
    fn known_cells_are_boxed_exactly() {
        let mut tile = MapTile::unknown(-1, 2);
        assert!(tile.known().is_empty() && tile.is_unknown());
        tile.cells[3 * TILE as usize + 7] = 0;
        tile.cells[9 * TILE as usize + 2] = -5;
        assert_eq!(tile.known(), Rect { x0: -62, y0: 131, x1: -56, y1: 138 });
    }
}
