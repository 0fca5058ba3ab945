//! How much of two maps' walls lie on each other.

use super::field::Field;
use msg::Pose2;

/// Two walls seen from opposite sides, both clearly, are the two faces of a wall at best: below
/// this product of [`Field::seen_from`].
const BACK_TO_BACK: f64 = -0.15;
/// A wall missed weighs as much as so many found. In the right place nine walls in ten are found
/// again, in the best of many wrong ones about half: the log-likelihood ratios of found and missed
/// are ln(0.9 / 0.5) and ln(0.1 / 0.5).
const MISSED_WEIGHT: f64 = 2.7;
/// Two walls that are this near are the same, cells of the field.
const SAME_CELLS: f32 = 1.5;
/// A wall is missed only where the other map saw floor and no wall within this, cells of the field.
const MISSED_CELLS: f32 = 2.5;

/// How two maps' walls lie on each other.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Fit {
    pub a_from_b: Pose2,
    /// Wall points of either map on a wall of the other.
    pub found: f64,
    /// Wall points of either map on the other's floor, far from its walls.
    pub missed: f64,
    /// Mean distance of the found ones, metres.
    pub residual_m: f64,
    /// The least of the eigenvalues of the found walls' pull on the position over their sum, 0 to
    /// 0.5: near 0 the map can slide along itself, as in a corridor.
    pub observability: f64,
}

impl Fit {
    /// What speaks for it: walls found less [`MISSED_WEIGHT`] times the walls missed.
    pub fn evidence(&self) -> f64 {
        self.found - MISSED_WEIGHT * self.missed
    }

    /// Share of the walls missed.
    pub fn conflict(&self) -> f64 {
        self.missed / (self.found + self.missed).max(1.0)
    }

    /// Both directions together.
    fn plus(self, other: Self) -> Self {
        let found = self.found + other.found;
        let mean = |x: f64, y: f64| (x * self.found + y * other.found) / found.max(1.0);
        Self {
            a_from_b: self.a_from_b,
            found,
            missed: self.missed + other.missed,
            residual_m: mean(self.residual_m, other.residual_m),
            observability: mean(self.observability, other.observability),
        }
    }
}

impl Field {
    /// How b's walls lie, every `keep`th point.
    fn fit_of(&self, b: &Self, a_from_b: Pose2, keep: usize) -> Fit {
        let (sin, cos) = a_from_b.yaw_rad.sin_cos();
        let mut fit = Fit { a_from_b, ..Default::default() };
        let (mut sum, mut pull) = (0.0, [0.0; 3]);
        for ([x, y], side) in b.evidence.walls_m.iter().zip(&b.sides).step_by(keep) {
            let (x, y) = (f64::from(*x), f64::from(*y));
            let [u, v] = self.place([cos * x - sin * y + a_from_b.x_m, sin * x + cos * y + a_from_b.y_m]);
            if !(u >= 0.0 && v >= 0.0 && u < self.width as f64 && v < self.height as f64) {
                continue;
            }
            let index = v as usize * self.width + u as usize;
            let distance = self.distance[index];
            if distance <= SAME_CELLS {
                let [sx, sy] = side.map(f64::from);
                let [tx, ty] = self.seen_from(u as usize, v as usize);
                if tx * (cos * sx - sin * sy) + ty * (sin * sx + cos * sy) < BACK_TO_BACK {
                    continue;
                }
                fit.found += 1.0;
                sum += f64::from(distance);
                if let Some((_, [gx, gy])) = self.slope([u, v]) {
                    pull = [pull[0] + gx * gx, pull[1] + gx * gy, pull[2] + gy * gy];
                }
            } else if distance > MISSED_CELLS && self.free[index] {
                fit.missed += 1.0;
            }
        }
        let (trace, apart) = (pull[0] + pull[2], (pull[0] - pull[2]).hypot(2.0 * pull[1]));
        fit.residual_m = if fit.found > 0.0 { sum / fit.found * self.cell_m } else { 0.0 };
        fit.observability = if trace > 0.0 { (trace - apart) / (2.0 * trace) } else { 0.0 };
        fit.found *= keep as f64;
        fit.missed *= keep as f64;
        fit
    }
}

/// How the walls of both maps lie on each other's; about every `keep`th point of each.
pub(crate) fn fit([a, b]: [&Field; 2], a_from_b: Pose2, keep: [usize; 2]) -> Fit {
    a.fit_of(b, a_from_b, keep[1]).plus(b.fit_of(a, a_from_b.inverse(), keep[0]))
}
