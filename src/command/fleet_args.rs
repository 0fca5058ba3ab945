//! Options that describe a fleet, on top of its file.

use crate::config::{ConfigError, FleetConfig, Mode, RobotSource};
use std::path::PathBuf;

/// Fleet to start: its file, and options that override the file.
// More than 12 fields: each option is one.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct FleetArgs {
    /// Fleet file; other options override it
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Number of robots, 1 to 64 [default: 3]
    #[arg(long, value_name = "N")]
    pub robots: Option<usize>,
    /// Names of the robots in ROS, separated by commas; `--names ''` gives one robot plain names such as /scan
    /// [default: robot1,robot2,...]
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub names: Option<Vec<String>>,
    /// Seed of all random numbers [default: 1]
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Room: `laboratory`; `office`, `warehouse`, `school`, `museum`, `flat` or `hall`, generated from a seed as in `office:7`; or
    /// a map (.yaml of map_server), a scanned room (.json, .json.gz), .glb, .gltf, .obj [default: laboratory]
    #[arg(long, value_name = "NAME|FILE")]
    pub room: Option<String>,
    /// Source of robots, scans and time [default: simulator]
    #[arg(long, value_name = "WORLD", value_enum)]
    pub world: Option<RobotSource>,
    /// Whether merging knows where the robots start, or has to find out [default: known]
    #[arg(long, value_name = "HOW", value_enum)]
    pub starts: Option<Starts>,
    /// People who walk in the simulated room, 0 to 16 [default: 0]
    #[arg(long, value_name = "N")]
    pub people: Option<usize>,
    /// Doors of the simulated room that open and close, 0 to 16 [default: 0]
    #[arg(long, value_name = "N")]
    pub doors: Option<usize>,
    /// Boxes that are moved in the simulated room, 0 to 16 [default: 0]
    #[arg(long, value_name = "N")]
    pub boxes: Option<usize>,
    /// Let the robots explore by themselves
    #[arg(long)]
    pub explore: bool,
    /// Folder of sessions to begin with, such as runs/TIME/sessions; each robot is relocalized in its map
    #[arg(long, value_name = "DIR")]
    pub sessions: Option<PathBuf>,
    /// Leave the sessions' maps unchanged and estimate the robots' poses only
    #[arg(long)]
    pub localize: bool,
}

/// Knowledge of merging about the robots' starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Starts {
    /// Start of each robot's map
    Known,
    /// Nothing: merging finds the places by comparing maps
    Unknown,
}

impl FleetArgs {
    /// Returns the file's or the default configuration with the options applied.
    pub fn config(&self) -> Result<FleetConfig, ConfigError> {
        self.config_with(|_| {})
    }

    /// Returns the configuration with the options and another change applied; it is checked after them.
    pub fn config_with(&self, change: impl FnOnce(&mut FleetConfig)) -> Result<FleetConfig, ConfigError> {
        let apply = |config: &mut FleetConfig| {
            self.apply(config);
            change(config);
        };
        if let Some(path) = &self.config {
            return FleetConfig::from_file_with(path, apply);
        }
        let mut config = FleetConfig::default();
        apply(&mut config);
        config.check()?;
        Ok(config)
    }

    /// Options that were given and do nothing in this world: those of simulated robots elsewhere.
    pub fn unused_in(&self, world: RobotSource) -> Vec<&'static str> {
        let given = [
            ("--room", self.room.is_some()),
            ("--people", self.people.is_some()),
            ("--doors", self.doors.is_some()),
            ("--boxes", self.boxes.is_some()),
        ];
        let is_unused = |(_, is_given): &(&str, bool)| *is_given && world != RobotSource::Simulator;
        given.into_iter().filter(is_unused).map(|(option, _)| option).collect()
    }

    fn apply(&self, config: &mut FleetConfig) {
        let fleet = &mut config.fleet;
        if let Some(robots) = self.robots {
            // Fewer robots are the first ones of the file; poses and names for more are asked for by the check.
            fleet.starts.truncate(robots);
            fleet.names.truncate(robots);
            fleet.robots = robots;
        }
        if let Some(names) = &self.names {
            fleet.robots = self.robots.unwrap_or(names.len());
            fleet.names.clone_from(names);
        }
        config.world = self.world.unwrap_or(config.world);
        let moving = &mut config.sim.moving;
        moving.people = self.people.unwrap_or(moving.people);
        moving.doors = self.doors.unwrap_or(moving.doors);
        moving.boxes = self.boxes.unwrap_or(moving.boxes);
        // `--world ros` alone shall work: it enables ROS 2.
        config.bridge.dds.enabled |= self.world == Some(RobotSource::Ros);
        fleet.explore |= self.explore;
        fleet.seed = self.seed.unwrap_or(fleet.seed);
        fleet.starts_known = self.starts.map_or(fleet.starts_known, |starts| starts == Starts::Known);
        fleet.room = self.room.clone().unwrap_or(std::mem::take(&mut fleet.room));
        if let Some(folder) = &self.sessions {
            config.sessions.begin_with = std::path::absolute(folder).unwrap_or(folder.clone());
        }
        if self.localize {
            config.sessions.mode = Mode::Localization;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_number_of_robots_takes_the_first_starts_of_the_file_or_asks_for_more() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("fleet.toml");
        std::fs::write(&path, "[fleet]\nrobots = 2\nstarts = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]\n").unwrap();
        let config =
            |robots| FleetArgs { config: Some(path.clone()), robots, ..FleetArgs::default() }.config();
        assert_eq!(config(None).unwrap().fleet.starts.len(), 2);
        assert_eq!(config(Some(1)).unwrap().fleet.starts, [[0.0; 3]]);
        let said = config(Some(3)).unwrap_err().to_string();
        assert!(said.contains("2 poses for 3 robots"), "{said}");
    }

    #[test]
    fn options_of_simulated_robots_are_named_where_there_are_none() {
        let args = FleetArgs { people: Some(3), room: Some("office:7".into()), ..FleetArgs::default() };
        assert_eq!(args.unused_in(RobotSource::Headset), ["--room", "--people"]);
        assert!(args.unused_in(RobotSource::Simulator).is_empty());
        assert!(FleetArgs::default().unused_in(RobotSource::Ros).is_empty());
    }
}
