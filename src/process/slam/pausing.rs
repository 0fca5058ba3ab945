//! The pause of a robot's SLAM, which outlives its process: a file beside the session says that it is paused.

use super::FrontCommand;
use super::back_end::WorkerState;
use super::files::FileOperation;
use super::refused::FileJobError;
use super::services::{RequestOutcome, RequestResult, Services, submit_file_job};
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
    /// Pauses SLAM or goes on. The answer follows when a restarted process would know it.
    pub(super) fn pause(
        &mut self,
        pauses: bool,
        request: &SlamRequest,
        state: &mut WorkerState,
    ) -> RequestResult {
        let work = if pauses { FileOperation::Replace(Vec::new()) } else { FileOperation::Remove };
        let outcome = submit_file_job(state, request, self.pause_marker.clone(), work)?;
        self.paused = pauses;
        state.commands.send(FrontCommand::Pause(pauses));
        Ok(outcome)
    }
}

/// Returns the answer to a pause or a resumption whose file was written; `None` for other requests.
pub(super) fn answer(request: &SlamRequest, written: Result<(), &FileJobError>) -> Option<RequestOutcome> {
    let text = match SlamRequestKind::from_code(request.kind)? {
        SlamRequestKind::Pause => "new scans are not looked at",
        SlamRequestKind::Resume => "scans are looked at again",
        _ => return None,
    };
    Some(RequestOutcome::Done(match written {
        Ok(()) => text.into(),
        Err(why) => format!("{text}; but a restarted process would not know it: {why}"),
    }))
}
