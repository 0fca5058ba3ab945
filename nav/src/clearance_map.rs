//! Clearance map, a window of the occupancy grid around a robot with the obstacles of its scans, and the distance from
//! each cell to the nearest obstacle.

mod marking;

pub(crate) use marking::is_inside;

use crate::observation::MapView;
use msg::Pose2;
use msg::grid::Occupancy;

/// Largest side of the window, cells (51 m at 0.05 m). Bounds the memory and time of a plan on any map.
pub const WINDOW_CELLS_MAX: i64 = 1024;
/// Smallest side of the window's cells, metres: finer maps are read in blocks, or a plan would cost too much time.
pub const CELL_SIZE_MIN_M: f64 = 0.05;
/// Most unknown space that a line of sight may cross, metres: cells between two beams often stay unknown.
const UNKNOWN_CROSSED_MAX_M: f64 = 0.3;
/// Share of a cell's side by which a resolution may miss [`CELL_SIZE_MIN_M`] through rounding.
const BLOCK_ROUNDING: f64 = 1e-6;

/// Column and row steps to the eight neighbours, counter-clockwise from +x; opposite directions are four apart.
pub(crate) const NEIGHBOURS: [(i64, i64); 8] =
    [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)];

/// Window of a map with the clearance of each cell.
///
/// Cells are row-major indices of the window. Cells of the outermost ring are never free, so that every free cell
/// has eight neighbours.
#[derive(Clone, Debug, Default)]
pub struct ClearanceMap {
    map_from_window: Pose2,
    window_from_map: Pose2,
    cell_size_m: f64,
    width: i64,
    height: i64,
    covers_map: bool,
    occupancy: Vec<Occupancy>,
    clearance_m: Vec<f32>,
}

impl ClearanceMap {
    /// Copies the part of a map around `centre_m`, a point in the frame of the map.
    pub fn copy_window(&mut self, map: &MapView, centre_m: [f64; 2]) {
        let block = (CELL_SIZE_MIN_M / map.resolution_m - BLOCK_ROUNDING).ceil().max(1.0);
        self.cell_size_m = block * map.resolution_m;
        let block = block as i64;
        let in_cells = |v: f64| (v / self.cell_size_m).floor() as i64;
        let [x, y] = map.map_from_grid.inverse().apply(centre_m).map(in_cells);
        let (x0, width) = window_span(x, i64::from(map.width), block);
        let (y0, height) = window_span(y, i64::from(map.height), block);
        (self.width, self.height) = (width, height);
        let corner = Pose2::new(x0 as f64 * self.cell_size_m, y0 as f64 * self.cell_size_m, 0.0);
        let needed = |cells: u32| (i64::from(cells) + block - 1) / block + 2;
        self.covers_map = needed(map.width) <= width && needed(map.height) <= height;
        self.map_from_window = map.map_from_grid * corner;
        self.window_from_map = self.map_from_window.inverse();
        self.occupancy.clear();
        self.occupancy.reserve((width * height) as usize);
        for row in 0..height {
            let is_edge_row = row == 0 || row == height - 1;
            for column in 0..width {
                let is_edge = is_edge_row || column == 0 || column == width - 1;
                let seen = block_occupancy(map, (x0 + column) * block, (y0 + row) * block, block);
                let kept = if is_edge && seen == Occupancy::Free { Occupancy::Unknown } else { seen };
                self.occupancy.push(kept);
            }
        }
        self.clearance_m.clear();
    }

    /// Side of a cell, metres.
    pub fn cell_size_m(&self) -> f64 {
        self.cell_size_m
    }

    /// Direction of the window's columns in the frame of the map, radians.
    pub fn yaw_rad(&self) -> f64 {
        self.map_from_window.yaw_rad
    }

    /// Whether the window is the whole map.
    pub fn covers_map(&self) -> bool {
        self.covers_map
    }

    /// Number of columns of the window.
    pub fn width(&self) -> i64 {
        self.width
    }

    /// Number of cells of the window.
    pub fn cell_count(&self) -> usize {
        self.occupancy.len()
    }

    /// Occupancy of a cell of the window.
    ///
    /// # Panics
    /// If `cell` is not below [`ClearanceMap::cell_count`].
    pub fn occupancy(&self, cell: usize) -> Occupancy {
        self.occupancy[cell]
    }

