//! Tool `mr-slam edges`, which shows, pins and undoes the edges between robots' maps in a running fleet.

use super::output;
use super::robot_choice::{RobotChoice, RobotChoiceError};
use super::run_args::RunArgs;
use crate::channel::{self, Opener, Program};
use crate::ports::ChannelError;
use crate::run::{Run, RunError};
use crate::shared_memory::{Participant, let_readers_look, wait};
use msg::{CommandSource, EdgeAction, EdgeCommand, MergeEdges, Monotonic};
use reports::{EdgeView, edge_table};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// How long merging may take to answer: its longest task on a busy machine.
const PATIENCE: Duration = Duration::from_secs(10);
/// Period at which an answer is looked for, nanoseconds.
const POLL_NS: u64 = 20_000_000;

/// Show how the maps of a running fleet are joined, pin an edge or undo it
#[derive(Clone, Debug, clap::Args)]
pub struct EdgesArgs {
    /// Change to make; without it, show the edges
    #[command(subcommand)]
    pub action: Option<Action>,
    /// Print the result as JSON
    #[arg(long, global = true)]
    pub json: bool,
    /// Choice of the running fleet.
    #[command(flatten)]
    pub run: RunArgs,
}

/// Change of an edge.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum Action {
    /// Keep the edge whatever later evidence says; an undone edge holds again
    Pin(Pair),
    /// Let later evidence decide about the edge again
    Unpin(Pair),
    /// Reject this alignment of the two maps and never accept it again
    Undo(Pair),
}

/// Pair of robots whose edge is meant.
#[derive(Clone, Debug, clap::Args)]
pub struct Pair {
    /// The first robot: `robot1`, 1, or its name
    #[arg(value_name = "A")]
    pub a: RobotChoice,
    /// The second robot
    #[arg(value_name = "B")]
    pub b: RobotChoice,
}

/// Reason why edges could not be shown or changed.
#[derive(Debug, thiserror::Error)]
pub enum EdgesError {
    /// No run, or several and none was named.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Shared memory of the run.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// A robot that the fleet does not have.
    #[error(transparent)]
    Robot(#[from] RobotChoiceError),
    /// The same robot twice.
    #[error("expected two different robots")]
    SameRobot,
    /// Merging did not answer.
    #[error("run {}: merging does not answer within {} s; see `mr-slam status`", run.display(), PATIENCE.as_secs_f64())]
    Silent {
        /// Folder of the run.
        run: PathBuf,
    },
    /// Merging has no such edge.
    #[error("run {}: refused: no alignment of these two maps was found yet that could be pinned or undone", run.display())]
    Refused {
        /// Folder of the run.
        run: PathBuf,
    },
    /// The change was made, and is not in merging's file.
    #[error("run {}: changed, but NOT KEPT: merge.json cannot be written, and merging that is started again does not know it; the log says why", run.display())]
    NotKept {
        /// Folder of the run.
        run: PathBuf,
    },
    /// Merging was started again between the command and its answer.
    #[error("run {}: merging was started again meanwhile; whether the command was carried out is not known: see `mr-slam edges`", run.display())]
    Restarted {
        /// Folder of the run.
        run: PathBuf,
    },
    /// The edges cannot be written to standard output.
    #[error(transparent)]
    Print(#[from] std::io::Error),
}

/// Answer as JSON.
#[derive(Serialize)]
struct Answer<'a> {
    run: &'a Path,
    edges: Vec<EdgeView>,
    /// Whether merging cannot save what is pinned and undone.
    unsaved: bool,
}

/// What is said above edges that merging cannot save.
const UNSAVED: &str = "NOT KEPT: merge.json cannot be written, and merging that is started again does not know what was pinned or undone since\n";

/// Shows the edges, after a change if one is asked for.
pub fn run(args: &EdgesArgs) -> Result<(), EdgesError> {
    let (run, command) = match &args.action {
        None => (args.run.open()?, None),
        Some(action) => {
            let run = args.run.open_to_change()?;
            let command = action.command(&run)?;
            (run, Some(command))
        }
    };
    let edges = ask(&run, command)?;
    let unsaved = edges.unsaved != 0;
    let answer = Answer { run: &run.dir, edges: edges.edges().iter().map(EdgeView::new).collect(), unsaved };
    let heading = match command {
        Some(_) => format!("changed in run {}\n", run.dir.display()),
        None if unsaved => UNSAVED.into(),
        None => String::new(),
    };
    Ok(output::print_either(args.json, &answer, || heading + &edge_table(&answer.edges))?)
}

impl Action {
    fn command(&self, run: &Run) -> Result<EdgeCommand, EdgesError> {
        let (pair, action) = match self {
            Self::Pin(pair) => (pair, EdgeAction::Pin),
            Self::Unpin(pair) => (pair, EdgeAction::Unpin),
            Self::Undo(pair) => (pair, EdgeAction::Undo),
        };
        EdgeCommand::for_pair(action, pair.a.find(run)?, pair.b.find(run)?).ok_or(EdgesError::SameRobot)
    }
}

/// Returns the newest edges, after the command if there is one.
fn ask(run: &Run, command: Option<EdgeCommand>) -> Result<Box<MergeEdges>, EdgesError> {
    let node = Participant::open(&run.domain, Opener::of_fleet(Program::EdgesTool), "edges")?;
    let mut reader = node.reader(&channel::merge_edges())?;
    let mut next = |wanted: &dyn Fn(&MergeEdges) -> bool| -> Result<Box<MergeEdges>, EdgesError> {
        let begun = Instant::now();
        while begun.elapsed() < PATIENCE {
            if let Some(edges) = reader.newest()
                && wanted(&edges)
            {
                return Ok(Box::new(*edges));
            }
            wait([], Monotonic(crate::clock::now().0 + POLL_NS));
        }
        Err(EdgesError::Silent { run: run.dir.clone() })
    };
    let before = next(&|_| true)?;
    let Some(command) = command else { return Ok(before) };
    // The writer lives until all have looked, because a message of a closed writer may never be read.
    let mut writer = node.writer(&channel::edge_command())?;
    writer.send(&EdgeCommand { sender: CommandSource::LAPTOP, ..command });
    let is_of_same = |edges: &MergeEdges| edges.header.incarnation == before.header.incarnation;
    let after = next(&|edges| edges.commands != before.commands || !is_of_same(edges));
    // A recorder may not have looked yet.
    let_readers_look();
    let after = after?;
    if !is_of_same(&after) {
        return Err(EdgesError::Restarted { run: run.dir.clone() });
    }
    if after.refused != before.refused {
        return Err(EdgesError::Refused { run: run.dir.clone() });
    }
    if after.unsaved != 0 {
        return Err(EdgesError::NotKept { run: run.dir.clone() });
    }
    Ok(after)
}
