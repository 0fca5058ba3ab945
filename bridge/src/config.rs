//! The settings of the bridge.

mod battery;
mod dds;
mod discovery;
mod https;
mod limits;
mod page;
mod velocity;

pub use battery::BatteryConfig;
pub use dds::{DdsConfig, VelocityMessage};
pub use discovery::{Discovery, DiscoveryError, DiscoveryVariables, OrEnvironment};
pub use https::HttpsConfig;
pub use limits::{ALLOCATOR_SETTINGS, ClientLimits};
pub use page::PageConfig;
pub use velocity::{LimitsOfRobot, VelocityConfig};

use crate::peer_address::{ADDRESSES_MAX, check_peer_address};
use crate::world::ClockOffset;
use ros_messages::OdometrySigmas;
use ros_messages::{Dialect, NameStyle};
use serde::{Deserialize, Serialize};
use std::net::IpAddr;
use std::time::Duration;
use thiserror::Error;

/// Who has a permission. Loopback has every permission, unless `trust_loopback` is off.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Permission {
    /// Everybody who reaches the port.
    Anyone,
    /// Loopback, the allow list, and the addresses that the operator allows while the fleet runs.
    Allowed,
}

/// The table `bridge` of the fleet file.
// More than 12 fields: one field for each key of one table of the fleet file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BridgeConfig {
    /// The longest payload that a client may send, bytes, at most half of `limits.held_bytes_max`: a message is held
    /// twice while it is passed on. A map of 4096 x 4096 cells has 16.8 million.
    pub frame_bytes_max: usize,
    /// Bytes that may wait for one slow client, besides the newest map and the frame that is being written.
    pub outbox_bytes_max: usize,
    /// Unsent bytes that the kernel may hold for one client. It is small because a message that waits in the bridge
    /// can still be replaced by a newer one, and a message in the kernel cannot.
    pub unsent_bytes_max: u32,
    /// Clients that may be connected at a time, 1 to 1024.
    pub clients_max: usize,
    /// Topics that all clients together may create, 0 to 65536; the same number of services.
    pub client_topics_max: usize,
    /// Bytes of latched messages on all topics of clients together, 0 to 1 GB.
    pub latched_bytes_max: usize,
    /// The ROS version that all clients were built for: it determines how payloads are encoded.
    pub payloads: Dialect,
    /// How frame names carry the robot: `base_link_1`, or `robot1/base_link`.
    pub frame_names: NameStyle,
    /// Your own ROS packages whose types clients may use.
    pub message_packages: Vec<String>,
    /// Who may subscribe to topics.
    pub watch: Permission,
    /// Who may publish to the fleet: velocities, selection, poses. Everybody may set the emergency stop.
    pub drive: Permission,
    /// Topics and services that every client may publish, offer or call in ROS, such as `/chat`; others need the
    /// permission to drive.
    pub open_topics: Vec<String>,
    /// Addresses on the allow list, which may watch and drive.
    pub allow: Vec<IpAddr>,
    /// Whether an address that the operator allows may drive in later runs too.
    pub remember: bool,
    /// Whether 127.0.0.1 and ::1 have every permission. Switch it off only to try permissions on one machine.
    pub trust_loopback: bool,
    /// How long a client holds a robot after its last moving velocity, seconds, 0.1 to 3600: others are refused meanwhile.
    pub lease_s: f64,
    /// Forward speed at full deflection of a thumb stick, m/s, above 0, at most 10.
    pub stick_linear_m_s: f64,
    /// Turning speed at full deflection of a thumb stick, rad/s, above 0, at most 20.
    pub stick_angular_rad_s: f64,
    /// Seconds that the clock of an external world is ahead of ours, -4e9 to 4e9, or `"measured"`.
    pub clock_offset: ClockOffset,
    /// How long a service call may wait for its response, seconds, 0.1 to 3600; then it fails.
    pub service_timeout_s: f64,
    /// Limits of what clients may hold and do.
    pub limits: ClientLimits,
    /// Limits of all velocities that the bridge sends. A velocity beyond them is clamped.
    pub velocity: VelocityConfig,
    /// When the operator is warned of a robot's battery.
    pub battery: BatteryConfig,
    /// The operator's page, and the Foxglove protocol.
    pub page: PageConfig,
    /// The ROS 2 endpoint.
    pub dds: DdsConfig,
    /// Errors of the robots' odometry, for its published covariances. They are those of `[slam.odometry]`.
    #[serde(skip)]
    pub odometry_sigmas: OdometrySigmas,
}

