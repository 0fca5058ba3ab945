//! Tool `mr-slam worker ROLE`, which runs one process of a fleet, as the supervisor starts it.

use super::Error;
use crate::process::{self, Process};

/// Run one process of a fleet; started by `up`
#[derive(Clone, Debug, clap::Args)]
pub struct WorkerArgs {
    /// Process to run.
    #[command(subcommand)]
    process: Process,
}

/// Ends the process when any of its threads or tasks panics, after the message. What is left without one of them would look
/// alive: a bridge without its periodic tasks stops no robot. The supervisor starts the process again.
pub(super) fn abort_on_panic() {
    let say = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        say(panic);
        std::process::abort();
    }));
}

/// Runs the process until it is asked to stop.
pub fn run(args: &WorkerArgs) -> Result<(), Error> {
    abort_on_panic();
    process::run(&args.process)
}
