//! Tool `mr-slam clients`, which lists the clients of a running fleet and closes connections.

use super::output;
use super::permissions::{self, PermissionError};
use super::run_args::RunArgs;
use crate::control::Request;
use bridge::ClientSelector;
use bridge::ClientStatus;
use serde::Serialize;
use std::path::Path;

/// Arguments of `clients`
#[derive(Clone, Debug, clap::Args)]
pub struct ClientsArgs {
    /// Close connections: all of an IP address, the one of ADDRESS:PORT, or the one of a number of the list. The
    /// client may connect again; `mr-slam deny` takes its permission to drive
    #[arg(long, value_name = "WHICH")]
    pub drop: Option<ClientSelector>,
    /// Choice of the running fleet.
    #[command(flatten)]
    pub run: RunArgs,
    /// Print the clients as JSON
    #[arg(long)]
    pub json: bool,
}

/// Clients as JSON.
#[derive(Serialize)]
struct Answer<'a> {
    run: &'a Path,
    clients: &'a [ClientStatus],
}

/// Lists the clients, after it has closed connections if asked to.
pub fn run(args: &ClientsArgs) -> Result<(), PermissionError> {
    let (run, request) = match args.drop {
        Some(which) => (args.run.open_to_change()?, Request::Drop(which)),
        None => (args.run.open()?, Request::State),
    };
    let state = permissions::ask(&run, request)?;
    let answer = Answer { run: &run.dir, clients: &state.clients };
    Ok(output::print_either(args.json, &answer, || state.client_table())?)
}
