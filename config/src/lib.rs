//! Configuration of a fleet: one TOML file, with a built-in default for every key.
//!
//! Errors name the file, the line and the reason: an unknown key, a wrong type, a value out of range. The file
//! `config/default.toml` lists every key with its default; it is generated from the types and their doc comments.

mod error;
mod link;
mod recording;
pub mod resources;
pub mod robots;
pub mod room;
mod sessions;

pub use error::{ConfigError, ValueError};
pub use link::{MachineLinkConfig, MachineLinkConfigError};
pub use recording::{RecordingConfig, RecordingConfigError};
pub use sessions::{Mode, SessionsConfig, SessionsConfigError};

use bridge::RobotNames;
use msg::{Pose2, ROBOTS_MAX, RobotId, Role};
use runtime::processes::{self, ProcessRow};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Configuration of a whole fleet. Keys that a file leaves out keep their default.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FleetConfig {
    /// Source of robots, scans and time: `simulator`, `headset` or `ros`.
    pub world: RobotSource,
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
    /// Recording of the fleet's messages.
    pub recording: RecordingConfig,
    /// Link between a base and robots on other machines.
    pub link: MachineLinkConfig,
    /// Real-time priority, locked memory and cores of the processes.
    pub realtime: runtime::realtime::RealtimeConfig,
}

impl Default for FleetConfig {
    /// Returns the configuration of three simulated TurtleBot3 Burgers.
    fn default() -> Self {
        Self {
            world: RobotSource::Simulator,
            fleet: Fleet::default(),
            sim: sim::SimConfig::default(),
            slam: burger_slam(),
            sessions: SessionsConfig::default(),
            merge: merge::MergeConfig::default(),
            bridge: bridge::BridgeConfig::default(),
            recording: RecordingConfig::default(),
            link: MachineLinkConfig::default(),
            realtime: runtime::realtime::RealtimeConfig::default(),
        }
    }
}

/// Source of robots, scans and time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum RobotSource {
    /// The built-in simulators, one for each robot.
    #[default]
    Simulator,
    /// A headset's application, which publishes scans, transforms and the clock over TCP
    Headset,
    /// Real robots or another simulator, over DDS
    Ros,
    /// Robots on other machines, which run their own SLAM; `mr-slam base` sets it
    #[value(skip)]
    Robots,
}

impl RobotSource {
    /// Returns whether the world is not simulated here.
    pub fn is_external(self) -> bool {
        self != Self::Simulator
    }
}

/// SLAM's configuration for recorded logs of unknown robots; the default of `replay` and of the benches on logs.
///
/// Nothing is known of these robots' wheels and gyroscopes. The odometry's standard deviations are therefore two to ten
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
    /// Seed of all random numbers, 0 to 9223372036854775807.
    pub seed: u64,
    /// Room of the simulators: `laboratory`; `office`, `warehouse`, `school`, `museum`, `flat` or `hall`, generated from a
    /// seed as in `office:7`; the path of a map as map_saver writes it (.yaml), whose coordinates are then those of the
    /// room; or of a scanned room (.json, .json.gz; also MRUK's), .glb, .gltf or .obj. A relative path begins in the folder
    /// in which the program is started.
    pub room: String,
    /// Starts of the robots in the room, or in `map` if the world is not simulated: `[x, y, yaw]` in metres and radians,
    /// one for each robot. Empty: places are chosen, or, if the world is not simulated, all but the first are unknown.
    pub starts: Vec<[f64; 3]>,
    /// Whether merging knows the robots' starts. If not, `map` is the map of the first robot that sends one, and the
    /// others join it when comparing maps has shown where they lie. When a larger group is joined, `map` is the map of
    /// that group's first robot; a group that was connected to `map` keeps it.
    pub starts_known: bool,
    /// Whether the furniture that a room's file names, such as tables and beds, keeps robots out of its outline on the
    /// floor: as exclusion zones from the start. Simulated robots whose starts are known.
    pub furniture_zones: bool,
    /// Whether the robots explore by themselves from the start, as `mr-slam explore` lets them.
    pub explore: bool,
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
            furniture_zones: true,
            explore: false,
            port: 10_000,
            address: "0.0.0.0".into(),
        }
    }
}

impl Fleet {
    fn check(&self) -> Result<(), ValueError> {
        let robots = self.robots;
        if !(1..=ROBOTS_MAX).contains(&robots) {
            return Err(ValueError::Robots(robots));
        }
        if !self.starts.is_empty() && self.starts.len() != robots {
            return Err(ValueError::StartsCount { starts: self.starts.len(), robots });
        }
        if self.seed > SEED_MAX {
            return Err(ValueError::Seed(self.seed));
        }
        for (index, start) in self.starts.iter().enumerate() {
            let is_place = start[..2].iter().all(|m| m.abs() <= START_MAX_M);
            let is_pose = is_place && start[2].abs() <= msg::pose::YAW_MAX_RAD;
            if !is_pose {
                return Err(ValueError::Start { index, start: *start });
            }
        }
        if !self.names.is_empty() {
            if self.names.len() != robots {
                return Err(ValueError::NamesCount { names: self.names.len(), robots });
            }
            RobotNames::new(self.names.clone())?;
        }
        match self.address.parse::<std::net::IpAddr>() {
            Ok(_) => Ok(()),
            Err(_) => Err(ValueError::Address(self.address.clone())),
        }
    }
}

/// Largest seed: the largest integer of TOML.
const SEED_MAX: u64 = i64::MAX as u64;

/// Largest coordinate of a start, metres: no building is larger, and millimetres are.
pub(crate) const START_MAX_M: f64 = 1000.0;

