//! Marking of zones and unknown space on a clearance map, and search for cells near a point.

use super::ClearanceMap;
use crate::geometry::distance_m;
use msg::grid::Occupancy;

impl ClearanceMap {
    /// Marks every cell that has a part of a polygon as occupied, however thin it is; its corners are in order, in the map's frame.
    pub(crate) fn mark_polygon_occupied(&mut self, corners_m: &[[f64; 2]]) {
        let corners: Vec<[f64; 2]> = corners_m.iter().map(|corner| self.in_cells(*corner)).collect();
        let (size, occupancy) = ((self.width, self.height), &mut self.occupancy);
        for_each_cell_near(&corners, size, 0.0, |cell| occupancy[cell] = Occupancy::Occupied);
    }

    /// Sets for each cell whether it has a part of one of the polygons, or less than `clearance_m` to a cell that has: no robot that needs
    /// this clearance may be there.
    pub(crate) fn mark_near_polygons(
        &self,
        polygons_m: &[Vec<[f64; 2]>],
        clearance_m: f64,
        is_near: &mut Vec<bool>,
    ) {
        is_near.clear();
        is_near.resize(self.cell_count(), false);
        for polygon_m in polygons_m {
            let corners: Vec<[f64; 2]> = polygon_m.iter().map(|corner| self.in_cells(*corner)).collect();
            let reach = clearance_m / self.cell_size_m;
            for_each_cell_near(&corners, (self.width, self.height), reach, |cell| is_near[cell] = true);
        }
    }

    /// Takes all unknown cells for free, but those of the outermost ring.
    pub(crate) fn mark_unknown_free(&mut self) {
        for y in 1..self.height - 1 {
            for x in 1..self.width - 1 {
                let cell = self.index(x, y);
                if self.occupancy[cell] == Occupancy::Unknown {
                    self.occupancy[cell] = Occupancy::Free;
                }
            }
        }
    }

    /// Whether an occupied cell lies within `reach` cells of the one that contains a point, along either axis.
    pub(crate) fn is_occupied_near(&self, point_m: [f64; 2], reach: i64) -> bool {
        let Some(centre) = self.cell_at(point_m) else { return false };
        let (cx, cy) = self.column_row(centre);
        let rows = (cy - reach).max(0)..=(cy + reach).min(self.height - 1);
        rows.into_iter().any(|y| {
            let mut columns = (cx - reach).max(0)..=(cx + reach).min(self.width - 1);
            columns.any(|x| self.occupancy[self.index(x, y)] == Occupancy::Occupied)
        })
    }

    /// The cell nearest to a point, at most `reach_m` away, of those for which `is_wanted`.
    pub(crate) fn nearest_cell(
        &self,
        point_m: [f64; 2],
        reach_m: f64,
        is_wanted: impl Fn(usize) -> bool,
    ) -> Option<usize> {
        let centre = self.cell_at(point_m)?;
        let (cx, cy) = self.column_row(centre);
        let reach = (reach_m / self.cell_size_m).ceil() as i64;
        let rows = (cy - reach).max(0)..=(cy + reach).min(self.height - 1);
        let columns = (cx - reach).max(0)..=(cx + reach).min(self.width - 1);
        let cells = rows.flat_map(|y| columns.clone().map(move |x| (x, y))).map(|(x, y)| self.index(x, y));
        let off_m = |cell: &usize| distance_m(self.cell_centre_m(*cell), point_m);
        let wanted = cells.filter(|cell| off_m(cell) <= reach_m.max(self.cell_size_m) && is_wanted(*cell));
        wanted.min_by(|a, b| off_m(a).total_cmp(&off_m(b)))
    }
}

/// Longest step along a side, in cells: no cell that a side crosses by more than a corner is left out.
const STEP_CELLS: f64 = 0.25;
/// Rounding of the clearance, in cells: a cell at the least clearance is far enough.
const ROUNDING_CELLS: f64 = 1e-4;

