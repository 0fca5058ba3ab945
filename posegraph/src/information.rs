//! Information matrices of relative poses: over (x, y, yaw), in 1/m² and 1/rad².

use msg::Pose2;
use nalgebra::{Matrix3, Vector3};

/// Standard deviations of a relative pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseSigmas {
    /// Of the position along each axis, metres.
    pub position_m: f64,
    /// Of the heading, radians.
    pub heading_rad: f64,
}

impl PoseSigmas {
    /// The information of independent errors of this size, see [`information_from_sigmas`].
    pub fn information(self) -> Matrix3<f64> {
        information_from_sigmas(self.position_m, self.heading_rad)
    }
}

/// The information of independent standard deviations of the position (metres, each axis) and of
/// the heading (radians).
pub fn information_from_sigmas(sigma_m: f64, sigma_rad: f64) -> Matrix3<f64> {
    let position = 1.0 / (sigma_m * sigma_m);
    Matrix3::from_diagonal(&Vector3::new(position, position, 1.0 / (sigma_rad * sigma_rad)))
}

/// The same information, limited so that it claims no standard deviation below `floor` (metres, radians).
///
/// `unobserved` is the information (1/m², 1/rad²) of a direction in which nothing was measured: it
/// is added before the inversion, so that such a direction stays open. The result is symmetric, and
/// zero if the matrix cannot be inverted.
pub fn limit_information(information: Matrix3<f64>, floor: [f64; 2], unobserved: f64) -> Matrix3<f64> {
    let [m, rad] = floor;
    let floor = Matrix3::from_diagonal(&Vector3::new(m.powi(2), m.powi(2), rad.powi(2)));
    let covariance = (information + Matrix3::identity() * unobserved).try_inverse().map(|c| c + floor);
    let limited = covariance.and_then(|c| c.try_inverse()).unwrap_or(Matrix3::zeros());
    (limited + limited.transpose()) * 0.5
}

/// Removes the position along an axis from an information matrix by marginalisation (Schur complement). `axis_rad` is the axis' direction in the
/// plane. The result is positive semidefinite if the matrix is.
pub fn information_without_axis(information: Matrix3<f64>, axis_rad: f64) -> Matrix3<f64> {
    let axis = Vector3::new(axis_rad.cos(), axis_rad.sin(), 0.0);
    let column = information * axis;
    let along = axis.dot(&column);
    // Less than what rounding leaves of the other coordinates is no information.
    let is_held = along > f64::EPSILON * information.trace();
    if is_held { information - column * column.transpose() / along } else { information }
}

/// Information of a measured `a_from_b`, expressed for `i_from_j = i_from_a * a_from_b * b_from_j`.
pub fn transport_information(
    information: Matrix3<f64>,
    i_from_a: Pose2,
    a_from_b: Pose2,
    b_from_j: Pose2,
) -> Matrix3<f64> {
    let (sin, cos) = i_from_a.yaw_rad.sin_cos();
    let [arm_x, arm_y] = Pose2::new(0.0, 0.0, a_from_b.yaw_rad).apply([b_from_j.x_m, b_from_j.y_m]);
    let back = Matrix3::new(cos, sin, arm_y, -sin, cos, -arm_x, 0.0, 0.0, 1.0);
    back.transpose() * information * back
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn pose() -> impl Strategy<Value = Pose2> {
        (-9.0..9.0, -9.0..9.0, -9.0..9.0).prop_map(|(x, y, yaw)| Pose2::new(x, y, yaw))
    }

    proptest! {
        /// A small change of the transported pose costs what the same change costs at the measurement.
        #[test]
        fn transported_information_judges_errors_alike(
            i_from_a in pose(),
            a_from_b in pose(),
            b_from_j in pose(),
            x in -1e-5..1e-5,
            y in -1e-5..1e-5,
            yaw in -1e-5..1e-5,
        ) {
            let information = Matrix3::new(4.0, 1.0, 0.5, 1.0, 3.0, -0.5, 0.5, -0.5, 9.0);
            let wrong = Pose2::new(a_from_b.x_m + x, a_from_b.y_m + y, a_from_b.yaw_rad + yaw);
            let off: Vector3<f64> = Vector3::new(x, y, yaw);
            let here: f64 = (off.transpose() * information * off).x;
            let [right, moved] = [a_from_b, wrong].map(|middle| i_from_a * middle * b_from_j);
            let turned = msg::pose::wrap_angle(moved.yaw_rad - right.yaw_rad);
            let off: Vector3<f64> = Vector3::new(moved.x_m - right.x_m, moved.y_m - right.y_m, turned);
            let transported = transport_information(information, i_from_a, a_from_b, b_from_j);
            let there: f64 = (off.transpose() * transported * off).x;
            prop_assert!((here - there).abs() < 1e-3 * here + 1e-14, "{} {}", here, there);
        }

        /// Nothing is left along the axis, and of the rest as much as before with the position along the axis unknown.
        #[test]
        fn information_without_an_axis_is_what_an_unknown_position_along_it_leaves(axis_rad in -4.0..4.0_f64) {
            let information = Matrix3::new(4.0, 1.0, 0.5, 1.0, 3.0, -0.5, 0.5, -0.5, 9.0);
            let axis = Vector3::new(axis_rad.cos(), axis_rad.sin(), 0.0);
            let without = information_without_axis(information, axis_rad);
            prop_assert!((without * axis).amax() < 1e-9);
            let unknown = axis * axis.transpose() * 1e8;
            let covariance = information.try_inverse().unwrap() + unknown;
            prop_assert!((covariance.try_inverse().unwrap() - without).amax() < 1e-5);
        }

        #[test]
        fn limited_information_claims_no_more_than_the_floor(x in 0.0..1e9, y in 0.0..1e9, yaw in 0.0..1e9) {
            let information = Matrix3::from_diagonal(&Vector3::new(x, y, yaw));
            let limited = limit_information(information, [0.1, 0.02], 1e-2);
            let most = information_from_sigmas(0.1, 0.02);
            prop_assert!((0..3).all(|k| limited[(k, k)] <= most[(k, k)] * (1.0 + 1e-9)));
        }
    }
}
