//! `mr-slam status`: describes a running fleet.

use crate::control::{self, Request, RunArgs};
use crate::observer::Observer;
use crate::run::RunError;
use crate::view::FleetView;
use std::time::{Duration, Instant};

/// Describe a running fleet
#[derive(Clone, Debug, clap::Args)]
pub struct StatusArgs {
    /// Which fleet.
    #[command(flatten)]
    pub run: RunArgs,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Figures come once a second; a fleet that starts needs some more.
const PATIENCE: Duration = Duration::from_secs(5);

/// Prints the newest figures of a running fleet.
pub fn status(args: &StatusArgs) -> Result<(), RunError> {
    let run = args.run.open()?;
    let mut observer = Observer::attach(&run, "status")?;
    let begun = Instant::now();
    while !observer.look() && !observer.wait(PATIENCE) {
        if begun.elapsed() > PATIENCE {
            let why = format!("no figures came within {} s; is telemetry up?", PATIENCE.as_secs());
            return Err(RunError::File { path: run.dir, why });
        }
    }
    let Some(mut fleet) = observer.stats().map(FleetView::new) else { return Err(RunError::NoneRunning) };
    // Figures without the bridge's account are still worth having: it may just be starting again.
    observer.edge_news();
    fleet.merge_edges = observer.merge_edges();
    fleet.doors = control::ask(&run, Request::State, PATIENCE).ok();
    if args.json {
        println!("{}", serde_json::to_string_pretty(&fleet).unwrap_or_default());
    } else {
        let age_s = crate::clock::now().since(run.begun) as f64 * 1e-9;
        println!("run {} on port {}, {age_s:.0} s", run.dir.display(), run.port);
        print!("{}\n{}", fleet.table(), fleet.process_table());
    }
    Ok(())
}
