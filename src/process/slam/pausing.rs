//! The pause of a robot's SLAM, which outlives its process: a file beside the session says that it is paused.

use super::FrontCommand;
use super::back_end::WorkerState;
use super::files::FileOperation;
use super::refused::FileJobError;
use super::services::{RequestOutcome, RequestResult, Services};
use crate::ports::Ports;
use crate::run::Run;
use crate::sessions;
use crate::storage::Storage;
use msg::{RobotId, SlamRequest, SlamRequestKind};
use std::path::PathBuf;

/// Returns the file that a run has while a robot's SLAM is paused.
pub(super) fn marker(run: &Run, robot: RobotId) -> PathBuf {
    sessions::pause_marker(&sessions::folder(run), robot)
}

/// Returns whether an earlier process of this run was paused.
pub(super) fn was_paused(storage: &impl Storage, run: &Run, robot: RobotId) -> bool {
    storage.read(&marker(run, robot), 1).is_ok()
}

impl<P: Ports> Services<P> {
    /// Pauses SLAM or goes on, whatever the disk does.
    pub(super) fn pause(
        &mut self,
        pauses: bool,
        request: &SlamRequest,
        state: &mut WorkerState,
    ) -> RequestResult {
        let work = if pauses { FileOperation::Replace(Vec::new()) } else { FileOperation::Remove };
        let is_written = state.submit_file_job(Some(request), self.pause_marker.clone(), work);
        self.paused = pauses;
        state.commands.send(FrontCommand::Pause(pauses));
        let text = if pauses { "new scans are not looked at" } else { "scans are looked at again" };
        let kept = if is_written {
            ""
        } else {
            "; but a restarted process would not know it: too many files are being written"
        };
        Ok(RequestOutcome::Done(format!("{text}{kept}")))
    }
}

/// Returns whether a request was answered before its file was written; says if the file could not be written.
pub(super) fn is_answered(request: &SlamRequest, written: Result<(), &FileJobError>) -> bool {
    let kind = SlamRequestKind::from_code(request.kind);
    let is_pause = matches!(kind, Some(SlamRequestKind::Pause | SlamRequestKind::Resume));
    if is_pause && let Err(why) = written {
        tracing::warn!("slam: a process that is started again would not know whether it is paused: {why}");
    }
    is_pause
}