    /// Cell that contains a point of the map's frame; `None` outside the window.
    pub fn cell_at(&self, point_m: [f64; 2]) -> Option<usize> {
        let [x, y] = self.window_from_map.apply(point_m).map(|v| (v / self.cell_size_m).floor());
        let is_inside = x >= 0.0 && y >= 0.0 && x < self.width as f64 && y < self.height as f64;
        is_inside.then(|| self.index(x as i64, y as i64))
    }

    /// A point of the map's frame in cells of the window, from its lower left corner.
    pub(crate) fn in_cells(&self, point_m: [f64; 2]) -> [f64; 2] {
        self.window_from_map.apply(point_m).map(|v| v / self.cell_size_m)
    }

    /// Centre of a cell in the frame of the map, metres.
    pub fn cell_centre_m(&self, cell: usize) -> [f64; 2] {
        let (x, y) = self.column_row(cell);
        self.map_from_window.apply([(x as f64 + 0.5) * self.cell_size_m, (y as f64 + 0.5) * self.cell_size_m])
    }

    /// Neighbour of a cell in one of the eight directions; `None` if `cell` lies on the outermost ring.
    pub fn neighbour(&self, cell: usize, direction: usize) -> Option<usize> {
        let (x, y) = self.column_row(cell);
        let is_inner = x > 0 && y > 0 && x < self.width - 1 && y < self.height - 1;
        let (dx, dy) = NEIGHBOURS[direction];
        is_inner.then(|| self.index(x + dx, y + dy))
    }

    /// Sets the occupancy of all cells whose centres lie in a disc.
    pub fn mark_disc(&mut self, centre_m: [f64; 2], radius_m: f64, occupancy: Occupancy) {
        let Some(centre) = self.cell_at(centre_m) else { return };
        let reach = (radius_m / self.cell_size_m).ceil() as i64 + 1;
        let (cx, cy) = self.column_row(centre);
        for y in (cy - reach).max(1)..=(cy + reach).min(self.height - 2) {
            for x in (cx - reach).max(1)..=(cx + reach).min(self.width - 2) {
                let cell = self.index(x, y);
                let [px, py] = self.cell_centre_m(cell);
                if (px - centre_m[0]).hypot(py - centre_m[1]) <= radius_m {
                    self.occupancy[cell] = occupancy;
                }
            }
        }
    }

    /// Column and row of a cell.
    pub(crate) fn column_row(&self, cell: usize) -> (i64, i64) {
        (cell as i64 % self.width, cell as i64 / self.width)
    }

    /// Marks the cell that contains a point as occupied.
    pub fn mark_occupied(&mut self, point_m: [f64; 2]) {
        if let Some(cell) = self.cell_at(point_m) {
            self.occupancy[cell] = Occupancy::Occupied;
        }
    }

    /// Marks unknown cells between two points as free, because a beam has just passed through them.
    pub fn mark_ray_free(&mut self, from_m: [f64; 2], to_m: [f64; 2]) {
        let in_cells = |p: [f64; 2]| self.window_from_map.apply(p).map(|v| v / self.cell_size_m);
        let ([x0, y0], [x1, y1]) = (in_cells(from_m), in_cells(to_m));
        let (dx, dy) = (x1 - x0, y1 - y0);
        // Two steps a cell; the bound holds for rays whose ends are not usable numbers.
        let steps = (dx.hypot(dy) * 2.0).ceil().min(4.0 * WINDOW_CELLS_MAX as f64);
        let is_inner = |v: f64, size: i64| v >= 1.0 && v < (size - 1) as f64;
        for i in 0..steps as usize {
            let t = i as f64 / steps;
            let (x, y) = (x0 + t * dx, y0 + t * dy);
            if is_inner(x, self.width) && is_inner(y, self.height) {
                let cell = self.index(x as i64, y as i64);
                if self.occupancy[cell] == Occupancy::Unknown {
                    self.occupancy[cell] = Occupancy::Free;
                }
            }
        }
    }