/// Calls `mark` with every cell of a grid whose centre is in a polygon or that a side crosses, and with those nearer than `reach` cells to
/// one that a side crosses. Cells come more than once.
fn for_each_cell_near(
    corners: &[[f64; 2]],
    (width, height): (i64, i64),
    reach: f64,
    mut mark: impl FnMut(usize),
) {
    let mut mark_cell = |x: i64, y: i64| {
        if (0..width).contains(&x) && (0..height).contains(&y) {
            mark((y * width + x) as usize);
        }
    };
    let sides = || corners.iter().zip(corners.iter().cycle().skip(1)).map(|(a, b)| (*a, *b));
    let mut crossings = Vec::with_capacity(corners.len());
    let rows = || corners.iter().map(|corner| corner[1]);
    let first = rows().fold(f64::INFINITY, f64::min).floor().clamp(0.0, height as f64) as i64;
    let last = rows().fold(f64::NEG_INFINITY, f64::max).ceil().clamp(0.0, height as f64) as i64;
    for y in first..last {
        let centre = y as f64 + 0.5;
        let crosses = sides().filter(|(a, b)| (a[1] > centre) != (b[1] > centre));
        crossings.clear();
        crossings.extend(crosses.map(|(a, b)| a[0] + (b[0] - a[0]) * (centre - a[1]) / (b[1] - a[1])));
        crossings.sort_by(f64::total_cmp);
        for pair in crossings.chunks_exact(2) {
            let [from, to] = [pair[0], pair[1]].map(|x| (x - 0.5).ceil().clamp(0.0, width as f64) as i64);
            (from..to).for_each(|x| mark_cell(x, y));
        }
    }
    // As navigation computes the clearance: the chamfer distance between the centres of cells.
    let side = reach.ceil() as i64;
    let around: Vec<(i64, i64)> = (-side..=side)
        .flat_map(|v| (-side..=side).map(move |u| (u, v)))
        .filter(|(u, v)| (*u, *v) == (0, 0) || chamfer_cells(*u, *v) < reach - ROUNDING_CELLS)
        .collect();
    let mut last = None;
    for (a, b) in sides() {
        let Some((from, to)) = clip(a, b, [width as f64, height as f64], reach + 1.0) else { continue };
        // The same points of the side, whatever part of it is near.
        let steps = ((b[0] - a[0]).hypot(b[1] - a[1]) / STEP_CELLS).ceil().max(1.0);
        for i in (from * steps).floor() as i64..=(to * steps).ceil() as i64 {
            let t = i as f64 / steps;
            let [x, y] = [0, 1].map(|axis| (a[axis] + t * (b[axis] - a[axis])).floor() as i64);
            if last.replace((x, y)) != Some((x, y)) {
                around.iter().for_each(|(u, v)| mark_cell(x + u, y + v));
            }
        }
    }
}

/// Chamfer distance between two cells that are so many columns and rows apart, in cells; see [`ClearanceMap::compute_clearance`].
fn chamfer_cells(columns: i64, rows: i64) -> f64 {
    let (u, v) = (columns.abs(), rows.abs());
    (u.max(v) - u.min(v)) as f64 + core::f64::consts::SQRT_2 * u.min(v) as f64
}

/// Part of a side within a distance of a rectangle from the origin, as shares of its length (Liang and Barsky 1984); `None` if there is
/// none. Zones may be many kilometres away.
fn clip(a: [f64; 2], b: [f64; 2], size: [f64; 2], beyond: f64) -> Option<(f64, f64)> {
    let (mut from, mut to) = (0.0f64, 1.0f64);
    for axis in 0..2 {
        let along = b[axis] - a[axis];
        let (low, high) = (-beyond - a[axis], size[axis] + beyond - a[axis]);
        if along == 0.0 {
            if low > 0.0 || high < 0.0 {
                return None;
            }
            continue;
        }
        let (first, last) = (low / along, high / along);
        from = from.max(first.min(last));
        to = to.min(first.max(last));
    }
    (from <= to).then_some((from, to))
}

