//! Triangulation of simple polygons by ear clipping (Meisters, 1975).

use glam::Vec2;

/// Most corners of a polygon: the work grows with their square, at worst with their cube.
pub(crate) const CORNERS_MAX: usize = 500;
/// Smallest area of a polygon, square metres: a square centimetre.
const AREA_MIN_M2: f32 = 1e-4;

/// Reason why a polygon has no triangles.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PolygonError {
    /// There are too few or too many corners.
    #[error("{0} corners; expected 3 to {CORNERS_MAX}")]
    Corners(usize),
    /// The polygon encloses nothing.
    #[error("the corners enclose {0} m²")]
    Empty(f32),
    /// The outline crosses itself.
    #[error("the outline crosses itself")]
    Crossing,
}

/// Returns the triangles of a polygon, by the numbers of its corners.
pub(crate) fn triangulate(corners: &[Vec2]) -> Result<Vec<[u32; 3]>, PolygonError> {
    if !(3..=CORNERS_MAX).contains(&corners.len()) {
        return Err(PolygonError::Corners(corners.len()));
    }
    let next = corners.iter().cycle().skip(1);
    let area = corners.iter().zip(next).map(|(a, b)| a.perp_dot(*b)).sum::<f32>() / 2.0;
    if area.is_nan() || area.abs() < AREA_MIN_M2 {
        return Err(PolygonError::Empty(area.abs()));
    }
    if crosses_itself(corners) {
        return Err(PolygonError::Crossing);
    }
    let mut rest: Vec<u32> = (0..corners.len() as u32).collect();
    if area < 0.0 {
        rest.reverse();
    }
    let mut triangles = Vec::with_capacity(corners.len() - 2);
    while rest.len() > 3 {
        let ear = (0..rest.len()).find(|i| is_ear(corners, &rest, *i)).ok_or(PolygonError::Crossing)?;
        triangles.push(around(&rest, ear));
        rest.remove(ear);
    }
    triangles.push([rest[0], rest[1], rest[2]]);
    Ok(triangles)
}

/// Returns whether two edges cross. Edges that only touch do not.
fn crosses_itself(corners: &[Vec2]) -> bool {
    let edges = || corners.iter().zip(corners.iter().cycle().skip(1));
    let turn = |p: Vec2, q: Vec2, r: Vec2| (q - p).perp_dot(r - p);
    edges().enumerate().any(|(i, (a, b))| {
        edges().skip(i + 1).any(|(c, d)| {
            turn(*a, *b, *c) * turn(*a, *b, *d) < 0.0 && turn(*c, *d, *a) * turn(*c, *d, *b) < 0.0
        })
    })
}

/// Returns a corner between its neighbours.
fn around(rest: &[u32], i: usize) -> [u32; 3] {
    let count = rest.len();
    [rest[(i + count - 1) % count], rest[i], rest[(i + 1) % count]]
}

/// Returns whether a corner can be cut off: it is convex or straight, and no other corner lies in its triangle.
fn is_ear(corners: &[Vec2], rest: &[u32], i: usize) -> bool {
    let triangle = around(rest, i);
    let [a, b, c] = triangle.map(|corner| corners[corner as usize]);
    let turn = |p: Vec2, q: Vec2, r: Vec2| (q - p).perp_dot(r - p);
    let convexity = turn(a, b, c);
    if convexity < 0.0 {
        return false;
    }
    // A corner on a straight edge takes no area with it.
    let is_inside = |p: Vec2| turn(a, b, p) >= 0.0 && turn(b, c, p) >= 0.0 && turn(c, a, p) >= 0.0;
    let others =
        rest.iter().filter(|corner| !triangle.contains(corner)).map(|corner| corners[*corner as usize]);
    convexity == 0.0 || !others.into_iter().any(|p| p != a && p != b && p != c && is_inside(p))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn area_of(corners: &[Vec2], triangles: &[[u32; 3]]) -> f32 {
        let of = |[a, b, c]: [u32; 3]| {
            let [a, b, c] = [a, b, c].map(|i| corners[i as usize]);
            (b - a).perp_dot(c - a).abs() / 2.0
        };
        triangles.iter().map(|triangle| of(*triangle)).sum()
    }

    #[test]
    fn a_corner_that_points_inwards_is_left_out() {
        let mut corners =
            [[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [2.0, 3.0], [2.0, 1.0], [0.0, 1.0]].map(Vec2::from);
        for _ in 0..2 {
            let triangles = triangulate(&corners).unwrap();
            assert_eq!(triangles.len(), 4);
            assert!((area_of(&corners, &triangles) - 8.0).abs() < 1e-5);
            corners.reverse();
        }
    }

    #[test]
    fn bad_outlines_are_named() {
        let bow = [[0.0, 0.0], [2.0, 2.0], [2.0, 0.0], [0.0, 1.0]].map(Vec2::from);
        assert_eq!(triangulate(&bow), Err(PolygonError::Crossing));
        assert_eq!(triangulate(&bow[..2]), Err(PolygonError::Corners(2)));
        assert!(matches!(triangulate(&[Vec2::ZERO; 3]), Err(PolygonError::Empty(_))));
        assert!(matches!(triangulate(&[Vec2::NAN; 3]), Err(PolygonError::Empty(_))));
    }

    proptest! {
        // A star-shaped polygon never crosses itself.
        #[test]
        fn triangles_cover_a_polygon_once(radii in proptest::collection::vec(0.5_f32..3.0, 3..40)) {
            let step = core::f32::consts::TAU / radii.len() as f32;
            let corners: Vec<Vec2> =
                radii.iter().enumerate().map(|(i, r)| Vec2::from_angle(step * i as f32) * *r).collect();
            let next = corners.iter().cycle().skip(1);
            let area = corners.iter().zip(next).map(|(a, b)| a.perp_dot(*b)).sum::<f32>() / 2.0;
            let triangles = triangulate(&corners).unwrap();
            prop_assert_eq!(triangles.len(), corners.len() - 2);
            prop_assert!((area_of(&corners, &triangles) - area).abs() < 1e-3 * area);
        }
    }
}
