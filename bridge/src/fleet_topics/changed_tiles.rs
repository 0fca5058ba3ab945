//! Finds the tiles of a map whose published cells changed, for mr_slam_msgs/MapTiles.

use msg::grid::UNKNOWN;
use msg::{GridHeader, GridView, IndexRect};
use ros_messages::map_tiles::TileUpdate;

/// Side of a tile, cells. A scan changes few of them, and the numbers beside a tile's cells are a fiftieth of it.
const TILE_CELLS: usize = 32;
/// Origins that differ by whole cells do so up to this share of a cell.
const CELL_TOLERANCE: f64 = 1e-3;

/// A copy of the map that was published last, kept only while somebody subscribes to its tiles.
#[derive(Default)]
pub struct ChangedTileFinder {
    header: GridHeader,
    cells: Vec<i8>,
    /// Number of the last update; 0 before the first.
    number: u32,
    areas: Vec<IndexRect>,
}

impl ChangedTileFinder {
    /// Returns what changed since the map before, as published cells of `values`, and keeps this map.
    ///
    /// `None` if nothing did. If there was no map before, or one with other cells, no update can tell: then it has no base.
    pub fn changed_tiles(&mut self, map: GridView<'_>, values: &[i8; 256]) -> Option<TileUpdate<'_>> {
        let place = cell_offset(&self.header, map.header).filter(|_| !self.cells.is_empty());
        let is_same_place = place == Some((0, 0))
            && (self.header.width, self.header.height) == (map.header.width, map.header.height);
        self.areas.clear();
        if let Some(offset) = place {
            if !is_same_place {
                self.cells = moved_cells(&self.header, &self.cells, map.header, offset);
            }
            add_changed(&mut self.areas, &self.cells, map, values);
        }
        self.header = *map.header;
        self.cells.clear();
        self.cells.extend_from_slice(map.cells);
        if is_same_place && self.areas.is_empty() {
            return None;
        }
        let base = if place.is_some() { self.number } else { 0 };
        self.number = self.number.checked_add(1).unwrap_or(1);
        Some(TileUpdate { number: self.number, base, areas: &self.areas })
    }

    /// Forgets the map: nobody wants its tiles.
    pub fn clear(&mut self) {
        self.cells = Vec::new();
    }
}

/// Returns by how many cells the origin of `now` lies behind that of `before`, if the cells of both coincide.
fn cell_offset(before: &GridHeader, now: &GridHeader) -> Option<(i64, i64)> {
    if (before.resolution_m, before.origin.yaw_rad) != (now.resolution_m, now.origin.yaw_rad) {
        return None;
    }
    let cells = before
        .origin
        .inverse()
        .apply([now.origin.x_m, now.origin.y_m])
        .map(|metres| metres / now.resolution_m);
    let is_whole = cells.iter().all(|count| (count - count.round()).abs() < CELL_TOLERANCE);
    is_whole.then(|| (cells[0].round() as i64, cells[1].round() as i64))
}

/// Returns the cells of a map in the place of another one; unknown where the map has none.
fn moved_cells(before: &GridHeader, cells: &[i8], now: &GridHeader, (dx, dy): (i64, i64)) -> Vec<i8> {
    let (width, height) = (now.width as usize, now.height as usize);
    let mut moved = vec![UNKNOWN; width * height];
    // The columns of `now` that `before` has too.
    let first = (-dx).clamp(0, i64::from(now.width));
    let end = (i64::from(before.width) - dx).clamp(first, i64::from(now.width));
    for (y, row) in moved.chunks_exact_mut(width.max(1)).enumerate() {
        let from_y = y as i64 + dy;
        if !(0..i64::from(before.height)).contains(&from_y) || first == end {
            continue;
        }
        let from = (from_y * i64::from(before.width) + first + dx) as usize;
        let count = (end - first) as usize;
        row[first as usize..end as usize].copy_from_slice(&cells[from..from + count]);
    }
    moved
}

/// Adds the changed tiles of a map; neighbours in a row of tiles become one rectangle.
fn add_changed(areas: &mut Vec<IndexRect>, before: &[i8], map: GridView<'_>, values: &[i8; 256]) {
    let (width, height) = (map.header.width as usize, map.header.height as usize);
    let rows_of_tile = TILE_CELLS * width.max(1);
    let mut is_changed = vec![false; width.div_ceil(TILE_CELLS)];
    for (tile_y, (before, now)) in before.chunks(rows_of_tile).zip(map.cells.chunks(rows_of_tile)).enumerate()
    {
        is_changed.fill(false);
        for (before, now) in before.chunks_exact(width.max(1)).zip(now.chunks_exact(width.max(1))) {
            if before != now {
                mark_changed(&mut is_changed, before, now, values);
            }
        }
        let y0 = tile_y * TILE_CELLS;
        let rows = (y0 as i64, (y0 + TILE_CELLS).min(height) as i64);
        for run in runs(&is_changed) {
            let (x0, x1) = ((run.0 * TILE_CELLS) as i64, (run.1 * TILE_CELLS).min(width) as i64);
            areas.push(IndexRect { x0, y0: rows.0, x1, y1: rows.1 });
        }
    }
}

/// Marks the tiles in which two rows of cells are published differently.
fn mark_changed(is_changed: &mut [bool], before: &[i8], now: &[i8], values: &[i8; 256]) {
    let tiles = before.chunks(TILE_CELLS).zip(now.chunks(TILE_CELLS));
    for (is_changed, (before, now)) in is_changed.iter_mut().zip(tiles) {
        let of = |cell: i8| values[cell as u8 as usize];
        *is_changed = *is_changed || (before != now && before.iter().zip(now).any(|(a, b)| of(*a) != of(*b)));
    }
}

/// Returns the runs of true values: first index, and index behind the last.
fn runs(flags: &[bool]) -> impl Iterator<Item = (usize, usize)> {
    let mut from = 0;
    std::iter::from_fn(move || {
        let first = from + flags[from..].iter().position(|flag| *flag)?;
        let end = flags[first..].iter().position(|flag| !flag).map_or(flags.len(), |count| first + count);
        from = end;
        Some((first, end))
    })
}
