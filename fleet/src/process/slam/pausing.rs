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
        let path = self.pause_marker.clone();
        let is_submitted = state.submit_file_job(Some(request), path.clone(), work);
        if is_submitted {
            self.held.add_file(request, path, state.now());
        }
        self.paused = pauses;
        state.commands.send(FrontCommand::Pause(pauses));
        match is_submitted {
            true => Ok(RequestOutcome::Deferred),
            false => Ok(outcome(pauses, Some(&RequestRefused::TooManyFiles))),
        }
    }
}

/// Returns the outcome of a request that has paused SLAM or has it go on; `unwritten`: why its file is not as it should be.
fn outcome(pauses: bool, unwritten: Option<&dyn Display>) -> RequestOutcome {
    let done = if pauses { "new scans are not looked at" } else { "scans are looked at again" };
    let Some(why) = unwritten else { return RequestOutcome::Done(done.into()) };
    let text = format!("{done}; NOT SAVED, a process that is started again would not know it: {why}");
    tracing::warn!("slam: {text}");
    RequestOutcome::NotSaved(text)
}

/// Returns the outcome of a request that has paused SLAM or has it go on, and whose file was written or could not be; `None` for
/// other requests.
pub(super) fn answer(request: &SlamRequest, written: Result<(), &FileJobError>) -> Option<RequestOutcome> {
    Some(outcome(pauses(request)?, written.as_ref().err().map(|why| why as &dyn Display)))
}

/// Returns the outcome of a request that has paused SLAM or has it go on, and whose file is not written yet; `None` for other requests.
pub(super) fn unwritten(request: &SlamRequest, why: &dyn Display) -> Option<RequestOutcome> {
    Some(outcome(pauses(request)?, Some(why)))
}

/// Returns whether a request pauses SLAM, or has it go on; `None` for others.
fn pauses(request: &SlamRequest) -> Option<bool> {
    match SlamRequestKind::from_code(request.kind)? {
        SlamRequestKind::Pause => Some(true),
        SlamRequestKind::Resume => Some(false),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pause_whose_file_is_not_written_is_not_answered_as_done() {
        let full =
            FileJobError::Write { path: "robot1.paused".into(), source: ErrorKind::StorageFull.into() };
        for kind in [SlamRequestKind::Pause, SlamRequestKind::Resume] {
            let request = SlamRequest { kind: kind as u32, ..SlamRequest::default() };
            assert!(matches!(answer(&request, Ok(())), Some(RequestOutcome::Done(_))));
            let Some(RequestOutcome::NotSaved(text)) = answer(&request, Err(&full)) else {
                panic!("{kind:?}")
            };
            assert!(text.contains("NOT SAVED") && text.contains("robot1.paused"), "{text}");
        }
        let other = SlamRequest { kind: SlamRequestKind::Reset as u32, ..SlamRequest::default() };
        assert!(answer(&other, Err(&full)).is_none());
    }
}
