//! Rooms from occupancy grids, such as the maps that SLAM or map_server's map_saver saves.
//!
//! Occupied cells become walls, free cells become floor. Unknown cells are no floor: a low border keeps robots out of
//! them, which the LiDAR does not see.

mod outline;

use super::builder::WALL_HEIGHT_M;
use super::ground::{CELL_M, FLOOR_RELIEF_M, Ground};
use super::raster::Raster;
use super::{EXTENT_MAX_M, Room, RoomError, TRIANGLES_MAX};
use glam::{DVec2, Vec3};
use msg::grid::{CELLS_MAX, Occupancy, UNKNOWN, occupancy};
use msg::{GridView, Pose2};
use outline::{OutlinePoint, count_sides, simplify, visit_outlines};
use parry3d::shape::TriMesh;
use std::sync::Arc;

/// Largest distance between the outline of occupied cells and the wall that replaces it, in cells.
const TOLERANCE_CELLS: f64 = 0.5;
/// Tolerance for outlines of which the other leaves no area, such as a single cell's, in cells.
const SMALL_TOLERANCE_CELLS: f64 = 0.1;
/// Height of the border between floor and unknown cells, metres: robots touch it, and the LiDAR's plane is above it.
const BORDER_HEIGHT_M: f32 = 0.1;
/// Largest area of unknown cells within the floor that are floor too, square metres. Beams leave such gaps between them.
const GAP_MAX_M2: f64 = 0.1;

/// Largest number of sides between occupied and other cells, and between free and other cells: they bound time and memory.
const SIDES_MAX: usize = 4_000_000;

/// Reason why a map is not a usable room.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MapError {
    /// No cell is occupied.
    #[error("the map has no occupied cell; expected walls, which are black (or white with `negate: 1`)")]
    NoWalls,
    /// No cell is free.
    #[error("the map has no free cell; expected a floor, which is white (or black with `negate: 1`)")]
    NoFloor,
    /// The cells are none of a map, or the pose of the map is not finite.
    #[error(
        "the map has {cells} cells in {width} x {height}; expected as many as its size says, and a finite pose"
    )]
    Malformed {
        /// Number of cells.
        cells: usize,
        /// Stated number of columns.
        width: u32,
        /// Stated number of rows.
        height: u32,
    },
    /// Known cells are too many for a room.
    #[error(
        "the known part of the map has {width} x {height} cells; expected at most {CELLS_MAX} in all: use a coarser map"
    )]
    TooManyCells {
        /// Columns of the known part.
        width: usize,
        /// Rows of the known part.
        height: usize,
    },
    /// The outlines are too long for a room.
    #[error(
        "the cells of the map change {sides} times between occupied, free and unknown; expected at most {SIDES_MAX} \
         times: is it a map, and not noise?"
    )]
    TooManySides {
        /// Number of sides between cells of different kinds.
        sides: usize,
    },
    /// Known cells lie too far from the origin of `world`.
    #[error(
        "known cells of the map lie {reach_m:.0} m from the origin, or from each other; expected at most 200 m: see \
         `origin` and `resolution`"
    )]
    TooLarge {
        /// Largest coordinate or extent, metres.
        reach_m: f64,
    },
    /// Robots fit nowhere on the free cells.
    #[error("the map has free cells, but a robot fits nowhere on them; expected a way at least 0.3 m wide")]
    NoPlace,
}

