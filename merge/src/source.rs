//! One robot's newest map.

use crate::lookup::Lookup;
use crate::trail::Trail;
use msg::{Grid, GridHeader, GridView, MapHeader, MapTile, Pose2, Rect, TileMap};
use std::sync::Arc;

/// Two grids share a lattice if their cells coincide this well, in cells.
const SAME_LATTICE: f64 = 1e-3;

/// One robot of the fleet.
#[derive(Clone, Debug, Default)]
pub(crate) struct Source {
    /// `map` from `robotK/map`, when known.
    pub map_from_robot_map: Option<Pose2>,
    /// The newest map that came; without tiles before the first.
    pub own: TileMap,
    /// The map that is drawn: `own`, or `redrawn` in its place.
    pub map: TileMap,
    /// What the fleet's graph made of the robot's map, where no place alone puts that right.
    pub redrawn: Option<Arc<Grid>>,
    /// From the lattice to `map`; `None` while the robot's place or its map is not known.
    pub lookup: Option<Lookup>,
    /// Tiles of the lattice that `map` reaches.
    pub reach: Rect,
    /// Where the robot has been of late,
    pub trail: Trail,
    /// and the tiles of the lattice that this touches; none while the robot's place is not known.
    pub body: Rect,
}

impl Source {
    /// From the lattice to a map of this robot.
    pub fn lookup_of(&self, header: &MapHeader, lattice_resolution_m: f64) -> Option<Lookup> {
        let map_from_cells = self.map_from_robot_map? * header.origin;
        (header.resolution_m > 0.0)
            .then(|| Lookup::new(map_from_cells, header.resolution_m, lattice_resolution_m))
    }

    /// Tiles of the lattice that the robot's trail touches.
    pub fn body_tiles(&self, lattice_resolution_m: f64) -> Rect {
        self.map_from_robot_map.map_or(Rect::default(), |place| self.trail.tiles(place, lattice_resolution_m))
    }

    /// Puts floor under the robot's trail in a tile.
    pub fn clear(&self, lattice_resolution_m: f64, tile: &mut MapTile) {
        if let Some(place) = self.map_from_robot_map {
            self.trail.clear(place, lattice_resolution_m, tile);
        }
    }

    /// A whole grid as tiles, on the lattice of the robot's last map if the cells coincide. `None` if
    /// it spans too many tiles.
    pub fn tiles_of(&self, grid: GridView<'_>) -> Option<TileMap> {
        let GridHeader { header, scan_sent, origin, resolution_m, .. } = *grid.header;
        let (lattice, corner) = match corner_on(&self.map.header, grid.header) {
            Some(corner) => (self.map.header, corner),
            None => {
                let (origin, corner) = own_lattice(origin, resolution_m);
                (MapHeader { origin, resolution_m, ..Default::default() }, corner)
            }
        };
        TileMap::from_grid(MapHeader { header, scan_sent, ..lattice }, corner, grid)
    }
}

/// Tiles of the lattice that a map reaches.
pub(crate) fn reach(map: &TileMap, lookup: Option<&Lookup>) -> Rect {
    let tiles = map.tiles().map(|tile| Rect::cells_of_tile(tile.x.into(), tile.y.into()));
    let cells = tiles.fold(Rect::default(), Rect::union);
    lookup.map_or(Rect::default(), |lookup| lookup.lattice_box(cells).tiles())
}

/// The lattice's cell in which a grid's cell (0, 0) lies, if all cells of the two coincide.
fn corner_on(lattice: &MapHeader, grid: &GridHeader) -> Option<[i64; 2]> {
    let lattice_from_grid = lattice.origin.between(grid.origin);
    let far = f64::from(grid.width.max(grid.height)).max(1.0);
    let same = lattice.resolution_m > 0.0
        && ((grid.resolution_m / lattice.resolution_m - 1.0) * far).abs() < SAME_LATTICE
        && (lattice_from_grid.yaw_rad * far).abs() < SAME_LATTICE;
    let corner = [lattice_from_grid.x_m, lattice_from_grid.y_m].map(|metres| metres / lattice.resolution_m);
    let whole = corner.iter().all(|c| (c - c.round()).abs() < SAME_LATTICE && c.abs() < 1e9);
    (same && whole).then(|| corner.map(|c| c.round() as i64))
}

/// A lattice for a grid that is the same for every window on the same cells: its point (0, 0) is the
/// cells' corner nearest to the frame's origin. With it, the cell in which the grid's (0, 0) lies.
fn own_lattice(origin: Pose2, resolution_m: f64) -> (Pose2, [i64; 2]) {
    let turn = Pose2::new(0.0, 0.0, origin.yaw_rad);
    let [x_m, y_m] = turn.inverse().apply([origin.x_m, origin.y_m]);
    let corner = [x_m, y_m].map(|metres| (metres / resolution_m).round());
    let back = Pose2::new(-corner[0] * resolution_m, -corner[1] * resolution_m, 0.0);
    (origin * back, corner.map(|c| c as i64))
}
