//! Merge edges as people and programs read them, and `mr-slam edges`, with which people pin and undo them.

use crate::channel::{self, Opener, Program};
use crate::control::RunArgs;
use crate::process::Error;
use crate::run::Run;
use crate::shared_memory::Participant;
use msg::{EdgeAction, EdgeCommand, EdgeState, MergeEdge, MergeEdges, Monotonic, RobotId};
use serde::Serialize;
use std::fmt::{self, Write};
use std::time::{Duration, Instant};

/// How long merging may take to answer: its longest piece of work, on a busy machine.
const PATIENCE: Duration = Duration::from_secs(10);
/// How often it is looked for an answer, nanoseconds.
const LOOK_NS: u64 = 20_000_000;

/// Show what merging believes of each pair of robots' maps and why; or pin it, or take it back
#[derive(Clone, Debug, clap::Args)]
pub struct EdgesArgs {
    /// What to do; without it, show
    #[command(subcommand)]
    pub action: Option<Action>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
    /// Which fleet; before the action.
    #[command(flatten)]
    pub run: RunArgs,
}

/// What to do to an edge.
#[derive(Clone, Copy, Debug, clap::Subcommand)]
pub enum Action {
    /// It stays, whatever comes; if it was taken back, it holds again
    Pin(Pair),
    /// It stays as long as the maps agree
    Unpin(Pair),
    /// The two maps do not lie like this: never join them so again
    Undo(Pair),
}

/// Two robots.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct Pair {
    /// One: its number
    #[arg(value_name = "A", value_parser = robot)]
    pub a: RobotId,
    /// The other
    #[arg(value_name = "B", value_parser = robot)]
    pub b: RobotId,
}

fn robot(text: &str) -> Result<RobotId, String> {
    let number = text.strip_prefix("robot").unwrap_or(text).parse().ok();
    number.and_then(RobotId::new).ok_or(format!("`{text}` is no robot; expected its number, from 1"))
}

/// Runs the subcommand.
pub fn run(args: &EdgesArgs) -> Result<(), Error> {
    let run = args.run.open()?;
    let (pair, action) = match args.action {
        None => return show(&*ask(&run, None)?, args.json),
        Some(Action::Pin(pair)) => (pair, EdgeAction::Pin),
        Some(Action::Unpin(pair)) => (pair, EdgeAction::Unpin),
        Some(Action::Undo(pair)) => (pair, EdgeAction::Undo),
    };
    if pair.a.number().max(pair.b.number()) > run.config.fleet.robots {
        return Err(format!("this fleet has robots 1 to {}", run.config.fleet.robots).into());
    }
    let command = EdgeCommand::for_pair(action, pair.a, pair.b).ok_or("a robot and itself are no pair")?;
    show(&*ask(&run, Some(command))?, args.json)
}

/// The newest edges, after a command if there is one.
fn ask(run: &Run, command: Option<EdgeCommand>) -> Result<Box<MergeEdges>, Error> {
    let node = Participant::open(&run.domain, Opener::of_fleet(Program::AskMerge), "edges")?;
    let mut reader = node.reader(&channel::merge_edges())?;
    let begun = Instant::now();
    let mut next = |wanted: &dyn Fn(&MergeEdges) -> bool| -> Result<Box<MergeEdges>, Error> {
        while begun.elapsed() < PATIENCE {
            if let Some(edges) = reader.newest()
                && wanted(&edges)
            {
                return Ok(Box::new(*edges));
            }
            crate::shared_memory::wait([], Monotonic(crate::clock::now().0 + LOOK_NS));
        }
        Err("merging does not answer; is it up (mr-slam status)?".into())
    };
    let before = next(&|_| true)?;
    let Some(command) = command else { return Ok(before) };
    // Kept until the answer is there: what a writer that is gone has said may never be read.
    let mut writer = node.writer(&channel::edge_command())?;
    writer.send(&command);
    let after = next(&|edges| edges.commands != before.commands)?;
    if after.refused != before.refused {
        return Err(
            "refused: nothing has been found between these two that could be held or taken back".into()
        );
    }
    Ok(after)
}

fn show(edges: &MergeEdges, as_json: bool) -> Result<(), Error> {
    let views: Vec<EdgeView> = edges.edges().iter().map(EdgeView::new).collect();
    match as_json {
        true => println!("{}", json(edges)),
        false => print!("{}", table(&views)),
    }
    Ok(())
}

