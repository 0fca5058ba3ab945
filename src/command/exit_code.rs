//! Exit codes: which errors mean that the command line is wrong, and which that the tool failed.

use super::Error;
use super::edges::EdgesError;
use super::explore::ExploreError;
use super::goto::GotoError;
use super::link::LinkArgsError;
use super::merge::MergeMapsError;
use super::permissions::PermissionError;
use super::replay::ReplayError;
use super::room::RoomCommandError;
use super::slam::SlamCommandError;
use super::status::StatusError;
use super::up::UpError;
use super::zone::ZoneToolError;
use crate::config::room::RoomLoadError;
use crate::config::{ConfigError, RecordingConfigError};
use crate::run::RunError;
use crate::world::WorldError;
use ::operator::OperatorError;
use headset::wireless::LinkError;
use link_transport::EndpointError;
use link_transport::keys::KeysError;

/// Exit code of a tool that failed.
const FAILED: u8 = 1;
/// Exit code of a tool that refused its command line; clap has it, too.
const USAGE: u8 = 2;
/// Exit code of a tool that has neither done what it was told nor failed.
const UNDONE: u8 = 3;

/// The command line asks for something that cannot be done, which is known before anything is begun.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct UsageError(pub String);

/// Returns the exit code of a tool that ended with an error.
pub fn exit_code(error: &Error) -> u8 {
    let is_nothing_to_stop = is(error, PermissionError::is_nothing_to_stop);
    if is_nothing_to_stop || is(error, |why| matches!(why, UpError::SlowStart { .. })) {
        return UNDONE;
    }
    // The fleet in the background has refused the same words.
    let is_refused_in_background = is(error, |why| match why {
        UpError::Background { code, .. } => *code == Some(i32::from(USAGE)),
        _ => false,
    });
    if is_refused_in_background || is_usage(error) || is_usage_of_fleet_tool(error) { USAGE } else { FAILED }
}

/// Returns whether an error is of this type, and as `wanted` says.
fn is<E: std::error::Error + 'static>(error: &Error, wanted: impl Fn(&E) -> bool) -> bool {
    error.downcast_ref().is_some_and(wanted)
}

/// Returns whether a tool that needs no running fleet has refused its command line, or a file that it names as its input.
fn is_usage(error: &Error) -> bool {
    is(error, |_: &UsageError| true)
        || is(error, |_: &ConfigError| true)
        || is(error, |_: &RecordingConfigError| true)
        || is(error, |_: &RoomLoadError| true)
        || is(error, |_: &WorldError| true)
        || is(error, |_: &LinkError| true)
        || is(error, |_: &EndpointError| true)
        || is(error, |why| matches!(why, KeysError::Name(_)))
        || is(error, |why| matches!(why, OperatorError::Argument { .. } | OperatorError::Names(_)))
        || is(error, |why| !matches!(why, LinkArgsError::NotBuilt | LinkArgsError::Panic))
        || is(error, |why| match why {
            UpError::Config(_) | UpError::World(_) | UpError::Certificate(_) => true,
            UpError::Run(why) => is_usage_of_run(why),
            _ => false,
        })
        || is(error, |why| match why {
            MergeMapsError::Input(_) | MergeMapsError::Refused { .. } => true,
            MergeMapsError::Overwrites { .. } | MergeMapsError::TooMany(_) => true,
            MergeMapsError::Output(why) => is_usage_of_run(why),
            _ => false,
        })
        || is(error, ReplayError::is_usage)
}

/// Returns whether a tool of a running fleet has refused its command line.
fn is_usage_of_fleet_tool(error: &Error) -> bool {
    is(error, is_usage_of_run)
        || is(error, |why| matches!(why, StatusError::Run(why) if is_usage_of_run(why)))
        || is(error, |why| matches!(why, ExploreError::Run(why) if is_usage_of_run(why)))
        || is(error, |why| matches!(why, PermissionError::Run(why) if is_usage_of_run(why)))
        || is(error, |why| matches!(why, RoomCommandError::Run(why) if is_usage_of_run(why)))
        || is(error, |why| match why {
            EdgesError::Robot(_) | EdgesError::SameRobot => true,
            EdgesError::Run(why) => is_usage_of_run(why),
            _ => false,
        })
        || is(error, |why| match why {
            GotoError::Robot(_) => true,
            GotoError::Run(why) => is_usage_of_run(why),
            _ => false,
        })
        || is(error, |why| match why {
            ZoneToolError::Corners(_) => true,
            ZoneToolError::Run(why) => is_usage_of_run(why),
            _ => false,
        })
        || is(error, |why| match why {
            SlamCommandError::NoRobot(_) | SlamCommandError::Path(_) | SlamCommandError::Folder(_) => true,
            SlamCommandError::Run(why) => is_usage_of_run(why),
            _ => false,
        })
}

/// Returns whether `--run-dir` is wrong, or missing where several fleets run.
fn is_usage_of_run(why: &RunError) -> bool {
    matches!(why, RunError::NoRun(_) | RunError::SeveralRunning { .. } | RunError::NoRobot { .. })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_neither_done_nor_failed_has_an_exit_code_of_its_own_and_says_how_to_go_on() {
        let starting = UpError::SlowStart { pid: 7, dir: "runs/a".into() };
        let said = starting.to_string();
        assert!(said.contains("`mr-slam status --run-dir runs/a`") && said.contains("kill 7"), "{said}");
        let background =
            |code| UpError::Background { log: "launcher.log".into(), words: String::new(), code };
        let not_stopped = PermissionError::NotStopped { failed: 1, all: 2 };
        let nothing = [0, 2].map(|others| Error::from(PermissionError::NothingToStop { others }));
        assert_eq!(nothing.each_ref().map(exit_code), [UNDONE; 2]);
        assert_eq!(exit_code(&starting.into()), UNDONE);
        let failed =
            [background(Some(1)).into(), background(None).into(), not_stopped.into(), "other".into()];
        assert_eq!(failed.each_ref().map(exit_code), [FAILED; 4]);
        assert_eq!(exit_code(&background(Some(2)).into()), USAGE);
    }

    #[test]
    fn what_a_fleet_or_the_machine_lacks_is_a_failure_and_a_wrong_word_is_not() {
        let several = || RunError::SeveralRunning { runs: vec!["a".into(), "b".into()] };
        assert_eq!(exit_code(&StatusError::Run(several()).into()), USAGE);
        assert_eq!(exit_code(&GotoError::Run(RunError::NoRun("a".into())).into()), USAGE);
        assert_eq!(exit_code(&ExploreError::Run(RunError::NoneRunning).into()), FAILED);
        assert_eq!(exit_code(&RunError::Ended("a".into()).into()), FAILED);
        assert_eq!(exit_code(&EdgesError::SameRobot.into()), USAGE);
        assert_eq!(exit_code(&LinkArgsError::NotBuilt.into()), FAILED);
    }
}
