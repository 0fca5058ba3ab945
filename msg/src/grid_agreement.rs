//! Agreement of two grids under a transform, cell by cell.

use crate::grid::{Occupancy, occupancy};
use crate::{GridView, Pose2};

/// Largest ratio of the sides of two grids' cells.
const RATIO_MAX: f64 = 64.0;
/// Most cells of the tolerance: bounds the cells that are looked at around one.
const TOLERANCE_CELLS_MAX: f64 = 10.0;
/// Number of bits of a fixed-point coordinate below one cell.
const FRACTION_BITS: u32 = 32;
/// Added to every coordinate, cells: a point on the border of two cells always falls into the same one.
const BORDER_BIAS_CELLS: f64 = 1e-6;

/// How well two grids agree where both are known.
///
/// Every known cell of each grid is compared with the nearest cell of the other, without interpolation; the two
/// directions are averaged.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GridAgreement {
    /// Share of the cells known to both on which they agree, 0 to 1: the acceptance index of Carpin ("Fast and accurate
    /// map merging for multi-robot systems", 2008).
    pub agreement: f64,
    /// The same if a cell within the tolerance may agree instead.
    pub agreement_near: f64,
    /// F1 of occupied cells within the tolerance, 0 to 1; 0 if the overlap has none.
    pub occupied_f1: f64,
    /// Area known to both, square metres.
    pub overlap_m2: f64,
    /// The same over the known area of the grid that knows less, 0 to 1.
    pub overlap_share: f64,
    /// Occupied cells of each grid that the other has within the tolerance.
    pub occupied_found: [u64; 2],
}

/// Counts of one direction.
#[derive(Default)]
struct OneWayCounts {
    known: u64,
    known_to_both: u64,
    agreeing: u64,
    agreeing_near: u64,
    occupied: u64,
    occupied_found: u64,
}

/// Compares two grids. The tolerance is in metres along each axis, and at least one cell.
///
/// `None` if no cell is known to both, or if the cells of one are more than 64 times as long as the other's.
pub fn compare_grids(
    a: GridView<'_>,
    b: GridView<'_>,
    a_from_b: Pose2,
    tolerance_m: f64,
) -> Option<GridAgreement> {
    let ratio = a.header.resolution_m / b.header.resolution_m;
    if !(1.0 / RATIO_MAX..=RATIO_MAX).contains(&ratio) {
        return None;
    }
    let a_in_b = count_one_way(a, b, a_from_b.inverse(), tolerance_m);
    let b_in_a = count_one_way(b, a, a_from_b, tolerance_m);
    if a_in_b.known_to_both == 0 || b_in_a.known_to_both == 0 {
        return None;
    }
    let mean = |part: fn(&OneWayCounts) -> u64| {
        let share = |way: &OneWayCounts| part(way) as f64 / way.known_to_both as f64;
        (share(&a_in_b) + share(&b_in_a)) / 2.0
    };
    let (precision, recall) = (a_in_b.occupied_share(), b_in_a.occupied_share());
    let occupied_f1 =
        if precision + recall > 0.0 { 2.0 * precision * recall / (precision + recall) } else { 0.0 };
    let area_m2 = |cells: u64, grid: GridView<'_>| cells as f64 * grid.header.resolution_m.powi(2);
    let overlap_m2 = (area_m2(a_in_b.known_to_both, a) + area_m2(b_in_a.known_to_both, b)) / 2.0;
    let smaller_m2 = area_m2(a_in_b.known, a).min(area_m2(b_in_a.known, b));
    Some(GridAgreement {
        agreement: mean(|way| way.agreeing),
        agreement_near: mean(|way| way.agreeing_near),
        occupied_f1,
        overlap_m2,
        overlap_share: (overlap_m2 / smaller_m2).min(1.0),
        occupied_found: [a_in_b.occupied_found, b_in_a.occupied_found],
    })
}

impl OneWayCounts {
    fn occupied_share(&self) -> f64 {
        if self.occupied == 0 { 0.0 } else { self.occupied_found as f64 / self.occupied as f64 }
    }
}

/// Compares every known cell of `from` with the nearest cell of `to`.
fn count_one_way(
    from: GridView<'_>,
    to: GridView<'_>,
    to_from_from: Pose2,
    tolerance_m: f64,
) -> OneWayCounts {
    let tolerance = (tolerance_m / to.header.resolution_m).round().clamp(1.0, TOLERANCE_CELLS_MAX) as i64;
    let mut counts = OneWayCounts::default();
    for_known_cells(from, to, to_from_from, |here, x, y| {
        counts.known += 1;
        let there = occupancy(to.cell(x, y));
        if there == Occupancy::Unknown {
            return;
        }
        counts.known_to_both += 1;
        let mut around = (y - tolerance..=y + tolerance)
            .flat_map(|y| (x - tolerance..=x + tolerance).map(move |x| (x, y)));
        let near = here == there || around.any(|(x, y)| occupancy(to.cell(x, y)) == here);
        counts.agreeing += u64::from(here == there);
        counts.agreeing_near += u64::from(near);
        if here == Occupancy::Occupied {
            counts.occupied += 1;
            counts.occupied_found += u64::from(near);
        }
    });
    counts
}

