//! The settings of the ROS 2 endpoint.

use super::ConfigError;
use super::discovery::{DOMAIN_MAX, Discovery, OrEnvironment};
use crate::repeater::Repetition;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// The highest `relayed_topics_max`. RustDDS's cost of discovery grows with every reader and writer.
const RELAYED_TOPICS_LIMIT: usize = 1024;
/// The highest `relayed_services_max`, for the same reason.
const RELAYED_SERVICES_LIMIT: usize = 1024;

/// Type of velocities on DDS, where a topic is read and written by type.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VelocityMessage {
    /// geometry_msgs/Twist, without a stamp.
    #[default]
    Twist,
    /// geometry_msgs/TwistStamped, with stamp and frame.
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
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DdsConfig {
    /// Whether the fleet's topics are on DDS, for ROS 2.
    pub enabled: bool,
    /// Domain of the ROS 2 nodes to communicate with, 0 to 232; `"environment"`: ROS_DOMAIN_ID, or 0.
    pub domain: OrEnvironment<u16>,
    /// Whether to communicate with this machine alone. Otherwise everybody in the domain may watch, and may drive
    /// only if `bridge.drive` is `anyone`: DDS does not identify who publishes. `"environment"`: as
    /// ROS_AUTOMATIC_DISCOVERY_RANGE and ROS_LOCALHOST_ONLY say; without them this machine alone.
    pub loopback_only: OrEnvironment<bool>,
    /// Prefix of all topics but /tf, /tf_static and /clock: `/lab` makes `/lab/robot1/scan`.
    pub namespace: String,
    /// Name of the node in the ROS graph.
    pub node: String,
    /// Type of velocities on `/cmd_vel`, `/cmd_vel_N` and `/robotN/cmd_vel`: `twist`, `twist_stamped` (TurtleBots and Nav2
    /// may expect it from Jazzy on), or `either`, which reads and writes both.
    pub velocity: VelocityMessage,
    /// Rate at which the last transforms from `map` to `odom` are sent again, Hz; 0 to 200. 0: once for each scan. SLAM
    /// Toolbox has 50 (transform_publish_period 0.02). On TCP they are sent once for each scan, with its stamp.
    pub transform_rate_hz: f64,
    /// How far ahead of the time they are dated, seconds; 0 to 5. SLAM Toolbox has 0.2 (transform_timeout): tf2's readers
    /// need not wait for a transform that is on its way.
    pub transform_tolerance_s: f64,
    /// For how long they are sent again after SLAM's last answer, seconds; 0.1 to 60. 1 s bridges a few lost scans. While
    /// a robot is lost they are not sent.
    pub transform_hold_s: f64,
    /// Topics, besides the fleet's, that clients and ROS nodes may exchange at a time, 0 to 1024.
    pub relayed_topics_max: usize,
    /// Services, besides SLAM's, that clients may call in ROS or offer to it at a time, 0 to 1024.
    pub relayed_services_max: usize,
}

impl Default for DdsConfig {
    fn default() -> Self {
        Self {
            enabled: false,
            domain: OrEnvironment::Environment,
            loopback_only: OrEnvironment::Environment,
            namespace: String::new(),
            node: "mr_slam".into(),
            velocity: VelocityMessage::Twist,
            transform_rate_hz: 50.0,
            transform_tolerance_s: 0.2,
            transform_hold_s: 1.0,
            relayed_topics_max: 256,
            relayed_services_max: 128,
        }
    }
}

impl DdsConfig {
    /// Refuses values that cannot work.
    pub(crate) fn validate(&self) -> Result<(), ConfigError> {
        if self.domain() > DOMAIN_MAX {
            return Err(ConfigError::new("dds.domain", self.domain().to_string(), "0 to 232"));
        }
        if self.relayed_topics_max > RELAYED_TOPICS_LIMIT {
            let value = self.relayed_topics_max.to_string();
            return Err(ConfigError::new("dds.relayed_topics_max", value, "0 to 1024 topics"));
        }
        if self.relayed_services_max > RELAYED_SERVICES_LIMIT {
            let value = self.relayed_services_max.to_string();
            return Err(ConfigError::new("dds.relayed_services_max", value, "0 to 1024 services"));
        }
        let parts = self.namespace.strip_prefix('/').map(|rest| rest.split('/'));
        let is_valid = self.namespace.is_empty() || parts.is_some_and(|mut parts| parts.all(is_name));
        if !is_valid {
            let value = format!("'{}'", self.namespace);
            return Err(ConfigError::new("dds.namespace", value, "nothing, or a name like /lab"));
        }
        if !is_name(&self.node) {
            let value = format!("'{}'", self.node);
            return Err(ConfigError::new("dds.node", value, "letters, digits and underscores"));
        }
        self.validate_transforms()
    }

    fn validate_transforms(&self) -> Result<(), ConfigError> {
        let limits = [
            ("dds.transform_rate_hz", self.transform_rate_hz, 0.0..=200.0, "0 to 200 Hz"),
            ("dds.transform_tolerance_s", self.transform_tolerance_s, 0.0..=5.0, "0 to 5 seconds"),
            ("dds.transform_hold_s", self.transform_hold_s, 0.1..=60.0, "0.1 to 60 seconds"),
        ];
        for (key, value, range, expected) in limits {
            if !range.contains(&value) {
                return Err(ConfigError::new(key, value.to_string(), expected));
            }
        }
        Ok(())
    }
}

impl DdsConfig {
    /// Returns the domain; 0 if it is left to the environment and [`Self::set_discovery`] was not called.
    pub fn domain(&self) -> u16 {
        self.domain.value().unwrap_or(0)
    }

    /// Returns whether only nodes on this machine are found, as it is if that is left to the environment and
    /// [`Self::set_discovery`] was not called.
    pub fn is_loopback_only(&self) -> bool {
        self.loopback_only.value().unwrap_or(true)
    }

    /// Replaces what is left to the environment by what was decided.
    pub fn set_discovery(&mut self, discovery: &Discovery) {
        self.domain = discovery.domain.into();
        self.loopback_only = discovery.is_loopback_only.into();
    }

    /// Returns how transforms map -> odom are repeated.
    pub(crate) fn repetition(&self) -> Repetition {
        Repetition {
            tolerance: Duration::from_secs_f64(self.transform_tolerance_s),
            hold: Duration::from_secs_f64(self.transform_hold_s),
        }
    }

    /// Returns the time between two of them; `None` if they are not repeated.
    pub(crate) fn transform_period(&self) -> Option<Duration> {
        (self.transform_rate_hz > 0.0).then(|| Duration::from_secs_f64(1.0 / self.transform_rate_hz))
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
        assert!(with(|c| c.domain = 233.into()).is_err());
    }
}
