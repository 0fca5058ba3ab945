//! The gate: do two whole maps agree under a transform?

use msg::grid::{Occupancy, occupancy};
use msg::{GridView, Pose2};

/// Counts of both directions.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Agreement {
    /// Share of the cells both know on which they agree (Carpin's acceptance index), 0 to 1.
    pub agreement: f64,
    /// F1 of occupied cells at one cell's tolerance, 0 to 1.
    pub occupied_f1: f64,
    /// Floor and walls both know, square metres.
    pub overlap_m2: f64,
    /// The same over what the map that knows less knows.
    pub overlap_share: f64,
    /// Occupied cells found again, of both maps.
    pub walls_found: u32,
}

#[derive(Default)]
struct OneWay {
    known: u64,
    both: u64,
    agree: u64,
    walls: u64,
    walls_found: u64,
}

/// Both directions, nearest cells.
pub(crate) fn agreement(a: GridView<'_>, b: GridView<'_>, a_from_b: Pose2) -> Agreement {
    let (ab, ba) = (one_way(a, b, a_from_b.inverse()), one_way(b, a, a_from_b));
    let share = |part: u64, whole: u64| if whole == 0 { 0.0 } else { part as f64 / whole as f64 };
    let (precision, recall) = (share(ab.walls_found, ab.walls), share(ba.walls_found, ba.walls));
    let area = |cells: u64, grid: GridView<'_>| cells as f64 * grid.header.resolution_m.powi(2);
    let overlap_m2 = (area(ab.both, a) + area(ba.both, b)) / 2.0;
    let least_m2 = area(ab.known, a).min(area(ba.known, b));
    Agreement {
        agreement: (share(ab.agree, ab.both) + share(ba.agree, ba.both)) / 2.0,
        occupied_f1: if precision + recall > 0.0 {
            2.0 * precision * recall / (precision + recall)
        } else {
            0.0
        },
        overlap_m2,
        overlap_share: if least_m2 > 0.0 { overlap_m2 / least_m2 } else { 0.0 },
        walls_found: (ab.walls_found + ba.walls_found) as u32,
    }
}

/// Every known cell of `from` at the nearest cell of `to`, in fixed point of 2^-32 cells.
fn one_way(from: GridView<'_>, to: GridView<'_>, to_from_from: Pose2) -> OneWay {
    const FRACTION_BITS: u32 = 32;
    let limit = f64::from(1 << 30);
    let fixed = |cells: f64| (cells.clamp(-limit, limit) * (1_u64 << FRACTION_BITS) as f64) as i64;
    let grid = to.header.origin.inverse() * to_from_from * from.header.origin;
    let (sin, cos) = grid.yaw_rad.sin_cos();
    let step = from.header.resolution_m / to.header.resolution_m;
    let start = [grid.x_m, grid.y_m].map(|m| m / to.header.resolution_m + 1e-6);
    let (per_x, per_y) = ([cos * step, sin * step], [-sin * step, cos * step]);
    let [du, dv] = per_x.map(fixed);
    let mut way = OneWay::default();
    for (y, row) in from.cells.chunks_exact((from.header.width as usize).max(1)).enumerate() {
        let [mut u, mut v] = [0, 1].map(|k| fixed(start[k] + 0.5 * per_x[k] + (y as f64 + 0.5) * per_y[k]));
        for cell in row {
            let here = occupancy(*cell);
            if here != Occupancy::Unknown {
                way.count(here, to, u >> FRACTION_BITS, v >> FRACTION_BITS);
            }
            u = u.wrapping_add(du);
            v = v.wrapping_add(dv);
        }
    }
    way
}

impl OneWay {
    fn count(&mut self, here: Occupancy, to: GridView<'_>, x: i64, y: i64) {
        self.known += 1;
        let there = occupancy(to.cell(x, y));
        if there == Occupancy::Unknown {
            return;
        }
        self.both += 1;
        self.agree += u64::from(here == there);
        if here == Occupancy::Occupied {
            self.walls += 1;
            let mut near = (y - 1..=y + 1).flat_map(|y| (x - 1..=x + 1).map(move |x| (x, y)));
            let found = there == here || near.any(|(x, y)| occupancy(to.cell(x, y)) == here);
            self.walls_found += u64::from(found);
        }
    }
}
