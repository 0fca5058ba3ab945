//! Marking of zones and unknown space on a clearance map, and search for cells near a point.

use super::ClearanceMap;
use crate::geometry::distance_m;
use msg::grid::Occupancy;

impl ClearanceMap {
    /// Marks the cells whose centres lie in a polygon as occupied; its corners are in order, in the map's frame.
    pub(crate) fn mark_polygon_occupied(&mut self, corners_m: &[[f64; 2]]) {
        let corners: Vec<[f64; 2]> = corners_m
            .iter()
            .map(|corner| self.window_from_map.apply(*corner).map(|v| v / self.cell_size_m))
            .collect();
        let span = |axis: usize, size: i64| {
            let values = || corners.iter().map(|corner| corner[axis]);
            let low = values().fold(f64::INFINITY, f64::min).floor().max(0.0);
            let high = values().fold(f64::NEG_INFINITY, f64::max).ceil().min(size as f64);
            low as i64..high as i64
        };
        for y in span(1, self.height) {
            for x in span(0, self.width) {
                if is_inside([x as f64 + 0.5, y as f64 + 0.5], &corners) {
                    let cell = self.index(x, y);
                    self.occupancy[cell] = Occupancy::Occupied;
                }
            }
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

/// Whether a point lies in a polygon: a ray from it crosses the polygon's sides an odd number of times.
pub(crate) fn is_inside([x, y]: [f64; 2], corners: &[[f64; 2]]) -> bool {
    let next = corners.iter().cycle().skip(1);
    let crosses = |([ax, ay], [bx, by]): (&[f64; 2], &[f64; 2])| {
        (*ay > y) != (*by > y) && x < (bx - ax) * (y - ay) / (by - ay) + ax
    };
    corners.iter().zip(next).filter(|side| crosses(*side)).count() % 2 == 1
}
