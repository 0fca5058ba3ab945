//! Entry point of the binary `mr-slam`.

use clap::Parser;
use mr_slam::command::{self, Cli, output};
use std::process::ExitCode;

fn main() -> ExitCode {
    output::start_log();
    match command::run(Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            output::note(&format!("mr-slam: {error}"));
            ExitCode::FAILURE
        }
    }
}
