//! Configuration of a fleet: one TOML file, with a built-in default for every key.
//!
//! Errors name the file, the line and the reason: an unknown key, a wrong type, a value out of range. The file
//! `config/default.toml` lists every key with its default; it is generated from the types and their doc comments.

mod sessions;

pub use sessions::{Mode, SessionsConfig};

use crate::processes::{self, ProcessRow};
use crate::realtime::RealtimeConfig;
use bridge::RobotNames;
use msg::{Pose2, ROBOTS_MAX, RobotId};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Reason why a configuration was refused.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{path}: {why}")]
    Unreadable {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        why: std::io::Error,
    },
    /// The file is no TOML, has an unknown key or a value out of range.
    #[error("{path}:{line}: {why}")]
    Wrong {
        /// Path of the file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// Text that was found, and what was expected.
        why: String,
    },
    /// A value of the configuration or of an option is out of range.
    #[error("{field}: {why}")]
    Value {
        /// Key of the value, such as `fleet.robots`.
        field: &'static str,
        /// Value that was found, and what was expected.
        why: String,
    },
}

/// Configuration of a whole fleet. Keys that a file leaves out keep their default.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FleetConfig {
    /// Source of robots, scans and time: `simulator`, `headset` or `ros`.
    pub world: World,
    /// Robots, their room and their starts, and the TCP port.
    pub fleet: Fleet,
    /// Simulated robot: LiDAR, noise and speed limits of a TurtleBot3 Burger.
    pub sim: sim::SimConfig,
    /// SLAM of each robot.
    pub slam: slam::SlamConfig,
    /// Session files: what SLAM begins with and how often it saves.
    pub sessions: SessionsConfig,
    /// Merging of the robots' maps.
    pub merge: merge::MergeConfig,
    /// Bridge to headsets (ros_tcp) and to ROS 2 (DDS).
    pub bridge: bridge::BridgeConfig,
    /// Real-time priority, locked memory and cores of the processes.
    pub realtime: RealtimeConfig,
}

impl Default for FleetConfig {
    /// Returns the configuration of three simulated TurtleBot3 Burgers.
    fn default() -> Self {
        Self {
            world: World::Simulator,
            fleet: Fleet::default(),
            sim: sim::SimConfig::default(),
            slam: burger_slam(),
            sessions: SessionsConfig::default(),
            merge: merge::MergeConfig::default(),
            bridge: bridge::BridgeConfig::default(),
            realtime: RealtimeConfig::default(),
        }
    }
}

/// Source of robots, scans and time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum World {
    /// The built-in simulators, one for each robot.
    #[default]
    Simulator,
    /// A headset's application, which publishes scans, transforms and the clock over TCP
    Headset,
    /// Real robots or another simulator, over DDS
    Ros,
}

impl World {
    /// Returns whether the world is not simulated here.
    pub fn is_outside(self) -> bool {
        self != Self::Simulator
    }
}

/// SLAM's configuration for recorded logs of unknown robots; the default of `replay` and of the benches on logs.
///
/// Nothing is known of these robots' wheels and gyroscopes. The odometry's standard deviations are therefore two to six
/// times those of [`burger_slam`]: 0.1 m per metre driven, 0.2 rad per radian turned and 0.06 rad per metre driven. With
/// the TurtleBot3's values, odometry that is worse would outweigh the scans.
pub fn recorded_log_slam() -> slam::SlamConfig {
    slam::SlamConfig::default()
}

/// SLAM's configuration for the simulated TurtleBot3 Burger; the default of a fleet.
///
/// The pose of its LiDAR, its radius and its speeds are known (ROBOTIS e-Manual). Its heading comes from a gyroscope, so
/// that 0.02 rad per radian turned and 0.01 rad per metre driven hold; slip makes 0.05 m per metre driven.
pub fn burger_slam() -> slam::SlamConfig {
    let [x_m, y_m, _] = sim::burger::SCAN_IN_BASE_LINK_M;
    let mut config = slam::SlamConfig::default();
    config.lidar.base_from_scan = [x_m, y_m, 0.0];
    config.map.robot_radius_m = sim::burger::ROBOT_RADIUS_M;
    config.odometry = slam::OdometryConfig {
        sigma_m: 0.01,
        sigma_m_per_m: 0.05,
        sigma_rad: 0.003,
        sigma_rad_per_rad: 0.02,
        sigma_rad_per_m: 0.01,
        speed_max_m_s: 0.3,
        turn_max_rad_s: 2.0,
        ..config.odometry
    };
    config
}