impl Default for BridgeConfig {
    fn default() -> Self {
        Self {
            frame_bytes_max: 32 << 20,
            outbox_bytes_max: 6 << 20,
            unsent_bytes_max: 16 << 10,
            clients_max: 64,
            client_topics_max: 1024,
            latched_bytes_max: 32 << 20,
            payloads: Dialect::Ros2,
            frame_names: NameStyle::Flat,
            message_packages: Vec::new(),
            watch: Permission::Anyone,
            drive: Permission::Allowed,
            open_topics: Vec::new(),
            allow: Vec::new(),
            remember: true,
            trust_loopback: true,
            lease_s: 1.0,
            stick_linear_m_s: 0.15,
            stick_angular_rad_s: 1.5,
            clock_offset: ClockOffset::Measured,
            service_timeout_s: 10.0,
            limits: ClientLimits::default(),
            velocity: VelocityConfig::default(),
            battery: BatteryConfig::default(),
            page: PageConfig::default(),
            dds: DdsConfig::default(),
            odometry_sigmas: OdometrySigmas::default(),
        }
    }
}

/// Why a configuration is refused.
#[derive(Clone, Debug, PartialEq, Error)]
#[error("bridge.{key} is {value}; expected {expected}")]
pub struct ConfigError {
    /// Path of the key below `bridge`, such as `velocity.robots[0].robot`.
    pub key: String,
    /// Value that was found.
    pub value: String,
    /// What was expected.
    pub expected: &'static str,
}

impl ConfigError {
    pub(crate) fn new(key: impl Into<String>, value: String, expected: &'static str) -> Self {
        Self { key: key.into(), value, expected }
    }
}

