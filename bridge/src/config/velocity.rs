//! The settings of the velocities that the bridge sends to robots.

use super::ConfigError;
use msg::ROBOTS_MAX;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Shortest and longest validity of a velocity, seconds: a command at 20 Hz must not end before the next one.
const TIMEOUT_RANGE_S: std::ops::RangeInclusive<f64> = 0.1..=10.0;
/// Largest limits that are accepted, m/s and rad/s: beyond these a number is a mistake.
const LINEAR_MAX_M_S: f64 = 10.0;
const ANGULAR_MAX_RAD_S: f64 = 20.0;

/// Limits of all velocities that the bridge sends. A velocity beyond them is clamped.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VelocityConfig {
    /// Largest speed forward and backward, m/s, above 0, at most 10. A TurtleBot3 Burger reaches 0.22.
    pub linear_m_s: f64,
    /// Largest turning rate in either direction, rad/s, above 0, at most 20. A TurtleBot3 Burger reaches 2.84.
    pub angular_rad_s: f64,
    /// How long a velocity is valid (dead man), seconds, 0.1 to 10; then the robot is sent zeros. At 20 Hz five
    /// commands may be lost in 0.3 s.
    pub timeout_s: f64,
    /// Other limits for single robots, such as `[{ robot = 2, linear_m_s = 0.26, angular_rad_s = 1.82 }]`.
    pub robots: Vec<LimitsOfRobot>,
}

/// Limits of one robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LimitsOfRobot {
    /// The robot's number, from 1.
    pub robot: usize,
    /// Largest speed forward and backward, m/s, above 0, at most 10.
    pub linear_m_s: f64,
    /// Largest turning rate in either direction, rad/s, above 0, at most 20.
    pub angular_rad_s: f64,
}

impl Default for VelocityConfig {
    fn default() -> Self {
        Self { linear_m_s: 0.22, angular_rad_s: 2.84, timeout_s: 0.3, robots: Vec::new() }
    }
}

impl VelocityConfig {
    /// Refuses values that cannot work; the error names the key.
    pub fn validate(&self) -> Result<(), ConfigError> {
        if !TIMEOUT_RANGE_S.contains(&self.timeout_s) {
            return Err(ConfigError::new(
                "velocity.timeout_s",
                self.timeout_s.to_string(),
                "0.1 to 10 seconds work",
            ));
        }
        check_limits(self.linear_m_s, self.angular_rad_s)?;
        for limits in &self.robots {
            if !(1..=ROBOTS_MAX).contains(&limits.robot) {
                let expected = "the number of a robot of the fleet works";
                return Err(ConfigError::new("velocity.robots.robot", limits.robot.to_string(), expected));
            }
            check_limits(limits.linear_m_s, limits.angular_rad_s)?;
        }
        Ok(())
    }

    /// Returns [`Self::timeout_s`] as a duration.
    pub fn timeout(&self) -> Duration {
        Duration::from_secs_f64(self.timeout_s)
    }
}

fn check_limits(linear_m_s: f64, angular_rad_s: f64) -> Result<(), ConfigError> {
    let check = |key, value: f64, max: f64, expected| {
        let is_valid = value > 0.0 && value <= max;
        if is_valid { Ok(()) } else { Err(ConfigError::new(key, value.to_string(), expected)) }
    };
    check("velocity.linear_m_s", linear_m_s, LINEAR_MAX_M_S, "above 0, at most 10 m/s work")?;
    check("velocity.angular_rad_s", angular_rad_s, ANGULAR_MAX_RAD_S, "above 0, at most 20 rad/s work")
}