/// Calls `each` with the occupancy of every known cell of `from`, and with the column and row of `to`, perhaps outside it,
/// in which its centre lies.
pub fn for_known_cells(
    from: GridView<'_>,
    to: GridView<'_>,
    to_from_from: Pose2,
    mut each: impl FnMut(Occupancy, i64, i64),
) {
    let to_grid_from_grid = to.header.origin.inverse() * to_from_from * from.header.origin;
    let (sin, cos) = to_grid_from_grid.yaw_rad.sin_cos();
    let step = from.header.resolution_m / to.header.resolution_m;
    let (per_x, per_y) = ([cos * step, sin * step], [-sin * step, cos * step]);
    let origin = [to_grid_from_grid.x_m, to_grid_from_grid.y_m];
    let start = origin.map(|m| m / to.header.resolution_m + BORDER_BIAS_CELLS);
    let [du, dv] = per_x.map(to_fixed_point);
    for (y, row) in from.cells.chunks_exact((from.header.width as usize).max(1)).enumerate() {
        let y = y as f64 + 0.5;
        let [mut u, mut v] = [0, 1].map(|k| to_fixed_point(start[k] + 0.5 * per_x[k] + y * per_y[k]));
        for cell in row {
            let here = occupancy(*cell);
            if here != Occupancy::Unknown {
                each(here, u >> FRACTION_BITS, v >> FRACTION_BITS);
            }
            u = u.wrapping_add(du);
            v = v.wrapping_add(dv);
        }
    }
}

/// Converts a coordinate in cells to fixed point. No grid reaches beyond 2^30 cells.
fn to_fixed_point(cells: f64) -> i64 {
    let limit = f64::from(1 << 30);
    (cells.clamp(-limit, limit) * (1_u64 << FRACTION_BITS) as f64) as i64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::UNKNOWN;
    use crate::{Grid, GridHeader};

    /// A room of 6 m with a wall along x at this height, metres.
    fn room(resolution_m: f64, wall_m: f64) -> Grid {
        let side = (6.0 / resolution_m).round() as u32;
        let header = GridHeader { resolution_m, width: side, height: side, ..Default::default() };
        let mut grid = Grid { header, cells: vec![UNKNOWN; (side * side) as usize] };
        for y in 0..side {
            let is_wall = (f64::from(y) * resolution_m - wall_m).abs() < resolution_m / 2.0;
            let row = (y * side) as usize;
            grid.cells[row..row + side as usize].fill(if is_wall { 80 } else { -80 });
        }
        grid
    }

    #[test]
    fn the_tolerance_is_in_metres_whatever_the_resolution() {
        for resolution_m in [0.025, 0.05] {
            let (a, b) = (room(resolution_m, 3.0), room(resolution_m, 3.1));
            let f1 = |tolerance_m| {
                compare_grids(a.view(), b.view(), Pose2::IDENTITY, tolerance_m).unwrap().occupied_f1
            };
            assert_eq!((f1(0.0), f1(0.05), f1(0.1)), (0.0, 0.0, 1.0), "{resolution_m} m");
        }
        // A cell cannot be told from its neighbour: at least one is tolerated.
        let (a, b) = (room(0.2, 3.0), room(0.2, 3.2));
        let found = compare_grids(a.view(), b.view(), Pose2::IDENTITY, 0.05).unwrap();
        assert_eq!((found.occupied_f1, found.occupied_found), (1.0, [30, 30]));
        assert!(found.agreement < 1.0 && found.agreement_near == 1.0);
    }

    #[test]
    fn maps_without_a_common_cell_or_scale_are_not_compared() {
        let (a, b) = (room(0.05, 3.0), room(0.05, 3.0));
        let apart = Pose2::new(100.0, 0.0, 0.0);
        assert_eq!(compare_grids(a.view(), b.view(), apart, 0.05), None);
        let tiny = Grid { header: GridHeader { resolution_m: 5e-4, ..b.header }, ..b.clone() };
        assert_eq!(compare_grids(a.view(), tiny.view(), Pose2::IDENTITY, 0.05), None);
    }
}
