//! The same pairs, varied as worse mapping would: coarser, noisier, cropped, bent by drift. Their truth follows from the
//! pair's. No wrong place may be accepted, whatever the map.

use super::pairs::{Outcome, Pair};
use super::table::{Row, Table};
use msg::grid::{OCCUPIED_MIN, Occupancy, UNKNOWN, occupancy};
use msg::{Grid, GridHeader, Pose2};
use nav::RandomNumbers;
use std::f64::consts::TAU;

/// Varies a map by a seed.
type Vary = fn(&Grid, u64) -> Grid;

/// Variation of the first and of the second map, negatives' too, and how much the second is bent, radians a metre.
const VARIATIONS: [(&str, Vary, Vary, f64); 7] = [
    ("second map at 0.1 m", same, coarse, 0.0),
    ("both at 0.1 m", coarse, coarse, 0.0),
    ("second map redrawn at a random angle", same, turned, 0.0),
    ("1 cell in 500 wrong, in both", noisy, noisy, 0.0),
    ("half of the second map", same, half, 0.0),
    ("second map bent: 1 degree each 10 m", same, same, 0.0017),
    ("second map bent: 3 degrees each 10 m", same, same, 0.0052),
];

/// Adds the figures of each variation over all pairs.
pub fn rows(table: &mut Table, pairs: &[Pair]) {
    table.begin("the same pairs, varied", "wrong, pairs", "right, pairs");
    for (name, vary_a, vary_b, rad_per_m) in VARIATIONS {
        let (mut right, mut placed, mut wrong) = (0, 0, Vec::new());
        for (seed, pair) in (1_u64..).zip(pairs) {
            let (a, mut b) = (vary_a(&pair.maps[0], 2 * seed), vary_b(&pair.maps[1], 2 * seed + 1));
            let outcome = if rad_per_m == 0.0 {
                Outcome::of([&a, &b], pair.a_from_b)
            } else {
                let straight = straight(&b, if seed % 2 == 0 { rad_per_m } else { -rad_per_m });
                b = resampled(&b, 0.0, &straight);
                Outcome::of_bent([&a, &b], pair.a_from_b, &straight)
            };
            placed += usize::from(pair.a_from_b.is_some());
            right += usize::from(outcome.right());
            if outcome.accepted() && !outcome.right() {
                wrong.push(pair.name.as_str());
            }
        }
        let note = format!("right of {placed} {}", wrong.join(" "));
        table.add(Row::new(name, wrong.len() as f64, f64::from(right as u32)).at_most(0.0).note(note));
    }
}

fn same(map: &Grid, _: u64) -> Grid {
    map.clone()
}

/// Cells of twice the size: occupied if one of the four is, known if one is.
fn coarse(map: &Grid, _: u64) -> Grid {
    let view = map.view();
    let (width, height) = (map.header.width.div_ceil(2), map.header.height.div_ceil(2));
    let cell = |x: u32, y: u32| {
        let four = [(0, 0), (1, 0), (0, 1), (1, 1)]
            .map(|(i, j)| view.cell(i64::from(2 * x) + i, i64::from(2 * y) + j));
        let known = four.iter().filter(|cell| **cell != UNKNOWN);
        known.copied().max_by_key(|cell| (*cell >= OCCUPIED_MIN, *cell)).unwrap_or(UNKNOWN)
    };
    let cells = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| cell(x, y)).collect();
    Grid {
        header: GridHeader { resolution_m: 2.0 * map.header.resolution_m, width, height, ..map.header },
        cells,
    }
}

/// The map resampled on a rotated grid, nearest cells.
fn turned(map: &Grid, seed: u64) -> Grid {
    resampled(map, TAU * share(seed), |place| place)
}

/// The map with one known cell in five hundred inverted.
fn noisy(map: &Grid, seed: u64) -> Grid {
    let mut random = seed;
    let mut noisy = map.clone();
    for cell in noisy.cells.iter_mut().filter(|cell| **cell != UNKNOWN) {
        random = RandomNumbers::new(random).next_u64();
        if random.is_multiple_of(500) {
            *cell = if occupancy(*cell) == Occupancy::Occupied { -60 } else { 60 };
        }
    }
    noisy
}

/// The part of the map on one side of a line through its centre.
fn half(map: &Grid, seed: u64) -> Grid {
    let (sin, cos) = (TAU * share(seed)).sin_cos();
    let middle = [map.header.width, map.header.height].map(|cells| f64::from(cells) / 2.0);
    let mut half = map.clone();
    for (index, cell) in half.cells.iter_mut().enumerate() {
        let (x, y) = (index % map.header.width as usize, index / map.header.width as usize);
        if (x as f64 - middle[0]) * cos + (y as f64 - middle[1]) * sin < 0.0 {
            *cell = UNKNOWN;
        }
    }
    half
}

/// Maps a point of the bent map to the straight one. It is bent as by a heading that drifts along x: right in the centre,
/// worse towards both ends.
fn straight(map: &Grid, rad_per_m: f64) -> impl Fn([f64; 2]) -> [f64; 2] + use<> {
    let half_m =
        [map.header.width, map.header.height].map(|cells| f64::from(cells) * map.header.resolution_m / 2.0);
    let middle = map.header.origin.apply(half_m);
    // An arc through the centre: the distance along it is the distance along the straight map.
    move |[x, y]| {
        let ([along, across], radius) = ([x - middle[0], y - middle[1]], 1.0 / rad_per_m);
        let (from_centre, angle) = (
            along.hypot(radius - across),
            along.atan2((radius - across) * radius.signum()) * radius.signum(),
        );
        [middle[0] + angle * radius, middle[1] + radius - from_centre * radius.signum()]
    }
}

/// The map on a grid rotated by `yaw_rad`; `source` gives the point that each cell is read from.
fn resampled(map: &Grid, yaw_rad: f64, source: impl Fn([f64; 2]) -> [f64; 2]) -> Grid {
    let resolution_m = map.header.resolution_m;
    let size_m = [map.header.width, map.header.height].map(|cells| f64::from(cells) * resolution_m);
    let half_m = 0.5 * size_m[0].hypot(size_m[1]) + 1.0;
    let side = (2.0 * half_m / resolution_m).ceil() as u32;
    let [x, y] = map.header.origin.apply([size_m[0] / 2.0, size_m[1] / 2.0]);
    let origin = Pose2::new(x, y, yaw_rad) * Pose2::new(-half_m, -half_m, 0.0);
    let header = GridHeader { origin, width: side, height: side, ..map.header };
    let mut grid = Grid { header, cells: vec![UNKNOWN; (side * side) as usize] };
    for y in 0..i64::from(side) {
        for x in 0..i64::from(side) {
            let (i, j) = map.view().cell_of(source(grid.view().centre_m(x, y)));
            grid.cells[(y * i64::from(side) + x) as usize] = map.view().cell(i, j);
        }
    }
    grid
}

fn share(seed: u64) -> f64 {
    (RandomNumbers::new(seed).next_u64() >> 11) as f64 / (1_u64 << 53) as f64
}
