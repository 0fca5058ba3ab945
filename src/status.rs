//! `mr-slam status`: describes a running fleet.

use crate::observer::Observer;
use crate::run::{Run, RunError};
use crate::view::FleetView;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Describe a running fleet
#[derive(Clone, Debug, clap::Args)]
pub struct StatusArgs {
    /// The run's folder; without it, the fleet started last
    #[arg(long, value_name = "DIR")]
    pub run_dir: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Figures come once a second; a fleet that starts needs some more.
const PATIENCE: Duration = Duration::from_secs(5);

/// Prints the newest figures of a running fleet.
pub fn status(args: &StatusArgs) -> Result<(), RunError> {
    let dir = match &args.run_dir {
        Some(dir) => dir.clone(),
        None => Run::living().pop().ok_or(RunError::NoneRunning)?,
    };
    let run = Run::open(&dir)?;
    if !std::path::Path::new(&format!("/proc/{}", run.pid)).exists() {
        return Err(RunError::NoneRunning);
    }
    let mut observer = Observer::attach(&run, "status")?;
    let begun = Instant::now();
    while !observer.look() && !observer.wait(PATIENCE) {
        if begun.elapsed() > PATIENCE {
            let why = format!("no figures came within {} s; is telemetry up?", PATIENCE.as_secs());
            return Err(RunError::File { path: dir, why });
        }
    }
    let Some(stats) = observer.stats() else { return Err(RunError::NoneRunning) };
    let fleet = FleetView::new(stats);
    if args.json {
        println!("{}", serde_json::to_string_pretty(&fleet).unwrap_or_default());
    } else {
        println!("run {} on port {}, {:.0} s", dir.display(), run.port, fleet.time_s);
        print!("{}\n{}", fleet.table(), fleet.process_table());
    }
    Ok(())
}
