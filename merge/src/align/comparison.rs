//! Comparison of two whole grids under a transform, cell by cell.

use msg::grid::{Occupancy, occupancy};
use msg::{GridView, Pose2};

/// How well two grids agree, both directions together.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct GridComparison {
    /// Share of the cells known to both on which they agree, 0 to 1: the acceptance index of Carpin ("Fast and accurate
    /// map merging for multi-robot systems", 2008).
    pub agreement: f64,
    /// F1 of occupied cells at a tolerance of one cell, 0 to 1.
    pub occupied_f1: f64,
    /// Area known to both, square metres.
    pub overlap_m2: f64,
    /// The same over the known area of the grid that knows less.
    pub overlap_share: f64,
    /// Occupied cells that the other grid has too, of both grids.
    pub inliers: u32,
}

/// Counts of one direction.
#[derive(Default)]
struct OneWayCounts {
    known: u64,
    known_to_both: u64,
    agreeing: u64,
    occupied: u64,
    occupied_found: u64,
}

/// Compares every known cell of each grid with the nearest cell of the other.
pub(crate) fn compare_grids(a: GridView<'_>, b: GridView<'_>, a_from_b: Pose2) -> GridComparison {
    let (a_in_b, b_in_a) = (count_one_way(a, b, a_from_b.inverse()), count_one_way(b, a, a_from_b));
    let share = |part: u64, whole: u64| if whole == 0 { 0.0 } else { part as f64 / whole as f64 };
    let precision = share(a_in_b.occupied_found, a_in_b.occupied);
    let recall = share(b_in_a.occupied_found, b_in_a.occupied);
    let area_m2 = |cells: u64, grid: GridView<'_>| cells as f64 * grid.header.resolution_m.powi(2);
    let overlap_m2 = (area_m2(a_in_b.known_to_both, a) + area_m2(b_in_a.known_to_both, b)) / 2.0;
    let smaller_m2 = area_m2(a_in_b.known, a).min(area_m2(b_in_a.known, b));
    let agreement =
        share(a_in_b.agreeing, a_in_b.known_to_both) + share(b_in_a.agreeing, b_in_a.known_to_both);
    GridComparison {
        agreement: agreement / 2.0,
        occupied_f1: if precision + recall > 0.0 {
            2.0 * precision * recall / (precision + recall)
        } else {
            0.0
        },
        overlap_m2,
        overlap_share: if smaller_m2 > 0.0 { overlap_m2 / smaller_m2 } else { 0.0 },
        inliers: (a_in_b.occupied_found + b_in_a.occupied_found) as u32,
    }
}

/// Looks up every known cell of `from` at the nearest cell of `to`, in fixed point.
fn count_one_way(from: GridView<'_>, to: GridView<'_>, to_from_from: Pose2) -> OneWayCounts {
    /// Coordinates are counted in 2^-32 of a cell.
    const FRACTION_BITS: u32 = 32;
    /// No grid reaches beyond so many cells.
    const CELLS_MAX: f64 = (1_u32 << 30) as f64;
    /// A point on the border of two cells always falls into the same one, whatever the last bit of a sine is.
    const BORDER_BIAS_CELLS: f64 = 1e-6;
    let fixed = |cells: f64| (cells.clamp(-CELLS_MAX, CELLS_MAX) * (1_u64 << FRACTION_BITS) as f64) as i64;
    let grid = to.header.origin.inverse() * to_from_from * from.header.origin;
    let (sin, cos) = grid.yaw_rad.sin_cos();
    let step = from.header.resolution_m / to.header.resolution_m;
    let start = [grid.x_m, grid.y_m].map(|m| m / to.header.resolution_m + BORDER_BIAS_CELLS);
    let (per_x, per_y) = ([cos * step, sin * step], [-sin * step, cos * step]);
    let [du, dv] = per_x.map(fixed);
    let mut counts = OneWayCounts::default();
    for (y, row) in from.cells.chunks_exact((from.header.width as usize).max(1)).enumerate() {
        let [mut u, mut v] = [0, 1].map(|k| fixed(start[k] + 0.5 * per_x[k] + (y as f64 + 0.5) * per_y[k]));
        for cell in row {
            let here = occupancy(*cell);
            if here != Occupancy::Unknown {
                counts.add(here, to, u >> FRACTION_BITS, v >> FRACTION_BITS);
            }
            u = u.wrapping_add(du);
            v = v.wrapping_add(dv);
        }
    }
    counts
}

impl OneWayCounts {
    fn add(&mut self, here: Occupancy, to: GridView<'_>, x: i64, y: i64) {
        self.known += 1;
        let there = occupancy(to.cell(x, y));
        if there == Occupancy::Unknown {
            return;
        }
        self.known_to_both += 1;
        self.agreeing += u64::from(here == there);
        if here == Occupancy::Occupied {
            self.occupied += 1;
            let mut around = (y - 1..=y + 1).flat_map(|y| (x - 1..=x + 1).map(move |x| (x, y)));
            let found = there == here || around.any(|(x, y)| occupancy(to.cell(x, y)) == here);
            self.occupied_found += u64::from(found);
        }
    }
}
