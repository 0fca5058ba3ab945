//! Planar poses and their composition.
//!
//! The name of a pose tells its two frames: `map_from_base` transforms points of `base` to `map`. In a
//! product the inner names cancel: `map_from_base = map_from_odom * odom_from_base`.

use bytemuck::{Pod, Zeroable};
use core::f64::consts::{PI, TAU};
use core::ops::Mul;

/// Largest coordinate that is taken from outside, metres: no robot gets farther, so that beyond it a message is broken.
pub const COORDINATE_MAX_M: f64 = 1e5;

/// Largest yaw that a person can mean in radians, and not in degrees: a whole turn, rounded.
pub const YAW_MAX_RAD: f64 = 6.29;

/// Pose or transform in the plane, SE(2): a rotation by `yaw_rad`, then a shift by (`x_m`, `y_m`).
///
/// ```
/// use core::f64::consts::FRAC_PI_2;
/// use msg::Pose2;
///
/// let map_from_odom = Pose2::new(2.0, 0.0, FRAC_PI_2);
/// let odom_from_base = Pose2::new(1.0, 0.0, 0.0);
/// let map_from_base = map_from_odom * odom_from_base;
/// assert!(map_from_base.distance_m(Pose2::new(2.0, 1.0, 0.0)) < 1e-9);
///
/// // A point one metre ahead of the robot, in `map`.
/// let [x, y] = map_from_base.apply([1.0, 0.0]);
/// assert!((x - 2.0).abs() < 1e-9 && (y - 2.0).abs() < 1e-9);
///
/// let base_from_odom = map_from_base.between(map_from_odom);
/// assert!((base_from_odom * odom_from_base).distance_m(Pose2::IDENTITY) < 1e-9);
/// ```
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable, serde::Serialize, serde::Deserialize)]
pub struct Pose2 {
    /// Position along x, metres.
    pub x_m: f64,
    /// Position along y, metres.
    pub y_m: f64,
    /// Heading, radians, counter-clockwise (REP-103). Products keep it in (-pi, pi].
    pub yaw_rad: f64,
}

impl Pose2 {
    /// The pose that leaves every point where it is.
    pub const IDENTITY: Self = Self { x_m: 0.0, y_m: 0.0, yaw_rad: 0.0 };

    /// Creates a pose from metres, metres and radians.
    pub const fn new(x_m: f64, y_m: f64, yaw_rad: f64) -> Self {
        Self { x_m, y_m, yaw_rad }
    }

    /// Inverts the transform: `a_from_b.inverse()` is `b_from_a`.
    pub fn inverse(self) -> Self {
        let (sin, cos) = self.yaw_rad.sin_cos();
        Self {
            x_m: -cos * self.x_m - sin * self.y_m,
            y_m: sin * self.x_m - cos * self.y_m,
            yaw_rad: wrap_angle(-self.yaw_rad),
        }
    }

    /// Transforms a point: `a_from_b.apply(p_b)` is the same point in `a`; [x, y] in metres.
    pub fn apply(self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.yaw_rad.sin_cos();
        [cos * x - sin * y + self.x_m, sin * x + cos * y + self.y_m]
    }

    /// Computes the relative pose: `reference_from_a.between(reference_from_b)` is `a_from_b`.
    pub fn between(self, other: Self) -> Self {
        self.inverse() * other
    }

    /// Returns the distance between the two positions, metres.
    pub fn distance_m(self, other: Self) -> f64 {
        (self.x_m - other.x_m).hypot(self.y_m - other.y_m)
    }

    /// Returns whether no component is NaN or infinite.
    pub fn is_finite(self) -> bool {
        self.x_m.is_finite() && self.y_m.is_finite() && self.yaw_rad.is_finite()
    }
}