/// How one robot's map lies in another's, and what speaks for it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EdgeView {
    /// The edge's number.
    pub edge: u32,
    /// `robot1`: the robot it is seen from.
    pub a: String,
    /// `robot2`: the robot that is seen.
    pub b: String,
    /// `accepted`, `pinned`, `undone` ...
    pub state: &'static str,
    /// `a`'s map from `b`'s: x, y in metres, yaw in radians.
    pub a_from_b: [f64; 3],
    /// Occupied cells found again, of both maps together.
    pub inliers: u32,
    /// Mean distance of walls found again, metres.
    pub residual_m: f64,
    /// What both maps know, square metres.
    pub overlap_m2: f64,
    /// The same over what the map that knows less knows.
    pub overlap_share: f64,
    /// Share of the cells both know on which they agree.
    pub agreement: f64,
    /// F1 of occupied cells at one cell's tolerance.
    pub occupied_f1: f64,
    /// The largest such F1 under 20 wrong transforms.
    pub null_f1_max: f64,
    /// Walls of one map in the middle of the other's floor.
    pub conflict: f64,
    /// Evidence over that of the best other place.
    pub margin: f64,
    /// Closures between submaps in force.
    pub closures: u32,
    /// Closures found and not believed together with the others.
    pub closures_rejected: u32,
    /// Mean distance by which the fleet's graph leaves its closures, metres.
    pub closure_residual_m: f64,
    /// Alignments tried.
    pub tries: u32,
}

impl EdgeView {
    /// Names the figures.
    pub fn new(edge: &MergeEdge) -> Self {
        Self {
            edge: edge.id,
            a: format!("robot{}", edge.a),
            b: format!("robot{}", edge.b),
            state: edge.state().name(),
            a_from_b: [edge.a_from_b.x_m, edge.a_from_b.y_m, edge.a_from_b.yaw_rad],
            inliers: edge.inliers,
            residual_m: edge.residual_m,
            overlap_m2: edge.overlap_m2,
            overlap_share: edge.overlap_share,
            agreement: edge.agreement,
            occupied_f1: edge.occupied_f1,
            null_f1_max: edge.null_f1_max,
            conflict: edge.conflict,
            margin: edge.margin,
            closures: edge.closures,
            closures_rejected: edge.closures_rejected,
            closure_residual_m: edge.closure_residual_m,
            tries: edge.tries,
        }
    }

    /// Whether a person may want to know of it: something was found, or taken back.
    pub fn is_news(&self) -> bool {
        self.state != EdgeState::None.name()
    }
}

impl fmt::Display for EdgeView {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [x, y, yaw] = self.a_from_b;
        write!(
            f,
            "{} {} {}: x {x:.2} m, y {y:.2} m, {:.1} degrees; {} walls found again, F1 {:.2} (chance {:.2}), {:.0} m2 shared, {} closures",
            self.a,
            self.b,
            self.state,
            yaw.to_degrees(),
            self.inliers,
            self.occupied_f1,
            self.null_f1_max,
            self.overlap_m2,
            self.closures
        )
    }
}

/// All edges, for programs: the same on `/merge_edges`, from `mr-slam edges --json` and in reports.
pub fn json(edges: &MergeEdges) -> String {
    let views: Vec<EdgeView> = edges.edges().iter().map(EdgeView::new).collect();
    serde_json::to_string(&serde_json::json!({ "edges": views })).unwrap_or_default()
}

/// A table for a terminal.
pub fn table(edges: &[EdgeView]) -> String {
    let mut text = format!(
        "{:>4} {:<15} {:<9} {:>9} {:>9} {:>8} {:>8} {:>8} {:>10} {:>5} {:>5} {:>9}\n",
        "edge",
        "robots",
        "state",
        "x m",
        "y m",
        "yaw deg",
        "inliers",
        "shared",
        "resid. mm",
        "F1",
        "null",
        "closures"
    );
    for e in edges {
        let [x, y, yaw] = e.a_from_b;
        let _ = writeln!(
            text,
            "{:>4} {:<15} {:<9} {x:>9.3} {y:>9.3} {:>8.2} {:>8} {:>5.0} m2 {:>10.0} {:>5.2} {:>5.2} {:>5} -{:>2}",
            e.edge,
            format!("{} {}", e.a, e.b),
            e.state,
            yaw.to_degrees(),
            e.inliers,
            e.overlap_m2,
            1e3 * e.residual_m,
            e.occupied_f1,
            e.null_f1_max,
            e.closures,
            e.closures_rejected
        );
    }
    text
}
