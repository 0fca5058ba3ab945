//! Cells of a lattice that a round body covers while it moves.

use crate::IndexRect;

/// Area that a disk covers while it moves along a straight line, in units of cells.
///
/// Cell (0, 0) reaches from (0, 0) to (1, 1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SweptDisk {
    from: [f64; 2],
    along: [f64; 2],
    radius: f64,
}

impl SweptDisk {
    /// Creates the area between two points, in cells. `None` if a number is not finite or absurdly large.
    pub fn new(from: [f64; 2], to: [f64; 2], radius: f64) -> Option<Self> {
        let along = [to[0] - from[0], to[1] - from[1]];
        let valid =
            [from, along].as_flattened().iter().all(|v| v.abs() < 1e9) && radius > 0.0 && radius < 1e6;
        valid.then_some(Self { from, along, radius })
    }

    /// Returns a rectangle that contains all covered cells.
    pub fn cells(&self) -> IndexRect {
        let reach = |k: usize| {
            let (a, b) = (self.from[k], self.from[k] + self.along[k]);
            ((a.min(b) - self.radius).floor() as i64, (a.max(b) + self.radius).ceil() as i64)
        };
        let ((x0, x1), (y0, y1)) = (reach(0), reach(1));
        IndexRect { x0, y0, x1, y1 }
    }

    /// Returns whether the disk passes over the centre of a cell.
    pub fn covers(&self, x: i64, y: i64) -> bool {
        let to = [x as f64 + 0.5 - self.from[0], y as f64 + 0.5 - self.from[1]];
        let dot = |p: [f64; 2], q: [f64; 2]| p[0] * q[0] + p[1] * q[1];
        let length_squared = dot(self.along, self.along);
        let share =
            if length_squared > 0.0 { (dot(to, self.along) / length_squared).clamp(0.0, 1.0) } else { 0.0 };
        let off = [0, 1].map(|k| to[k] - share * self.along[k]);
        dot(off, off) <= self.radius * self.radius
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn place() -> impl Strategy<Value = [f64; 2]> {
        [-12.0..12.0, -12.0..12.0]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn covers_the_cells_that_the_disk_passes_and_no_others(a in place(), b in place(), radius in 0.1..6.0) {
            let swept = SweptDisk::new(a, b, radius).unwrap();
            let all = IndexRect { x0: -20, y0: -20, x1: 20, y1: 20 };
            let steps = || (0..=400).map(|k| f64::from(k) / 400.0);
            for (x, y) in all.points() {
                let off = |t: f64| {
                    let at = [0, 1].map(|k| a[k] + t * (b[k] - a[k]));
                    (x as f64 + 0.5 - at[0]).hypot(y as f64 + 0.5 - at[1])
                };
                let inside = swept.cells().intersect(IndexRect::single(x, y)) == IndexRect::single(x, y);
                // Far cells need no search along the line.
                let middle = off(0.5) - (a[0] - b[0]).hypot(a[1] - b[1]) / 2.0;
                if middle > radius + 0.1 {
                    prop_assert!(!swept.covers(x, y));
                    continue;
                }
                let nearest = steps().map(off).fold(f64::INFINITY, f64::min);
                if nearest < radius - 0.05 {
                    prop_assert!(swept.covers(x, y) && inside);
                }
                if nearest > radius + 0.05 {
                    prop_assert!(!swept.covers(x, y));
                }
            }
        }
    }

    #[test]
    fn refuses_numbers_that_are_not_finite_or_not_positive() {
        assert!(SweptDisk::new([0.0; 2], [1.0; 2], 0.0).is_none());
        assert!(SweptDisk::new([f64::NAN, 0.0], [1.0; 2], 1.0).is_none());
        assert!(SweptDisk::new([0.0; 2], [f64::INFINITY, 0.0], 1.0).is_none());
        assert!(SweptDisk::new([0.0; 2], [1.0; 2], f64::NAN).is_none());
    }
}