/// Largest size of a fleet file, bytes: the default with its explanations has 30 kB.
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
                Err(error.locate(path, &text))
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Parses and checks a file's text; `path` is for errors.
    pub fn from_text(path: &Path, text: &str) -> Result<Self, ConfigError> {
        let config = Self::parse(path, text)?;
        config.check().map_err(|error| error.locate(path, text))?;
        Ok(config)
    }

    /// Parses a file's text over the default.
    fn parse(path: &Path, text: &str) -> Result<Self, ConfigError> {
        let wrong = |why: toml::de::Error| {
            let byte = why.span().map_or(0, |span| span.start);
            let (line, setting) = (error::line_of(text, byte), error::setting_at(text, byte));
            ConfigError::Syntax { path: path.into(), line, setting, why: why.into() }
        };
        // Parsed alone first, since its errors have lines; then laid over the default, table by table.
        toml::from_str::<Self>(text).map_err(wrong)?;
        // By way of text: each other way into and out of tables would be as much code again, some 0.3 MB.
        let mut whole: toml::Table = Self::default().to_toml().parse().map_err(wrong)?;
        overlay(&mut whole, text.parse().map_err(wrong)?);
        toml::from_str(&whole.to_string()).map_err(wrong)
    }

    /// Checks ranges and keys that depend on each other.
    pub fn check(&self) -> Result<(), ValueError> {
        self.fleet.check()?;
        if self.world == RobotSource::Ros && !self.bridge.dds.enabled {
            return Err(ValueError::RosWithoutDds);
        }
        self.sim.validate()?;
        self.slam.validate()?;
        self.sessions.validate()?;
        self.merge.validate()?;
        self.bridge.validate()?;
        self.check_robots_of_limits()?;
        self.recording.validate()?;
        self.link.validate()?;
        self.realtime.validate()?;
        self.check_text()
    }

    /// Refuses what a file does not give back: a fleet's processes read their configuration from the run's file.
    fn check_text(&self) -> Result<(), ValueError> {
        let text = toml::to_string_pretty(self).map_err(|why| ValueError::NotWritable(why.to_string()))?;
        match toml::from_str::<Self>(&text) {
            Ok(read) if read == *self => Ok(()),
            Ok(_) => Err(ValueError::NotWritable("a value changes when it is written and read again".into())),
            Err(why) => Err(ValueError::NotWritable(why.to_string())),
        }
    }

    /// Refuses limits of a robot that the fleet does not have: the one that is meant would keep the fleet's.
    fn check_robots_of_limits(&self) -> Result<(), ValueError> {
        let robots = self.fleet.robots;
        match self.bridge.velocity.robots.iter().position(|limits| limits.robot > robots) {
            Some(index) => {
                let robot = self.bridge.velocity.robots[index].robot;
                Err(ValueError::LimitsOfNoRobot { index, robot, robots })
            }
            None => Ok(()),
        }
    }

    /// Returns every process of the fleet with its row of the table, in the order in which they are started.
    pub fn processes(&self) -> impl Iterator<Item = (&'static ProcessRow, Option<RobotId>)> + use<> {
        // Robots on other machines have their SLAM there.
        let has_slam = self.world != RobotSource::Robots;
        let (external, moving) = (self.world.is_external(), self.sim.moving.is_any());
        processes::of_fleet(self.fleet.robots, external, self.recording.enabled, moving)
            .filter(move |(row, _)| has_slam || row.role != Role::Slam)
    }

    /// Returns the room's name, or the source of the world, for people.
    pub fn world_name(&self) -> &str {
        match self.world {
            RobotSource::Simulator => room::name_for_people(&self.fleet.room),
            RobotSource::Headset => "the world of a headset",
            RobotSource::Ros => "a world over ROS 2",
            RobotSource::Robots => "the rooms of other machines",
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
        let mut config = bridge::BridgeConfig { odometry_sigmas, ..self.bridge.clone() };
        if self.world == RobotSource::Simulator {
            // What the simulator would clamp, nobody is told to be the robot's velocity.
            let sim::Limits { linear_m_s, angular_rad_s, .. } = self.sim.limits;
            config.velocity.cap(linear_m_s, angular_rad_s);
        }
        config
    }

    /// Returns the robots' names in ROS, of a configuration that was checked.
    pub fn robot_names(&self) -> RobotNames {
        RobotNames::new(self.fleet.names.clone()).unwrap_or_else(|_| self.fleet.robots.into())
    }

    /// Returns a robot's name for people and on links between machines: `robot1` where it has none of its own.
    pub fn robot_name(&self, robot: RobotId) -> String {
        let own = self.fleet.names.get(robot.index()).filter(|name| !name.is_empty());
        own.cloned().unwrap_or_else(|| robot.to_string())
    }

    /// Returns the configured starts in `world`; `None` if they are to be chosen.
    pub fn configured_starts(&self) -> Option<Vec<Pose2>> {
        let starts = &self.fleet.starts;
        (!starts.is_empty()).then(|| starts.iter().map(|[x, y, yaw]| Pose2::new(*x, *y, *yaw)).collect())
    }

    /// Takes the robots' starts in the room: x and y in metres and yaw in radians of each robot. Returns false, and changes nothing, if they
    /// are not as many as the robots, or not permitted.
    pub fn set_starts(&mut self, starts: Vec<[f64; 3]>) -> bool {
        if starts.len() != self.fleet.robots {
            return false;
        }
        let before = std::mem::replace(&mut self.fleet.starts, starts);
        let is_sound = self.fleet.check().is_ok();
        if !is_sound {
            self.fleet.starts = before;
        }
        is_sound
    }

    /// Formats the configuration as a file with every key. A configuration that [`Self::check`] refuses may give a text that
    /// is no TOML.
    pub fn to_toml(&self) -> String {
        toml::to_string_pretty(self).unwrap_or_else(|why| format!("cannot be written: {why}\n"))
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
