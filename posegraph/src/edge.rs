//! A measured relative pose: its error and the error's derivatives.

use crate::kernel::Kernel;
use msg::{Pose2, pose::wrap_angle};
use nalgebra::{Matrix3, Vector3};

/// A measured relative pose between two poses of a graph.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edge {
    /// Index of the pose that the measurement is made from.
    pub a: usize,
    /// Index of the pose that is measured; another one than `a`.
    pub b: usize,
    /// The measurement: pose `b` in the frame of pose `a`, metres and radians.
    pub a_from_b: Pose2,
    /// Inverse covariance of the measurement over (x, y, yaw) in the frame of `a`; symmetric,
    /// positive semidefinite, in 1/m² and 1/rad².
    pub information: Matrix3<f64>,
    /// How the squared error counts.
    pub kernel: Kernel,
}

impl Edge {
    /// Relative pose of the two poses minus the measured one over (x, y, yaw), the angle wrapped.
    pub fn error(&self, a: Pose2, b: Pose2) -> Vector3<f64> {
        let expected = a.between(b);
        let yaw = wrap_angle(expected.yaw_rad - self.a_from_b.yaw_rad);
        Vector3::new(expected.x_m - self.a_from_b.x_m, expected.y_m - self.a_from_b.y_m, yaw)
    }

    /// Squared Mahalanobis distance of the error, in squared standard deviations.
    pub fn chi_squared(&self, a: Pose2, b: Pose2) -> f64 {
        let error = self.error(a, b);
        (error.transpose() * self.information * error).x
    }

    /// Derivatives of [`Edge::error`] by (x, y, yaw) of `a` and of `b` (Grisetti et al. 2010, eqs. 30-33).
    pub fn jacobians(a: Pose2, b: Pose2) -> [Matrix3<f64>; 2] {
        let (sin, cos) = a.yaw_rad.sin_cos();
        let (dx, dy) = (b.x_m - a.x_m, b.y_m - a.y_m);
        let by_a =
            Matrix3::new(-cos, -sin, -sin * dx + cos * dy, sin, -cos, -cos * dx - sin * dy, 0.0, 0.0, -1.0);
        let by_b = Matrix3::new(cos, sin, 0.0, -sin, cos, 0.0, 0.0, 0.0, 1.0);
        [by_a, by_b]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Positions within 50 m, headings of several turns.
    fn pose() -> impl Strategy<Value = Pose2> {
        (-50.0..50.0, -50.0..50.0, -20.0..20.0).prop_map(|(x, y, yaw)| Pose2::new(x, y, yaw))
    }

    fn shifted(pose: Pose2, k: usize, by: f64) -> Pose2 {
        let mut values = [pose.x_m, pose.y_m, pose.yaw_rad];
        values[k] += by;
        Pose2::new(values[0], values[1], values[2])
    }

    proptest! {
        #[test]
        fn jacobians_are_the_finite_differences_of_the_error(a in pose(), b in pose(), a_from_b in pose()) {
            let information = Matrix3::identity();
            let edge = Edge { a: 0, b: 1, a_from_b, information, kernel: Kernel::Quadratic };
            let [by_a, by_b] = Edge::jacobians(a, b);
            let step = 1e-5;
            for k in 0..3 {
                let differences = [
                    edge.error(shifted(a, k, step), b) - edge.error(shifted(a, k, -step), b),
                    edge.error(a, shifted(b, k, step)) - edge.error(a, shifted(b, k, -step)),
                ];
                for (jacobian, difference) in [by_a, by_b].iter().zip(differences) {
                    // Where the angle wraps between the two errors, the difference does too.
                    let mut slope = difference;
                    slope.z = wrap_angle(slope.z);
                    let off = slope / (2.0 * step) - jacobian.column(k);
                    prop_assert!(off.amax() < 1e-5, "column {}: off by {}", k, off.amax());
                }
            }
        }

        #[test]
        fn moving_the_whole_graph_changes_no_error(a in pose(), b in pose(), a_from_b in pose(), whole in pose()) {
            let information = Matrix3::identity();
            let edge = Edge { a: 0, b: 1, a_from_b, information, kernel: Kernel::Quadratic };
            let mut change = edge.error(a, b) - edge.error(whole * a, whole * b);
            change.z = wrap_angle(change.z);
            prop_assert!(change.amax() < 1e-9);
        }
    }
}
