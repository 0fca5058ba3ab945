//! Outlines of sets of cells: closed lines around each connected part and around each of its holes.
//!
//! Cells that touch at an edge or at a corner are connected, so that a wall whose cells touch at corners alone stays closed.

use glam::DVec2;

/// Distance of an outline from the edges of its cells, to the inside, in cells. A measured range ends in the cell then, also with an
/// error of a quarter of a cell, and walls are half a cell thick where one cell is occupied.
pub(super) const INSET_CELLS: f64 = 0.25;
/// Largest number of points behind the last possible end of a segment among which a farther end is looked for.
const LOOK_AHEAD: usize = 64;
/// Directions of a cell's sides, counter-clockwise from east.
const SIDES: [(i32, i32); 4] = [(1, 0), (0, 1), (-1, 0), (0, -1)];

/// A point of an outline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct OutlinePoint {
    /// Cell of the set in which the point lies, as column and row.
    pub(super) cell: (i32, i32),
    /// Position in cells from the corner of cell (0, 0).
    pub(super) position: DVec2,
}

impl OutlinePoint {
    /// Returns the point of a cell in the direction of one of its sides, or of the corner between two.
    fn towards(cell: (i32, i32), sides: &[usize]) -> Self {
        let centre = DVec2::new(f64::from(cell.0) + 0.5, f64::from(cell.1) + 0.5);
        let offset = |side: &usize| DVec2::new(f64::from(SIDES[*side].0), f64::from(SIDES[*side].1));
        let position = centre + sides.iter().map(offset).sum::<DVec2>() * (0.5 - INSET_CELLS);
        Self { cell, position }
    }
}

/// A side of a cell of the set, beyond which a cell is not of the set.
#[derive(Clone, Copy, PartialEq)]
struct Side {
    cell: (i32, i32),
    /// Index into [`SIDES`].
    side: usize,
}

impl Side {
    /// Returns the next side of the ring, with the set on the left hand, and adds the points from this side on.
    fn next(self, is_inside: &impl Fn(i32, i32) -> bool, ring: &mut Vec<OutlinePoint>) -> Self {
        let Self { cell, side } = self;
        let (ahead, back) = ((side + 1) % 4, (side + 3) % 4);
        let step = |(x, y): (i32, i32), side: usize| (x + SIDES[side].0, y + SIDES[side].1);
        let beside = step(cell, ahead);
        let corner = step(beside, side);
        let [has_beside, has_corner] = [beside, corner].map(|(x, y)| is_inside(x, y));
        ring.push(OutlinePoint::towards(cell, &[side]));
        match (has_beside, has_corner) {
            (true, true) => ring.push(OutlinePoint::towards(beside, &[side, back])),
            // The cells touch at a corner: the outline goes there and back through it.
            (false, true) => ring.extend([
                OutlinePoint::towards(cell, &[side, ahead]),
                OutlinePoint::towards(corner, &[back, (side + 2) % 4]),
            ]),
            (true, false) => {}
            (false, false) => ring.push(OutlinePoint::towards(cell, &[side, ahead])),
        }
        match (has_beside, has_corner) {
            (_, true) => Self { cell: corner, side: back },
            (true, false) => Self { cell: beside, side },
            (false, false) => Self { cell, side: ahead },
        }
    }
}

/// Counts the sides between cells of the set and others: each gives one to three points of an outline.
pub(super) fn count_sides([width, height]: [usize; 2], is_inside: impl Fn(i32, i32) -> bool) -> usize {
    let rows = (0..height as i32).flat_map(|row| (0..width as i32).map(move |column| (column, row)));
    let changes = |(x, y): (i32, i32)| {
        let here = is_inside(x, y);
        usize::from(here != is_inside(x - 1, y)) + usize::from(here != is_inside(x, y - 1))
    };
    rows.map(changes).sum()
}

/// Calls `visit` with each ring around a part or a hole of the set of cells for which `is_inside` holds. All sides lie in
/// `width` by `height` cells: beyond them every cell has the value of the nearest one on the rim.
pub(super) fn visit_outlines(
    [width, height]: [usize; 2],
    is_inside: impl Fn(i32, i32) -> bool,
    mut visit: impl FnMut(&[OutlinePoint]),
) {
    const WEST: usize = 2;
    // Each ring crosses a row from the outside to the inside somewhere: there it has a western side.
    let mut visited = vec![false; width * height];
    let mut ring = Vec::new();
    for (row, column) in (0..height as i32).flat_map(|row| (0..width as i32).map(move |column| (row, column)))
    {
        let start = Side { cell: (column, row), side: WEST };
        let index = |(column, row): (i32, i32)| row as usize * width + column as usize;
        if visited[index(start.cell)] || !is_inside(column, row) || is_inside(column - 1, row) {
            continue;
        }
        ring.clear();
        let mut at = start;
        loop {
            if at.side == WEST {
                visited[index(at.cell)] = true;
            }
            at = at.next(&is_inside, &mut ring);
            if at == start {
                break;
            }
        }
        visit(&ring);
    }
}

