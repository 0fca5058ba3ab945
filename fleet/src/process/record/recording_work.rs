//! The work of a recorder, which is done at once or later.

use super::topics::Recorder;
use crate::recording_files::RecordingCounts;
use crate::spare_time::{Action, JobExecutor};
use std::sync::Arc;

/// Encodes and writes messages; counts those for which too much waits.
pub struct RecordingWork {
    pub(super) work: JobExecutor<Recorder>,
    pub(super) counts: Arc<RecordingCounts>,
}

impl RecordingWork {
    /// Records a message that takes so many bytes of memory while it waits.
    pub(super) fn record(&mut self, bytes: usize, record: Action<Recorder>) {
        if !self.work.push(bytes, record) {
            self.counts.add_dropped(1);
        }
    }
}
