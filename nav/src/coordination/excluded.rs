//! Areas of the map that no robot may enter.

use crate::clearance_map::ClearanceMap;

/// Whether a cell's centre lies where robots are kept out.
pub(super) fn is_excluded(map: &ClearanceMap, excluded: &[Vec<[f64; 2]>], cell: usize) -> bool {
    // The centre takes longer than all else here.
    !excluded.is_empty() && {
        let centre_m = map.cell_centre_m(cell);
        excluded.iter().any(|polygon| contains(polygon, centre_m))
    }
}

/// Whether a polygon contains a point (even-odd rule).
fn contains(polygon: &[[f64; 2]], [x, y]: [f64; 2]) -> bool {
    let edges = polygon.iter().zip(polygon.iter().cycle().skip(1));
    let crosses = |(a, b): (&[f64; 2], &[f64; 2])| {
        (a[1] > y) != (b[1] > y) && x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
    };
    edges.filter(|edge| crosses(*edge)).count() % 2 == 1
}
