//! Tools `mr-slam allow`, `deny`, `stop` and `release` for permissions to drive and the emergency stop.

mod stop;

pub use stop::{release, stop};

use super::output;
use super::run_args::RunArgs;
use crate::allowed;
use crate::control::{self, Request};
use crate::process::control::saved_state::denied_file;
use crate::run::{Run, RunError};
use crate::storage::DiskStorage;
use reports::BridgeState;
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
    #[arg(value_name = "ADDRESS", value_parser = bridge::parse_peer_address)]
    pub address: Option<IpAddr>,
    /// Choice of the running fleet, and the format of the answer.
    #[command(flatten)]
    pub common: StopArgs,
}

/// Forbid an address to drive
#[derive(Clone, Debug, clap::Args)]
pub struct DenyArgs {
    /// IP address of the client
    #[arg(value_name = "ADDRESS", value_parser = bridge::parse_peer_address)]
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
    /// The bridge did not answer: it will deny the address when it starts.
    #[error("{address} is denied from the bridge's next start on, not before: {error}")]
    DeniedLater {
        /// The denied address.
        address: IpAddr,
        /// Why it is not denied now.
        error: Box<PermissionError>,
    },
    /// Nobody has confirmed that a fleet is stopped.
    #[error("{failed} of {all} fleets may still drive; try again, or end them with Ctrl-C or `kill`")]
    NotStopped {
        /// Fleets that are not known to be stopped.
        failed: usize,
        /// All fleets that were to be stopped.
        all: usize,
    },
    /// No fleet of this user runs, so nothing was stopped.
    #[error("no fleet of yours runs, and nothing was stopped{}", others_text(*.others))]
    NothingToStop {
        /// Fleets of other users that run, and may drive.
        others: usize,
    },
    /// The fleet that was named has ended.
    #[error(transparent)]
    Ended(RunError),
    /// The emergency stop is not, or not surely, released.
    #[error("run {run}: {why}")]
    NotReleased {
        /// Folder of the run.
        run: String,
        /// What is so instead.
        why: String,
    },
    /// It holds now, but a bridge that is started again may not know it.
    #[error("run {run}: {done}; but it is NOT SAVED: {why}")]
    NotSaved {
        /// Folder of the run.
        run: String,
        /// What holds now.
        done: String,
        /// What is not in the files, why, and what follows from it at a restart.
        why: String,
    },
    /// The answer cannot be written to standard output.
    #[error(transparent)]
    Print(#[from] std::io::Error),
}

impl PermissionError {
    /// Returns whether nothing failed, but nothing was there to be stopped either.
    pub fn is_nothing_to_stop(&self) -> bool {
        matches!(self, Self::NothingToStop { .. } | Self::Ended(_))
    }
}

/// Says how many fleets of other users may drive.
fn others_text(others: usize) -> String {
    match others {
        0 => String::new(),
        others => format!("; fleets of other users that may drive: {others}"),
    }
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

/// Forbids an address to drive, at once on the disk, too: a bridge that does not answer starts with it.
pub fn deny(args: &DenyArgs) -> Result<(), PermissionError> {
    let address = args.address;
    let run = args.common.run.open_to_change()?;
    let denied = denied_file(&run);
    let write = || {
        // Off the list of those who may, also if the other list is full.
        let taken_off = allowed::remember(&DiskStorage, &allowed::file(&run), address, false);
        allowed::remember(&DiskStorage, &denied, address, true).and(taken_off)
    };
    // A disk may be slow, and who drives must not drive on meanwhile.
    let (asked, written) = std::thread::scope(|scope| {
        let written = scope.spawn(write);
        let asked = ask(&run, Request::Deny(address));
        (asked, written.join().unwrap_or_else(|why| std::panic::resume_unwind(why)))
    });
    let bridge = asked.map_err(|error| match written {
        Ok(()) => PermissionError::DeniedLater { address, error: Box::new(error) },
        Err(_) => error,
    })?;
    if written.is_err() {
        check_saved(&run, &bridge, &format!("{address} may not drive"))?;
    }
    let text = || format!("{address} may not drive (run {})\n", run.dir.display());
    Ok(output::print_either(args.common.json, &Answer { run: &run.dir, bridge: &bridge }, text)?)
}

fn change(args: &StopArgs, request: Request, done: &str) -> Result<(), PermissionError> {
    let run = args.run.open_to_change()?;
    let bridge = ask(&run, request)?;
    check_saved(&run, &bridge, done)?;
    let text = || format!("{done} (run {})\n", run.dir.display());
    Ok(output::print_either(args.json, &Answer { run: &run.dir, bridge: &bridge }, text)?)
}

fn list(args: &StopArgs) -> Result<(), PermissionError> {
    let run = args.run.open()?;
    let bridge = ask(&run, Request::State)?;
    let text = || {
        let mut text = String::new();
        if run.config.bridge.trust_loopback {
            text += "loopback may drive, unless it is denied\n";
        }
        bridge.allowed.iter().for_each(|address| text += &format!("{address} may drive\n"));
        bridge.waiting.iter().for_each(|address| text += &format!("{address} waits for an answer\n"));
        text += &bridge.unlisted_text();
        bridge.denied.iter().for_each(|address| text += &format!("{address} is denied\n"));
        if bridge.allowed.is_empty() && bridge.waiting.is_empty() && bridge.denied.is_empty() {
            text += "nobody has asked\n";
        }
        text
    };
    Ok(output::print_either(args.json, &Answer { run: &run.dir, bridge: &bridge }, text)?)
}

/// Returns an error if what was done is not in the files of the run.
fn check_saved(run: &Run, bridge: &BridgeState, done: &str) -> Result<(), PermissionError> {
    let Some(why) = bridge.not_saved.clone() else { return Ok(()) };
    Err(PermissionError::NotSaved { run: run.dir.display().to_string(), done: done.into(), why })
}

/// Sends a request to a run's bridge, and waits for one that is being started.
pub(super) fn ask(run: &Run, request: Request) -> Result<BridgeState, PermissionError> {
    control::ask_again(run, request, PATIENCE)
        .map_err(|why| PermissionError::Bridge { run: run.dir.display().to_string(), why: why.to_string() })
}
