//! Configuration of a simulated robot. Angles are in degrees; all other values are in SI units.

mod moving;

pub use moving::MovingConfig;

use crate::burger;
use msg::{BEAMS_MAX, BEAMS_MIN};
use serde::de::value::MapAccessDeserializer;
use serde::de::{self, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use std::fmt;

/// Sensors, sensor errors and limits of one robot.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SimConfig {
    /// LiDAR: the name of a preset or a table of values.
    pub lidar: LidarConfig,
    /// Errors of the sensors.
    pub noise: NoiseConfig,
    /// Limits of velocity commands.
    pub limits: Limits,
    /// People, doors and boxes that move in the room.
    pub moving: MovingConfig,
}

impl SimConfig {
    /// Checks all values and returns the first invalid one.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.lidar.validate()?;
        self.noise.validate()?;
        self.limits.validate()?;
        self.moving.validate()
    }
}

/// An invalid value of the configuration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("sim.{field} is {value}; expected {expected}")]
pub struct ConfigError {
    /// Path of the key below `sim`, such as `lidar.beams`.
    pub field: &'static str,
    /// Value that was found.
    pub value: f64,
    /// Range of valid values, for the error message.
    pub expected: &'static str,
}

fn check(field: &'static str, value: f64, valid: bool, expected: &'static str) -> Result<(), ConfigError> {
    if valid && value.is_finite() { Ok(()) } else { Err(ConfigError { field, value, expected }) }
}

/// Configuration of a planar LiDAR.
///
/// In a file it is the name of a preset (`lidar = "lds01"`) or a table of these values. Missing values are
/// those of [`LidarConfig::PAPER`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LidarConfig {
    /// Number of beams in a scan, [`BEAMS_MIN`] to [`BEAMS_MAX`].
    pub beams: usize,
    /// Direction of the first beam in `base_scan`, degrees, counter-clockwise from forward.
    pub angle_min_deg: f64,
    /// Angle from the first beam to the last, degrees, above 0, at most 360. With 360 the beams divide the circle evenly.
    pub fov_deg: f64,
    /// Smallest range that is measured, metres.
    pub range_min_m: f64,
    /// Largest range that is measured, metres.
    pub range_max_m: f64,
    /// Scan rate, Hz: 20, 10, 5, 4, 2 or 1, so that each scan has an odometry pose with the same stamp.
    pub rate_hz: f64,
}

impl LidarConfig {
    /// Sensor of the MR-SLAM paper: 180 beams over 90° forward at 10 Hz. The paper gives no range; the
    /// ranges are those of the LDS-01, with which the Burger is sold.
    pub const PAPER: Self =
        Self { beams: 180, angle_min_deg: -45.0, fov_deg: 90.0, rate_hz: 10.0, ..Self::LDS_01 };
    /// HLS-LFCD LDS-01 by ROBOTIS's e-Manual: 360 beams, 0.12 to 3.5 m, 300 rpm.
    pub const LDS_01: Self = Self {
        beams: 360,
        angle_min_deg: 0.0,
        fov_deg: 360.0,
        range_min_m: 0.12,
        range_max_m: 3.5,
        rate_hz: 5.0,
    };
    /// LDS-02 by ROBOTIS's e-Manual: 360 beams, 0.16 to 8 m, 5 Hz.
    pub const LDS_02: Self = Self { range_min_m: 0.16, range_max_m: 8.0, ..Self::LDS_01 };

    /// All presets with their names in a configuration file.
    pub const PRESETS: [(&str, Self); 3] =
        [("paper", Self::PAPER), ("lds01", Self::LDS_01), ("lds02", Self::LDS_02)];

    /// Returns the preset with this name; `None` if there is none.
    pub fn preset(name: &str) -> Option<Self> {
        Self::PRESETS.iter().find(|(known, _)| *known == name).map(|(_, config)| *config)
    }

    /// Returns the angle between two beams, radians.
    pub fn angle_increment_rad(&self) -> f64 {
        let gaps = if self.fov_deg >= 360.0 { self.beams } else { self.beams.saturating_sub(1).max(1) };
        self.fov_deg.to_radians() / gaps as f64
    }

    /// Checks all values and returns the first invalid one.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let beams = self.beams as f64;
        check("lidar.beams", beams, (BEAMS_MIN..=BEAMS_MAX).contains(&self.beams), "2 to 4096")?;
        let angle = self.angle_min_deg;
        check("lidar.angle_min_deg", angle, (-360.0..=360.0).contains(&angle), "-360 to 360")?;
        check(
            "lidar.fov_deg",
            self.fov_deg,
            self.fov_deg > 0.0 && self.fov_deg <= 360.0,
            "above 0, at most 360",
        )?;
        let (near, far) = (self.range_min_m, self.range_max_m);
        check("lidar.range_min_m", near, (0.0..100.0).contains(&near), "0 to 100")?;
        check("lidar.range_max_m", far, far > near && far <= 100.0, "more than range_min_m, at most 100")?;
        let rates = [20.0, 10.0, 5.0, 4.0, 2.0, 1.0];
        check("lidar.rate_hz", self.rate_hz, rates.contains(&self.rate_hz), "20, 10, 5, 4, 2 or 1")
    }
}

