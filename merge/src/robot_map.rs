//! One robot's newest map and its place on the lattice of the merged map.

use crate::resample::Resampler;
use crate::swept_area::SweptArea;
use msg::{Grid, GridHeader, GridView, IndexRect, MapHeader, MapTile, Pose2, TileMap};
use std::sync::Arc;

/// Two grids share a lattice if no cell of one is off the other's by more than this, in cells.
const LATTICE_TOLERANCE_CELLS: f64 = 1e-3;

/// One robot of a [`crate::Merger`].
#[derive(Clone, Debug, Default)]
pub(crate) struct RobotMap {
    /// Frame `map` from frame `robotK/map`; `None` while it is unknown.
    pub map_from_robot_map: Option<Pose2>,
    /// The newest map that the robot sent; without tiles before the first.
    pub own: TileMap,
    /// The map in use: `own`, or `redrawn` as tiles.
    pub drawn: TileMap,
    /// The map that the fleet's pose graph redrew, if no single transform aligns all of `own`.
    pub redrawn: Option<Arc<Grid>>,
    /// Resamples `drawn` on the lattice; `None` while the transform or the map is unknown.
    pub resampler: Option<Resampler>,
    /// Tiles of the lattice that `drawn` reaches.
    pub tiles: IndexRect,
    /// The area that the robot swept most recently.
    pub path: SweptArea,
    /// Tiles of the lattice that `path` touches; none while the transform is unknown.
    pub path_tiles: IndexRect,
}

impl RobotMap {
    /// Builds the resampler for a map of this robot.
    pub fn resampler_for(&self, header: &MapHeader, lattice_resolution_m: f64) -> Option<Resampler> {
        let map_from_cells = self.map_from_robot_map? * header.origin;
        (header.resolution_m > 0.0)
            .then(|| Resampler::new(map_from_cells, header.resolution_m, lattice_resolution_m))
    }

    /// Tiles of the lattice that the robot's path touches where its map lies now.
    pub fn current_path_tiles(&self, lattice_resolution_m: f64) -> IndexRect {
        self.map_from_robot_map
            .map_or(IndexRect::default(), |transform| self.path.tiles(transform, lattice_resolution_m))
    }

    /// Sets the cells of a tile under the robot's path to floor.
    pub fn clear_path(&self, lattice_resolution_m: f64, tile: &mut MapTile) {
        if let Some(transform) = self.map_from_robot_map {
            self.path.clear_tile(transform, lattice_resolution_m, tile);
        }
    }

    /// Converts a grid to tiles, on the lattice of the drawn map if their cells coincide. `None` if it spans too many
    /// tiles.
    pub fn tiles_of(&self, grid: GridView<'_>) -> Option<TileMap> {
        let GridHeader { header, scan_sent, origin, resolution_m, .. } = *grid.header;
        let (lattice, corner) = match corner_on(&self.drawn.header, grid.header) {
            Some(corner) => (self.drawn.header, corner),
            None => {
                let (origin, corner) = own_lattice(origin, resolution_m);
                (MapHeader { origin, resolution_m, ..Default::default() }, corner)
            }
        };
        TileMap::from_grid(MapHeader { header, scan_sent, ..lattice }, corner, grid)
    }
}

/// Tiles of the lattice that a map reaches.
pub(crate) fn lattice_tiles(map: &TileMap, resampler: Option<&Resampler>) -> IndexRect {
    let tiles = map.tiles().map(|tile| IndexRect::cells_of_tile(tile.x.into(), tile.y.into()));
    let cells = tiles.fold(IndexRect::default(), IndexRect::union);
    resampler.map_or(IndexRect::default(), |resampler| resampler.lattice_cells(cells).tiles())
}

/// Cell of the lattice that holds a grid's cell (0, 0); `None` unless all cells of the two coincide.
fn corner_on(lattice: &MapHeader, grid: &GridHeader) -> Option<[i64; 2]> {
    /// Beyond this many cells whole numbers are no longer exact enough to compare.
    const CORNER_MAX: f64 = 1e9;
    let lattice_from_grid = lattice.origin.between(grid.origin);
    let side = f64::from(grid.width.max(grid.height)).max(1.0);
    let same_axes = lattice.resolution_m > 0.0
        && ((grid.resolution_m / lattice.resolution_m - 1.0) * side).abs() < LATTICE_TOLERANCE_CELLS
        && (lattice_from_grid.yaw_rad * side).abs() < LATTICE_TOLERANCE_CELLS;
    let corner = [lattice_from_grid.x_m, lattice_from_grid.y_m].map(|metres| metres / lattice.resolution_m);
    let is_whole = |c: &f64| (c - c.round()).abs() < LATTICE_TOLERANCE_CELLS && c.abs() < CORNER_MAX;
    (same_axes && corner.iter().all(is_whole)).then(|| corner.map(|c| c.round() as i64))
}

/// A lattice for a grid, and the cell of the lattice that holds the grid's cell (0, 0).
///
/// The lattice is the same for every window on the same cells: its origin is the corner of a cell nearest to the
/// frame's origin.
fn own_lattice(origin: Pose2, resolution_m: f64) -> (Pose2, [i64; 2]) {
    let rotation = Pose2::new(0.0, 0.0, origin.yaw_rad);
    let [x_m, y_m] = rotation.inverse().apply([origin.x_m, origin.y_m]);
    let corner = [x_m, y_m].map(|metres| (metres / resolution_m).round());
    let to_corner = Pose2::new(-corner[0] * resolution_m, -corner[1] * resolution_m, 0.0);
    (origin * to_corner, corner.map(|c| c as i64))
}
