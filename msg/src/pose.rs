//! Planar poses. A name says which frame a pose leads from and to: `map_from_base` takes points
//! of `base` to `map`, and in a product the inner names cancel:
//! `map_from_base = map_from_odom * odom_from_base`.

use bytemuck::{Pod, Zeroable};
use core::f64::consts::{PI, TAU};
use core::ops::Mul;

/// An element of SE(2): rotate by `yaw_rad`, then shift by (`x_m`, `y_m`).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Pose2 {
    /// Metres.
    pub x_m: f64,
    /// Metres.
    pub y_m: f64,
    /// Radians, counter-clockwise (REP-103). Products keep it in (-pi, pi].
    pub yaw_rad: f64,
}

impl Pose2 {
    /// The neutral element.
    pub const IDENTITY: Self = Self { x_m: 0.0, y_m: 0.0, yaw_rad: 0.0 };

    /// From metres, metres, radians.
    pub const fn new(x_m: f64, y_m: f64, yaw_rad: f64) -> Self {
        Self { x_m, y_m, yaw_rad }
    }

    /// `a_from_b.inverse()` is `b_from_a`.
    pub fn inverse(self) -> Self {
        let (sin, cos) = self.yaw_rad.sin_cos();
        Self {
            x_m: -cos * self.x_m - sin * self.y_m,
            y_m: sin * self.x_m - cos * self.y_m,
            yaw_rad: wrap_angle(-self.yaw_rad),
        }
    }

    /// `a_from_b.apply(p_b)` is the same point in `a`; [x, y] in metres.
    pub fn apply(self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.yaw_rad.sin_cos();
        [cos * x - sin * y + self.x_m, sin * x + cos * y + self.y_m]
    }

    /// `reference_from_a.between(reference_from_b)` is `a_from_b`.
    pub fn between(self, other: Self) -> Self {
        self.inverse() * other
    }

    /// Metres between the two origins.
    pub fn distance_m(self, other: Self) -> f64 {
        (self.x_m - other.x_m).hypot(self.y_m - other.y_m)
    }

    /// No NaN, no infinity.
    pub fn is_finite(self) -> bool {
        self.x_m.is_finite() && self.y_m.is_finite() && self.yaw_rad.is_finite()
    }
}

impl Mul for Pose2 {
    type Output = Self;
    // Angles of a product add.
    #[expect(clippy::suspicious_arithmetic_impl)]
    fn mul(self, inner: Self) -> Self {
        let [x_m, y_m] = self.apply([inner.x_m, inner.y_m]);
        Self { x_m, y_m, yaw_rad: wrap_angle(self.yaw_rad + inner.yaw_rad) }
    }
}

/// The same angle in (-pi, pi]. NaN and infinities give NaN.
pub fn wrap_angle(angle_rad: f64) -> f64 {
    let wrapped = (angle_rad + PI).rem_euclid(TAU) - PI;
    if wrapped <= -PI { PI } else { wrapped }
}

#[cfg(test)]
mod laws {
    use super::*;
    use proptest::prelude::*;

    fn pose() -> impl Strategy<Value = Pose2> {
        (-100.0..100.0, -100.0..100.0, -10.0..10.0).prop_map(|(x, y, yaw)| Pose2::new(x, y, yaw))
    }

    fn close(a: Pose2, b: Pose2) -> bool {
        a.distance_m(b) < 1e-9 && wrap_angle(a.yaw_rad - b.yaw_rad).abs() < 1e-9
    }

    proptest! {
        #[test]
        fn group(a in pose(), b in pose(), c in pose()) {
            prop_assert!(close((a * b) * c, a * (b * c)));
            prop_assert!(close(a * a.inverse(), Pose2::IDENTITY));
            prop_assert!(close(a.inverse() * a, Pose2::IDENTITY));
            prop_assert!(close(a * a.between(b), b));
        }

        #[test]
        fn acts_on_points(a in pose(), b in pose(), x in -9.0..9.0, y in -9.0..9.0) {
            let once = (a * b).apply([x, y]);
            let twice = a.apply(b.apply([x, y]));
            prop_assert!((once[0] - twice[0]).hypot(once[1] - twice[1]) < 1e-9);
        }

        #[test]
        fn wraps(angle in -1e4..1e4) {
            let wrapped = wrap_angle(angle);
            prop_assert!(wrapped > -PI && wrapped <= PI);
            prop_assert!((wrapped.sin() - angle.sin()).abs() < 1e-9);
            prop_assert!((wrapped.cos() - angle.cos()).abs() < 1e-9);
        }
    }
}
