//! Rasters of the floor with marked cells, regions and distances.

use std::collections::VecDeque;

/// Points per cell that mark a segment. More points find smaller cut corners and take longer.
const POINTS_PER_CELL: f64 = 8.0;

/// A raster over the x-y plane. Cells are row-major; row 0 has the lowest y.
#[derive(Clone, Debug)]
pub(crate) struct Raster {
    /// Position of the lower left corner, metres.
    pub(crate) origin_m: [f64; 2],
    /// Length of a cell's side, metres.
    pub(crate) resolution_m: f64,
    pub(crate) width: usize,
    pub(crate) height: usize,
}

impl Raster {
    /// Creates a raster over a rectangle and one cell around it. Edges of cells lie on multiples of the
    /// resolution.
    pub(crate) fn covering(min_m: [f64; 2], max_m: [f64; 2], resolution_m: f64) -> Self {
        let first = min_m.map(|m| (m / resolution_m).floor() - 1.0);
        let last = max_m.map(|m| (m / resolution_m).floor() + 1.0);
        Self {
            origin_m: first.map(|cell| cell * resolution_m),
            resolution_m,
            width: (last[0] - first[0]) as usize + 1,
            height: (last[1] - first[1]) as usize + 1,
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.width * self.height
    }

    /// Returns the index of the cell under a point; `None` outside of the raster.
    pub(crate) fn index(&self, point_m: [f64; 2]) -> Option<usize> {
        self.index_of_cell(self.in_cells(point_m))
    }

    /// Returns a point in cells' sides from the lower left corner.
    fn in_cells(&self, point_m: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|axis| (point_m[axis] - self.origin_m[axis]) / self.resolution_m)
    }

    /// Returns the index of the cell under a point in cells' sides from the lower left corner.
    fn index_of_cell(&self, [column, row]: [f64; 2]) -> Option<usize> {
        let inside = (0.0..self.width as f64).contains(&column) && (0.0..self.height as f64).contains(&row);
        // Both are positive and small: rounded down, without a call of `floor` and 64 bits.
        inside.then(|| row as u32 as usize * self.width + column as u32 as usize)
    }

    /// Returns the centre of a cell, metres.
    pub(crate) fn centre_m(&self, index: usize) -> [f64; 2] {
        let (column, row) = (index % self.width, index / self.width);
        let [x, y] = self.origin_m;
        [x + (column as f64 + 0.5) * self.resolution_m, y + (row as f64 + 0.5) * self.resolution_m]
    }

    /// Iterates over up to eight neighbours of a cell, each with whether it shares an edge. Those come first.
    pub(crate) fn neighbours(&self, index: usize) -> impl Iterator<Item = (usize, bool)> + '_ {
        const STEPS: [(isize, isize); 8] =
            [(1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)];
        let (column, row) = (index % self.width, index / self.width);
        STEPS.into_iter().enumerate().filter_map(move |(i, (dx, dy))| {
            let column = column.checked_add_signed(dx).filter(|c| *c < self.width)?;
            let row = row.checked_add_signed(dy).filter(|r| *r < self.height)?;
            Some((row * self.width + column, i < 4))
        })
    }

    /// Marks the cells under a segment. A corner that it cuts by less than an eighth of a cell may be missed.
    pub(crate) fn mark_segment(&self, cells: &mut [bool], from: [f64; 2], to: [f64; 2]) {
        self.mark_points(cells, from, to, POINTS_PER_CELL);
    }

    /// Marks the cells under points of a segment, `points_per_cell` of them along a cell's side.
    pub(crate) fn mark_points(&self, cells: &mut [bool], from: [f64; 2], to: [f64; 2], points_per_cell: f64) {
        let (from, to) = (self.in_cells(from), self.in_cells(to));
        let length = [to[0] - from[0], to[1] - from[1]];
        let steps = (length[0].hypot(length[1]) * points_per_cell).ceil().max(1.0) as usize;
        let step = length.map(|cells| cells / steps as f64);
        for i in 0..=steps {
            let point = [0, 1].map(|axis| from[axis] + i as f64 * step[axis]);
            if let Some(index) = self.index_of_cell(point) {
                cells[index] = true;
            }
        }
    }

    /// Marks the cells under a convex polygon: those of its outline, and those whose centres lie inside.
    pub(crate) fn mark_polygon(&self, cells: &mut [bool], polygon: &[[f64; 2]]) {
        let edges = || polygon.iter().zip(polygon.iter().cycle().skip(1));
        for (from, to) in edges() {
            self.mark_segment(cells, *from, *to);
        }
        let rows = bounds(polygon.iter().map(|p| (p[1] - self.origin_m[1]) / self.resolution_m), self.height);
        for row in rows {
            // The centre line of a row enters and leaves a convex polygon once.
            let y = self.origin_m[1] + (row as f64 + 0.5) * self.resolution_m;
            let crossings = edges().filter(|(a, b)| (a[1] > y) != (b[1] > y));
            let crossings = crossings.map(|(a, b)| a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]));
            let columns = crossings.map(|x| (x - self.origin_m[0]) / self.resolution_m);
            for column in bounds(columns, self.width) {
                cells[row * self.width + column] = true;
            }
        }
    }

    /// Finds the regions of `cells` that are connected over edges. Returns each cell's region, from 1, or 0;
    /// and the number of cells of each region, starting with that of region 0, which counts none.
    pub(crate) fn regions(&self, cells: &[bool]) -> (Vec<u32>, Vec<usize>) {
        let mut labels = vec![0; self.len()];
        let mut sizes = vec![0];
        for start in 0..self.len() {
            if !cells[start] || labels[start] != 0 {
                continue;
            }
            let label = sizes.len() as u32;
            let reached = self.flood(&mut labels, label, [start], |cell| cells[cell]);
            sizes.push(reached);
        }
        (labels, sizes)
    }

    /// Labels the `open` cells that can be reached over edges. Returns their number.
    pub(crate) fn flood(
        &self,
        labels: &mut [u32],
        label: u32,
        starts: impl IntoIterator<Item = usize>,
        open: impl Fn(usize) -> bool,
    ) -> usize {
        let mut queue: VecDeque<usize> = starts.into_iter().filter(|cell| labels[*cell] == 0).collect();
        queue.iter().for_each(|cell| labels[*cell] = label);
        let mut reached = queue.len();
        while let Some(cell) = queue.pop_front() {
            for (next, _) in self.neighbours(cell).filter(|(_, over_edge)| *over_edge) {
                if labels[next] == 0 && open(next) {
                    labels[next] = label;
                    reached += 1;
                    queue.push_back(next);
                }
            }
        }
        reached
    }

    /// Computes the distance from each cell's centre to the nearest marked cell's centre, metres; infinite
    /// without one. It is exact (Felzenszwalb and Huttenlocher, "Distance Transforms of Sampled Functions",
    /// 2012).
    pub(crate) fn distances_m(&self, marked: &[bool]) -> Vec<f32> {
        let far = (self.width + self.height).pow(2) as f64;
        let mut squared: Vec<f64> = marked.iter().map(|m| if *m { 0.0 } else { far }).collect();
        let mut line = Vec::new();
        for column in 0..self.width {
            line.clear();
            line.extend((0..self.height).map(|row| squared[row * self.width + column]));
            for (row, value) in lower_envelope(&line).into_iter().enumerate() {
                squared[row * self.width + column] = value;
            }
        }
        for row in squared.chunks_mut(self.width) {
            let transformed = lower_envelope(row);
            row.copy_from_slice(&transformed);
        }
        let metres = |d: f64| if d >= far { f32::INFINITY } else { (d.sqrt() * self.resolution_m) as f32 };
        squared.into_iter().map(metres).collect()
    }
}

