//! Choice of a robot on the command line: by its number, or by its name in the fleet.

use crate::config::FleetConfig;
use crate::run::Run;
use msg::RobotId;
use std::convert::Infallible;
use std::path::PathBuf;
use std::str::FromStr;

/// A robot as a person names it: `robot2`, `2`, or the name of the configuration, such as `alice`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RobotChoice(String);

/// The fleet has no such robot.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("run {}: there is no robot {found:?}; this fleet has {robots}", run.display())]
pub struct RobotChoiceError {
    /// Folder of the run.
    run: PathBuf,
    /// What was given.
    found: String,
    /// The fleet's robots.
    robots: String,
}

impl FromStr for RobotChoice {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(Self(text.into()))
    }
}

impl RobotChoice {
    /// Finds the robot in a running fleet.
    pub fn find(&self, run: &Run) -> Result<RobotId, RobotChoiceError> {
        self.find_in(&run.config).ok_or_else(|| RobotChoiceError {
            run: run.dir.clone(),
            found: self.0.clone(),
            robots: robots(&run.config),
        })
    }

    /// No robot has another's number as its name: the configuration refuses it.
    fn find_in(&self, config: &FleetConfig) -> Option<RobotId> {
        let mut all = RobotId::first(config.fleet.robots);
        let named = all.clone().find(|robot| config.robot_name(*robot) == self.0);
        named.or_else(|| {
            let number = self.0.strip_prefix("robot").unwrap_or(&self.0).parse().ok();
            all.find(|robot| number == Some(robot.number()))
        })
    }
}

/// Lists the robots, with the names that they have of their own.
fn robots(config: &FleetConfig) -> String {
    let count = config.fleet.robots;
    if config.fleet.names.is_empty() {
        return if count == 1 { "robot1 alone".into() } else { format!("robot1 to robot{count}") };
    }
    let own = |robot: RobotId| match config.robot_name(robot) {
        name if name == robot.to_string() => name,
        name => format!("{name} ({robot})"),
    };
    RobotId::first(count).map(own).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fleet(count: usize, names: &[&str]) -> FleetConfig {
        let mut config = FleetConfig::default();
        config.fleet.robots = count;
        config.fleet.names = names.iter().map(|name| String::from(*name)).collect();
        config
    }

    fn found(config: &FleetConfig, text: &str) -> Option<usize> {
        text.parse::<RobotChoice>().unwrap().find_in(config).map(RobotId::number)
    }

    #[test]
    fn a_robot_is_found_by_number_and_by_name() {
        let unnamed = fleet(2, &[]);
        for (text, number) in
            [("1", Some(1)), ("robot2", Some(2)), ("robot3", None), ("0", None), ("alice", None), ("", None)]
        {
            assert_eq!(found(&unnamed, text), number, "{text}");
        }
        let named = fleet(3, &["alice", "", "bob"]);
        for (text, number) in [
            ("alice", Some(1)),
            ("robot1", Some(1)),
            ("robot2", Some(2)),
            ("bob", Some(3)),
            ("3", Some(3)),
            ("Bob", None),
        ] {
            assert_eq!(found(&named, text), number, "{text}");
        }
        assert_eq!(robots(&named), "alice (robot1), robot2, bob (robot3)");
        assert_eq!(
            (robots(&unnamed), robots(&fleet(1, &[]))),
            ("robot1 to robot2".into(), "robot1 alone".into())
        );
    }
}
