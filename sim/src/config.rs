//! What can be set about a simulated robot. Angles of a configuration are in degrees, as people
//! write them; everything else is SI.

use crate::burger;
use msg::BEAMS_MAX;
use serde::de::value::MapAccessDeserializer;
use serde::de::{self, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use std::fmt;

/// One robot's sensors, flaws and limits.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SimConfig {
    /// The LiDAR: a preset's name or a table of numbers.
    pub lidar: LidarConfig,
    /// How wrong the sensors are.
    pub noise: NoiseConfig,
    /// How fast the robot may go.
    pub limits: Limits,
}

impl SimConfig {
    /// The first value that makes no sense, by name.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.lidar.validate()?;
        self.noise.validate()?;
        self.limits.validate()
    }
}

/// A value that makes no sense.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{field} is {value}, but must be {expected}")]
pub struct ConfigError {
    /// Its path, as in `lidar.beams`.
    pub field: &'static str,
    /// What it is.
    pub value: f64,
    /// What it may be.
    pub expected: &'static str,
}

fn check(field: &'static str, value: f64, sound: bool, expected: &'static str) -> Result<(), ConfigError> {
    if sound && value.is_finite() { Ok(()) } else { Err(ConfigError { field, value, expected }) }
}

/// A planar LiDAR. In a file either a preset's name (`lidar = "lds01"`) or a table of these numbers;
/// numbers left out are those of [`LidarConfig::PAPER`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LidarConfig {
    /// Rays in a scan, 1 to [`BEAMS_MAX`].
    pub beams: usize,
    /// Direction of the first ray in `base_scan`, degrees, counter-clockwise from forward.
    pub angle_min_deg: f64,
    /// From the first ray to the last, degrees; at 360 the circle is divided evenly and no ray doubles.
    pub fov_deg: f64,
    /// Nearer things are not measured, metres.
    pub range_min_m: f64,
    /// Farther things are not measured, metres.
    pub range_max_m: f64,
    /// Scans a second: 20, 10, 5, 4, 2 or 1, so that a scan never lies between two odometry poses.
    pub rate_hz: f64,
}

impl LidarConfig {
    /// The paper's sensor: 180 rays over 90° forward at 10 Hz. The paper names no range; these are
    /// the LDS-01's, the LiDAR that the Burger it models is sold with.
    pub const PAPER: Self =
        Self { beams: 180, angle_min_deg: -45.0, fov_deg: 90.0, rate_hz: 10.0, ..Self::LDS_01 };
    /// HLS-LFCD LDS-01, ROBOTIS e-Manual: 360 rays, 0.12 to 3.5 m, 300 rpm.
    pub const LDS_01: Self = Self {
        beams: 360,
        angle_min_deg: 0.0,
        fov_deg: 360.0,
        range_min_m: 0.12,
        range_max_m: 3.5,
        rate_hz: 5.0,
    };
    /// LDS-02, ROBOTIS e-Manual: 360 rays, 0.16 to 8 m, 5 Hz.
    pub const LDS_02: Self = Self { range_min_m: 0.16, range_max_m: 8.0, ..Self::LDS_01 };

    /// The presets by the names that a file calls them.
    pub const PRESETS: [(&str, Self); 3] =
        [("paper", Self::PAPER), ("lds01", Self::LDS_01), ("lds02", Self::LDS_02)];

    /// `None` if no preset has this name.
    pub fn preset(name: &str) -> Option<Self> {
        Self::PRESETS.iter().find(|(known, _)| *known == name).map(|(_, config)| *config)
    }

    /// Radians between two rays.
    pub fn angle_increment_rad(&self) -> f64 {
        let gaps = if self.fov_deg >= 360.0 { self.beams } else { self.beams.saturating_sub(1).max(1) };
        self.fov_deg.to_radians() / gaps as f64
    }

