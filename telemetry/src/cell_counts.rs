//! Counts of a map's free, occupied and unknown cells.

use msg::grid::{Occupancy, UNKNOWN, occupancy};
use msg::{GridView, RobotStats};

/// Counts a map's cells by map_server's thresholds. `coverage` is the known share of its rectangle, as in the MR-SLAM
/// paper.
pub(crate) fn count_cells(map: GridView<'_>) -> RobotStats {
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
