//! What the ROS 2 door may be told at start.

use crate::config::ConfigError;
use serde::{Deserialize, Serialize};

/// The highest domain whose ports exist (RTPS 9.6.1.1).
const DOMAIN_MAX: u16 = 232;

/// The bridge's table `dds` of the fleet file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DdsConfig {
    /// Whether there is a ROS 2 door.
    pub enabled: bool,
    /// ROS_DOMAIN_ID of those to talk to.
    pub domain: u16,
    /// Whether to talk with this machine alone. Off, everybody in the domain may watch, and may drive only if
    /// `bridge.drive` is `anyone`: DDS does not say who speaks.
    pub loopback_only: bool,
    /// Before the names of all topics but /tf, /tf_static and /clock: `/lab` makes `/lab/robot1/scan`.
    pub namespace: String,
    /// The node's name in the ROS graph.
    pub node: String,
    /// Whether robots that are not simulated here want TwistStamped on `/robotN/cmd_vel`, as TurtleBots do from
    /// Jazzy on, or Twist.
    pub stamped_commands: bool,
}

impl Default for DdsConfig {
    fn default() -> Self {
        Self {
            enabled: false,
            domain: 0,
            loopback_only: true,
            namespace: String::new(),
            node: "mr_slam".into(),
            stamped_commands: false,
        }
    }
}

impl DdsConfig {
    /// Checks every value.
    pub(crate) fn validate(&self) -> Result<(), ConfigError> {
        if self.domain > DOMAIN_MAX {
            return Err(ConfigError::new("dds.domain", self.domain.to_string(), "domains 0 to 232 exist"));
        }
        let parts = self.namespace.strip_prefix('/').map(|rest| rest.split('/'));
        let sound = self.namespace.is_empty() || parts.is_some_and(|mut parts| parts.all(is_name));
        if !sound {
            let value = format!("'{}'", self.namespace);
            return Err(ConfigError::new("dds.namespace", value, "expected nothing, or a name like /lab"));
        }
        if !is_name(&self.node) {
            let value = format!("'{}'", self.node);
            return Err(ConfigError::new("dds.node", value, "expected letters, digits and underscores"));
        }
        Ok(())
    }
}

/// One token of a ROS name.
fn is_name(text: &str) -> bool {
    let rest = |c: char| c.is_ascii_alphanumeric() || c == '_';
    text.len() <= 128 && text.starts_with(|c: char| c.is_ascii_alphabetic()) && text.chars().all(rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_domains_are_checked() {
        assert_eq!(DdsConfig::default().validate(), Ok(()));
        let with = |change: fn(&mut DdsConfig)| {
            let mut config = DdsConfig::default();
            change(&mut config);
            config.validate()
        };
        assert_eq!(with(|c| c.namespace = "/lab/floor_2".into()), Ok(()));
        assert!(with(|c| c.namespace = "lab".into()).is_err());
        assert!(with(|c| c.namespace = "/lab//a".into()).is_err());
        assert!(with(|c| c.node = "1st".into()).is_err());
        assert!(with(|c| c.domain = 233).is_err());
    }
}