impl Room {
    /// Makes a room from an occupancy grid, whose frame is `world`: walls of full height where cells are occupied, floor where they
    /// are free.
    ///
    /// Walls follow the outlines of the occupied cells, a quarter of a cell inside of the cells' edges, and up to half a
    /// cell beside that where this makes them straight. Cells that touch at corners alone make a closed wall, and one or two unknown
    /// cells between two occupied ones are wall. Other unknown cells are no
    /// floor, but for gaps of at most 0.1 m² in the floor. A border of 0.1 m in height between floor and unknown cells stops robots;
    /// the LiDAR sees over it.
    ///
    /// # Errors
    /// The grid is malformed or too large, or has no occupied cells, no free cells or no space for a robot.
    pub fn from_map(name: &str, map: GridView<'_>) -> Result<Room, RoomError> {
        let cells = KnownCells::new(map)?;
        let mut walls = WallMesh::default();
        let size = [cells.width, cells.height];
        let is_occupied = |column, row| cells.at(column, row) == Occupancy::Occupied;
        let is_blocked = |column, row| cells.at(column, row) != Occupancy::Free;
        let sides = count_sides(size, is_occupied).max(count_sides(size, is_blocked));
        if sides > SIDES_MAX {
            return Err(MapError::TooManySides { sides }.into());
        }
        visit_outlines(size, is_occupied, |ring| walls.add_ring(&cells, ring));
        visit_outlines(size, is_blocked, |ring| walls.add_border(&cells, ring));
        let count = walls.triangles.len();
        if count > TRIANGLES_MAX {
            return Err(RoomError::TooMany { what: "triangles", count, max: TRIANGLES_MAX });
        }
        let ground = cells.ground(&walls);
        if !ground.drivable.contains(&true) {
            return Err(MapError::NoPlace.into());
        }
        let mesh = TriMesh::new(walls.vertices, walls.triangles).map_err(|_| MapError::NoWalls)?;
        Ok(Self {
            name: name.to_owned(),
            mesh: Arc::new(mesh),
            ground: Arc::new(ground),
            furniture: Vec::new().into(),
            open_edge_m: walls.border_m,
        })
    }
}

/// The part of a map that has known cells, with one row or column of unknown cells around it.
struct KnownCells {
    width: usize,
    height: usize,
    cells: Vec<Occupancy>,
    /// Pose of the lower left corner of cell (0, 0).
    world_from_corner: Pose2,
    resolution_m: f64,
}

impl KnownCells {
    fn new(map: GridView<'_>) -> Result<Self, MapError> {
        let header = map.header;
        let (cells, width, height) = (map.cells.len(), header.width, header.height);
        let map = GridView::new(header, map.cells).ok_or(MapError::Malformed { cells, width, height })?;
        for (occupied, missing) in
            [(Occupancy::Occupied, MapError::NoWalls), (Occupancy::Free, MapError::NoFloor)]
        {
            if !map.cells.iter().any(|cell| occupancy(*cell) == occupied) {
                return Err(missing);
            }
        }
        let (first, last) = known_rectangle(map);
        let [width, height] = [0, 1].map(|axis| last[axis] - first[axis] + 3);
        check_count(width - 2, height - 2)?;
        let resolution_m = header.resolution_m;
        let corner_m = first.map(|cell| (cell as f64 - 1.0) * resolution_m);
        let [x_m, y_m] = header.origin.apply(corner_m);
        let world_from_corner = Pose2::new(x_m, y_m, header.origin.yaw_rad);
        let cells = (0..height as i64).flat_map(|row| (0..width as i64).map(move |column| (column, row)));
        let cells = cells.map(|(column, row)| {
            occupancy(map.cell(column + first[0] as i64 - 1, row + first[1] as i64 - 1))
        });
        let mut known = Self { width, height, cells: cells.collect(), world_from_corner, resolution_m };
        known.check_extent()?;
        known.close_walls();
        known.fill_gaps();
        Ok(known)
    }

    fn check_extent(&self) -> Result<(), MapError> {
        let (min, max) = self.bounds();
        let reach_m = (max - min).max(min.abs()).max(max.abs()).max_element();
        if reach_m <= f64::from(EXTENT_MAX_M) { Ok(()) } else { Err(MapError::TooLarge { reach_m }) }
    }

    /// Returns the corners of the box around all known cells, in `world`, metres.
    fn bounds(&self) -> (DVec2, DVec2) {
        let (right, top) = (self.width as f64 - 1.0, self.height as f64 - 1.0);
        let corners = [[1.0, 1.0], [right, 1.0], [right, top], [1.0, top]].map(|at| self.in_world(at.into()));
        corners.iter().fold((corners[0], corners[0]), |(min, max), at| (min.min(*at), max.max(*at)))
    }

    /// Converts a point in cells from the corner of cell (0, 0) to `world`, metres.
    fn in_world(&self, point: DVec2) -> DVec2 {
        self.world_from_corner.apply((point * self.resolution_m).into()).into()
    }

