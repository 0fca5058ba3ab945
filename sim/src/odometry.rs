//! Odometry of a differential drive with the errors of real sensors.
//!
//! It is dead reckoning (Siegwart, Nourbakhsh, Scaramuzza, "Autonomous Mobile Robots", 2nd ed., eq. 5.7). As
//! on a TurtleBot3, the distance comes from the wheels and the heading from the gyroscope (turtlebot3_node,
//! parameter `odometry.use_imu`). Wheels that spin at a table leg therefore do not turn the map. The
//! configuration can take the heading from the wheels too.

use crate::burger::{WHEEL_RADIUS_M, WHEEL_SEPARATION_M};
use crate::config::{HeadingSource, NoiseConfig};
use crate::noise::Noise;
use msg::Pose2;

/// Dead reckoning from wheel angles and turns. It starts at the origin of `odom`.
pub(crate) struct WheelOdometry {
    odom_from_base: Pose2,
    /// Distance and turn since the last [`WheelOdometry::take_motion`], metres and radians.
    motion: (f64, f64),
    /// Radii of the left and the right wheel as odometry assumes them, metres.
    radii_m: [f64; 2],
    separation_m: f64,
    walk_m_per_sqrt_m: f64,
    heading: HeadingSource,
    /// Angle that the gyroscope reports per radian of turning, radians.
    gyro_scale: f64,
    gyro_walk_rad_per_sqrt_rad: f64,
    noise: Noise,
}

impl WheelOdometry {
    pub(crate) fn new(config: &NoiseConfig, mut noise: Noise) -> Self {
        let mut drawn = |std: f64| 1.0 + (std * noise.gaussian()).clamp(-0.5, 0.5);
        let radii_m = [(); 2].map(|()| WHEEL_RADIUS_M * drawn(config.wheel_scale_std));
        let separation_m = WHEEL_SEPARATION_M * drawn(config.wheel_separation_std);
        let gyro_scale = drawn(config.gyro_scale_std);
        Self {
            odom_from_base: Pose2::IDENTITY,
            motion: (0.0, 0.0),
            radii_m,
            separation_m,
            walk_m_per_sqrt_m: config.wheel_walk_m_per_sqrt_m,
            heading: config.heading,
            gyro_scale,
            gyro_walk_rad_per_sqrt_rad: config.gyro_walk_rad_per_sqrt_rad,
            noise,
        }
    }

    /// Adds a motion in which the left and right wheel turned by `delta_rad` and the body by `yaw_rad`.
    pub(crate) fn advance(&mut self, delta_rad: [f64; 2], yaw_rad: f64) {
        let mut measured_m = [0.0; 2];
        for ((way_m, delta_rad), radius_m) in measured_m.iter_mut().zip(delta_rad).zip(self.radii_m) {
            let rolled_m = radius_m * delta_rad;
            *way_m = rolled_m + self.walk_m_per_sqrt_m * rolled_m.abs().sqrt() * self.noise.gaussian();
        }
        let [left_m, right_m] = measured_m;
        let way_m = (left_m + right_m) / 2.0;
        let walk_rad = self.gyro_walk_rad_per_sqrt_rad * yaw_rad.abs().sqrt() * self.noise.gaussian();
        let turn_rad = match self.heading {
            HeadingSource::Gyro => self.gyro_scale * yaw_rad + walk_rad,
            HeadingSource::Wheels => (right_m - left_m) / self.separation_m,
        };
        // The step follows the chord of the arc, whose direction is half of the turn (second order).
        let (sin, cos) = (turn_rad / 2.0).sin_cos();
        self.odom_from_base = self.odom_from_base * Pose2::new(way_m * cos, way_m * sin, turn_rad);
        self.motion = (self.motion.0 + way_m, self.motion.1 + turn_rad);
    }

    pub(crate) fn odom_from_base(&self) -> Pose2 {
        self.odom_from_base
    }

    /// Returns the distance and turn since the last call, metres and radians.
    pub(crate) fn take_motion(&mut self) -> (f64, f64) {
        core::mem::take(&mut self.motion)
    }
}
