//! Choice of a robot on the command line: by its number, or by its name in the fleet.

use crate::config::robots;
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
#[error("run {}: there is no robot `{found}`; this fleet has {robots}", run.display())]
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
        robots::find(&run.config, &self.0).ok_or_else(|| RobotChoiceError {
            run: run.dir.clone(),
            found: self.0.clone(),
            robots: robots::list(&run.config),
        })
    }
}
