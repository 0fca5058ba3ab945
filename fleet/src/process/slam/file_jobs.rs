//! The queue of jobs to the file worker, and for how long the disk has not answered.

use super::files::SlamFileJob;
use msg::Monotonic;
use std::sync::mpsc::SyncSender;
use std::time::Duration;

/// Longest time for which an answer waits for a small file or for the session, after the disk has answered last.
pub(super) const DISK_PATIENCE: Duration = Duration::from_secs(3);
/// Longest time for which an answer waits for a file that was asked for, which may be large.
pub(super) const FILE_PATIENCE: Duration = Duration::from_secs(10);

/// The sending end of the queue to the file worker.
pub(super) struct FileJobs {
    queue: SyncSender<SlamFileJob>,
    /// Jobs whose outcome has not come.
    outstanding: usize,
    /// When the oldest of them came to the worker.
    since: Monotonic,
}

impl FileJobs {
    /// Creates a queue with no job.
    pub fn new(queue: SyncSender<SlamFileJob>) -> Self {
        Self { queue, outstanding: 0, since: Monotonic(0) }
    }

    /// Submits a job; returns false if the queue is full.
    pub fn submit(&mut self, job: SlamFileJob, now: Monotonic) -> bool {
        let is_submitted = self.queue.try_send(job).is_ok();
        if is_submitted {
            if self.outstanding == 0 {
                self.since = now;
            }
            self.outstanding += 1;
        }
        is_submitted
    }

    /// Submits the last job of the process, and waits for room.
    pub fn submit_last(&self, job: SlamFileJob) {
        let _ = self.queue.send(job);
    }

    /// Records that the outcome of a job has come.
    pub fn finish(&mut self, now: Monotonic) {
        self.outstanding = self.outstanding.saturating_sub(1);
        self.since = now;
    }

    /// Returns for how long the disk has not answered; zero if nothing is to be done.
    pub fn silence(&self, now: Monotonic) -> Duration {
        if self.outstanding == 0 { Duration::ZERO } else { Duration::from_nanos(now.since(self.since)) }
    }
}
