//! Known cells of maps, and what a map lacks of an older one.

use std::collections::BTreeSet;

/// Cells in whole cells from the origin of a map's frame.
pub type Cells = BTreeSet<(i64, i64)>;

/// Returns the known cells of a map.
pub fn known_cells(map: &msg::GridView<'_>) -> Cells {
    let cell = |metres: f64| (metres / map.header.resolution_m).round() as i64;
    let (x0, y0) = (cell(map.header.origin.x_m), cell(map.header.origin.y_m));
    let width = map.header.width as usize;
    let known = map.cells.iter().enumerate().filter(|(_, cell)| **cell != 0);
    known.map(|(k, _)| (x0 + (k % width) as i64, y0 + (k / width) as i64)).collect()
}

/// Counts cells of `before` that have no known cell in or around their place in `after`.
pub fn count_lost(before: &Cells, after: &Cells) -> usize {
    let is_near = |(x, y): &(i64, i64)| (-1..=1).any(|i| (-1..=1).any(|j| after.contains(&(x + i, y + j))));
    before.iter().filter(|cell| !is_near(cell)).count()
}
