//! Tool `mr-slam status`, which shows the newest figures of a running fleet.

use super::output;
use super::run_args::RunArgs;
use crate::control::{self, Request};
use crate::observer::Observer;
use crate::ports::ChannelError;
use crate::run::{Run, RunError};
use crate::terminal;
use reports::FleetView;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Show the figures of a running fleet
#[derive(Clone, Debug, clap::Args)]
pub struct StatusArgs {
    /// Choice of the running fleet.
    #[command(flatten)]
    pub run: RunArgs,
    /// Print the figures as JSON
    #[arg(long)]
    pub json: bool,
}

/// How long figures may take: they come once a second, and a fleet that starts needs some more.
const PATIENCE: Duration = Duration::from_secs(5);

/// Reason why no figures were shown.
#[derive(Debug, thiserror::Error)]
pub enum StatusError {
    /// No run, or not the one that was named.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Shared memory of the run.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// Telemetry did not send figures.
    #[error("run {}: no figures came within {PATIENCE:?}; telemetry may be restarting, try again", run.display())]
    NoFigures {
        /// Folder of the run.
        run: PathBuf,
    },
    /// The figures cannot be written to standard output.
    #[error("cannot print the figures: {0}")]
    Print(#[from] std::io::Error),
}

/// Prints the newest figures of a running fleet.
pub fn run(args: &StatusArgs) -> Result<(), StatusError> {
    let run = args.run.open()?;
    let fleet = newest_figures(&run)?;
    let text = || {
        let age_s = crate::clock::now().since(run.begun) as f64 * 1e-9;
        let heading = format!("run {} on port {}, {age_s:.0} s\n", run.dir.display(), run.port);
        let style = terminal::style(&std::io::stdout());
        format!("{heading}{}\n{}", fleet.table(&style), fleet.process_table(&style))
    };
    Ok(output::print_either(args.json, &fleet, text)?)
}

fn newest_figures(run: &Run) -> Result<FleetView, StatusError> {
    let mut observer = Observer::attach(run, "status")?;
    let begun = Instant::now();
    while !observer.poll() && !observer.wait(PATIENCE) && begun.elapsed() <= PATIENCE {}
    let stats = observer.stats().ok_or(StatusError::NoFigures { run: run.dir.clone() })?;
    let view = FleetView::new(stats).without_given_transforms(run.config.fleet.starts_known);
    observer.changed_edges();
    // Figures without the bridge's state are still worth having: it may just be restarting.
    let bridge = control::ask(run, Request::State, PATIENCE).ok();
    Ok(FleetView { bridge, ..view.with_edges(observer.merge_edges()) })
}
