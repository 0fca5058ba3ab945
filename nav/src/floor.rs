//! The floor around a robot as the operator judges it: a window of the map with what he has just seen
//! himself drawn in, and how much room there is at each spot.

use crate::sight::MapView;
use msg::Pose2;
use msg::grid::Occupancy;

/// The window's largest side, cells: 51 m at 0.05 m. Bounds the memory and time of a plan on any map.
pub const WINDOW_CELLS_MAX: i64 = 1024;
/// Finer maps are read in blocks up to this size, metres.
pub const CELL_MIN_M: f64 = 0.05;
/// A ray of sight is trusted through at most this much that nobody has seen, metres.
const UNKNOWN_SEEN_THROUGH_M: f64 = 0.3;

/// The eight neighbours: column step, row step. Opposite directions are four apart.
pub const NEIGHBOURS: [(i64, i64); 8] =
    [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)];

/// A window of a map. Cells are row-major indices; the outermost ring of cells is never free.
#[derive(Clone, Debug, Default)]
pub struct Floor {
    map_from_window: Pose2,
    window_from_map: Pose2,
    cell_m: f64,
    width: i64,
    height: i64,
    known: Vec<Occupancy>,
    clearance_m: Vec<f32>,
}

impl Floor {
    /// Copies the part of the map around `centre_m` (in the map's frame).
    pub fn survey(&mut self, map: &MapView, centre_m: [f64; 2]) {
        let block = (CELL_MIN_M / map.resolution_m - 1e-6).ceil().max(1.0);
        self.cell_m = block * map.resolution_m;
        let block = block as i64;
        let [x, y] = map.map_from_grid.inverse().apply(centre_m).map(|v| (v / self.cell_m).floor() as i64);
        let (x0, width) = span(x, i64::from(map.width), block);
        let (y0, height) = span(y, i64::from(map.height), block);
        (self.width, self.height) = (width, height);
        let corner = Pose2::new(x0 as f64 * self.cell_m, y0 as f64 * self.cell_m, 0.0);
        self.map_from_window = map.map_from_grid * corner;
        self.window_from_map = self.map_from_window.inverse();
        self.known.clear();
        self.known.reserve((width * height) as usize);
        for row in 0..height {
            let edge_row = row == 0 || row == height - 1;
            for column in 0..width {
                let edge = edge_row || column == 0 || column == width - 1;
                let seen = block_occupancy(map, (x0 + column) * block, (y0 + row) * block, block);
                let kept = if edge && seen == Occupancy::Free { Occupancy::Unknown } else { seen };
                self.known.push(kept);
            }
        }
        self.clearance_m.clear();
    }

    /// Side of a cell, metres.
    pub fn cell_m(&self) -> f64 {
        self.cell_m
    }

    /// Columns.
    pub fn width(&self) -> i64 {
        self.width
    }

    /// All cells' knowledge.
    pub fn known(&self) -> &[Occupancy] {
        &self.known
    }

    /// The cell under a point of the map's frame.
    pub fn cell_of(&self, point_m: [f64; 2]) -> Option<usize> {
        let [x, y] = self.window_from_map.apply(point_m).map(|v| (v / self.cell_m).floor());
        let inside = x >= 0.0 && y >= 0.0 && x < self.width as f64 && y < self.height as f64;
        inside.then(|| self.index(x as i64, y as i64))
    }

    /// A cell's centre in the map's frame, metres.
    pub fn centre_m(&self, cell: usize) -> [f64; 2] {
        let (x, y) = self.column_row(cell);
        self.map_from_window.apply([(x as f64 + 0.5) * self.cell_m, (y as f64 + 0.5) * self.cell_m])
    }

    /// The neighbour in one of the eight directions, unless `cell` lies on the outermost ring.
    pub fn neighbour(&self, cell: usize, direction: usize) -> Option<usize> {
        let (x, y) = self.column_row(cell);
        let inner = x > 0 && y > 0 && x < self.width - 1 && y < self.height - 1;
        let (dx, dy) = NEIGHBOURS[direction];
        inner.then(|| self.index(x + dx, y + dy))
    }

