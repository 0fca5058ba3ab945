//! Coordinates on the command line, such as `-1,2`, which are no options although they begin with a minus.

use std::ffi::OsString;

/// Puts a space before coordinates that begin with a minus, so that the word is a value. Parsers of coordinates ignore it.
///
/// An argument that takes any word with a minus as a value would take options behind it as values, too.
pub(super) fn as_value(word: OsString) -> OsString {
    match word.to_str() {
        Some(text) if is_negative(text) => format!(" {text}").into(),
        _ => word,
    }
}

/// Whether a word begins with a minus and is a list of two or more numbers.
fn is_negative(text: &str) -> bool {
    let is_number = |part: &str| {
        let part = part.trim();
        // `-inf,0` and `-nan,0` are numbers for the parser, too; its error is the right one.
        part.parse::<f64>().is_ok()
    };
    text.starts_with('-') && text.contains(',') && text.split(',').all(is_number)
}

#[cfg(test)]
mod tests {
    use super::super::Cli;
    use super::*;
    use clap::{ArgAction, CommandFactory, parser::ValueSource};

    /// Values that the arguments of a name take, by the name of the value.
    fn sample(value: &str) -> &'static str {
        match value {
            "X,Y" => "-1.5,-2",
            "X,Y[,YAW]" => "-1.5,2",
            "X,Y,YAW" => "-1.5,-2,-.5",
            "ADDRESS" => "10.0.0.7",
            "A" | "ROBOT" => "1",
            "B" | "N" | "NUMBER" => "2",
            "FILE" | "LOG" | "DIR" => "file",
            _ => "x",
        }
    }

    /// Words that give a command its positional arguments, three each where it takes several.
    fn positionals(command: &clap::Command) -> Vec<String> {
        let words = |argument: &clap::Arg| {
            let possible = argument.get_possible_values();
            let name =
                argument.get_value_names().and_then(|names| names.first()).map_or("", |name| name.as_str());
            let word = possible.first().map_or(sample(name), |value| value.get_name()).to_owned();
            let many = argument.get_num_args().is_some_and(|count| count.max_values() > 1);
            vec![word; if many { 3 } else { 1 }]
        };
        command.get_positionals().flat_map(words).collect()
    }

    /// Calls `check` with each command that has no commands below it: the words that name it, with values, and its options.
    fn for_each_tool(check: &mut dyn FnMut(&[String], &[clap::Arg])) {
        fn visit(
            command: &clap::Command,
            words: &[String],
            options: &[clap::Arg],
            check: &mut dyn FnMut(&[String], &[clap::Arg]),
        ) {
            let own = command.get_opts().chain(command.get_arguments().filter(|it| !it.is_positional()));
            let options: Vec<clap::Arg> = options.iter().chain(own).cloned().collect();
            let words = [words, &positionals(command)].concat();
            let mut below = command.get_subcommands().filter(|it| it.get_name() != "help").peekable();
            if below.peek().is_none() || !command.is_subcommand_required_set() {
                check(&words, &options);
            }
            for tool in below {
                visit(tool, &[&words[..], &[tool.get_name().to_owned()]].concat(), &options, check);
            }
        }
        let mut root = Cli::command();
        root.build();
        visit(&root, &["mr-slam".to_owned()], &[], check);
    }

    fn matches(words: &[String]) -> Result<clap::ArgMatches, clap::Error> {
        Cli::command().try_get_matches_from(words.iter().map(|word| as_value(word.into())))
    }

    /// The matches of the innermost command.
    fn innermost(matches: &clap::ArgMatches) -> &clap::ArgMatches {
        matches.subcommand().map_or(matches, |(_, below)| innermost(below))
    }

    #[test]
    fn options_of_a_command_and_of_those_above_stand_behind_its_words_too() {
        let (mut commands, mut run_dirs) = (0, 0);
        for_each_tool(&mut |words, options| {
            commands += 1;
            for option in options {
                let Some(long) = option.get_long().filter(|long| !["help", "version"].contains(long)) else {
                    continue;
                };
                let is_flag = matches!(option.get_action(), ArgAction::SetTrue);
                if !is_flag && long != "run-dir" {
                    continue;
                }
                run_dirs += usize::from(long == "run-dir");
                let mut words = words.to_vec();
                words.push(format!("--{long}"));
                words.extend((!is_flag).then(|| "file".to_owned()));
                use clap::error::ErrorKind::{
                    ArgumentConflict, InvalidValue, MissingRequiredArgument, ValueValidation,
                };
                match matches(&words) {
                    Ok(matches) => {
                        let source = innermost(&matches).value_source(option.get_id().as_str());
                        assert_eq!(source, Some(ValueSource::CommandLine), "{words:?}");
                    }
                    // The option belongs to other words, or the sample to other arguments.
                    Err(why) if matches!(why.kind(), ArgumentConflict | MissingRequiredArgument) => {}
                    Err(why) if matches!(why.kind(), InvalidValue | ValueValidation) => {
                        assert!(!why.to_string().contains(&format!("'--{long}'")), "{words:?}: {why}");
                    }
                    Err(why) => panic!("{words:?}: {why}"),
                }
            }
        });
        assert!(commands > 30 && run_dirs > 20, "{commands} commands, {run_dirs} with --run-dir");
    }

    #[test]
    fn the_commands_that_act_on_a_fleet_take_options_and_coordinates_in_any_order() {
        let words = |line: &str| -> Vec<String> { line.split(' ').map(str::to_owned).collect() };
        for line in [
            "mr-slam zone add -1,0 2,0 -2,-3 --run-dir D --json",
            "mr-slam zone --run-dir D --json add 1,0 -2,0 2,3",
            "mr-slam zone add --run-dir D 1,0 -2,0 -2,3 --json",
            "mr-slam zone remove 2 --run-dir D --json",
            "mr-slam zone clear --json --run-dir D",
            "mr-slam edges pin 1 2 --run-dir D --json",
            "mr-slam edges --json --run-dir D undo 1 2",
            "mr-slam room accept --run-dir D --json",
            "mr-slam goto 2 -1.5,-0.5 --run-dir D --json",
            "mr-slam goto --run-dir D --json 2 -.5,1,-3.1",
            "mr-slam slam 1 pose -1,-2,-3 --run-dir D --json",
            "mr-slam slam 1 load f --at -1,-2,-3 --run-dir D --json",
            "mr-slam explore stop --run-dir D --json",
            "mr-slam stop --run-dir D --json",
        ] {
            let matches = matches(&words(line)).unwrap_or_else(|why| panic!("{line}: {why}"));
            let tool = innermost(&matches);
            for id in ["run_dir", "json"] {
                assert_eq!(tool.value_source(id), Some(ValueSource::CommandLine), "{line}: {id}");
            }
        }
        let zone =
            Cli::parse_words(words("mr-slam zone add -1,0 2,0 2,3 --run-dir D").into_iter().map(Into::into));
        let super::super::Command::Zone(zone) = zone.unwrap().command else { panic!("not a zone") };
        assert_eq!(zone.run.run_dir, Some("D".into()), "the value reaches the command");
    }

    #[test]
    fn only_lists_of_numbers_are_coordinates() {
        for word in ["-1,2", "-1.5,-2,-3", "-.5,1", "-1e3, 2"] {
            assert_eq!(as_value(word.into()), format!(" {word}").as_str(), "{word}");
        }
        for word in ["1,-2", "-1", "--json", "-h", "-a,b", "-", "--", "-1,", "--at=-1,2", ""] {
            assert_eq!(as_value(word.into()), word, "{word}");
        }
    }
}