/// Robots, their room and their starts, and the TCP port.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Fleet {
    /// Number of robots, 1 to 64.
    pub robots: usize,
    /// Names of the robots in ROS, one for each robot, such as `["alice", "lab/bob"]`: topics `/alice/scan`, frames
    /// `odom_alice`. Empty: `robot1`, `robot2` and so on. `[""]`, for one robot: plain `/scan`, `odom`, `base_footprint`.
    pub names: Vec<String>,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Room of the simulators: `laboratory`, or the path of a scanned room (.json, .json.gz), .glb, .gltf or .obj.
    pub room: String,
    /// Starts of the robots in the room, or in `map` if the world is not simulated: `[x, y, yaw]` in metres and radians,
    /// one for each robot. Empty: places are chosen, or, if the world is not simulated, all but the first are unknown.
    pub starts: Vec<[f64; 3]>,
    /// Whether merging knows the robots' starts. If not, `map` is the first robot's map, and the others join it when
    /// comparing maps has shown where they lie.
    pub starts_known: bool,
    /// TCP port for headsets, 1 to 65535; 0: any free port. 10000 is the default of ROS-TCP-Connector.
    pub port: u16,
    /// IP address to listen on. `0.0.0.0`: all networks; `127.0.0.1`: this machine alone.
    pub address: String,
}

impl Default for Fleet {
    fn default() -> Self {
        Self {
            robots: 3,
            names: Vec::new(),
            seed: 1,
            room: LABORATORY.into(),
            starts: Vec::new(),
            starts_known: true,
            port: 10_000,
            address: "0.0.0.0".into(),
        }
    }
}

/// Largest size of a fleet file, bytes: the default with its explanations has 60 kB.
const FILE_BYTES_MAX: u64 = 1 << 20;

/// Name of the built-in room.
pub const LABORATORY: &str = "laboratory";

impl FleetConfig {
    /// Reads and checks a file.
    pub fn from_file(path: &Path) -> Result<Self, ConfigError> {
        Self::from_file_with(path, |_| {})
    }

    /// Reads a file, changes it as options say, and checks the result.
    pub fn from_file_with(path: &Path, change: impl FnOnce(&mut Self)) -> Result<Self, ConfigError> {
        let text = formats::limited::read_text(path, FILE_BYTES_MAX)
            .map_err(|why| ConfigError::Unreadable { path: path.into(), why })?;
        let mut config = Self::parse(path, &text)?;
        let of_file = config.check();
        change(&mut config);
        match config.check() {
            Ok(()) => Ok(config),
            // What the file alone has wrong too is reported at its line.
            Err(error) if of_file.is_err_and(|of_file| of_file.to_string() == error.to_string()) => {
                Err(locate(path, &text, error))
            }
            Err(error) => Err(error),
        }
    }

    /// Parses and checks a file's text; `path` is for errors.
    pub fn from_text(path: &Path, text: &str) -> Result<Self, ConfigError> {
        let config = Self::parse(path, text)?;
        config.check().map_err(|error| locate(path, text, error))?;
        Ok(config)
    }

    /// Parses a file's text over the default.
    fn parse(path: &Path, text: &str) -> Result<Self, ConfigError> {
        let wrong = |error: toml::de::Error| ConfigError::Wrong {
            path: path.into(),
            line: line_of(text, error.span().map_or(0, |span| span.start)),
            why: error.message().to_string(),
        };
        // Parsed alone first, since its errors have lines; then laid over the default, table by table.
        toml::from_str::<Self>(text).map_err(wrong)?;
        let mut whole = toml::Table::try_from(Self::default()).unwrap_or_default();
        overlay(&mut whole, text.parse().map_err(wrong)?);
        whole.try_into().map_err(wrong)
    }

