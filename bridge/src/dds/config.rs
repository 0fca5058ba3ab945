//! The settings of the ROS 2 endpoint.

use crate::config::ConfigError;
use serde::{Deserialize, Serialize};

/// The highest domain whose UDP ports exist (RTPS 2.5, 9.6.1.1).
const DOMAIN_MAX: u16 = 232;

/// The highest `relayed_topics_max`. RustDDS's cost of discovery grows with every reader and writer.
const RELAYED_TOPICS_LIMIT: usize = 1024;
/// Type of velocities on DDS, where a topic is read and written by type.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VelocityMessage {
    /// geometry_msgs/Twist.
    #[default]
    Twist,
    /// geometry_msgs/TwistStamped.
    TwistStamped,
    /// Both, each with its own readers and writers.
    Either,
}

impl VelocityMessage {
    /// Returns the types of the messages, whether each is stamped.
    pub(crate) fn is_stamped(self) -> &'static [bool] {
        match self {
            Self::Twist => &[false],
            Self::TwistStamped => &[true],
            Self::Either => &[false, true],
        }
    }
}

/// The table `bridge.dds` of the fleet file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DdsConfig {
    /// Whether the fleet's topics are on DDS, for ROS 2.
    pub enabled: bool,
    /// ROS_DOMAIN_ID of the ROS 2 nodes to communicate with, 0 to 232.
    pub domain: u16,
    /// Whether to communicate with this machine alone. Otherwise everybody in the domain may watch, and may drive
    /// only if `bridge.drive` is `anyone`: DDS does not identify who publishes.
    pub loopback_only: bool,
    /// Prefix of all topics but /tf, /tf_static and /clock: `/lab` makes `/lab/robot1/scan`.
    pub namespace: String,
    /// Name of the node in the ROS graph.
    pub node: String,
    /// Type of velocities on `/cmd_vel`, `/cmd_vel_N` and `/robotN/cmd_vel`: `twist`, `twist_stamped` (TurtleBots and Nav2
    /// may expect it from Jazzy on), or `either`, which reads and writes both.
    pub velocity: VelocityMessage,
    /// Topics, besides the fleet's, that clients and ROS nodes may exchange at a time, 0 to 1024.
    pub relayed_topics_max: usize,
}

impl Default for DdsConfig {
    fn default() -> Self {
        Self {
            enabled: false,
            domain: 0,
            loopback_only: true,
            namespace: String::new(),
            node: "mr_slam".into(),
            velocity: VelocityMessage::Twist,
            relayed_topics_max: 256,
        }
    }
}

impl DdsConfig {
    /// Refuses values that cannot work.
    pub(crate) fn validate(&self) -> Result<(), ConfigError> {
        if self.domain > DOMAIN_MAX {
            return Err(ConfigError::new("dds.domain", self.domain.to_string(), "domains 0 to 232 exist"));
        }
        if self.relayed_topics_max > RELAYED_TOPICS_LIMIT {
            let value = self.relayed_topics_max.to_string();
            return Err(ConfigError::new("dds.relayed_topics_max", value, "0 to 1024 topics work"));
        }
        let parts = self.namespace.strip_prefix('/').map(|rest| rest.split('/'));
        let is_valid = self.namespace.is_empty() || parts.is_some_and(|mut parts| parts.all(is_name));
        if !is_valid {
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

/// The longest token of a ROS name that is accepted.
const NAME_MAX: usize = 128;

/// Returns whether a text is one token of a ROS name.
fn is_name(text: &str) -> bool {
    let rest = |c: char| c.is_ascii_alphanumeric() || c == '_';
    text.len() <= NAME_MAX && text.starts_with(|c: char| c.is_ascii_alphabetic()) && text.chars().all(rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn invalid_names_and_domains_are_refused() {
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
