//! Sensors that are not as they are described: what a launch file, a mount or a driver gets wrong for the whole run.

use crate::noise::Noise;
use core::f64::consts::PI;
use msg::{Pose2, Scan};

/// What is wrong about the sensors of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum WrongSensor {
    /// Nothing.
    #[default]
    Nothing,
    /// The LiDAR is mounted upside down, and nothing says so.
    Mirrored,
    /// The yaw of its mount is wrong by this angle, radians.
    Turned(f64),
    /// Its ranges are too long by this factor, as in another unit.
    RangesTimes(f64),
    /// The distances of odometry are too long by this factor.
    OdometryTimes(f64),
    /// Odometry's yaw has the wrong sign.
    OdometryTurnsOtherWay,
    /// What odometry calls forward is backward.
    OdometryReversed,
}

impl WrongSensor {
    /// Draws what is wrong for a seed: each kind in turn.
    pub fn draw(seed: u64) -> Self {
        let mut noise = Noise::new(seed ^ 0x05E0_50A5);
        let factor = noise.between(1.6, 4.0);
        let factor = if noise.uniform() < 0.5 { factor } else { 1.0 / factor };
        let sign = if noise.uniform() < 0.5 { 1.0 } else { -1.0 };
        match seed % 6 {
            0 => Self::Mirrored,
            1 => Self::Turned(sign * noise.between(0.2, PI)),
            2 => Self::RangesTimes(factor),
            3 => Self::OdometryTimes(factor),
            4 => Self::OdometryTurnsOtherWay,
            _ => Self::OdometryReversed,
        }
    }

    /// The kind's name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Nothing => "nothing",
            Self::Mirrored => "LiDAR mirrored",
            Self::Turned(_) => "LiDAR's yaw",
            Self::RangesTimes(_) => "unit of ranges",
            Self::OdometryTimes(_) => "unit of odometry",
            Self::OdometryTurnsOtherWay => "odometry's turns",
            Self::OdometryReversed => "odometry reversed",
        }
    }

    /// All kinds' names.
    pub fn names() -> [&'static str; 6] {
        core::array::from_fn(|kind| Self::draw(kind as u64).name())
    }

    /// Changes a scan of a robot with right sensors.
    pub fn change_scan(self, scan: &mut Scan) {
        let beams = scan.len as usize;
        match self {
            Self::Mirrored => {
                // The same ranges at the negative angles.
                let last = scan.angle_min_rad + scan.angle_increment_rad * (beams.max(1) - 1) as f32;
                scan.ranges_m[..beams].reverse();
                scan.angle_min_rad = -last;
            }
            Self::Turned(yaw_rad) => scan.angle_min_rad += yaw_rad as f32,
            Self::RangesTimes(factor) => {
                scan.ranges_m[..beams].iter_mut().for_each(|range_m| *range_m *= factor as f32);
                scan.range_min_m *= factor as f32;
                scan.range_max_m *= factor as f32;
            }
            Self::Nothing | Self::OdometryTimes(_) | Self::OdometryTurnsOtherWay | Self::OdometryReversed => {
            }
        }
    }

    /// What right odometry reads as.
    pub fn change_odometry(self, odom_from_base: Pose2) -> Pose2 {
        let Pose2 { x_m, y_m, yaw_rad } = odom_from_base;
        match self {
            Self::OdometryTimes(factor) => Pose2::new(factor * x_m, factor * y_m, yaw_rad),
            Self::OdometryTurnsOtherWay => Pose2::new(x_m, -y_m, -yaw_rad),
            Self::OdometryReversed => Pose2::new(-x_m, -y_m, yaw_rad),
            _ => odom_from_base,
        }
    }
}