impl BridgeConfig {
    /// Refuses values that cannot work; the error names the key.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.dds.validate()?;
        self.battery.validate()?;
        self.page.validate()?;
        self.limits.validate()?;
        self.velocity.validate()?;
        self.validate_dds_access()?;
        self.validate_limits()?;
        self.validate_times()?;
        velocity::check_stick(self.stick_linear_m_s, self.stick_angular_rad_s)?;
        if let Some(index) = self.allow.iter().position(|address| check_peer_address(*address).is_err()) {
            let expected = "the address of one machine, such as 192.168.1.20: no client has an unspecified, multicast or \
                            broadcast address";
            return Err(ConfigError::new(format!("allow[{index}]"), self.allow[index].to_string(), expected));
        }
        if self.allow.len() > ADDRESSES_MAX {
            // As many as `ADDRESSES_MAX`.
            let expected = "1024 addresses at most";
            return Err(ConfigError::new("allow", format!("{} addresses", self.allow.len()), expected));
        }
        if let Some(name) =
            self.open_topics.iter().find(|name| ros_messages::interfaces::resolve_name(name).is_err())
        {
            let expected = "a topic's name such as /chat";
            return Err(ConfigError::new("open_topics", format!("'{name}'"), expected));
        }
        let packages = &self.message_packages;
        match packages.iter().find(|name| !ros_messages::interfaces::is_package_name(name)) {
            Some(package) => Err(ConfigError::new(
                "message_packages",
                format!("'{package}'"),
                "the name of a ROS package, such as my_robot_msgs",
            )),
            None => Ok(()),
        }
    }

    /// DDS carries ROS 2's encoding only, and cannot restrict who subscribes.
    fn validate_dds_access(&self) -> Result<(), ConfigError> {
        if self.dds.enabled && self.payloads != Dialect::Ros2 {
            return Err(ConfigError::new(
                "payloads",
                "ros1".into(),
                "\"ros2\", which ROS 2 (bridge.dds) needs",
            ));
        }
        if self.dds.enabled && !self.dds.is_loopback_only() && self.watch != Permission::Anyone {
            let expected = "anyone, or bridge.dds.loopback_only = true: DDS does not identify subscribers";
            return Err(ConfigError::new("watch", "allowed".into(), expected));
        }
        Ok(())
    }

    fn validate_limits(&self) -> Result<(), ConfigError> {
        let limits = [
            (
                "frame_bytes_max",
                self.frame_bytes_max,
                64 << 10,
                self.limits.held_bytes_max / 2,
                "65536 bytes to half of limits.held_bytes_max",
            ),
            ("outbox_bytes_max", self.outbox_bytes_max, 64 << 10, 64 << 20, "65536 to 67108864 bytes"),
            ("unsent_bytes_max", self.unsent_bytes_max as usize, 4 << 10, 16 << 20, "4096 to 16777216 bytes"),
            ("clients_max", self.clients_max, 1, 1024, "1 to 1024 clients"),
            ("latched_bytes_max", self.latched_bytes_max, 0, 1 << 30, "at most 1073741824 bytes"),
            ("client_topics_max", self.client_topics_max, 0, 65_536, "at most 65536 topics"),
        ];
        match limits.iter().find(|(_, value, low, high, _)| !(*low..=*high).contains(value)) {
            Some((key, value, _, _, expected)) => Err(ConfigError::new(*key, value.to_string(), expected)),
            None => Ok(()),
        }
    }

    fn validate_times(&self) -> Result<(), ConfigError> {
        let is_valid = |seconds: f64| seconds.is_finite() && (0.1..=3600.0).contains(&seconds);
        let times = [("lease_s", self.lease_s), ("service_timeout_s", self.service_timeout_s)];
        if let Some((key, value)) = times.into_iter().find(|(_, value)| !is_valid(*value)) {
            return Err(ConfigError::new(key, value.to_string(), "0.1 to 3600 seconds"));
        }
        match self.clock_offset {
            ClockOffset::Fixed(offset_s) if !(offset_s.is_finite() && offset_s.abs() <= 4e9) => {
                let expected = "\"measured\", or up to 4e9 seconds";
                Err(ConfigError::new("clock_offset", offset_s.to_string(), expected))
            }
            _ => Ok(()),
        }
    }

    /// Returns whether ROS 2 nodes may drive: those on this machine as on TCP, others only if anyone may.
    pub fn may_ros_drive(&self) -> bool {
        self.drive == Permission::Anyone || (self.dds.is_loopback_only() && self.trust_loopback)
    }

    /// Returns [`Self::lease_s`] as a duration.
    pub fn lease(&self) -> Duration {
        Duration::from_secs_f64(self.lease_s)
    }

    /// Returns [`Self::service_timeout_s`] as a duration.
    pub fn service_timeout(&self) -> Duration {
        Duration::from_secs_f64(self.service_timeout_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_valid_and_an_error_names_the_key() {
        let valid = BridgeConfig::default();
        assert_eq!(valid.validate(), Ok(()));
        let text = |config: BridgeConfig| config.validate().unwrap_err().to_string();
        assert!(
            text(BridgeConfig { frame_bytes_max: 3, ..valid.clone() })
                .contains("bridge.frame_bytes_max is 3")
        );
        assert!(text(BridgeConfig { lease_s: f64::NAN, ..valid.clone() }).contains("bridge.lease_s is NaN"));
        let packages = vec!["my-msgs".to_owned()];
        assert!(text(BridgeConfig { message_packages: packages, ..valid }).contains("'my-msgs'"));
        assert!(serde_json::from_str::<BridgeConfig>(r#"{"lease_seconds": 3}"#).is_err());
        let partial: BridgeConfig = serde_json::from_str(r#"{"frame_names": "slash"}"#).unwrap();
        assert_eq!(partial.frame_names, NameStyle::Slash);
    }
}
