//! The pause of a robot's SLAM, which outlives its process: a file beside the session says that it is paused.

use super::FrontCommand;
use super::back_end::WorkerState;
use super::files::FileOperation;
use super::refused::{FileJobError, RequestRefused};
use super::services::{RequestOutcome, RequestResult, Services};
use crate::ports::Ports;
use crate::run::Run;
use crate::sessions;
use crate::storage::Storage;
use msg::{RobotId, SlamRequest, SlamRequestKind};
use std::fmt::Display;
use std::io::ErrorKind;
use std::path::PathBuf;

/// Returns the file that a run has while a robot's SLAM is paused.
pub(super) fn marker(run: &Run, robot: RobotId) -> PathBuf {
    sessions::pause_marker(&sessions::folder(run), robot)
}

/// Returns whether an earlier process of this run was paused. If that cannot be read, it may have been, and a person decides.
pub(super) fn was_paused(storage: &impl Storage, run: &Run, robot: RobotId) -> bool {
    let marker = marker(run, robot);
    match storage.read(&marker, 1) {
        Ok(_) => true,
        Err(why) if why.kind() == ErrorKind::NotFound => false,
        Err(why) => {
            tracing::warn!(
                "slam of {robot}: {}: {why}; it is paused, as it may have been before",
                marker.display()
            );
            true
        }
    }
}

impl<P: Ports> Services<P> {
    /// Pauses SLAM or goes on at once, whatever the disk does. The answer comes when the file is written, or could not be.
    pub(super) fn pause(
        &mut self,
        pauses: bool,
        request: &SlamRequest,
        state: &mut WorkerState,
    ) -> RequestResult {
        let work = if pauses { FileOperation::Replace(Vec::new()) } else { FileOperation::Remove };
        let is_submitted = state.submit_file_job(Some(request), self.pause_marker.clone(), work);
        self.paused = pauses;
        state.commands.send(FrontCommand::Pause(pauses));
        match is_submitted {
            true => Ok(RequestOutcome::Deferred),
            false => Ok(RequestOutcome::Done(text(pauses, Some(&RequestRefused::TooManyFiles)))),
        }
    }
}

/// Returns the answer to a request that has paused SLAM or has it go on; `unwritten`: why its file is not as it should be.
fn text(pauses: bool, unwritten: Option<&dyn Display>) -> String {
    let done = if pauses { "new scans are not looked at" } else { "scans are looked at again" };
    unwritten.map_or_else(
        || done.into(),
        |why| format!("{done}, but a process that is started again would not know it: {why}"),
    )
}

/// Returns the answer to a request that has paused SLAM or has it go on, and whose file was written or could not be; `None` for
/// other requests.
pub(super) fn answer(request: &SlamRequest, written: Result<(), &FileJobError>) -> Option<String> {
    let pauses = match SlamRequestKind::from_code(request.kind)? {
        SlamRequestKind::Pause => true,
        SlamRequestKind::Resume => false,
        _ => return None,
    };
    let answer = text(pauses, written.as_ref().err().map(|why| why as &dyn Display));
    if written.is_err() {
        tracing::warn!("slam: {answer}");
    }
    Some(answer)
}
