//! Tools `mr-slam allow`, `deny`, `stop` and `release` for permissions to drive and the emergency stop.

use super::output;
use super::run_args::RunArgs;
use crate::control::{self, BridgeState, Request};
use crate::run::{Run, RunError};
use serde::Serialize;
use std::net::IpAddr;
use std::path::Path;
use std::time::Duration;

/// How long a command waits for the bridge at each step: a bridge that was killed is back by then.
const PATIENCE: Duration = Duration::from_secs(2);

/// Let an address drive, now and in later runs; without one, list who may drive and who waits
#[derive(Clone, Debug, clap::Args)]
pub struct AllowArgs {
    /// IP address, such as the headset's
    #[arg(value_name = "ADDRESS")]
    pub address: Option<IpAddr>,
    /// Choice of the running fleet, and the format of the answer.
    #[command(flatten)]
    pub common: StopArgs,
}

/// Forbid an address to drive
#[derive(Clone, Debug, clap::Args)]
pub struct DenyArgs {
    /// IP address of the client
    #[arg(value_name = "ADDRESS")]
    pub address: IpAddr,
    /// Choice of the running fleet, and the format of the answer.
    #[command(flatten)]
    pub common: StopArgs,
}

/// Arguments of `stop` and `release`
#[derive(Clone, Debug, clap::Args)]
pub struct StopArgs {
    /// Choice of the running fleet.
    #[command(flatten)]
    pub run: RunArgs,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// Reason why the bridge did not apply the request.
#[derive(Debug, thiserror::Error)]
pub enum PermissionError {
    /// No run, or several and none was named.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The bridge did not answer, or refused.
    #[error("run {run}: {why}")]
    Bridge {
        /// Folder of the run.
        run: String,
        /// Reason of the bridge.
        why: String,
    },
    /// The answer cannot be written to standard output.
    #[error("cannot print the answer: {0}")]
    Print(#[from] std::io::Error),
}

/// Answer as JSON.
#[derive(Serialize)]
struct Answer<'a> {
    run: &'a Path,
    bridge: &'a BridgeState,
}

/// Lets an address drive; without one, lists the addresses.
pub fn allow(args: &AllowArgs) -> Result<(), PermissionError> {
    match args.address {
        Some(address) => change(&args.common, Request::Allow(address), &format!("{address} may drive")),
        None => list(&args.common),
    }
}

/// Forbids an address to drive.
pub fn deny(args: &DenyArgs) -> Result<(), PermissionError> {
    let address = args.address;
    change(&args.common, Request::Deny(address), &format!("{address} may not drive"))
}

/// Sets the emergency stop.
pub fn stop(args: &StopArgs) -> Result<(), PermissionError> {
    change(args, Request::Stop, "every robot is stopped until `mr-slam release`")
}

/// Releases the emergency stop.
pub fn release(args: &StopArgs) -> Result<(), PermissionError> {
    change(args, Request::Release, "the robots may be driven again")
}

fn change(args: &StopArgs, request: Request, done: &str) -> Result<(), PermissionError> {
    let run = args.run.open_to_change()?;
    let bridge = ask(&run, request)?;
    let text = || format!("{done} (run {})\n", run.dir.display());
    Ok(output::print_either(args.json, &Answer { run: &run.dir, bridge: &bridge }, text)?)
}

fn list(args: &StopArgs) -> Result<(), PermissionError> {
    let run = args.run.open()?;
    let bridge = ask(&run, Request::State)?;
    let text = || {
        let mut text = String::new();
        bridge.allowed.iter().for_each(|address| text += &format!("{address} may drive\n"));
        bridge.waiting.iter().for_each(|address| text += &format!("{address} waits for an answer\n"));
        if text.is_empty() {
            text += "nobody has asked; loopback may drive\n";
        }
        text
    };
    Ok(output::print_either(args.json, &Answer { run: &run.dir, bridge: &bridge }, text)?)
}

fn ask(run: &Run, request: Request) -> Result<BridgeState, PermissionError> {
    control::ask(run, request, PATIENCE)
        .map_err(|why| PermissionError::Bridge { run: run.dir.display().to_string(), why })
}
