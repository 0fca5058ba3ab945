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
                "0.1 to 10 seconds",
            ));
        }
        check_limits("velocity", self.linear_m_s, self.angular_rad_s)?;
        for (index, limits) in self.robots.iter().enumerate() {
            let table = format!("velocity.robots[{index}]");
            if !(1..=ROBOTS_MAX).contains(&limits.robot) {
                let expected = "the number of a robot, 1 to 64";
                return Err(ConfigError::new(table + ".robot", limits.robot.to_string(), expected));
            }
            if self.robots[..index].iter().any(|before| before.robot == limits.robot) {
                let expected = "one entry for each robot, and an entry before has this robot";
                return Err(ConfigError::new(table + ".robot", limits.robot.to_string(), expected));
            }
            check_limits(&table, limits.linear_m_s, limits.angular_rad_s)?;
        }
        Ok(())
    }

    /// Lowers the limits of all robots to those that the robots have themselves.
    pub fn cap(&mut self, linear_m_s: f64, angular_rad_s: f64) {
        let lower = |linear: &mut f64, angular: &mut f64| {
            *linear = linear.min(linear_m_s);
            *angular = angular.min(angular_rad_s);
        };
        lower(&mut self.linear_m_s, &mut self.angular_rad_s);
        for robot in &mut self.robots {
            lower(&mut robot.linear_m_s, &mut robot.angular_rad_s);
        }
    }

    /// Returns [`Self::timeout_s`] as a duration.
    pub fn timeout(&self) -> Duration {
        Duration::from_secs_f64(self.timeout_s)
    }
}

/// Checks the limits of the table with this path.
fn check_limits(table: &str, linear_m_s: f64, angular_rad_s: f64) -> Result<(), ConfigError> {
    check_speed(|| format!("{table}.linear_m_s"), linear_m_s, LINEAR_MAX_M_S, "above 0, at most 10 m/s")?;
    let key = || format!("{table}.angular_rad_s");
    check_speed(key, angular_rad_s, ANGULAR_MAX_RAD_S, "above 0, at most 20 rad/s")
}

/// Checks the speeds of a thumb stick at full deflection.
pub(super) fn check_stick(linear_m_s: f64, angular_rad_s: f64) -> Result<(), ConfigError> {
    check_speed(|| "stick_linear_m_s".into(), linear_m_s, LINEAR_MAX_M_S, "above 0, at most 10 m/s")?;
    let key = || "stick_angular_rad_s".into();
    check_speed(key, angular_rad_s, ANGULAR_MAX_RAD_S, "above 0, at most 20 rad/s")
}

fn check_speed(
    key: impl FnOnce() -> String,
    value: f64,
    max: f64,
    expected: &'static str,
) -> Result<(), ConfigError> {
    let is_valid = value > 0.0 && value <= max;
    if is_valid { Ok(()) } else { Err(ConfigError::new(key(), value.to_string(), expected)) }
}