impl Default for LidarConfig {
    fn default() -> Self {
        Self::PAPER
    }
}

/// [`LidarConfig`] as a table in a file.
#[derive(Deserialize)]
#[serde(default, deny_unknown_fields)]
struct LidarTable {
    beams: usize,
    angle_min_deg: f64,
    fov_deg: f64,
    range_min_m: f64,
    range_max_m: f64,
    rate_hz: f64,
}

impl Default for LidarTable {
    fn default() -> Self {
        let LidarConfig { beams, angle_min_deg, fov_deg, range_min_m, range_max_m, rate_hz } =
            LidarConfig::PAPER;
        Self { beams, angle_min_deg, fov_deg, range_min_m, range_max_m, rate_hz }
    }
}

impl<'de> Deserialize<'de> for LidarConfig {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(PresetOrTable)
    }
}

struct PresetOrTable;

impl<'de> Visitor<'de> for PresetOrTable {
    type Value = LidarConfig;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "\"paper\", \"lds01\", \"lds02\" or a table of numbers")
    }

    fn visit_str<E: de::Error>(self, name: &str) -> Result<LidarConfig, E> {
        LidarConfig::preset(name).ok_or_else(|| E::invalid_value(de::Unexpected::Str(name), &self))
    }

    fn visit_map<M: MapAccess<'de>>(self, map: M) -> Result<LidarConfig, M::Error> {
        let table = LidarTable::deserialize(MapAccessDeserializer::new(map))?;
        let LidarTable { beams, angle_min_deg, fov_deg, range_min_m, range_max_m, rate_hz } = table;
        Ok(LidarConfig { beams, angle_min_deg, fov_deg, range_min_m, range_max_m, rate_hz })
    }
}

/// Errors of the sensors: standard deviations of zero-mean Gaussians. 0 switches an error off.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NoiseConfig {
    /// Error of a range, metres. ROBOTIS's Gazebo model of the Burger has 0.01.
    pub range_std_m: f64,
    /// Error of a range relative to the range. It adds to `range_std_m`.
    pub range_std_ratio: f64,
    /// Probability that a beam yields no measurement (NaN).
    pub dropout_probability: f64,
    /// Relative error of each wheel's radius in odometry, drawn once per run. Unequal wheels bend a
    /// straight line (Borenstein and Feng 1996, E_d).
    pub wheel_scale_std: f64,
    /// Relative error of the distance between the wheels in odometry, drawn once per run (Borenstein and
    /// Feng 1996, E_b).
    pub wheel_separation_std: f64,
    /// Error of each wheel's measured distance after one metre, metres: a random walk, which grows with the
    /// square root of the distance.
    pub wheel_walk_m_per_sqrt_m: f64,
    /// Sensor from which odometry takes the heading.
    pub heading: HeadingSource,
    /// Relative error of the gyroscope's scale, drawn once per run.
    pub gyro_scale_std: f64,
    /// Error of the gyroscope's heading after one radian of turning, radians: a random walk.
    pub gyro_walk_rad_per_sqrt_rad: f64,
}

/// Sensor from which odometry takes the heading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HeadingSource {
    /// Uses the gyroscope, as TurtleBot3's driver does by default.
    #[default]
    Gyro,
    /// Uses the wheels, whose slip then causes errors of the heading.
    Wheels,
}

impl NoiseConfig {
    /// Sensors without errors.
    pub const OFF: Self = Self {
        range_std_m: 0.0,
        range_std_ratio: 0.0,
        dropout_probability: 0.0,
        wheel_scale_std: 0.0,
        wheel_separation_std: 0.0,
        wheel_walk_m_per_sqrt_m: 0.0,
        heading: HeadingSource::Gyro,
        gyro_scale_std: 0.0,
        gyro_walk_rad_per_sqrt_rad: 0.0,
    };

    /// Checks all values and returns the first invalid one.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let deviations = [
            ("noise.range_std_m", self.range_std_m),
            ("noise.range_std_ratio", self.range_std_ratio),
            ("noise.wheel_walk_m_per_sqrt_m", self.wheel_walk_m_per_sqrt_m),
            ("noise.gyro_walk_rad_per_sqrt_rad", self.gyro_walk_rad_per_sqrt_rad),
        ];
        for (field, value) in deviations {
            check(field, value, (0.0..=1.0).contains(&value), "0 to 1")?;
        }
        let p = self.dropout_probability;
        check("noise.dropout_probability", p, (0.0..=1.0).contains(&p), "0 to 1")?;
        // With larger values a wheel of size zero could be drawn.
        let scales = [
            ("noise.wheel_scale_std", self.wheel_scale_std),
            ("noise.wheel_separation_std", self.wheel_separation_std),
            ("noise.gyro_scale_std", self.gyro_scale_std),
        ];
        for (field, value) in scales {
            check(field, value, (0.0..=0.1).contains(&value), "0 to 0.1")?;
        }
        Ok(())
    }
}

