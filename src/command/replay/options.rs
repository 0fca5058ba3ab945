//! Which options have no effect on which kind of replay: they are refused, not ignored.

use super::{ReplayArgs, ReplayError};
use crate::config::Mode;

/// A kind of replay on which some options have no effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Replay {
    /// A fleet's recording: its robots, parameters and scans are those of the recording.
    Fleet,
    /// CARMEN logs, which have no topics and frames.
    Carmen,
    /// Several logs that are merged.
    MergedLogs,
}

use Replay::{Carmen, Fleet, MergedLogs};

impl Replay {
    fn text(self) -> &'static str {
        match self {
            Fleet => "the replay of a fleet's recording",
            Carmen => "the replay of CARMEN logs",
            MergedLogs => "the replay of several logs",
        }
    }
}

/// An option, whether it is given, and the replays on which it has no effect.
type ReplayOption = (&'static str, fn(&ReplayArgs) -> bool, &'static [Replay]);

/// All options but those that need `--serve` or `--session`.
pub const OPTIONS: &[ReplayOption] = &[
    // With one of these four, one robot of a fleet's recording is replayed.
    ("scan-topic", |args| args.bag.scan_topic.is_some(), &[Carmen]),
    ("odom-topic", |args| args.bag.odom_topic.is_some(), &[Carmen]),
    ("odom-frame", |args| args.bag.odom_frame.is_some(), &[Carmen]),
    ("truth-topic", |args| args.bag.truth_topic.is_some(), &[Carmen]),
    ("scanner", |args| args.bag.scanner.is_some(), &[Fleet, Carmen]),
    ("config", |args| args.config.is_some(), &[Fleet]),
    ("merge", |args| args.merge.is_some(), &[]),
    ("trajectory", |args| args.trajectory.is_some(), &[Fleet]),
    ("map", |args| args.map.is_some(), &[]),
    ("json", |args| args.json, &[]),
    ("fov-deg", |args| args.fov_deg.is_some(), &[Fleet]),
    ("no-odometry", |args| args.no_odometry, &[Fleet]),
    ("no-closures", |args| args.no_closures, &[Fleet]),
    ("session", |args| args.session.is_some(), &[Fleet, MergedLogs]),
    ("save-session", |args| args.save_session.is_some(), &[Fleet, MergedLogs]),
    ("mode", |args| args.mode != Mode::default(), &[Fleet, MergedLogs]),
    ("skip", |args| args.skip > 0, &[Fleet, MergedLogs]),
    ("scans", |args| args.scans.is_some(), &[Fleet, MergedLogs]),
    // Other replays refuse it with `ReplayError::NotServed`.
    ("serve", |args| args.serving.serve, &[]),
];

/// Refuses options that are given and have no effect.
pub fn refuse(replay: Replay, args: &ReplayArgs) -> Result<(), ReplayError> {
    let given = OPTIONS.iter().filter(|(_, is_given, without)| without.contains(&replay) && is_given(args));
    let options: Vec<String> = given.map(|(name, ..)| format!("--{name}")).collect();
    if options.is_empty() {
        return Ok(());
    }
    Err(ReplayError::WithoutEffect { options: options.join(", "), replay: replay.text() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use std::collections::BTreeSet;

    #[derive(clap::Parser)]
    struct Program {
        #[command(flatten)]
        args: ReplayArgs,
    }

    fn command() -> clap::Command {
        <Program as clap::CommandFactory>::command()
    }

    fn parse(option: &str, value: Option<&str>) -> ReplayArgs {
        let option = format!("--{option}");
        let words = ["replay", "a.log", &option].into_iter().chain(value);
        Program::try_parse_from(words).unwrap_or_else(|error| panic!("{error}")).args
    }

    /// A value that the option can have and that is not its default; none for a flag.
    fn value(argument: &clap::Arg) -> Option<String> {
        if !argument.get_action().takes_values() {
            return None;
        }
        let named = argument.get_possible_values();
        // Not the default, which reads as not given.
        let last = named.last().map(|value| value.get_name().to_owned());
        Some(last.unwrap_or_else(|| match argument.get_long() {
            Some("scanner" | "at") => "0.1,0,0".into(),
            Some("merge") => "unknown".into(),
            _ => "7".into(),
        }))
    }

    #[test]
    fn each_option_says_on_which_replays_it_has_no_effect_and_is_refused_there_alone() {
        let command = command();
        let needs_another = ["at", "go-on", "speed", "port", "page", "ros-domain", "help"];
        let options: Vec<&clap::Arg> = command
            .get_arguments()
            .filter(|argument| argument.get_long().is_some_and(|name| !needs_another.contains(&name)))
            .collect();
        let names: BTreeSet<&str> = options.iter().filter_map(|argument| argument.get_long()).collect();
        assert_eq!(names, OPTIONS.iter().map(|(name, ..)| *name).collect::<BTreeSet<_>>());
        let bare = Program::try_parse_from(["replay", "a.log"]).ok().unwrap().args;
        assert!(OPTIONS.iter().all(|(_, is_given, _)| !is_given(&bare)));
        for argument in options {
            let name = argument.get_long().unwrap();
            let args = parse(name, value(argument).as_deref());
            let (_, is_given, without) = OPTIONS.iter().find(|(option, ..)| *option == name).unwrap();
            assert!(is_given(&args), "--{name}");
            for replay in [Fleet, Carmen, MergedLogs] {
                let refused = refuse(replay, &args).err().map(|error| error.to_string());
                assert_eq!(refused.is_some(), without.contains(&replay), "--{name}, {replay:?}: {refused:?}");
                assert!(
                    refused.is_none_or(|text| text.contains(&format!("--{name}"))),
                    "--{name}, {replay:?}"
                );
            }
        }
        for name in needs_another.iter().filter(|name| **name != "help") {
            let value =
                command.get_arguments().find(|argument| argument.get_long() == Some(name)).and_then(value);
            let words = ["replay".into(), "a.log".into(), format!("--{name}")].into_iter().chain(value);
            let error = Program::try_parse_from(words).err().expect(name);
            assert_eq!(error.kind(), clap::error::ErrorKind::MissingRequiredArgument, "--{name}: {error}");
        }
    }
}
