//! The settings of the robots' batteries.

use super::ConfigError;
use serde::{Deserialize, Serialize};

/// The table `bridge.battery` of the fleet file: when the operator is warned. A robot is not stopped by its battery.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BatteryConfig {
    /// Charge below which a battery is called low, 0 to 1. A TurtleBot3 turns its motors off at 11.0 V, which its OpenCR
    /// calls 0.28: set 0.45 for these.
    pub low: f64,
    /// Charge below which it is urgent, 0 to `low`. For a TurtleBot3 set 0.35.
    pub critical: f64,
}

impl Default for BatteryConfig {
    fn default() -> Self {
        Self { low: 0.2, critical: 0.1 }
    }
}

impl BatteryConfig {
    /// Refuses values that cannot work; the error names the key.
    pub(crate) fn validate(&self) -> Result<(), ConfigError> {
        if !(0.0..=1.0).contains(&self.low) {
            return Err(ConfigError::new("battery.low", self.low.to_string(), "a charge from 0 to 1"));
        }
        if !(0.0..=self.low).contains(&self.critical) {
            let expected = "a charge from 0 to battery.low";
            return Err(ConfigError::new("battery.critical", self.critical.to_string(), expected));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn charges_are_shares_and_urgent_is_not_above_low() {
        let with = |low, critical| BatteryConfig { low, critical }.validate();
        assert_eq!(with(0.45, 0.35), Ok(()));
        assert_eq!(with(0.0, 0.0), Ok(()), "no warnings");
        for (low, critical, key) in
            [(20.0, 10.0, "low"), (f64::NAN, 0.1, "low"), (0.2, 0.3, "critical"), (0.2, -0.1, "critical")]
        {
            let error = with(low, critical).unwrap_err().to_string();
            assert!(error.contains(&format!("bridge.battery.{key} is")), "{error}");
        }
    }
}