impl Default for NoiseConfig {
    /// Errors of a robot as sold: about 0.3° of heading per radian of turning, and 1 mm per metre.
    fn default() -> Self {
        Self {
            range_std_m: 0.01,
            range_std_ratio: 0.0,
            dropout_probability: 0.002,
            wheel_scale_std: 0.002,
            wheel_separation_std: 0.01,
            wheel_walk_m_per_sqrt_m: 0.001,
            heading: HeadingSource::Gyro,
            gyro_scale_std: 0.005,
            gyro_walk_rad_per_sqrt_rad: 0.005,
        }
    }
}

/// Limits of velocity commands. A command beyond them is clamped.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Largest speed forward and backward, m/s.
    pub linear_m_s: f64,
    /// Largest turning rate in either direction, rad/s.
    pub angular_rad_s: f64,
    /// Time after the last command at which the robot stops (dead man), seconds.
    pub command_timeout_s: f64,
}

impl Limits {
    /// Checks all values and returns the first invalid one.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let linear = self.linear_m_s;
        let valid = linear > 0.0 && linear <= burger::LINEAR_MAX_M_S;
        check("limits.linear_m_s", linear, valid, "more than 0, at most the Burger's 0.22")?;
        let angular = self.angular_rad_s;
        let valid = angular > 0.0 && angular <= burger::ANGULAR_MAX_RAD_S;
        check("limits.angular_rad_s", angular, valid, "more than 0, at most the Burger's 2.84")?;
        let timeout = self.command_timeout_s;
        check("limits.command_timeout_s", timeout, (0.01..=10.0).contains(&timeout), "0.01 to 10")
    }
}

impl Default for Limits {
    fn default() -> Self {
        Self { linear_m_s: 0.15, angular_rad_s: 1.5, command_timeout_s: 0.3 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<SimConfig, String> {
        toml::from_str(text).map_err(|error: toml::de::Error| error.to_string())
    }

    #[test]
    fn reads_presets_and_numbers() {
        assert_eq!(read("").unwrap(), SimConfig::default());
        assert_eq!(read("lidar = 'lds02'").unwrap().lidar, LidarConfig::LDS_02);
        let custom =
            read("[lidar]\nbeams = 720\nfov_deg = 270\nangle_min_deg = -135\nrange_max_m = 30").unwrap();
        assert_eq!((custom.lidar.beams, custom.lidar.rate_hz), (720, LidarConfig::PAPER.rate_hz));
        assert_eq!(read("[noise]\nrange_std_m = 0").unwrap().noise.range_std_m, 0.0);
        assert_eq!(read("[limits]\nlinear_m_s = 0.1").unwrap().limits.linear_m_s, 0.1);
    }

    #[test]
    fn a_written_configuration_is_read_back() {
        let text =
            toml::to_string(&SimConfig { lidar: LidarConfig::LDS_01, ..SimConfig::default() }).unwrap();
        assert_eq!(read(&text).unwrap().lidar, LidarConfig::LDS_01);
    }

    #[test]
    fn unknown_names_are_refused() {
        for (text, word) in [
            ("lidar = 'lds03'", "lds01"),
            ("lidar = 7", "table of numbers"),
            ("[lidar]\nbeam = 7", "beam"),
            ("[noise]\nrange = 1", "range"),
            ("[limits]\nspeed = 1", "speed"),
            ("sonar = 1", "sonar"),
        ] {
            let error = read(text).unwrap_err();
            assert!(error.contains(word), "{text}: {error}");
        }
    }

    #[test]
    fn invalid_values_are_refused_with_their_key() {
        let refused = |text: &str| read(text).unwrap().validate().unwrap_err();
        for (text, field) in [
            ("[lidar]\nbeams = 0", "lidar.beams"),
            ("[lidar]\nbeams = 4097", "lidar.beams"),
            ("[lidar]\nfov_deg = 361", "lidar.fov_deg"),
            ("[lidar]\nfov_deg = nan", "lidar.fov_deg"),
            ("[lidar]\nangle_min_deg = inf", "lidar.angle_min_deg"),
            ("[lidar]\nrange_min_m = -1", "lidar.range_min_m"),
            ("[lidar]\nrange_max_m = 0.1", "lidar.range_max_m"),
            ("[lidar]\nrate_hz = 7", "lidar.rate_hz"),
            ("[noise]\ndropout_probability = 1.5", "noise.dropout_probability"),
            ("[noise]\nrange_std_m = nan", "noise.range_std_m"),
            ("[noise]\nwheel_scale_std = 2", "noise.wheel_scale_std"),
            ("[limits]\nlinear_m_s = 0", "limits.linear_m_s"),
            ("[limits]\nangular_rad_s = -inf", "limits.angular_rad_s"),
            ("[limits]\ncommand_timeout_s = 0", "limits.command_timeout_s"),
            ("[moving]\ndoors = 17", "moving.doors"),
        ] {
            assert_eq!(refused(text).field, field);
        }
        let words = refused("[lidar]\nrate_hz = 7").to_string();
        assert_eq!(words, "sim.lidar.rate_hz is 7; expected 20, 10, 5, 4, 2 or 1");
        assert_eq!(SimConfig::default().validate(), Ok(()));
    }
}
