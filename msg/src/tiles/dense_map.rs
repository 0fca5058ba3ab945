//! A tiled map as one dense grid, updated tile by tile.

use super::{MAP_TILES_MAX, MapTile, TILE, TileMap};
use crate::grid::UNKNOWN;
use crate::rect::IndexRect;
use crate::{Grid, GridView};

/// The smallest grid that contains all known cells of a [`TileMap`].
#[derive(Clone, Debug, Default)]
pub struct DenseMap {
    /// Version of the map that `grid` shows.
    map: TileMap,
    /// Rectangle of known cells of each tile of `map`, by the tile's index in the extent.
    known: Vec<IndexRect>,
    /// Cells of the lattice that `grid` shows.
    window: IndexRect,
    grid: Grid,
}

impl DenseMap {
    /// Updates the grid to a version of the map. Copies only changed tiles unless the known part changed its size.
    pub fn update(&mut self, map: &TileMap) -> GridView<'_> {
        let known = self.known_of(map);
        let window = known.iter().fold(IndexRect::default(), |all, part| all.union(*part));
        if window == self.window {
            let changed: Vec<(i64, i64)> = map.changed_since(&self.map).collect();
            changed.into_iter().for_each(|(x, y)| self.copy(map, x, y));
        } else {
            self.window = window;
            self.grid.cells.clear();
            self.grid.cells.resize(window.width() * window.height(), UNKNOWN);
            window.tiles().points().for_each(|(x, y)| self.copy(map, x, y));
        }
        self.grid.header = map.header.grid_header(window);
        (self.map, self.known) = (map.clone(), known);
        self.view()
    }

    /// Returns the grid as of the last update.
    pub fn view(&self) -> GridView<'_> {
        self.grid.view()
    }

    /// Returns the cells of the map's lattice that the grid shows.
    pub fn window(&self) -> IndexRect {
        self.window
    }

    fn known_of(&self, map: &TileMap) -> Vec<IndexRect> {
        debug_assert!(map.extent().area().is_some_and(|tiles| tiles <= MAP_TILES_MAX));
        let before = |x, y| self.known[self.map.extent().index(x, y)];
        let known = |(x, y)| match (map.get(x, y), self.map.get(x, y)) {
            (Some(tile), Some(old)) if std::sync::Arc::ptr_eq(tile, old) => before(x, y),
            (Some(tile), _) => tile.known(),
            (None, _) => IndexRect::default(),
        };
        map.extent().points().map(known).collect()
    }

    /// Copies the part of a tile that lies in the window.
    fn copy(&mut self, map: &TileMap, x: i64, y: i64) {
        let part = IndexRect::cells_of_tile(x, y).intersect(self.window);
        if part.is_empty() {
            return;
        }
        let tile: Option<&MapTile> = map.get(x, y).map(|tile| &**tile);
        for row in part.y0..part.y1 {
            let to = self.window.index(part.x0, row);
            let to = &mut self.grid.cells[to..to + part.width()];
            let from = ((row - y * TILE) * TILE + part.x0 - x * TILE) as usize;
            match tile {
                Some(tile) => to.copy_from_slice(&tile.cells[from..from + part.width()]),
                None => to.fill(UNKNOWN),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tiles::MapHeader;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// After any sequence of edits, the updated grid equals a new one and is not larger than needed.
        #[test]
        fn an_updated_grid_equals_a_new_one(edits in prop::collection::vec(
            (-150_i64..150, -150_i64..150, prop_oneof![Just(UNKNOWN), -127_i8..=127], any::<bool>()), 1..40,
        )) {
            let mut map = TileMap::new(MapHeader { resolution_m: 0.1, ..Default::default() });
            let mut dense = DenseMap::default();
            for (x, y, cell, look) in edits {
                let (tx, ty) = (x.div_euclid(TILE), y.div_euclid(TILE));
                prop_assert!(map.grow_to(IndexRect::single(tx, ty), 64));
                let place = (y.rem_euclid(TILE) * TILE + x.rem_euclid(TILE)) as usize;
                map.get_mut(tx, ty).unwrap().cells[place] = cell;
                if look {
                    dense.update(&map);
                }
            }
            let updated = dense.update(&map).to_owned();
            let window = dense.window();
            prop_assert_eq!(&updated, &DenseMap::default().update(&map).to_owned());
            let everything = IndexRect { x0: -192, y0: -192, x1: 192, y1: 192 };
            let known = everything.points().filter(|(x, y)| map.cell(*x, *y) != UNKNOWN);
            let smallest = known.fold(IndexRect::default(), |all, (x, y)| all.union(IndexRect::single(x, y)));
            prop_assert_eq!(window, smallest);
            for ((x, y), cell) in window.points().zip(&updated.cells) {
                prop_assert_eq!(map.cell(x, y), *cell);
            }
        }
    }
}