/// Whether a point lies in a polygon: a ray from it crosses the polygon's sides an odd number of times.
pub(crate) fn is_inside([x, y]: [f64; 2], corners: &[[f64; 2]]) -> bool {
    let next = corners.iter().cycle().skip(1);
    let crosses = |([ax, ay], [bx, by]): (&[f64; 2], &[f64; 2])| {
        (*ay > y) != (*by > y) && x < (bx - ax) * (y - ay) / (by - ay) + ax
    };
    corners.iter().zip(next).filter(|side| crosses(*side)).count() % 2 == 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observation::MapView;
    use crate::random::RandomNumbers;
    use msg::Pose2;

    const SIZE: u32 = 60;
    const CELL_M: f64 = 0.05;

    fn free_map() -> ClearanceMap {
        let free = vec![0; (SIZE * SIZE) as usize];
        let mut map = ClearanceMap::default();
        let view = MapView::from_percent(Pose2::new(-0.4, 0.3, 0.5), CELL_M, (SIZE, SIZE), &free).unwrap();
        map.copy_window(&view, [0.0, 0.0]);
        map
    }

    fn random_m(random: &mut RandomNumbers, span_m: f64) -> f64 {
        (random.index_below(10_000) as f64 / 10_000.0 - 0.5) * span_m
    }

    /// Zones of any shape and width: what a robot could pass on one side of it or the other, it must not cross.
    #[test]
    fn every_point_of_a_zone_is_in_a_marked_cell_and_far_ones_are_free() {
        for seed in 0..300 {
            let mut random = RandomNumbers::new(seed);
            // Every third zone is thinner than a cell, some begin far outside of the map.
            let span_m = if seed % 7 == 0 { 4000.0 } else { 4.0 };
            let width_m = [0.001, 0.03, 1.5][(seed % 3) as usize];
            let a = [random_m(&mut random, span_m), random_m(&mut random, span_m)];
            let b = [random_m(&mut random, span_m), random_m(&mut random, span_m)];
            let length_m = distance_m(a, b).max(0.01);
            let side = [-(b[1] - a[1]), b[0] - a[0]].map(|v| v / length_m * width_m);
            let zone = [a, b, [b[0] + side[0], b[1] + side[1]], [a[0] + side[0], a[1] + side[1]]];
            let mut map = free_map();
            map.mark_polygon_occupied(&zone);
            let mut is_near = Vec::new();
            map.mark_near_polygons(&[zone.to_vec()], 0.19, &mut is_near);
            for i in 0..=2000 {
                let t = i as f64 / 2000.0;
                let at_m = [0, 1].map(|axis| a[axis] + t * (b[axis] - a[axis]) + 0.5 * side[axis]);
                if let Some(cell) = map.cell_at(at_m) {
                    assert!(is_near[cell], "seed {seed}: {at_m:?} of {zone:?}");
                    let beside = width_m < CELL_M && map.is_occupied_near(at_m, 1);
                    assert!(beside || map.occupancy(cell) == Occupancy::Occupied, "seed {seed}: {at_m:?}");
                }
            }
            map.compute_clearance();
            for (cell, is_near) in is_near.iter().enumerate() {
                let (x, y) = map.column_row(cell);
                // The clearance is less exact beside the border of the window.
                let is_inner = |v: i64| (5..i64::from(SIZE) - 5).contains(&v);
                if is_inner(x) && is_inner(y) {
                    let is_too_near = map.clearance_m(cell) < 0.19 - 1e-5;
                    assert_eq!(*is_near, is_too_near, "seed {seed}: {} of {zone:?}", map.clearance_m(cell));
                }
                let centre_m = map.cell_centre_m(cell);
                let is_in = is_inside(centre_m, &zone);
                if map.occupancy(cell) == Occupancy::Occupied {
                    assert!(
                        is_in || off_m(centre_m, &zone) < CELL_M,
                        "seed {seed}: {centre_m:?} of {zone:?}"
                    );
                }
                assert!(!is_in || map.occupancy(cell) == Occupancy::Occupied, "seed {seed}: {centre_m:?}");
            }
        }
    }

    /// Distance of a point from the nearest side.
    fn off_m(point: [f64; 2], corners: &[[f64; 2]]) -> f64 {
        let sides = corners.iter().zip(corners.iter().cycle().skip(1));
        let off = |(a, b): (&[f64; 2], &[f64; 2])| {
            let (along, to) = ([b[0] - a[0], b[1] - a[1]], [point[0] - a[0], point[1] - a[1]]);
            let t = (along[0] * to[0] + along[1] * to[1]) / (along[0] * along[0] + along[1] * along[1]);
            let t = t.clamp(0.0, 1.0);
            (to[0] - t * along[0]).hypot(to[1] - t * along[1])
        };
        sides.map(off).fold(f64::INFINITY, f64::min)
    }
}