    /// Declares a disc of the floor free or occupied.
    pub fn mark_disc(&mut self, centre_m: [f64; 2], radius_m: f64, what: Occupancy) {
        let Some(centre) = self.cell_of(centre_m) else { return };
        let reach = (radius_m / self.cell_m).ceil() as i64 + 1;
        let (cx, cy) = self.column_row(centre);
        for y in (cy - reach).max(1)..=(cy + reach).min(self.height - 2) {
            for x in (cx - reach).max(1)..=(cx + reach).min(self.width - 2) {
                let cell = self.index(x, y);
                let [px, py] = self.centre_m(cell);
                if (px - centre_m[0]).hypot(py - centre_m[1]) <= radius_m {
                    self.known[cell] = what;
                }
            }
        }
    }

    /// Marks the cell under a point as occupied.
    pub fn mark_hit(&mut self, point_m: [f64; 2]) {
        if let Some(cell) = self.cell_of(point_m) {
            self.known[cell] = Occupancy::Occupied;
        }
    }

    /// Marks what nobody has drawn yet between two points as free, for the operator just saw through it.
    pub fn mark_seen(&mut self, from_m: [f64; 2], to_m: [f64; 2]) {
        let in_cells = |p: [f64; 2]| self.window_from_map.apply(p).map(|v| v / self.cell_m);
        let ([x0, y0], [x1, y1]) = (in_cells(from_m), in_cells(to_m));
        let (dx, dy) = (x1 - x0, y1 - y0);
        // Two steps a cell.
        let steps = (dx.hypot(dy) * 2.0).ceil().min(4.0 * WINDOW_CELLS_MAX as f64);
        let inner = |v: f64, size: i64| v >= 1.0 && v < (size - 1) as f64;
        for i in 0..steps as usize {
            let t = i as f64 / steps;
            let (x, y) = (x0 + t * dx, y0 + t * dy);
            if inner(x, self.width) && inner(y, self.height) {
                let cell = self.index(x as i64, y as i64);
                if self.known[cell] == Occupancy::Unknown {
                    self.known[cell] = Occupancy::Free;
                }
            }
        }
    }

    /// Distance from each cell's centre to that of the nearest occupied cell: two passes of a chamfer
    /// (Borgefors 1986, weights 1 and sqrt 2: at most 8 % too long). Call it after all marking.
    pub fn measure_clearance(&mut self) {
        let far = WINDOW_CELLS_MAX as f32 * 2.0 * self.cell_m as f32;
        let occupied = |known: &Occupancy| if *known == Occupancy::Occupied { 0.0 } else { far };
        self.clearance_m.clear();
        self.clearance_m.extend(self.known.iter().map(occupied));
        let inner =
            |w: i64, h: i64| (1..h - 1).flat_map(move |y| (1..w - 1).map(move |x| (y * w + x) as usize));
        for cell in inner(self.width, self.height) {
            self.relax(cell, [4, 5, 6, 7]);
        }
        for cell in inner(self.width, self.height).rev() {
            self.relax(cell, [0, 1, 2, 3]);
        }
    }

    fn relax(&mut self, cell: usize, directions: [usize; 4]) {
        let mut nearest = self.clearance_m[cell];
        for direction in directions {
            let (dx, dy) = NEIGHBOURS[direction];
            let step = if direction % 2 == 0 { 1.0 } else { core::f32::consts::SQRT_2 };
            let neighbour = (cell as i64 + dy * self.width + dx) as usize;
            nearest = nearest.min(self.clearance_m[neighbour] + step * self.cell_m as f32);
        }
        self.clearance_m[cell] = nearest;
    }

    /// From the cell's centre to the nearest obstacle's, metres. Zero before [`Floor::measure_clearance`].
    pub fn clearance_m(&self, cell: usize) -> f64 {
        self.clearance_m.get(cell).map_or(0.0, |c| f64::from(*c))
    }

    /// Whether nothing known stands between the centres of two cells (the ends themselves may be anything).
    pub fn sees(&self, from: usize, to: usize) -> bool {
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
            match self.known[cell] {
                Occupancy::Occupied => return false,
                Occupancy::Unknown => unknown_m += self.cell_m / 2.0,
                Occupancy::Free => {}
            }
        }
        unknown_m <= UNKNOWN_SEEN_THROUGH_M
    }

    fn index(&self, x: i64, y: i64) -> usize {
        (y * self.width + x) as usize
    }

    fn column_row(&self, cell: usize) -> (i64, i64) {
        (cell as i64 % self.width, cell as i64 / self.width)
    }
}