/// Returns a line through some of the points, the first and the last among them. Each point that is left out lies within `tolerance`
/// of the segment that replaces it.
///
/// A segment is prolonged as long as one direction passes all points within the tolerance (the cone of Sklansky and Gonzalez, "Fast
/// polygonal approximation of digitized curves", 1980). The time is proportional to the number of points.
pub(super) fn simplify(points: &[DVec2], tolerance: f64) -> Vec<DVec2> {
    let mut kept: Vec<DVec2> = points.first().copied().into_iter().collect();
    let mut from = 0;
    while from + 1 < points.len() {
        from = farthest_end(points, from, tolerance);
        kept.push(points[from]);
    }
    kept
}

/// Returns the last point up to which one segment from `from` can replace the points between.
fn farthest_end(points: &[DVec2], from: usize, tolerance: f64) -> usize {
    let mut end = from + 1;
    let mut reach = 0.0_f64;
    // First direction, and the angles from it between which the segment may lie.
    let mut cone: Option<(DVec2, f64, f64)> = None;
    for (index, point) in points.iter().enumerate().skip(from + 1) {
        let offset = *point - points[from];
        let distance = offset.length();
        if distance < reach - tolerance || index > end + LOOK_AHEAD {
            break;
        }
        let mut is_end = distance >= reach;
        if distance > tolerance {
            let half = (tolerance / distance).asin();
            let (first, low, high) = cone.unwrap_or((offset, -half, half));
            let angle = first.angle_to(offset);
            is_end &= (low..=high).contains(&angle);
            let (low, high) = (low.max(angle - half), high.min(angle + half));
            cone = Some((first, low, high));
            if low > high {
                break;
            }
        }
        reach = reach.max(distance);
        if is_end {
            end = index;
        }
    }
    end
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SIDE: usize = 12;

    /// A set of cells; beyond its rim of one cell nothing belongs to it.
    #[derive(Clone, Debug)]
    struct Bitmap([[bool; SIDE]; SIDE]);

    impl Bitmap {
        fn has(&self, column: i32, row: i32) -> bool {
            let inside = |cell: i32| (1..SIDE as i32 - 1).contains(&cell);
            inside(column) && inside(row) && self.0[row as usize][column as usize]
        }

        fn cells(&self) -> impl Iterator<Item = (i32, i32)> + '_ {
            let all = (0..SIDE as i32).flat_map(|row| (0..SIDE as i32).map(move |column| (column, row)));
            all.filter(|(column, row)| self.has(*column, *row))
        }

        fn outlines(&self) -> Vec<Vec<OutlinePoint>> {
            let mut outlines = Vec::new();
            visit_outlines(
                [SIDE; 2],
                |column, row| self.has(column, row),
                |ring| outlines.push(ring.to_vec()),
            );
            outlines
        }

        /// Segments between the centres of cells of the set that touch at an edge, or at a corner without a third one between.
        fn skeleton(&self) -> Vec<[DVec2; 2]> {
            let steps = [(1, 0), (0, 1), (1, 1), (-1, 1)];
            let pairs = self.cells().flat_map(|(x, y)| steps.map(|(dx, dy)| [(x, y), (x + dx, y + dy)]));
            let is_short = |[(x, y), (u, v)]: &[(i32, i32); 2]| {
                x == u || y == v || !(self.has(*x, *v) || self.has(*u, *y))
            };
            let joined = pairs.filter(|[_, (x, y)]| self.has(*x, *y)).filter(is_short);
            joined.map(|ends| ends.map(|(x, y)| DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5))).collect()
        }

        /// Returns the distance from a point to the nearest cell of the set.
        fn distance(&self, point: DVec2) -> f64 {
            let to = |(x, y): (i32, i32)| {
                let corner = DVec2::new(f64::from(x), f64::from(y));
                point.distance(point.clamp(corner, corner + DVec2::ONE))
            };
            self.cells().map(to).fold(f64::INFINITY, f64::min)
        }
    }

    fn bitmaps() -> impl Strategy<Value = Bitmap> {
        let cell = prop::bool::weighted(0.35);
        prop::array::uniform12(prop::array::uniform12(cell)).prop_map(Bitmap)
    }

    /// Returns the distance along a ray at which it crosses a segment; its ends may be missed by a rounding error.
    fn crossing(from: DVec2, direction: DVec2, [a, b]: [DVec2; 2]) -> Option<f64> {
        let (along, offset) = (b - a, a - from);
        let denominator = direction.perp_dot(along);
        let at = offset.perp_dot(along) / denominator;
        let share = offset.perp_dot(direction) / denominator;
        (at > 0.0 && (0.0..=1.0).contains(&share)).then_some(at)
    }

    fn distance_to_segment(point: DVec2, [a, b]: [DVec2; 2]) -> f64 {
        let along = b - a;
        let share = ((point - a).dot(along) / along.length_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        point.distance(a + along * share)
    }

    proptest! {
        #[test]
        fn outlines_pass_each_side_between_inside_and_outside_once(bitmap in bitmaps()) {
            let sides = bitmap.cells().flat_map(|(x, y)| SIDES.map(|(dx, dy)| (x + dx, y + dy)));
            let expected = sides.filter(|(x, y)| !bitmap.has(*x, *y)).count();
            let outlines = bitmap.outlines();
            prop_assert_eq!(count_sides([SIDE; 2], |column, row| bitmap.has(column, row)), expected);
            let is_middle = |point: &&OutlinePoint| (point.position - point.position.floor()).to_array().contains(&0.5);
            prop_assert_eq!(outlines.iter().flatten().filter(is_middle).count(), expected);
            for ring in outlines {
                let next = ring.iter().cycle().skip(1);
                for (point, next) in ring.iter().zip(next) {
                    prop_assert!(point.position.distance(next.position) <= 1.0);
                }
            }
        }

        #[test]
        fn a_ray_ends_at_the_first_cell_that_it_enters_deeply(
            bitmap in bitmaps(), from in (1.0..11.0, 1.0..11.0), angle in 0.0..core::f64::consts::TAU,
        ) {
            let (from, direction) = (DVec2::from(from), DVec2::from_angle(angle));
            prop_assume!(bitmap.distance(from) > 0.0);
            let outlines = bitmap.outlines();
            let edges = outlines.iter().flat_map(|ring| ring.iter().zip(ring.iter().cycle().skip(1)));
            let edges = edges.map(|(a, b)| [a.position, b.position]);
            let nearest = |hits: &mut dyn Iterator<Item = f64>| hits.fold(f64::INFINITY, f64::min);
            let range = nearest(&mut edges.filter_map(|edge| crossing(from, direction, edge)));
            if range.is_finite() {
                prop_assert!(bitmap.distance(from + direction * range) < 1e-9);
            }
            let skeleton = bitmap.skeleton();
            let behind = nearest(&mut skeleton.iter().filter_map(|pair| crossing(from, direction, *pair)));
            prop_assert!(range <= behind + 1e-9, "{} behind {}", range, behind);
        }

        #[test]
        fn points_that_are_left_out_are_near_the_line(
            turns in prop::collection::vec(-0.9..0.9, 1..200), tolerance in 0.05..1.0,
        ) {
            let (mut at, mut heading) = (DVec2::ZERO, 0.0);
            let mut points = vec![at];
            for turn in turns {
                heading += turn;
                at += DVec2::from_angle(heading) * 0.7;
                points.push(at);
            }
            let line = simplify(&points, tolerance);
            prop_assert_eq!((line[0], line.last()), (points[0], points.last()));
            let mut segment = 0;
            for point in &points {
                if segment + 2 < line.len() && *point == line[segment + 1] {
                    segment += 1;
                }
                let far = distance_to_segment(*point, [line[segment], line[segment + 1]]);
                prop_assert!(far <= tolerance + 1e-9, "{} is {} off", point, far);
            }
        }
    }

    #[test]
    fn a_straight_wall_has_one_segment_on_each_side() {
        let points: Vec<DVec2> = (0..1000).map(|i| DVec2::new(f64::from(i), 0.0)).collect();
        assert_eq!(simplify(&points, 0.5).len(), 2);
        // A staircase of one step in ten cells.
        let stairs: Vec<DVec2> = (0..1000).map(|i| DVec2::new(f64::from(i), f64::from(i / 10))).collect();
        assert!(simplify(&stairs, 1.0).len() <= 3);
    }
}
