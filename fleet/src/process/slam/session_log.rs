//! The log beside a robot's session: nodes since the session was saved, appended to a file as they come.
//!
//! Two files take turns: while a session is written, records go to the other one, and those of the first stay until the
//! session is whole. A change that records cannot repeat (a loaded map, undone closures, a lost robot) suspends the
//! log until a session with that change is saved.

use super::file_jobs::FileJobs;
use super::files::{FileOperation, SlamFileJob};
use super::keep_written;
use crate::run::Run;
use crate::session_records::{self, FILE_BYTES_MAX, Records, WAITING_BYTES_MAX};
use crate::sessions;
use crate::storage::Storage;
use ::slam::session::log::{LogPosition, LogRecord, LogRecordBuilder};
use ::slam::{FrontEndState, LocalFrameEstimate, Node, SessionIdentity};
use msg::{Monotonic, RobotId};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Time from a node to the request of its record. With the scan path's answer at its next scan (0.1 s) and the write,
/// nodes older than 0.5 s are in the file.
const RECORD_PERIOD: Duration = Duration::from_millis(200);

/// The newest record that was read, and where the next one goes.
#[derive(Clone, Copy, Debug, Default)]
pub struct LogEnd {
    /// Place of the newest record.
    pub newest: LogPosition,
    /// Index of the file with it.
    file: usize,
    /// Bytes of that file up to its end.
    end: u64,
    /// Whether a file has records that the session has not.
    has_records: bool,
}

/// Writer of the log, on the back-end thread; the file worker writes the bytes.
pub(super) struct SessionLog {
    waiting: LogRecordBuilder,
    files: [PathBuf; 2],
    to: LogEnd,
    /// The other file's records are in no saved session yet.
    other_is_needed: bool,
    /// Moment of the first node that waits.
    waits_since: Option<Monotonic>,
    /// A record is requested from the scan path.
    pub is_requested: bool,
    /// Nothing is recorded until a session is saved.
    suspended: bool,
    /// The session that is being saved is to end a suspension.
    resumes: bool,
    /// Autosave is off, and so is the log.
    is_off: bool,
    /// The last write failed, which was said.
    failed: bool,
}

impl SessionLog {
    pub fn new(run: &Run, robot: RobotId, to: LogEnd) -> Self {
        Self {
            waiting: LogRecordBuilder::default(),
            files: files(run, robot),
            to,
            other_is_needed: to.has_records,
            waits_since: None,
            is_requested: false,
            suspended: false,
            resumes: false,
            is_off: run.config.sessions.autosave_s == 0.0,
            failed: false,
        }
    }

    /// Records a node before the back end receives it. `is_repeatable`: whether a restart can do the same with it.
    pub fn add(
        &mut self,
        node: &Node,
        begins_at: Option<LocalFrameEstimate>,
        is_repeatable: bool,
        now: Monotonic,
    ) {
        if self.is_off || self.suspended {
            return;
        }
        if !is_repeatable || self.waiting.len() > WAITING_BYTES_MAX || self.to.end > FILE_BYTES_MAX {
            return self.suspend();
        }
        self.waiting.add(node, begins_at);
        self.waits_since.get_or_insert(now);
    }

    /// Stops recording until a session is saved.
    pub fn suspend(&mut self) {
        self.suspended = !self.is_off;
        self.waiting.clear();
        (self.waits_since, self.is_requested) = (None, false);
    }

    /// Returns whether a session must be saved, because nothing is recorded until then.
    pub fn needs_session(&self) -> bool {
        self.suspended
    }

    /// Returns whether the scan path's state is to be requested for a record.
    pub fn is_due(&self, now: Monotonic) -> bool {
        let waits = self.waits_since.map(|since| Duration::from_nanos(now.since(since)));
        !self.is_requested && waits.is_some_and(|waits| waits >= RECORD_PERIOD)
    }

    /// Moment at which [`SessionLog::is_due`] becomes true.
    pub fn due(&self) -> Option<Monotonic> {
        let since = self.waits_since.filter(|_| !self.is_requested)?;
        Some(Monotonic(since.0 + RECORD_PERIOD.as_nanos() as u64))
    }

    /// Writes the nodes that wait as one record, with the front end's state after them.
    pub fn write(
        &mut self,
        identity: &SessionIdentity,
        front: &FrontEndState,
        jobs: &mut FileJobs,
        now: Monotonic,
    ) {
        self.is_requested = false;
        if self.suspended || self.waiting.is_empty() {
            return;
        }
        self.waits_since = None;
        let bytes = match self.waiting.encode(identity, &mut self.to.newest, front) {
            Ok(bytes) => bytes,
            Err(why) => {
                self.report_failure(&why);
                return self.suspend();
            }
        };
        let (at, length) = (self.to.end, bytes.len() as u64);
        let path = self.files[self.to.file].clone();
        let work = FileOperation::Append { at, bytes };
        if !jobs.submit(SlamFileJob { request: None, path, work }, now) {
            return self.suspend();
        }
        self.to.end += length;
    }

    /// A session with all records so far, or in place of a suspended log, is about to be saved. Returns its place in the
    /// log. Records go to the other file from now on, if that is free.
    pub fn begin_session(&mut self) -> LogPosition {
        if self.suspended {
            // No record follows from the one before.
            self.to.newest.number += 1;
            (self.suspended, self.resumes) = (false, true);
        }
        if !self.other_is_needed {
            (self.to.file, self.to.end) = (1 - self.to.file, 0);
            self.other_is_needed = true;
        }
        self.to.newest
    }

    /// A session was saved, or could not be.
    pub fn finish_session(&mut self, is_saved: bool) {
        if std::mem::take(&mut self.resumes) && !is_saved {
            self.suspend();
        }
        if is_saved {
            self.other_is_needed = false;
            if std::mem::take(&mut self.failed) {
                tracing::warn!("slam: the session log is written again");
            }
        }
    }

    /// A record was written to a file at a place, or could not be.
    pub fn finish_record(&mut self, path: &Path, at: u64, error: Option<&str>) {
        if let Some(why) = error {
            if path == self.files[self.to.file] {
                self.to.end = self.to.end.min(at);
            }
            self.report_failure(&why);
            self.suspend();
        }
    }

    /// Says once that records are not written.
    fn report_failure(&mut self, why: &dyn std::fmt::Display) {
        if !std::mem::replace(&mut self.failed, true) {
            tracing::warn!(
                "slam: the session log is not written: {why}; mapping goes on, and the session is tried again"
            );
        }
    }
}

/// Returns the two log files of a robot in the run's folder.
fn files(run: &Run, robot: RobotId) -> [PathBuf; 2] {
    session_records::files(&sessions::file(&sessions::folder(run), robot))
}

/// Reads the records that follow a session at `newest`, and where the next record goes.
pub(super) fn read(
    storage: &impl Storage,
    run: &Run,
    robot: RobotId,
    newest: LogPosition,
) -> (Vec<LogRecord>, LogEnd) {
    let files = files(run, robot);
    let Records { chain, end, unreadable } =
        session_records::read(storage, &files, &sessions::identity(run, robot), newest);
    for (file, why) in &unreadable {
        let kept = keep_written(run, storage, file);
        tracing::warn!("{}: {why}; its nodes are left out; {kept}", file.display());
    }
    let to = match (chain.last(), end) {
        (Some(last), Some((file, end))) => LogEnd { newest: last.position, file, end, has_records: true },
        _ => LogEnd { newest, ..LogEnd::default() },
    };
    (chain, to)
}
