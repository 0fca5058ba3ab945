//! Counting of walls that two maps have in common, and of walls that contradict each other.

use super::distance_field::DistanceField;
use msg::Pose2;

/// Least product of the sides ([`DistanceField::floor_side`]) from which two matching walls were seen. Below it they were
/// clearly seen from opposite sides: they are the two faces of one wall at best.
const SIDE_PRODUCT_MIN: f64 = -0.15;
/// Weight of a contradicted wall, where a matched one counts 1. In the right place nine walls in ten match, in the best
/// of many wrong ones about half: the ratio of the log-likelihood ratios ln(0.1 / 0.5) and ln(0.9 / 0.5).
const CONTRADICTED_WEIGHT: f64 = 2.7;

/// How well two maps' walls match under a transform. Counts are of all points, though only some are looked at.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct WallMatch {
    /// The transform, between the maps' centred frames.
    pub a_from_b: Pose2,
    /// Wall points of either map on a wall of the other.
    pub matched: f64,
    /// Wall points of either map on the other's floor, far from its walls.
    pub contradicted: f64,
    /// Mean distance of the matched points, metres.
    pub residual_m: f64,
    /// Smaller eigenvalue of the matched walls' information on the position over the sum of both, 0 to 0.5.
    ///
    /// Near 0 the map can slide along itself, as in a corridor.
    pub observability: f64,
}

impl WallMatch {
    /// Matched walls less [`CONTRADICTED_WEIGHT`] times the contradicted ones: larger is better.
    pub fn score(&self) -> f64 {
        self.matched - CONTRADICTED_WEIGHT * self.contradicted
    }

    /// Share of contradicted walls, 0 to 1.
    pub fn conflict(&self) -> f64 {
        self.contradicted / (self.matched + self.contradicted).max(1.0)
    }

    /// Adds the other direction.
    fn combined(self, other: Self) -> Self {
        let matched = self.matched + other.matched;
        let mean = |x: f64, y: f64| (x * self.matched + y * other.matched) / matched.max(1.0);
        Self {
            a_from_b: self.a_from_b,
            matched,
            contradicted: self.contradicted + other.contradicted,
            residual_m: mean(self.residual_m, other.residual_m),
            observability: mean(self.observability, other.observability),
        }
    }
}

impl DistanceField {
    /// Matches b's walls to this map's, every `stride`th point.
    fn match_walls_of(&self, b: &Self, a_from_b: Pose2, stride: usize) -> WallMatch {
        let (sin, cos) = a_from_b.yaw_rad.sin_cos();
        let mut result = WallMatch { a_from_b, ..Default::default() };
        let (mut sum, mut information) = (0.0, [0.0; 3]);
        for ([x, y], side) in b.points.walls_m.iter().zip(&b.wall_sides).step_by(stride) {
            let (x, y) = (f64::from(*x), f64::from(*y));
            let [u, v] = self.to_cells([cos * x - sin * y + a_from_b.x_m, sin * x + cos * y + a_from_b.y_m]);
            if !(u >= 0.0 && v >= 0.0 && u < self.width as f64 && v < self.height as f64) {
                continue;
            }
            let index = v as usize * self.width + u as usize;
            let distance = self.distance[index];
            if distance <= self.match_cells {
                let [sx, sy] = side.map(f64::from);
                let [tx, ty] = self.floor_side(u as usize, v as usize);
                if tx * (cos * sx - sin * sy) + ty * (sin * sx + cos * sy) < SIDE_PRODUCT_MIN {
                    continue;
                }
                result.matched += 1.0;
                sum += f64::from(distance);
                if let Some((_, [gx, gy])) = self.distance_and_gradient([u, v]) {
                    information =
                        [information[0] + gx * gx, information[1] + gx * gy, information[2] + gy * gy];
                }
            } else if distance > self.conflict_cells && self.floor[index] {
                result.contradicted += 1.0;
            }
        }
        // Trace, and difference of the eigenvalues.
        let [xx, xy, yy] = information;
        let (trace, difference) = (xx + yy, (xx - yy).hypot(2.0 * xy));
        result.residual_m = if result.matched > 0.0 { sum / result.matched * self.cell_m } else { 0.0 };
        result.observability = if trace > 0.0 { (trace - difference) / (2.0 * trace) } else { 0.0 };
        result.matched *= stride as f64;
        result.contradicted *= stride as f64;
        result
    }
}

/// Matches the walls of both maps to each other's under a transform, every `strides`th point of each.
pub(crate) fn match_walls([a, b]: [&DistanceField; 2], a_from_b: Pose2, strides: [usize; 2]) -> WallMatch {
    a.match_walls_of(b, a_from_b, strides[1]).combined(b.match_walls_of(a, a_from_b.inverse(), strides[0]))
}