/// Returns the cells whose centres lie between the smallest and the largest of some coordinates, which are
/// in units of cells. The result lies inside `0..limit`.
fn bounds(cells: impl Iterator<Item = f64>, limit: usize) -> core::ops::Range<usize> {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    cells.for_each(|c| (low, high) = (low.min(c), high.max(c)));
    // Centres of cells are at half units.
    let first = (low - 0.5).ceil().max(0.0);
    let end = ((high - 0.5).floor() + 1.0).min(limit as f64);
    if first < end { first as usize..end as usize } else { 0..0 }
}

/// Computes the minimum over q of (p - q)² + f(q), for every p.
fn lower_envelope(f: &[f64]) -> Vec<f64> {
    let meet = |p: usize, q: usize| {
        let (pf, qf) = (p as f64, q as f64);
        ((f[q] + qf * qf) - (f[p] + pf * pf)) / (2.0 * (qf - pf))
    };
    // Parabolas of the envelope with the coordinate at which each begins.
    let mut hull: Vec<(usize, f64)> = vec![(0, f64::NEG_INFINITY)];
    for q in 1..f.len() {
        while let Some((p, begin)) = hull.last().copied() {
            let at = meet(p, q);
            if at > begin {
                hull.push((q, at));
                break;
            }
            hull.pop();
        }
        if hull.is_empty() {
            hull.push((q, f64::NEG_INFINITY));
        }
    }
    let mut k = 0;
    let value = |p: usize| {
        while hull.get(k + 1).is_some_and(|(_, begin)| *begin < p as f64) {
            k += 1;
        }
        let q = hull[k].0;
        (p as f64 - q as f64).powi(2) + f[q]
    };
    (0..f.len()).map(value).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn raster() -> Raster {
        Raster::covering([0.0, 0.0], [1.0, 0.5], 0.1)
    }

    #[test]
    fn distances_equal_those_of_brute_force() {
        let raster = raster();
        let marked: Vec<bool> = (0..raster.len()).map(|i| i % 37 == 5).collect();
        let distances = raster.distances_m(&marked);
        for (cell, distance) in distances.iter().enumerate() {
            let [x, y] = raster.centre_m(cell);
            let to = |other| {
                let [u, v] = raster.centre_m(other);
                (x - u).hypot(y - v)
            };
            let nearest = (0..raster.len()).filter(|i| marked[*i]).map(to).min_by(f64::total_cmp).unwrap();
            assert!((f64::from(*distance) - nearest).abs() < 1e-6, "{cell}: {distance} {nearest}");
        }
        assert!(raster.distances_m(&vec![false; raster.len()]).iter().all(|d| d.is_infinite()));
    }

    #[test]
    fn polygons_are_filled() {
        let raster = raster();
        let mut cells = vec![false; raster.len()];
        raster.mark_polygon(&mut cells, &[[0.11, 0.11], [0.49, 0.11], [0.49, 0.29], [0.11, 0.29]]);
        assert_eq!(cells.iter().filter(|c| **c).count(), 4 * 2);
    }

    #[test]
    fn regions_are_not_connected_over_corners() {
        let raster = Raster { origin_m: [0.0; 2], resolution_m: 1.0, width: 2, height: 2 };
        let (labels, sizes) = raster.regions(&[true, false, false, true]);
        assert_eq!((labels, sizes), (vec![1, 0, 0, 2], vec![0, 1, 1]));
    }
}
