//! Entry point of the binary `mr-slam`.

use mr_slam::command::{self, Cli, output};
use std::ffi::OsString;
use std::process::ExitCode;

fn main() -> ExitCode {
    mr_slam::child_process::set_own_name();
    output::start_log();
    let words: Vec<OsString> = std::env::args_os().collect();
    // Known before the words are understood: an unknown option is an error that a program reads, too.
    let is_json = words.iter().any(|word| word == "--json");
    let cli = Cli::parse_words(words).unwrap_or_else(|why| {
        if is_json && why.use_stderr() {
            output::print_failure(&command::usage_error(&why));
        }
        why.exit()
    });
    match command::run(cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            output::note(&format!("mr-slam: {error}"));
            if is_json {
                output::print_failure(&error.to_string());
            }
            ExitCode::from(command::exit_code(&error))
        }
    }
}
