//! One file describes one whole fleet; the default is built in.
//!
//! Whatever is wrong with a file is refused with the file, the line and the reason: a name that
//! nobody knows, a number out of range, a room that is not there.

use crate::realtime::RealtimeConfig;
use crate::sessions::SessionsConfig;
use msg::{Pose2, ROBOTS_MAX};
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::{Path, PathBuf};

/// Why a fleet file was refused.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// It cannot be read.
    #[error("{path}: {why}")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        why: std::io::Error,
    },
    /// It is not what it should be.
    #[error("{path}:{line}: {why}")]
    Wrong {
        /// The file.
        path: PathBuf,
        /// From 1.
        line: usize,
        /// What is wrong, and what was expected.
        why: String,
    },
    /// The value of an option or a field is out of its range.
    #[error("{field}: {why}")]
    Value {
        /// Which, as the file calls it.
        field: &'static str,
        /// What was expected.
        why: String,
    },
}

/// A whole fleet. A file need not say all: what it leaves out is as in the default.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FleetConfig {
    /// Where robots, scans and time come from.
    pub world: World,
    /// How many, and where.
    pub fleet: Fleet,
    /// The simulated robot.
    pub sim: sim::SimConfig,
    /// Each robot's mapping.
    pub slam: slam::SlamConfig,
    /// What is kept of it, and what it begins with.
    pub sessions: SessionsConfig,
    /// The fleet's map.
    pub merge: merge::MergeConfig,
    /// The doors.
    pub bridge: bridge::BridgeConfig,
    /// What processes ask of the machine.
    pub realtime: RealtimeConfig,
}

impl Default for FleetConfig {
    /// Three TurtleBot3 Burgers.
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

/// Where robots, scans and time come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum World {
    /// Simulators of ours.
    #[default]
    Simulator,
    /// A headset's application: over TCP it publishes its robots' scans and transforms, and the clock.
    Headset,
    /// Real robots, or a simulator of theirs: over DDS.
    Ros,
}

impl World {
    /// Not simulated here.
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

/// How many robots, and where.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Fleet {
    /// 1 to 16.
    pub robots: usize,
    /// Seed of all noise.
    pub seed: u64,
    /// `laboratory`, or a file: a scanned room (.json, .json.gz), .glb, .gltf or .obj. For simulators.
    pub room: String,
    /// Where robots start in the room, or in `map` where the world is not simulated: `[x, y, yaw]` in metres
    /// and radians, one for each robot; none: places are chosen, or unknown but for the first.
    pub starts: Vec<[f64; 3]>,
    /// Whether merging is told where robots start. If not, `map` is the first robot's map, and the others join it when
    /// their maps show where they lie.
    pub starts_known: bool,
    /// TCP port for headsets; 0: any that is free.
    pub port: u16,
    /// Address to listen on. `127.0.0.1` keeps others out.
    pub address: String,
}

impl Default for Fleet {
    fn default() -> Self {
        Self {
            robots: 3,
            seed: 1,
            room: LABORATORY.into(),
            starts: Vec::new(),
            starts_known: true,
            port: 10_000,
            address: "0.0.0.0".into(),
        }
    }
}

/// The room that is built in.
pub const LABORATORY: &str = "laboratory";

impl FleetConfig {
    /// Reads and checks a fleet file.
    pub fn from_file(path: &Path) -> Result<Self, ConfigError> {
        let text =
            fs::read_to_string(path).map_err(|why| ConfigError::Unreadable { path: path.into(), why })?;
        Self::from_text(path, &text)
    }

    /// The same from a file's text; `path` is for errors.
    pub fn from_text(path: &Path, text: &str) -> Result<Self, ConfigError> {
        let wrong = |error: toml::de::Error| ConfigError::Wrong {
            path: path.into(),
            line: line_of(text, error.span().map_or(0, |span| span.start)),
            why: error.message().to_string(),
        };
        // By itself first: its errors have lines. Then over the default, table by table.
        toml::from_str::<Self>(text).map_err(wrong)?;
        let mut whole = toml::Table::try_from(Self::default()).unwrap_or_default();
        overlay(&mut whole, text.parse().map_err(wrong)?);
        let config: Self = whole.try_into().map_err(wrong)?;
        config.check().map_err(|error| locate(path, text, error))?;
        Ok(config)
    }

    /// Checks what the types cannot say.
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
        if fleet.address.parse::<std::net::IpAddr>().is_err() {
            let why = format!("`{}` is not an IP address, such as 0.0.0.0 or 127.0.0.1", fleet.address);
            return Err(ConfigError::Value { field: "fleet.address", why });
        }
        if self.world == World::Ros && !self.bridge.dds.enabled {
            let why = "`ros` needs the ROS 2 door: bridge.dds.enabled = true, or --ros-domain ID".into();
            return Err(ConfigError::Value { field: "world", why });
        }
        let rooms = [
            ("sim", self.sim.validate().map_err(|error| error.to_string())),
            ("slam", self.slam.validate().map_err(|error| error.to_string())),
            ("sessions", self.sessions.validate()),
            ("merge", self.merge.validate().map_err(|error| error.to_string())),
            ("bridge", self.bridge.validate().map_err(|error| error.to_string())),
            ("realtime", self.realtime.validate()),
        ];
        rooms
            .into_iter()
            .try_for_each(|(field, checked)| checked.map_err(|why| ConfigError::Value { field, why }))
    }

    /// The room, or whose world it is, for people.
    pub fn world_name(&self) -> &str {
        match self.world {
            World::Simulator => &self.fleet.room,
            World::Headset => "a headset's world",
            World::Ros => "a world of ROS's",
        }
    }

    /// The configured start poses, `world` from each robot's start; `None`: to be chosen.
    pub fn configured_starts(&self) -> Option<Vec<Pose2>> {
        let starts = &self.fleet.starts;
        (!starts.is_empty()).then(|| starts.iter().map(|[x, y, yaw]| Pose2::new(*x, *y, *yaw)).collect())
    }

    /// The file that would say the same.
    pub fn to_toml(&self) -> String {
        toml::to_string_pretty(self).unwrap_or_else(|why| format!("# cannot be written: {why}\n"))
    }
}

/// Puts what `over` says in place of what `base` says; tables are gone into.
fn overlay(base: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (base.get_mut(&key), value) {
            (Some(toml::Value::Table(below)), toml::Value::Table(above)) => overlay(below, above),
            (_, value) => drop(base.insert(key, value)),
        }
    }
}

/// The line, from 1, on which a byte of the text lies.
fn line_of(text: &str, byte: usize) -> usize {
    1 + text.as_bytes()[..byte.min(text.len())].iter().filter(|b| **b == b'\n').count()
}

/// Gives a value's error the line on which the file sets it, or its section begins.
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
