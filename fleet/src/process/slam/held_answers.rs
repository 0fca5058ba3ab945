//! Answers that wait for the disk, each for a few seconds at most: what is answered as done is saved, else the answer says what is not.

use super::back_end::WorkerState;
use super::file_jobs::{DISK_PATIENCE, FILE_PATIENCE};
use super::files::FileOperation;
use super::pausing;
use super::refused::RequestRefused;
use super::services::{RequestOutcome, RequestResult, Services};
use crate::ports::Ports;
use msg::{Monotonic, SlamRequest, SlamRequestKind};
use std::collections::VecDeque;
use std::path::PathBuf;
use std::time::Duration;

/// Answers that wait for a save of the session; further ones are given at once.
const HELD_MAX: usize = 16;

/// Requests that were done, or whose files are read or written, and that have no answer yet.
#[derive(Default)]
pub(super) struct HeldAnswers {
    /// Changes of the map, which the session must have.
    changes: Vec<HeldChange>,
    /// Requests with a file, in the order of their jobs.
    files: VecDeque<FileRequest>,
}

/// Request that has changed the map.
struct HeldChange {
    request: Box<SlamRequest>,
    /// Answer to give when it is saved.
    text: String,
    /// Number of the save that has the change.
    save: u64,
    since: Monotonic,
}

/// Request whose file is read or written.
struct FileRequest {
    request: Box<SlamRequest>,
    path: PathBuf,
    since: Monotonic,
    /// The disk did not answer in time, which was said.
    is_answered: bool,
}

/// Returns whether the session must be saved anew for a request to outlive the process.
fn changes_session(request: &SlamRequest) -> bool {
    use SlamRequestKind::{Relocalize, SetPose};
    let kind = SlamRequestKind::from_code(request.kind);
    kind.is_some_and(|kind| kind.changes_map() && !matches!(kind, SetPose | Relocalize))
}

impl HeldAnswers {
    /// Records that a job for a request was submitted.
    pub fn add_file(&mut self, request: &SlamRequest, path: PathBuf, now: Monotonic) {
        let request = Box::new(*request);
        self.files.push_back(FileRequest { request, path, since: now, is_answered: false });
    }

    /// Records the outcome of the oldest job for a request. Returns whether the request still waits for its answer.
    pub fn finish_file(&mut self) -> bool {
        self.files.pop_front().is_none_or(|oldest| !oldest.is_answered)
    }

    /// Holds the answer to a request that was done until its change is saved. Returns the text if it needs not wait, or no more can.
    pub fn hold(&mut self, request: &SlamRequest, text: String, state: &mut WorkerState) -> Option<String> {
        if !changes_session(request) || self.changes.len() >= HELD_MAX {
            return Some(text);
        }
        let Some(save) = state.save_now() else { return Some(text) };
        self.changes.push(HeldChange { request: Box::new(*request), text, save, since: state.now() });
        None
    }

    /// Takes the answers that need not wait any longer.
    fn take_due(&mut self, state: &WorkerState) -> Vec<(Box<SlamRequest>, RequestResult)> {
        let now = state.now();
        let waited = |since: Monotonic| Duration::from_nanos(now.since(since));
        let silence = state.disk_silence();
        let mut due: Vec<(Box<SlamRequest>, RequestResult)> = Vec::new();
        for file in self.files.iter_mut().filter(|file| !file.is_answered) {
            let kind = SlamRequestKind::from_code(file.request.kind);
            let is_pause = matches!(kind, Some(SlamRequestKind::Pause | SlamRequestKind::Resume));
            let patience = if is_pause { DISK_PATIENCE } else { FILE_PATIENCE };
            if silence < patience || waited(file.since) < patience {
                continue;
            }
            file.is_answered = true;
            let silent = RequestRefused::DiskSilent { path: file.path.clone(), seconds: silence.as_secs() };
            due.push((file.request.clone(), pausing::unwritten(&file.request, &silent).ok_or(silent)));
        }
        for change in std::mem::take(&mut self.changes) {
            let outcome = match state.outcome_of_save(change.save) {
                Some(Ok(())) => RequestOutcome::Done(change.text),
                Some(Err(why)) => not_saved(&change.text, why),
                None if waited(change.since) < DISK_PATIENCE => {
                    self.changes.push(change);
                    continue;
                }
                None => {
                    let why = match silence.as_secs() {
                        0 => format!("the save has not ended within {} s", DISK_PATIENCE.as_secs()),
                        seconds => format!("the disk has not answered for {seconds} s"),
                    };
                    not_saved(&change.text, &why)
                }
            };
            due.push((change.request, Ok(outcome)));
        }
        due
    }
}

/// Returns the outcome of a request that was done and is not saved.
fn not_saved(text: &str, why: &str) -> RequestOutcome {
    RequestOutcome::NotSaved(format!(
        "{text}; NOT SAVED yet, a process that is started again would not know it: {why}"
    ))
}

impl<P: Ports> Services<P> {
    /// Submits a job for a request, whose answer comes with the job's outcome.
    pub(super) fn submit(
        &mut self,
        state: &mut WorkerState,
        request: &SlamRequest,
        path: PathBuf,
        work: FileOperation,
    ) -> RequestResult {
        if !state.submit_file_job(Some(request), path.clone(), work) {
            return Err(RequestRefused::TooManyFiles);
        }
        self.held.add_file(request, path, state.now());
        Ok(RequestOutcome::Deferred)
    }

    /// Gives the answers that have waited for the disk: what they wait for has happened, or they have waited long enough.
    pub(super) fn answer_held(&mut self, state: &mut WorkerState) {
        for (request, outcome) in self.held.take_due(state) {
            // What is loaded too late is not used.
            self.loading &= request.kind != SlamRequestKind::LoadSession as u32 || outcome.is_ok();
            self.send_response(&request, outcome, state);
        }
    }
}

impl WorkerState {
    /// Returns the outcome of a request that was done, with why the last save failed if the request changes the session.
    pub(super) fn with_unsaved_note(&self, request: &SlamRequest, text: String) -> RequestOutcome {
        match self.autosave.error().filter(|_| changes_session(request)) {
            Some(why) => not_saved(&text, why),
            None => RequestOutcome::Done(text),
        }
    }

    /// Returns the moment of this step.
    pub fn now(&self) -> Monotonic {
        self.now
    }

    /// Returns for how long the disk has not answered.
    pub fn disk_silence(&self) -> Duration {
        self.jobs.silence(self.now)
    }

    /// Saves the session at once if it has changed. Returns the number of the save that has all changes; `None`: nothing is to be saved.
    pub fn save_now(&mut self) -> Option<u64> {
        self.autosave.save_now(self.now)
    }

    /// Returns whether this save succeeded, or why it failed; `None`: it has not ended.
    pub fn outcome_of_save(&self, save: u64) -> Option<Result<(), &str>> {
        self.autosave.outcome(save)
    }
}
