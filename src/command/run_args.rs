//! Choice of the running fleet that a tool looks at or changes.

use crate::run::{Run, RunError};
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
            None => Run::open_running(&Run::all_running().pop().ok_or(RunError::NoneRunning)?),
        }
    }

    /// Opens the running fleet to change it. If several run, `--run-dir` must say which.
    pub fn open_to_change(&self) -> Result<Run, RunError> {
        let runs = if self.run_dir.is_some() { Vec::new() } else { Run::all_running() };
        if runs.len() > 1 {
            return Err(RunError::SeveralRunning { runs });
        }
        self.open()
    }
}