    /// Computes the clearance of every cell; call it after all marking.
    ///
    /// A chamfer distance transform in two passes (Borgefors 1986, weights 1 and sqrt 2): at most 8 % too long.
    pub fn compute_clearance(&mut self) {
        let far_m = WINDOW_CELLS_MAX as f32 * 2.0 * self.cell_size_m as f32;
        let start_m = |occupancy: &Occupancy| if *occupancy == Occupancy::Occupied { 0.0 } else { far_m };
        self.clearance_m.clear();
        self.clearance_m.extend(self.occupancy.iter().map(start_m));
        let (width, height) = (self.width as usize, self.height as usize);
        if width < 3 || height < 3 {
            return;
        }
        let step_m = self.cell_size_m as f32;
        for row in 1..height - 1 {
            let (before, row_m) = self.clearance_m.split_at_mut(row * width);
            relax_from_row(&mut row_m[..width], &before[(row - 1) * width..], step_m);
            relax_along(row_m[..width - 1].iter_mut(), step_m);
        }
        for row in (1..height - 1).rev() {
            let (before, after) = self.clearance_m.split_at_mut((row + 1) * width);
            let row_m = &mut before[row * width..];
            relax_from_row(row_m, &after[..width], step_m);
            relax_along(row_m[1..].iter_mut().rev(), step_m);
        }
    }

    /// Distance from the centre of a cell to that of the nearest occupied one, metres.
    ///
    /// Zero before [`ClearanceMap::compute_clearance`].
    pub fn clearance_m(&self, cell: usize) -> f64 {
        self.clearance_m.get(cell).map_or(0.0, |c| f64::from(*c))
    }

    /// Whether no occupied cell and little unknown space lies between two cells; the ends may be anything.
    pub fn has_line_of_sight(&self, from: usize, to: usize) -> bool {
        let (x0, y0) = self.column_row(from);
        let (x1, y1) = self.column_row(to);
        let steps = ((x1 - x0).abs().max((y1 - y0).abs()) * 2).max(1);
        let mut unknown_m = 0.0;
        for i in 1..steps {
            let along = |a: i64, b: i64| (2 * steps * a + 2 * i * (b - a) + steps).div_euclid(2 * steps);
            let cell = self.index(along(x0, x1), along(y0, y1));
            if cell == from || cell == to {
                continue;
            }
            match self.occupancy[cell] {
                Occupancy::Occupied => return false,
                // Two steps a cell.
                Occupancy::Unknown => unknown_m += self.cell_size_m / 2.0,
                Occupancy::Free => {}
            }
        }
        unknown_m <= UNKNOWN_CROSSED_MAX_M
    }

    fn index(&self, x: i64, y: i64) -> usize {
        (y * self.width + x) as usize
    }
}

/// Shortens the distances of the inner cells of a row to what its neighbours in another row allow.
fn relax_from_row(row_m: &mut [f32], other_m: &[f32], step_m: f32) {
    let diagonal_m = core::f32::consts::SQRT_2 * step_m;
    for (nearest_m, beside_m) in row_m[1..].iter_mut().zip(other_m.windows(3)) {
        let diagonal = beside_m[0].min(beside_m[2]) + diagonal_m;
        *nearest_m = nearest_m.min(beside_m[1] + step_m).min(diagonal);
    }
}

/// Shortens distances to what the cell before each allows.
fn relax_along<'a>(mut cells_m: impl Iterator<Item = &'a mut f32>, step_m: f32) {
    let Some(mut before_m) = cells_m.next().map(|first_m| *first_m) else { return };
    for nearest_m in cells_m {
        before_m = nearest_m.min(before_m + step_m);
        *nearest_m = before_m;
    }
}

/// First block and number of blocks of the window along one axis: around `centre`, within the map and one block of
/// padding at each side of it.
fn window_span(centre: i64, map_cells: i64, block: i64) -> (i64, i64) {
    let map_blocks = (map_cells + block - 1) / block;
    let length = (map_blocks + 2).min(WINDOW_CELLS_MAX);
    let centre = centre.clamp(0, map_blocks);
    let first = (centre - length / 2).clamp(-1, map_blocks + 1 - length);
    (first, length)
}

