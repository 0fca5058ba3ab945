//! One robot's newest map, and what of it changed.

use crate::layer::{Layer, Lookup};
use crate::rect::{Rect, TILE};
use msg::grid::UNKNOWN;
use msg::{Grid, GridHeader, GridView, Pose2};

/// Two grids share a lattice if their cells coincide this well, in cells.
const SAME_LATTICE: f64 = 1e-3;

/// One robot of the fleet.
#[derive(Clone, Debug, Default)]
pub(crate) struct Source {
    /// `map` from `robotK/map`, when known.
    pub map_from_robot_map: Option<Pose2>,
    /// The newest map; without cells before the first.
    pub grid: Grid,
    /// The cells of `grid` beyond which no tile has a known cell.
    pub known: Rect,
    /// `grid` on the lattice; empty while the robot's place is not known.
    pub layer: Layer,
}

/// What a new map changes.
pub(crate) struct Change {
    /// Tiles of the new map that are not as before, in its cells.
    pub tiles: Vec<Rect>,
    /// What [`Source::known`] becomes.
    pub known: Rect,
    /// Nothing of the old map's layer can be kept.
    pub afresh: bool,
}

impl Source {
    /// Compares a new map with the stored one.
    pub fn compare(&self, new: GridView<'_>) -> Change {
        let whole = Rect::of_size(new.header.width, new.header.height);
        let kept = old_from_new_shift(&self.grid.header, new.header)
            .map(|shift| (shift, moved(self.known, [-shift[0], -shift[1]])))
            .filter(|(_, known)| whole.holds(*known));
        let (tiles, known) = match kept {
            Some((shift, known)) => (changed_tiles(self.grid.view(), shift, new), known),
            None => (known_tiles(new), Rect::default()),
        };
        let known = tiles.iter().filter(|tile| any_known(new, **tile)).fold(known, |a, b| a.unite(*b));
        Change { tiles, known, afresh: kept.is_none() }
    }

    /// Stores a new map, touching only what changed if the shape is the same.
    pub fn store(&mut self, new: GridView<'_>, change: &Change) {
        let same_shape = !change.afresh
            && (self.grid.header.width, self.grid.header.height) == (new.header.width, new.header.height);
        if same_shape {
            let width = new.header.width as usize;
            for (tile, y) in change.tiles.iter().flat_map(|tile| (tile.y0..tile.y1).map(move |y| (tile, y))) {
                let row = y as usize * width;
                let part = row + tile.x0 as usize..row + tile.x1 as usize;
                self.grid.cells[part.clone()].copy_from_slice(&new.cells[part]);
            }
            self.grid.header = *new.header;
        } else {
            self.grid = new.to_owned();
        }
        self.known = change.known;
    }

    /// From the lattice to a grid of this robot.
    pub fn lookup(&self, header: &GridHeader, lattice_resolution_m: f64) -> Option<Lookup> {
        let map_from_grid = self.map_from_robot_map? * header.origin;
        Some(Lookup::new(map_from_grid, header.resolution_m, lattice_resolution_m))
    }
}

fn moved(rect: Rect, [dx, dy]: [i64; 2]) -> Rect {
    Rect { x0: rect.x0 + dx, y0: rect.y0 + dy, x1: rect.x1 + dx, y1: rect.y1 + dy }
}

/// The whole number of cells that leads from a cell of `new` to the same square in `old`.
fn old_from_new_shift(old: &GridHeader, new: &GridHeader) -> Option<[i64; 2]> {
    let old_from_new = old.origin.between(new.origin);
    let corner = f64::from(new.width.max(new.height)).max(1.0);
    let same = old.resolution_m > 0.0
        && ((new.resolution_m / old.resolution_m - 1.0) * corner).abs() < SAME_LATTICE
        && (old_from_new.yaw_rad * corner).abs() < SAME_LATTICE;
    let shift = [old_from_new.x_m, old_from_new.y_m].map(|metres| metres / old.resolution_m);
    let whole = shift.iter().all(|s| (s - s.round()).abs() < SAME_LATTICE && s.abs() < 1e9);
    (same && whole).then(|| shift.map(|s| s.round() as i64))
}

/// The tiles of a grid, cut from its cell (0, 0).
fn tiles_of(grid: GridView<'_>) -> impl Iterator<Item = Rect> {
    let whole = Rect::of_size(grid.header.width, grid.header.height);
    whole.tiles().points().map(move |(x, y)| Rect::of_tile(x, y).intersect(whole))
}

fn row(grid: GridView<'_>, x0: i64, x1: i64, y: i64) -> &[i8] {
    let start = y as usize * grid.header.width as usize + x0 as usize;
    &grid.cells[start..start + (x1 - x0) as usize]
}

fn any_known(grid: GridView<'_>, tile: Rect) -> bool {
    (tile.y0..tile.y1)
        .any(|y| row(grid, tile.x0, tile.x1, y).iter().fold(false, |any, c| any | (*c != UNKNOWN)))
}

fn known_tiles(grid: GridView<'_>) -> Vec<Rect> {
    tiles_of(grid).filter(|tile| any_known(grid, *tile)).collect()
}

/// Row by row: most rows are equal, and comparing long rows is what a machine does fastest.
fn changed_tiles(old: GridView<'_>, shift: [i64; 2], new: GridView<'_>) -> Vec<Rect> {
    let whole = Rect::of_size(new.header.width, new.header.height);
    let old_whole = moved(Rect::of_size(old.header.width, old.header.height), [-shift[0], -shift[1]]);
    let both = whole.intersect(old_whole);
    let mut changed = Vec::new();
    let mut marked = vec![false; whole.tiles().width()];
    for strip in whole.tiles().y0..whole.tiles().y1 {
        marked.fill(false);
        for y in strip * TILE..((strip + 1) * TILE).min(whole.y1) {
            let shared =
                if (both.y0..both.y1).contains(&y) && !both.is_empty() { both.x0..both.x1 } else { 0..0 };
            let old_row = row_or_empty(old, shared.start + shift[0], shared.end + shift[0], y + shift[1]);
            mark_row(&mut marked, row(new, 0, whole.x1, y), shared, old_row);
        }
        let tiles = marked.iter().enumerate().filter(|(_, marked)| **marked);
        changed.extend(tiles.map(|(x, _)| Rect::of_tile(x as i64, strip).intersect(whole)));
    }
    changed
}

fn row_or_empty(grid: GridView<'_>, x0: i64, x1: i64, y: i64) -> &[i8] {
    if x0 < x1 { row(grid, x0, x1, y) } else { &[] }
}

/// Marks the tiles in which a row is not as before. `old` covers the columns `shared` of `new`;
/// beyond them nothing was known.
fn mark_row(marked: &mut [bool], new: &[i8], shared: core::ops::Range<i64>, old: &[i8]) {
    let (from, to) = (shared.start as usize, shared.end as usize);
    let unknown = |cells: &[i8]| cells.iter().fold(true, |all, cell| all & (*cell == UNKNOWN));
    if new[from..to] == *old && unknown(&new[..from]) && unknown(&new[to..]) {
        return;
    }
    for (tile, mark) in marked.iter_mut().enumerate() {
        let start = tile * TILE as usize;
        let end = (start + TILE as usize).min(new.len());
        let (a, b) = (start.clamp(from, to), end.clamp(from, to));
        let same = if a < b {
            new[a..b] == old[a - from..b - from] && unknown(&new[start..a]) && unknown(&new[b..end])
        } else {
            unknown(&new[start..end])
        };
        *mark |= !same;
    }
}
