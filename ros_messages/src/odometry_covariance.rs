//! Covariances of wheel odometry, for nav_msgs/Odometry.

use msg::{Odometry, Pose2};
use serde::{Deserialize, Serialize};

/// Errors of a robot's odometry: the model that its SLAM uses (`[slam.odometry]`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct OdometrySigmas {
    /// Standard deviation of the position after one metre, metres.
    pub m_per_m: f64,
    /// Standard deviation of the heading after one radian of turning, radians.
    pub rad_per_rad: f64,
    /// Standard deviation of the heading after one metre, radians.
    pub rad_per_m: f64,
}

/// Variance of a standing robot's velocity, (m/s)² and (rad/s)². Filters cannot use a measurement without variance.
const VELOCITY_VARIANCE_MIN: f64 = 1e-6;
/// Variance of what wheels do not measure: z, roll and pitch.
const UNMEASURED_VARIANCE: f64 = 1e6;
// Places of x, y and yaw among x, y, z and the rotations about them.
const X: usize = 0;
const Y: usize = 1;
const YAW: usize = 5;

/// Accumulates the covariance of one robot's odometry pose since the origin of `odom`.
///
/// It is dead reckoning's (Siegwart, Nourbakhsh, Scaramuzza, "Autonomous Mobile Robots", 2nd ed., eq. 5.9). Errors of
/// successive motions are independent, so that variances grow with the distance and the turn.
#[derive(Clone, Copy, Debug, Default)]
pub struct OdometryCovariance {
    last: Option<(u64, Pose2)>,
    /// Row-major covariance over x, y, yaw in `odom`; m, rad.
    covariance: [[f64; 3]; 3],
}

impl OdometryCovariance {
    /// Adds the motion since the last message. A restarted source begins anew at the origin of its `odom`.
    pub fn add(&mut self, sigmas: &OdometrySigmas, odometry: &Odometry) {
        let (source, pose) = (odometry.header.incarnation, odometry.odom_from_base);
        let Some((_, before)) = self.last.replace((source, pose)).filter(|(of, _)| *of == source) else {
            self.covariance = [[0.0; 3]; 3];
            return;
        };
        let moved = before.between(pose);
        let distance_m = moved.x_m.hypot(moved.y_m);
        let [xx, yy] = [sigmas.m_per_m.powi(2) * distance_m; 2];
        let yaw_yaw =
            sigmas.rad_per_rad.powi(2) * moved.yaw_rad.abs() + sigmas.rad_per_m.powi(2) * distance_m;
        // An error of the heading turns the step.
        let (dx, dy) = (pose.x_m - before.x_m, pose.y_m - before.y_m);
        let step = [[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]];
        let turned = product(&step, &self.covariance);
        let transposed = core::array::from_fn(|row| core::array::from_fn(|column| step[column][row]));
        self.covariance = product(&turned, &transposed);
        for (place, variance) in [xx, yy, yaw_yaw].into_iter().enumerate() {
            self.covariance[place][place] += variance;
        }
    }

    /// Returns the covariance of the pose, row-major over x, y, z and the rotations about them.
    pub fn of_pose(&self) -> [f64; 36] {
        let mut all = unmeasured();
        for (row, to_row) in [X, Y, YAW].into_iter().enumerate() {
            for (column, to_column) in [X, Y, YAW].into_iter().enumerate() {
                all[6 * to_row + to_column] = self.covariance[row][column];
            }
        }
        all
    }

    /// Returns the covariance of the velocity, in the order of [`OdometryCovariance::of_pose`].
    pub fn of_velocity(sigmas: &OdometrySigmas, odometry: &Odometry) -> [f64; 36] {
        let (speed, turning) = (odometry.linear_m_s, odometry.angular_rad_s);
        let forward = (sigmas.m_per_m * speed).powi(2);
        let yaw = (sigmas.rad_per_rad * turning).powi(2) + (sigmas.rad_per_m * speed).powi(2);
        let mut all = unmeasured();
        // Wheels do not slip sideways in this model.
        for (place, variance) in [(X, forward), (Y, 0.0), (YAW, yaw)] {
            all[7 * place] = variance + VELOCITY_VARIANCE_MIN;
        }
        all
    }
}

/// Returns a covariance in which nothing is measured but the plane, whose variances are zero yet.
fn unmeasured() -> [f64; 36] {
    let mut all = [0.0; 36];
    (0..6)
        .filter(|place| ![X, Y, YAW].contains(place))
        .for_each(|place| all[7 * place] = UNMEASURED_VARIANCE);
    all
}

fn product(a: &[[f64; 3]; 3], b: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    core::array::from_fn(|row| core::array::from_fn(|column| (0..3).map(|k| a[row][k] * b[k][column]).sum()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use msg::Header;

    const SIGMAS: OdometrySigmas = OdometrySigmas { m_per_m: 0.05, rad_per_rad: 0.02, rad_per_m: 0.01 };

    fn at(incarnation: u64, x_m: f64, yaw_rad: f64) -> Odometry {
        let header = Header { incarnation, ..Header::default() };
        Odometry { header, odom_from_base: Pose2::new(x_m, 0.0, yaw_rad), ..Odometry::default() }
    }

    #[test]
    fn variances_grow_with_the_path_and_a_restarted_source_begins_anew() {
        let mut covariance = OdometryCovariance::default();
        (0..=100).for_each(|step| covariance.add(&SIGMAS, &at(1, 0.01 * f64::from(step), 0.0)));
        let pose = covariance.of_pose();
        assert!((pose[0].sqrt() - 0.05).abs() < 1e-9, "5 cm along the way after 1 m: {}", pose[0].sqrt());
        assert!((pose[35].sqrt() - 0.01).abs() < 1e-9, "{}", pose[35].sqrt());
        // The heading's error moves the robot sideways: a random walk's integral is sigma / sqrt(3).
        let sideways_m = (pose[7] - pose[0]).sqrt();
        assert!((sideways_m - 0.01 / 3.0_f64.sqrt()).abs() < 1e-4, "{sideways_m}");
        assert!(pose[11] > 0.0 && pose[11] == pose[31], "y and yaw are correlated");
        assert_eq!(pose[14], UNMEASURED_VARIANCE);
        covariance.add(&SIGMAS, &at(2, 1.0, 0.0));
        assert_eq!(covariance.of_pose()[0], 0.0);
    }

    #[test]
    fn a_standing_robot_has_a_small_variance_of_velocity() {
        let velocity = OdometryCovariance::of_velocity(&SIGMAS, &at(1, 0.0, 0.0));
        assert_eq!([velocity[0], velocity[7], velocity[35]], [VELOCITY_VARIANCE_MIN; 3]);
    }
}