    /// Returns a cell; beyond the rim, which is unknown, unknown.
    fn at(&self, column: i32, row: i32) -> Occupancy {
        let inside = (0..self.width as i32).contains(&column) && (0..self.height as i32).contains(&row);
        if inside { self.cells[row as usize * self.width + column as usize] } else { Occupancy::Unknown }
    }

    /// Makes walls of one or two unknown cells between two occupied ones, in a row, a column or a diagonal: beams would leave
    /// the building through such gaps between hits.
    fn close_walls(&mut self) {
        let at = |column: i32, row: i32, (dx, dy): (i32, i32), steps: i32| {
            self.at(column + steps * dx, row + steps * dy)
        };
        let is_gap = |column: i32, row: i32, axis: (i32, i32)| {
            let is_wall = |steps: i32| at(column, row, axis, steps) == Occupancy::Occupied;
            let is_unknown = |steps: i32| at(column, row, axis, steps) == Occupancy::Unknown;
            let beside = is_wall(1) && is_wall(-1);
            beside
                || (is_wall(-1) && is_unknown(1) && is_wall(2))
                || (is_wall(1) && is_unknown(-1) && is_wall(-2))
        };
        let axes = [(1, 0), (0, 1), (1, 1), (1, -1)];
        let unknown = self.cells.iter().enumerate().filter(|(_, cell)| **cell == Occupancy::Unknown);
        let place = |index: usize| ((index % self.width) as i32, (index / self.width) as i32);
        let gaps: Vec<usize> = unknown
            .map(|(index, _)| index)
            .filter(|index| axes.iter().any(|axis| is_gap(place(*index).0, place(*index).1, *axis)))
            .collect();
        gaps.into_iter().for_each(|index| self.cells[index] = Occupancy::Occupied);
    }

    /// Makes floor of small parts of unknown cells that touch the floor.
    fn fill_gaps(&mut self) {
        let unknown: Vec<bool> = self.cells.iter().map(|cell| *cell == Occupancy::Unknown).collect();
        let raster = Raster { origin_m: [0.0; 2], resolution_m: 1.0, width: self.width, height: self.height };
        let (regions, sizes) = raster.regions(&unknown);
        let cells_max = GAP_MAX_M2 / self.resolution_m.powi(2);
        let mut is_gap = vec![false; sizes.len()];
        for (cell, region) in regions.iter().enumerate().filter(|(_, region)| **region != 0) {
            let mut near = raster.neighbours(cell).filter(|(_, over_edge)| *over_edge);
            if sizes[*region as usize] as f64 <= cells_max && !is_gap[*region as usize] {
                is_gap[*region as usize] = near.any(|(near, _)| self.cells[near] == Occupancy::Free);
            }
        }
        let cells = self.cells.iter_mut().zip(&regions);
        cells.filter(|(_, region)| is_gap[**region as usize]).for_each(|(cell, _)| *cell = Occupancy::Free);
    }

    /// Returns the floor: the known cells in the cells of a [`Ground`].
    fn ground(&self, walls: &WallMesh) -> Ground {
        let (min, max) = self.bounds();
        let raster = Raster::covering(min.into(), max.into(), CELL_M);
        let corner_from_world = self.world_from_corner.inverse();
        let below = |cell: usize| {
            let [x, y] =
                corner_from_world.apply(raster.centre_m(cell)).map(|m| (m / self.resolution_m).floor());
            self.at(x as i32, y as i32)
        };
        let known: Vec<Occupancy> = (0..raster.len()).map(below).collect();
        let floor = known.iter().map(|cell| *cell != Occupancy::Unknown).collect();
        let mut obstacles: Vec<bool> = known.iter().map(|cell| *cell == Occupancy::Occupied).collect();
        let level = |corner: Vec3| [f64::from(corner.x), f64::from(corner.y)];
        for [a, b, _] in walls.triangles.iter().step_by(2) {
            let [from, to] = [a, b].map(|corner| level(walls.vertices[*corner as usize]));
            raster.mark_segment(&mut obstacles, from, to);
        }
        Ground::from_cells(raster, floor, &obstacles)
    }
}

/// Checks the number of cells of the known part, without the unknown ones around it.
fn check_count(width: usize, height: usize) -> Result<(), MapError> {
    let is_sound = width.checked_mul(height).is_some_and(|count| count <= CELLS_MAX);
    if is_sound { Ok(()) } else { Err(MapError::TooManyCells { width, height }) }
}

