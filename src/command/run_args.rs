//! Choice of the running fleet that a tool looks at or changes.

use super::output;
use crate::run::{Run, RunError, RunningFleets};
use std::path::PathBuf;

/// Choice of the running fleet.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct RunArgs {
    /// Folder of the run; needed if several fleets run and something is to be changed [default: the newest run]
    #[arg(long, value_name = "DIR", global = true)]
    pub run_dir: Option<PathBuf>,
}

impl RunArgs {
    /// Opens the running fleet to look at it. Without `--run-dir`, it is the fleet that was started last.
    pub fn open(&self) -> Result<Run, RunError> {
        match &self.run_dir {
            Some(dir) => Run::open_running(dir),
            None => open_newest(RunningFleets::find()),
        }
    }

    /// Opens the running fleet to change it. If several run, `--run-dir` must say which.
    pub fn open_to_change(&self) -> Result<Run, RunError> {
        if let Some(dir) = &self.run_dir {
            return Run::open_running(dir);
        }
        let fleets = RunningFleets::find();
        if fleets.runs.len() > 1 {
            return Err(RunError::SeveralRunning { runs: fleets.runs });
        }
        open_newest(fleets)
    }
}

fn open_newest(mut fleets: RunningFleets) -> Result<Run, RunError> {
    match fleets.runs.pop() {
        Some(dir) => {
            fleets.lost.iter().for_each(|fleet| output::note(&fleet.to_string()));
            Run::open_running(&dir)
        }
        None if !fleets.lost.is_empty() => Err(RunError::Lost(fleets.lost)),
        None if !fleets.others.is_empty() => Err(RunError::OthersRunning(fleets.others)),
        None => Err(RunError::NoneRunning),
    }
}