/// Occupancy of a square of map cells: occupied if any cell is, free if most cells are.
fn block_occupancy(map: &MapView, x: i64, y: i64, block: i64) -> Occupancy {
    if block == 1 {
        return map.occupancy(x, y);
    }
    let mut free = 0;
    for (dx, dy) in (0..block).flat_map(|dy| (0..block).map(move |dx| (dx, dy))) {
        match map.occupancy(x + dx, y + dy) {
            Occupancy::Occupied => return Occupancy::Occupied,
            Occupancy::Free => free += 1,
            Occupancy::Unknown => {}
        }
    }
    if 2 * free > block * block { Occupancy::Free } else { Occupancy::Unknown }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn map_of(rows: &[&str], resolution_m: f64, map_from_grid: Pose2) -> ClearanceMap {
        let cells: Vec<i8> = rows
            .iter()
            .rev()
            .flat_map(|row| row.bytes())
            .map(|b| match b {
                b'#' => 100,
                b'.' => 0,
                _ => -1,
            })
            .collect();
        let size = (rows[0].len() as u32, rows.len() as u32);
        let view = MapView::from_percent(map_from_grid, resolution_m, size, &cells).unwrap();
        let mut window = ClearanceMap::default();
        window.copy_window(&view, map_from_grid.apply([0.1, 0.1]));
        window.compute_clearance();
        window
    }

    proptest! {
        #[test]
        fn a_point_lies_in_the_cell_found_for_it(x in -50.0..50.0, y in -50.0..50.0, yaw in -3.0..3.0, column in 0..4, row in 0..3) {
            let map_from_grid = Pose2::new(x, y, yaw);
            let window = map_of(&["....", ".#..", "...."], 0.05, map_from_grid);
            let point = map_from_grid.apply([f64::from(column) * 0.05 + 0.02, f64::from(row) * 0.05 + 0.03]);
            let cell = window.cell_at(point).unwrap();
            let [cx, cy] = window.cell_centre_m(cell);
            prop_assert!((cx - point[0]).hypot(cy - point[1]) < 0.036);
            let expected = if (column, row) == (1, 1) { Occupancy::Occupied } else { Occupancy::Free };
            prop_assert_eq!(window.occupancy(cell), expected);
        }

        #[test]
        fn clearance_is_the_distance_to_the_nearest_obstacle(occupied in prop::collection::vec((1..39_i64, 1..39_i64), 1..6)) {
            let mut cells = vec![0_i8; 1600];
            for (x, y) in &occupied {
                cells[(y * 40 + x) as usize] = 100;
            }
            let view = MapView::from_percent(Pose2::IDENTITY, 0.05, (40, 40), &cells).unwrap();
            let mut window = ClearanceMap::default();
            window.copy_window(&view, [1.0, 1.0]);
            window.compute_clearance();
            for (x, y) in (0..40).flat_map(|y| (0..40).map(move |x| (x, y))) {
                let cell = window.cell_at([(x as f64 + 0.5) * 0.05, (y as f64 + 0.5) * 0.05]).unwrap();
                let exact = occupied.iter().map(|(ox, oy)| ((ox - x) as f64).hypot((oy - y) as f64) * 0.05);
                let exact = exact.fold(f64::INFINITY, f64::min);
                let measured = window.clearance_m(cell);
                prop_assert!(measured >= exact - 1e-4 && measured <= exact * 1.09 + 1e-4, "{measured} {exact}");
            }
        }
    }

    #[test]
    fn obstacles_block_the_line_of_sight() {
        let window = map_of(&[".....", "..#..", "....."], 0.05, Pose2::IDENTITY);
        let at = |x: f64, y: f64| window.cell_at([x * 0.05 + 0.025, y * 0.05 + 0.025]).unwrap();
        assert!(!window.has_line_of_sight(at(0.0, 1.0), at(4.0, 1.0)));
        assert!(window.has_line_of_sight(at(0.0, 0.0), at(4.0, 0.0)));
        assert!(window.has_line_of_sight(at(0.0, 2.0), at(2.0, 1.0)));
    }

    #[test]
    fn the_window_is_bounded_and_contains_the_robot() {
        let side = 3000_u32;
        let cells = vec![0_i8; (side * side) as usize];
        let view = MapView::from_percent(Pose2::IDENTITY, 0.05, (side, side), &cells).unwrap();
        let mut window = ClearanceMap::default();
        for place in [[0.1, 0.1], [75.0, 75.0], [149.9, 149.9], [149.9, 0.1]] {
            window.copy_window(&view, place);
            assert_eq!(window.cell_count() as i64, WINDOW_CELLS_MAX * WINDOW_CELLS_MAX);
            assert!(window.cell_at(place).is_some(), "{place:?}");
        }
    }

    #[test]
    fn fine_maps_are_read_in_blocks_of_cells() {
        let window = map_of(&["....", "....", "..#.", "...."], 0.025, Pose2::IDENTITY);
        assert!((window.cell_size_m() - 0.05).abs() < 1e-12);
        let occupied =
            (0..window.cell_count()).filter(|cell| window.occupancy(*cell) == Occupancy::Occupied).count();
        assert_eq!(occupied, 1);
    }
}