/// Returns the first and the last column and row with known cells, of a map that has some.
fn known_rectangle(map: GridView<'_>) -> ([usize; 2], [usize; 2]) {
    let width = map.header.width as usize;
    let (mut first, mut last) = ([usize::MAX; 2], [0; 2]);
    for (row, cells) in map.cells.chunks_exact(width).enumerate() {
        let is_known = |cell: &i8| *cell != UNKNOWN && occupancy(*cell) != Occupancy::Unknown;
        let Some(left) = cells.iter().position(is_known) else { continue };
        let right = cells.iter().rposition(is_known).unwrap_or(left);
        first = [first[0].min(left), first[1].min(row)];
        last = [last[0].max(right), row];
    }
    (first, last)
}

/// Upright rectangles, as two triangles each. Seen from above, the first two corners of a triangle are the whole rectangle.
#[derive(Default)]
struct WallMesh {
    vertices: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
    /// Length of all borders, metres.
    border_m: f64,
}

impl WallMesh {
    /// Adds the wall around occupied cells.
    fn add_ring(&mut self, cells: &KnownCells, ring: &[OutlinePoint]) {
        let mut points: Vec<DVec2> = ring.iter().map(|point| point.position).collect();
        points.push(points[0]);
        // Two points and the first one again are no ring.
        let tolerances = [TOLERANCE_CELLS, SMALL_TOLERANCE_CELLS].into_iter();
        let closed = tolerances.map(|tolerance| simplify(&points, tolerance)).find(|line| line.len() > 3);
        self.add_line(cells, &closed.unwrap_or(points), WALL_HEIGHT_M);
    }

    /// Adds the parts of a ring around cells that are not free where these are unknown.
    fn add_border(&mut self, cells: &KnownCells, ring: &[OutlinePoint]) {
        let is_unknown = |point: &OutlinePoint| cells.at(point.cell.0, point.cell.1) == Occupancy::Unknown;
        let Some(first_wall) = ring.iter().position(|point| !is_unknown(point)) else {
            let closed: Vec<DVec2> = ring.iter().chain(&ring[..1]).map(|point| point.position).collect();
            return self.add_border_line(cells, &closed);
        };
        // From one wall to the next one, with a point of each.
        let mut line = Vec::new();
        let around = ring[first_wall..].iter().chain(&ring[..=first_wall]);
        let mut last = None;
        for point in around {
            if is_unknown(point) {
                line.extend(last.take());
                line.push(point.position);
            } else {
                if !line.is_empty() {
                    line.push(point.position);
                    self.add_border_line(cells, &line);
                    line.clear();
                }
                last = Some(point.position);
            }
        }
    }

    fn add_border_line(&mut self, cells: &KnownCells, points: &[DVec2]) {
        let line = simplify(points, TOLERANCE_CELLS);
        let in_cells: f64 = line.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
        self.border_m += in_cells * cells.resolution_m;
        self.add_line(cells, &line, BORDER_HEIGHT_M);
    }

    /// Adds a rectangle on each segment of a line, from the floor's relief up. Stops where there are more triangles than a room has.
    fn add_line(&mut self, cells: &KnownCells, line: &[DVec2], height_m: f32) {
        if self.triangles.len() > TRIANGLES_MAX {
            return;
        }
        let mut before: Option<u32> = None;
        for point in line {
            let at_m = cells.in_world(*point).as_vec2();
            let low = self.vertices.len() as u32;
            self.vertices.extend([at_m.extend(FLOOR_RELIEF_M), at_m.extend(height_m)]);
            if let Some(before) = before {
                self.triangles.extend([[before, low, low + 1], [before, low + 1, before + 1]]);
            }
            before = Some(low);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_many_known_cells_as_the_limit_says_are_taken() {
        assert_eq!(CELLS_MAX, 4096 * 4096);
        check_count(4096, 4096).unwrap();
        let said = check_count(4096, 4097).unwrap_err().to_string();
        assert!(said.contains("4096 x 4097") && said.contains("16777216"), "{said}");
        check_count(usize::MAX, 2).unwrap_err();
    }
}
