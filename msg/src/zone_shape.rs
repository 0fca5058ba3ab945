//! Shape of an exclusion zone: its corners go around one area, and its sides meet in corners alone.

use thiserror::Error;

/// Smallest area of a zone, square metres: no robot, and no obstacle that a person wants to fence off, is smaller.
const AREA_MIN_M2: f64 = 1e-4;

/// Corners that go around no area.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum ShapeError {
    /// Two corners are the same point.
    #[error(
        "corners {} and {} of the zone are the same point; expected each corner once (the last is joined to the first by itself)",
        .0 + 1, .1 + 1
    )]
    Repeated(usize, usize),
    /// Two sides cross, touch or lie on each other: what is inside is not clear.
    #[error(
        "the sides of the zone behind corners {} and {} cross or touch each other; expected the corners in order around the area",
        .0 + 1, .1 + 1
    )]
    Crossing(usize, usize),
    /// The corners lie on one line, or nearly.
    #[error("the corners of the zone lie on one line or nearly; expected an area of 1 cm2 or more")]
    NoArea,
}

/// Refuses corners that repeat, lie on one line, or whose sides cross.
pub(crate) fn check(corners_m: &[[f64; 2]]) -> Result<(), ShapeError> {
    let count = corners_m.len();
    let pairs = || (0..count).flat_map(|i| (i + 1..count).map(move |j| (i, j)));
    if let Some((i, j)) = pairs().find(|(i, j)| corners_m[*i] == corners_m[*j]) {
        return Err(ShapeError::Repeated(i, j));
    }
    if !has_area(corners_m) {
        return Err(ShapeError::NoArea);
    }
    let side = |i: usize| [corners_m[i], corners_m[(i + 1) % count]];
    let is_crossing = |i: usize, j: usize| {
        let ([a, b], [c, d]) = (side(i), side(j));
        if b == c {
            return turns_back(a, b, d);
        }
        if d == a {
            return turns_back(c, a, b);
        }
        do_sides_meet([a, b], [c, d])
    };
    if let Some((i, j)) = pairs().find(|(i, j)| is_crossing(*i, *j)) {
        return Err(ShapeError::Crossing(i, j));
    }
    // A thin zone has corners that make a triangle, and still no area.
    let [x, y] = corners_m[0];
    let twice_m2: f64 = (0..count).map(|i| cross(corners_m[i], corners_m[(i + 1) % count], [x, y])).sum();
    if twice_m2.abs() / 2.0 < AREA_MIN_M2 { Err(ShapeError::NoArea) } else { Ok(()) }
}

/// Twice the area of a triangle, positive if it turns to the left, square metres.
fn cross(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (a[0] - c[0]) * (b[1] - c[1]) - (a[1] - c[1]) * (b[0] - c[0])
}

/// Whether two sides that share the corner `b` lie on each other.
fn turns_back(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> bool {
    let along = (a[0] - b[0]) * (c[0] - b[0]) + (a[1] - b[1]) * (c[1] - b[1]);
    cross(a, c, b) == 0.0 && along > 0.0
}

/// Whether two sides without a common corner have a point in common.
fn do_sides_meet([a, b]: [[f64; 2]; 2], [c, d]: [[f64; 2]; 2]) -> bool {
    let (of_c, of_d) = (cross(a, b, c), cross(a, b, d));
    let (of_a, of_b) = (cross(c, d, a), cross(c, d, b));
    let is_between = |p: [f64; 2], q: [f64; 2], r: [f64; 2]| {
        (0..2).all(|axis| p[axis].min(q[axis]) <= r[axis] && r[axis] <= p[axis].max(q[axis]))
    };
    let do_cross = of_c * of_d < 0.0 && of_a * of_b < 0.0;
    do_cross
        || of_c == 0.0 && is_between(a, b, c)
        || of_d == 0.0 && is_between(a, b, d)
        || of_a == 0.0 && is_between(c, d, a)
        || of_b == 0.0 && is_between(c, d, b)
}

/// Whether some three of the corners make a triangle of the smallest area.
fn has_area(corners_m: &[[f64; 2]]) -> bool {
    let first = corners_m[0];
    corners_m.iter().any(|a| corners_m.iter().any(|b| cross(*a, *b, first).abs() / 2.0 >= AREA_MIN_M2))
}

#[cfg(test)]
mod tests {
    use super::*;
    /// Most corners that are tried.
    const CORNERS_MAX: usize = 16;

    /// Corners of a convex polygon, in order to the left, with the first at this index of the circle.
    fn convex(count: usize, seed: u64) -> Vec<[f64; 2]> {
        let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        let mut random = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let (centre_m, radius_m) =
            ([200.0 * random() - 100.0, 200.0 * random() - 100.0], 0.3 + 5.0 * random());
        let corner = |i: usize, shift: f64| {
            let angle_rad = core::f64::consts::TAU * (i as f64 + 0.8 * shift) / count as f64;
            [centre_m[0] + radius_m * angle_rad.cos(), centre_m[1] + radius_m * angle_rad.sin()]
        };
        (0..count).map(|i| corner(i, random())).collect()
    }

    #[test]
    fn of_all_orders_of_corners_only_those_around_the_area_make_a_zone() {
        for seed in 0..200 {
            let count = 4 + (seed as usize) % (CORNERS_MAX - 3);
            let corners_m = convex(count, seed);
            assert!(check(&corners_m).is_ok(), "{corners_m:?}");
            let reversed: Vec<_> = corners_m.iter().rev().copied().collect();
            assert!(check(&reversed).is_ok(), "{reversed:?}");
            for (i, j) in [(0, 1), (1, count - 1), (0, count / 2)] {
                let mut swapped = corners_m.clone();
                swapped.swap(i, j);
                // With four corners, opposite ones that change places are the same area the other way around.
                let is_same = count == 4 && j - i == 2;
                let zone = check(&swapped);
                assert!(is_same == zone.is_ok(), "corners {i} and {j} of {swapped:?}: {zone:?}");
                assert!(is_same || matches!(zone, Err(ShapeError::Crossing(..))), "{swapped:?}: {zone:?}");
            }
        }
    }

    #[test]
    fn corners_that_repeat_or_enclose_nothing_make_no_zone() {
        for seed in 0..50 {
            let corners_m = convex(3 + (seed as usize) % 8, seed);
            for i in 0..corners_m.len() {
                let mut repeated = corners_m.clone();
                repeated.push(corners_m[i]);
                assert_eq!(check(&repeated), Err(ShapeError::Repeated(i, corners_m.len())));
            }
            let flat: Vec<_> = corners_m.iter().map(|[x, _]| [*x, 2.0]).collect();
            assert_eq!(check(&flat), Err(ShapeError::NoArea));
        }
        let thin = [[0.0, 0.0], [1.0, 0.0], [1.0, 1e-5], [0.0, 1e-5]];
        assert_eq!(check(&thin), Err(ShapeError::NoArea));
        let spike = [[0.0, 0.0], [2.0, 0.0], [1.0, 0.0], [1.0, 1.0]];
        assert_eq!(check(&spike), Err(ShapeError::Crossing(0, 1)));
        let touching = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 0.0], [0.0, 1.0]];
        assert_eq!(check(&touching), Err(ShapeError::Crossing(0, 2)));
        let concave = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [1.0, 0.5]];
        assert!(check(&concave).is_ok());
        let on_a_side = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 2.0]];
        assert!(check(&on_a_side).is_ok(), "a corner may lie on a straight side");
    }
}
