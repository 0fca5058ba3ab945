//! Maps for tests.

use msg::grid::UNKNOWN;
use msg::{Grid, GridHeader, Pose2};

/// A map of 12 m x 9 m: rooms with doors and furniture. Inside of furniture and outside of the outer wall it is unknown.
pub fn house() -> Grid {
    let (width, height) = (260_u32, 200_u32);
    let furniture = [(120..132, 40..60), (200..230, 150..156), (30..36, 120..160)];
    let part_of = |x: u32, y: u32, rim: u32| {
        let (columns, rows) = (x - rim..=x + rim, y - rim..=y + rim);
        furniture.iter().any(|(across, along): &(core::ops::Range<u32>, core::ops::Range<u32>)| {
            across.contains(columns.start())
                && across.contains(columns.end())
                && along.contains(rows.start())
                && along.contains(rows.end())
        })
    };
    let wall = |x: u32, y: u32| {
        let outer = x == 10 || x == 249 || y == 10 || y == 189;
        let inner = (x == 90 && !(40..58).contains(&y)) || (y == 110 && x > 90 && !(150..168).contains(&x));
        outer || inner || part_of(x, y, 0)
    };
    let inside = |x: u32, y: u32| (10..250).contains(&x) && (10..190).contains(&y) && !part_of(x, y, 1);
    let cell = |x, y| match (inside(x, y), wall(x, y)) {
        (false, _) => UNKNOWN,
        (true, true) => 90,
        (true, false) => -90,
    };
    let header = GridHeader {
        origin: Pose2::new(-1.0, -1.0, 0.0),
        resolution_m: 0.05,
        width,
        height,
        ..Default::default()
    };
    Grid { header, cells: (0..height).flat_map(|y| (0..width).map(move |x| cell(x, y))).collect() }
}

/// Asserts that a figure is within a tolerance, and shows both if it is not.
pub fn within(found: f64, expected: f64, tolerance: f64) {
    assert!((found - expected).abs() <= tolerance, "{found} is not {expected} +- {tolerance}");
}