    /// The first value that makes no sense, by name.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let beams = self.beams as f64;
        check("lidar.beams", beams, (1..=BEAMS_MAX).contains(&self.beams), "1 to 4096")?;
        let angle = self.angle_min_deg;
        check("lidar.angle_min_deg", angle, (-360.0..=360.0).contains(&angle), "-360 to 360")?;
        check("lidar.fov_deg", self.fov_deg, (0.0..=360.0).contains(&self.fov_deg), "0 to 360")?;
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

/// [`LidarConfig`] as a table.
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

/// How wrong the sensors are: standard deviations of zero-mean Gaussians. 0 switches one off.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NoiseConfig {
    /// Of a range, metres. ROBOTIS's Gazebo model of the Burger has 0.01.
    pub range_std_m: f64,
    /// Of a range, as a part of it; adds to `range_std_m`.
    pub range_std_ratio: f64,
    /// Probability that a ray yields no measurement (NaN).
    pub dropout_probability: f64,
    /// Of each wheel's radius as odometry believes it, as a part of it; drawn once a run. Unequal
    /// wheels bend a straight line (Borenstein and Feng 1996, E_d).
    pub wheel_scale_std: f64,
    /// Of the wheels' distance as odometry believes it, as a part of it; drawn once a run
    /// (Borenstein and Feng 1996, E_b).
    pub wheel_separation_std: f64,
    /// Of each wheel's measured way, metres after one metre: a random walk, which grows with the
    /// square root of the way.
    pub wheel_walk_m_per_sqrt_m: f64,
    /// What odometry takes the heading from.
    pub heading: Heading,
    /// Of the gyroscope's scale; drawn once a run.
    pub gyro_scale_std: f64,
    /// Of the gyroscope's heading, radians after one radian turned: a random walk.
    pub gyro_walk_rad_per_sqrt_rad: f64,
}

/// What odometry takes the heading from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Heading {
    /// The gyroscope, as TurtleBot3's own driver does by default.
    #[default]
    Gyro,
    /// The wheels: their slip turns the robot's belief.
    Wheels,
}

impl NoiseConfig {
    /// Perfect sensors.
    pub const OFF: Self = Self {
        range_std_m: 0.0,
        range_std_ratio: 0.0,
        dropout_probability: 0.0,
        wheel_scale_std: 0.0,
        wheel_separation_std: 0.0,
        wheel_walk_m_per_sqrt_m: 0.0,
        heading: Heading::Gyro,
        gyro_scale_std: 0.0,
        gyro_walk_rad_per_sqrt_rad: 0.0,
    };

    /// The first value that makes no sense, by name.
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
        // Larger ones could draw a wheel of no size.
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
    /// A robot as one buys it: about 0.3° of heading lost per radian turned, and some way per metre.
    fn default() -> Self {
        Self {
            range_std_m: 0.01,
            range_std_ratio: 0.0,
            dropout_probability: 0.002,
            wheel_scale_std: 0.002,
            wheel_separation_std: 0.01,
            wheel_walk_m_per_sqrt_m: 0.001,
            heading: Heading::Gyro,
            gyro_scale_std: 0.005,
            gyro_walk_rad_per_sqrt_rad: 0.005,
        }
    }
}

/// What a command may ask for. Beyond it is clamped.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// m/s, forward and backward.
    pub linear_m_s: f64,
    /// rad/s, either way.
    pub angular_rad_s: f64,
    /// Without a command for so long, the robot stops; seconds.
    pub command_timeout_s: f64,
}

impl Limits {
    /// The first value that makes no sense, by name.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let linear = self.linear_m_s;
        let sound = linear > 0.0 && linear <= burger::LINEAR_MAX_M_S;
        check("limits.linear_m_s", linear, sound, "more than 0, at most the Burger's 0.22")?;
        let angular = self.angular_rad_s;
        let sound = angular > 0.0 && angular <= burger::ANGULAR_MAX_RAD_S;
        check("limits.angular_rad_s", angular, sound, "more than 0, at most the Burger's 2.84")?;
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
    fn what_is_written_is_read() {
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
    fn nonsense_is_refused_by_name() {
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
        ] {
            assert_eq!(refused(text).field, field);
        }
        let words = refused("[lidar]\nrate_hz = 7").to_string();
        assert_eq!(words, "lidar.rate_hz is 7, but must be 20, 10, 5, 4, 2 or 1");
        assert_eq!(SimConfig::default().validate(), Ok(()));
    }
}
