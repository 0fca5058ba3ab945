//! Entry point of the binary `mr-slam`.

use mr_slam::command::{self, Cli, output};
use std::process::ExitCode;

fn main() -> ExitCode {
    output::start_log();
    match command::run(Cli::parse_words(std::env::args_os()).unwrap_or_else(|why| why.exit())) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            output::note(&format!("mr-slam: {error}"));
            ExitCode::FAILURE
        }
    }
}
