//! The newest version of a map, and the counts of its free, occupied and unknown cells.

use msg::grid::{MAP_CELLS_MAX, Occupancy, UNKNOWN, occupancy};
use msg::{Grid, GridView, RobotStats};

/// The newest version of a map that has come.
#[derive(Default)]
pub(crate) struct ReceivedMap {
    pub grid: Grid,
    /// Counts of its cells; the rest is zero.
    pub counts: RobotStats,
    /// Number of versions received.
    pub version: u64,
}

impl ReceivedMap {
    /// Replaces the map; a malformed one is ignored.
    pub fn update(&mut self, map: GridView<'_>) {
        if GridView::new(map.header, map.cells).is_none() || map.cells.len() > MAP_CELLS_MAX {
            return;
        }
        self.grid.header = *map.header;
        self.grid.cells.clear();
        self.grid.cells.extend_from_slice(map.cells);
        self.counts = count_cells(map);
        self.version += 1;
    }
}

/// Counts a map's cells by map_server's thresholds. `coverage` is the known share of its rectangle, as in the MR-SLAM
/// paper.
fn count_cells(map: GridView<'_>) -> RobotStats {
    let free = map.cells.iter().filter(|cell| occupancy(**cell) == Occupancy::Free).count();
    let occupied = map.cells.iter().filter(|cell| occupancy(**cell) == Occupancy::Occupied).count();
    let total = map.cells.len();
    debug_assert_eq!(occupancy(UNKNOWN), Occupancy::Unknown);
    RobotStats {
        free_cells: free as u32, // all at most MAP_CELLS_MAX
        occupied_cells: occupied as u32,
        unknown_cells: (total - free - occupied) as u32,
        width: map.header.width,
        height: map.header.height,
        resolution_m: map.header.resolution_m,
        coverage: (free + occupied) as f64 / total.max(1) as f64,
        ..Default::default()
    }
}