    /// Checks ranges and keys that depend on each other.
    pub fn check(&self) -> Result<(), ConfigError> {
        let fleet = &self.fleet;
        if !(1..=ROBOTS_MAX).contains(&fleet.robots) {
            let why = format!("{} robots; a fleet has 1 to {ROBOTS_MAX}", fleet.robots);
            return Err(ConfigError::Value { field: "fleet.robots", why });
        }
        if !fleet.starts.is_empty() && fleet.starts.len() != fleet.robots {
            let why = format!(
                "{} poses for {} robots; give one for each, or none",
                fleet.starts.len(),
                fleet.robots
            );
            return Err(ConfigError::Value { field: "fleet.starts", why });
        }
        if let Some(start) = fleet.starts.iter().find(|start| start.iter().any(|v| !v.is_finite())) {
            let why = format!("{start:?} is not a pose; expected [x, y, yaw], finite");
            return Err(ConfigError::Value { field: "fleet.starts", why });
        }
        if !fleet.names.is_empty() {
            let wrong = |why| ConfigError::Value { field: "fleet.names", why };
            if fleet.names.len() != fleet.robots {
                let (names, robots) = (fleet.names.len(), fleet.robots);
                return Err(wrong(format!("{names} names for {robots} robots; give one for each, or none")));
            }
            RobotNames::new(fleet.names.clone()).map_err(|why| wrong(why.to_string()))?;
        }
        if fleet.address.parse::<std::net::IpAddr>().is_err() {
            let why = format!("`{}` is not an IP address, such as 0.0.0.0 or 127.0.0.1", fleet.address);
            return Err(ConfigError::Value { field: "fleet.address", why });
        }
        if self.world == World::Ros && !self.bridge.dds.enabled {
            let why = "`ros` needs ROS 2: set bridge.dds.enabled = true, or give --ros-domain ID".into();
            return Err(ConfigError::Value { field: "world", why });
        }
        let sections = [
            ("sim", self.sim.validate().map_err(|error| error.to_string())),
            ("slam", self.slam.validate().map_err(|error| error.to_string())),
            ("sessions", self.sessions.validate()),
            ("merge", self.merge.validate().map_err(|error| error.to_string())),
            ("bridge", self.bridge.validate().map_err(|error| error.to_string())),
            ("realtime", self.realtime.validate()),
        ];
        sections
            .into_iter()
            .try_for_each(|(field, checked)| checked.map_err(|why| ConfigError::Value { field, why }))
    }

    /// Returns every process of the fleet with its row of the table, in the order in which they are started.
    pub fn processes(&self) -> impl Iterator<Item = (&'static ProcessRow, Option<RobotId>)> + use<> {
        processes::of_fleet(self.fleet.robots, self.world.is_outside())
    }

    /// Returns the room's name, or the source of the world, for people.
    pub fn world_name(&self) -> &str {
        match self.world {
            World::Simulator => &self.fleet.room,
            World::Headset => "the world of a headset",
            World::Ros => "a world over ROS 2",
        }
    }

    /// Returns the bridge's settings with what it needs of the others.
    pub fn bridge_config(&self) -> bridge::BridgeConfig {
        let odometry = &self.slam.odometry;
        let odometry_sigmas = bridge::OdometrySigmas {
            m_per_m: odometry.sigma_m_per_m,
            rad_per_rad: odometry.sigma_rad_per_rad,
            rad_per_m: odometry.sigma_rad_per_m,
        };
        bridge::BridgeConfig { odometry_sigmas, ..self.bridge.clone() }
    }

    /// Returns the robots' names in ROS, of a configuration that was checked.
    pub fn robot_names(&self) -> RobotNames {
        RobotNames::new(self.fleet.names.clone()).unwrap_or_else(|_| self.fleet.robots.into())
    }

    /// Returns the configured starts in `world`; `None` if they are to be chosen.
    pub fn configured_starts(&self) -> Option<Vec<Pose2>> {
        let starts = &self.fleet.starts;
        (!starts.is_empty()).then(|| starts.iter().map(|[x, y, yaw]| Pose2::new(*x, *y, *yaw)).collect())
    }

    /// Formats the configuration as a file with every key.
    pub fn to_toml(&self) -> String {
        toml::to_string_pretty(self).unwrap_or_else(|why| format!("# cannot be written: {why}\n"))
    }
}

/// Replaces values of `base` by those of `over`, table by table.
fn overlay(base: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (base.get_mut(&key), value) {
            (Some(toml::Value::Table(below)), toml::Value::Table(above)) => overlay(below, above),
            (_, value) => drop(base.insert(key, value)),
        }
    }
}

/// Returns the line number, from 1, of a byte of the text.
fn line_of(text: &str, byte: usize) -> usize {
    1 + text.as_bytes()[..byte.min(text.len())].iter().filter(|b| **b == b'\n').count()
}

/// Adds to an error the line on which the file sets the value, or on which its section begins.
fn locate(path: &Path, text: &str, error: ConfigError) -> ConfigError {
    let ConfigError::Value { field, why } = error else { return error };
    let (section, key) = field.split_once('.').unwrap_or((field, ""));
    let header = text.lines().position(|line| line.trim().starts_with(&format!("[{section}")));
    let key_line = header.and_then(|start| {
        let sets = |line: &str| !key.is_empty() && line.trim_start().starts_with(key);
        Some(start + text.lines().skip(start).position(sets)?)
    });
    let line = key_line.or(header).map_or(1, |index| index + 1);
    ConfigError::Wrong { path: path.into(), line, why: format!("{field}: {why}") }
}