/// First block and number of blocks of the window along one axis: around `centre`, within the map and one
/// block of padding at each side of it.
fn span(centre: i64, map_cells: i64, block: i64) -> (i64, i64) {
    let map_blocks = (map_cells + block - 1) / block;
    let length = (map_blocks + 2).min(WINDOW_CELLS_MAX);
    let centre = centre.clamp(0, map_blocks);
    let first = (centre - length / 2).clamp(-1, map_blocks + 1 - length);
    (first, length)
}

/// A block is occupied if any of its cells is, and free if most are.
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

    fn floor_of(rows: &[&str], resolution_m: f64, map_from_grid: Pose2) -> Floor {
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
        let map = MapView::percent(map_from_grid, resolution_m, size, &cells).unwrap();
        let mut floor = Floor::default();
        floor.survey(&map, map_from_grid.apply([0.1, 0.1]));
        floor.measure_clearance();
        floor
    }

    proptest! {
        #[test]
        fn points_and_cells_agree(x in -50.0..50.0, y in -50.0..50.0, yaw in -3.0..3.0, column in 0..4, row in 0..3) {
            let map_from_grid = Pose2::new(x, y, yaw);
            let floor = floor_of(&["....", ".#..", "...."], 0.05, map_from_grid);
            let point = map_from_grid.apply([f64::from(column) * 0.05 + 0.02, f64::from(row) * 0.05 + 0.03]);
            let cell = floor.cell_of(point).unwrap();
            let [cx, cy] = floor.centre_m(cell);
            prop_assert!((cx - point[0]).hypot(cy - point[1]) < 0.036);
            let expected = if (column, row) == (1, 1) { Occupancy::Occupied } else { Occupancy::Free };
            prop_assert_eq!(floor.known()[cell], expected);
        }

        #[test]
        fn clearance_is_the_distance(occupied in prop::collection::vec((1..39_i64, 1..39_i64), 1..6)) {
            let mut cells = vec![0_i8; 1600];
            for (x, y) in &occupied {
                cells[(y * 40 + x) as usize] = 100;
            }
            let map = MapView::percent(Pose2::IDENTITY, 0.05, (40, 40), &cells).unwrap();
            let mut floor = Floor::default();
            floor.survey(&map, [1.0, 1.0]);
            floor.measure_clearance();
            for (x, y) in (0..40).flat_map(|y| (0..40).map(move |x| (x, y))) {
                let cell = floor.cell_of([(x as f64 + 0.5) * 0.05, (y as f64 + 0.5) * 0.05]).unwrap();
                let exact = occupied.iter().map(|(ox, oy)| ((ox - x) as f64).hypot((oy - y) as f64) * 0.05);
                let exact = exact.fold(f64::INFINITY, f64::min);
                let measured = floor.clearance_m(cell);
                prop_assert!(measured >= exact - 1e-4 && measured <= exact * 1.09 + 1e-4, "{measured} {exact}");
            }
        }
    }

    #[test]
    fn sight_is_blocked_by_obstacles() {
        let floor = floor_of(&[".....", "..#..", "....."], 0.05, Pose2::IDENTITY);
        let at = |x: f64, y: f64| floor.cell_of([x * 0.05 + 0.025, y * 0.05 + 0.025]).unwrap();
        assert!(!floor.sees(at(0.0, 1.0), at(4.0, 1.0)));
        assert!(floor.sees(at(0.0, 0.0), at(4.0, 0.0)));
        assert!(floor.sees(at(0.0, 2.0), at(2.0, 1.0)));
    }

    #[test]
    fn the_window_is_bounded_and_holds_the_robot() {
        let side = 3000_u32;
        let cells = vec![0_i8; (side * side) as usize];
        let map = MapView::percent(Pose2::IDENTITY, 0.05, (side, side), &cells).unwrap();
        let mut floor = Floor::default();
        for place in [[0.1, 0.1], [75.0, 75.0], [149.9, 149.9], [149.9, 0.1]] {
            floor.survey(&map, place);
            assert_eq!(floor.known().len() as i64, WINDOW_CELLS_MAX * WINDOW_CELLS_MAX);
            assert!(floor.cell_of(place).is_some(), "{place:?}");
        }
    }

    #[test]
    fn fine_maps_are_read_in_blocks() {
        let floor = floor_of(&["....", "....", "..#.", "...."], 0.025, Pose2::IDENTITY);
        assert!((floor.cell_m() - 0.05).abs() < 1e-12);
        let occupied = floor.known().iter().filter(|k| **k == Occupancy::Occupied).count();
        assert_eq!(occupied, 1);
    }
}
