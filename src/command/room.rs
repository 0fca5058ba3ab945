//! Tool `mr-slam room`, which accepts or refuses the room that a headset offers as the simulators' world.

use super::output;
use super::run_args::RunArgs;
use crate::control::{self, Request};
use crate::offered_room::{self, OfferedRoomError};
use crate::run::{Run, RunError};
use serde::Serialize;
use std::path::Path;
use std::time::Duration;

/// How long the bridge may take to hear of the answer: one that was killed is back by then.
const PATIENCE: Duration = Duration::from_secs(2);

/// Accept or refuse the room that a headset offers as the simulators' world; without either, show it
#[derive(Clone, Debug, clap::Args)]
pub struct RoomArgs {
    /// Answer to the offer
    #[command(subcommand)]
    pub answer: Option<Answer>,
    /// Print the result as JSON
    #[arg(long, global = true)]
    pub json: bool,
    /// Choice of the running fleet.
    #[command(flatten)]
    pub run: RunArgs,
}

/// Answer to the offer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::Subcommand)]
pub enum Answer {
    /// End this run, and start the fleet again in the offered room
    Accept,
    /// Forget the offered room
    Refuse,
}

/// Reason why the room is not answered.
#[derive(Debug, thiserror::Error)]
pub enum RoomCommandError {
    /// No run, or several and none was named.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The room cannot be used.
    #[error(transparent)]
    Room(#[from] OfferedRoomError),
    /// The answer cannot be written to standard output.
    #[error(transparent)]
    Print(#[from] std::io::Error),
}

/// Result as JSON.
#[derive(Serialize)]
struct Outcome<'a> {
    run: &'a Path,
    /// Size of the room, metres.
    size_m: Option<[f64; 2]>,
    accepted: bool,
}

/// Answers the offer, or shows it.
pub fn run(args: &RoomArgs) -> Result<(), RoomCommandError> {
    let run = if args.answer.is_some() { args.run.open_to_change()? } else { args.run.open()? };
    let (size_m, what) = match args.answer {
        None => (Some(offered_room::check(&run)?), "a headset offers a room"),
        Some(Answer::Accept) => {
            (Some(offered_room::accept(&run)?), "the fleet starts again in the headset's room")
        }
        Some(Answer::Refuse) => {
            offered_room::refuse(&run)?;
            (None, "the headset's room is refused")
        }
    };
    if args.answer.is_some() {
        notify_bridge(&run);
    }
    let text = || {
        let size = size_m.map_or(String::new(), |[x, y]| format!(" of {x:.1} m x {y:.1} m"));
        let next = if args.answer.is_none() { ": mr-slam room accept, or refuse" } else { "" };
        format!("{what}{size}{next} (run {})\n", run.dir.display())
    };
    let accepted = args.answer == Some(Answer::Accept);
    Ok(output::print_either(args.json, &Outcome { run: &run.dir, size_m, accepted }, text)?)
}

/// Tells the bridge that the offer is answered. If it does not hear, it shows the offer a little longer.
fn notify_bridge(run: &Run) {
    if let Err(why) = control::ask_again(run, Request::AnswerRoom, PATIENCE) {
        tracing::warn!("{why}");
    }
}