impl Mul for Pose2 {
    type Output = Self;
    // The heading of a product is the sum of both headings.
    #[expect(clippy::suspicious_arithmetic_impl)]
    fn mul(self, inner: Self) -> Self {
        let [x_m, y_m] = self.apply([inner.x_m, inner.y_m]);
        Self { x_m, y_m, yaw_rad: wrap_angle(self.yaw_rad + inner.yaw_rad) }
    }
}

/// Returns the rigid transform that puts points nearest to others, by the sum of squared distances (Umeyama, "Least-squares
/// estimation of transformation parameters between two point patterns", IEEE PAMI 1991, without scale); `None` without points.
/// Each pair is a point in `b` and the same point in `a`, [x, y] in metres; the transform is `a_from_b`.
///
/// ```
/// use msg::Pose2;
///
/// let a_from_b = Pose2::new(3.0, -1.0, 0.5);
/// let points_b = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]];
/// let pairs = points_b.map(|point_b| [point_b, a_from_b.apply(point_b)]);
/// let found = msg::pose::best_rigid_transform(&pairs).unwrap();
/// assert!(found.distance_m(a_from_b) < 1e-9 && (found.yaw_rad - 0.5).abs() < 1e-9);
/// ```
pub fn best_rigid_transform(pairs: &[[[f64; 2]; 2]]) -> Option<Pose2> {
    let count = pairs.len() as f64;
    let mean = |which: usize| {
        let sum = pairs.iter().fold([0.0; 2], |[x, y], pair| [x + pair[which][0], y + pair[which][1]]);
        sum.map(|sum| sum / count)
    };
    let (mean_b, mean_a) = (mean(0), mean(1));
    let (mut dot, mut cross) = (0.0, 0.0);
    for [b, a] in pairs {
        let (b, a) = ([b[0] - mean_b[0], b[1] - mean_b[1]], [a[0] - mean_a[0], a[1] - mean_a[1]]);
        dot += b[0] * a[0] + b[1] * a[1];
        cross += b[0] * a[1] - b[1] * a[0];
    }
    let rotation = Pose2::new(0.0, 0.0, f64::atan2(cross, dot));
    let [x, y] = rotation.apply(mean_b);
    (!pairs.is_empty()).then(|| Pose2::new(mean_a[0] - x, mean_a[1] - y, rotation.yaw_rad))
}

/// Returns the heading of a unit quaternion x, y, z, w, radians; of one that is not about z, that of its projection on the floor.
pub fn yaw_of_quaternion([x, y, z, w]: [f64; 4]) -> f64 {
    (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z))
}

/// Wraps an angle into (-pi, pi]. NaN and infinities give NaN.
pub fn wrap_angle(angle_rad: f64) -> f64 {
    let wrapped = (angle_rad + PI).rem_euclid(TAU) - PI;
    if wrapped <= -PI { PI } else { wrapped }
}

#[cfg(test)]
mod tests {
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
        fn poses_form_a_group(a in pose(), b in pose(), c in pose()) {
            prop_assert!(close((a * b) * c, a * (b * c)));
            prop_assert!(close(a * a.inverse(), Pose2::IDENTITY));
            prop_assert!(close(a.inverse() * a, Pose2::IDENTITY));
            prop_assert!(close(a * a.between(b), b));
        }

        #[test]
        fn a_product_transforms_points_like_its_factors(a in pose(), b in pose(), x in -9.0..9.0, y in -9.0..9.0) {
            let once = (a * b).apply([x, y]);
            let twice = a.apply(b.apply([x, y]));
            prop_assert!((once[0] - twice[0]).hypot(once[1] - twice[1]) < 1e-9);
        }

        #[test]
        fn a_wrapped_angle_is_in_range_and_equivalent(angle in -1e4..1e4) {
            let wrapped = wrap_angle(angle);
            prop_assert!(wrapped > -PI && wrapped <= PI);
            prop_assert!((wrapped.sin() - angle.sin()).abs() < 1e-9);
            prop_assert!((wrapped.cos() - angle.cos()).abs() < 1e-9);
        }
    }
}
