//! The files of [`super::Control`], read and written beside the bridge's loop.

use super::permission_files::PermissionFiles;
use super::saved_state::{BridgeSnapshot, SavedFiles};
use crate::job_thread::{ImmediateJobs, JobRunner, JobThread, JobWorker};
use crate::storage::Storage;
use std::io;
use std::net::IpAddr;

/// Something to be done with the files.
#[derive(Clone, Debug, PartialEq)]
pub enum FileJob {
    /// Write what has changed, and see whether `mr-slam stop` has written the stop's file.
    Update(BridgeSnapshot),
    /// Keep whether an address may drive.
    Remember {
        /// Address of the client.
        address: IpAddr,
        /// Whether it may drive.
        may_drive: bool,
    },
}

/// What came of a job.
#[derive(Debug)]
pub struct FileReport {
    /// Number of stops found in the stop's file since the start; see [`SavedFiles::stops_found`].
    pub stops_found: u64,
    /// Whether everything was written.
    pub result: io::Result<()>,
}

/// The files, with what to do about a job.
pub struct ControlFiles<S> {
    /// What a restarted bridge continues with.
    pub saved: SavedFiles<S>,
    /// Who may drive in later runs, and who may not in this one.
    pub permissions: PermissionFiles<S>,
}

impl<S: Storage> JobRunner for ControlFiles<S> {
    type Job = FileJob;
    type Report = FileReport;

    fn run(&mut self, job: &FileJob) -> FileReport {
        match job {
            FileJob::Update(snapshot) => {
                let result = self.saved.update(snapshot);
                FileReport { stops_found: self.saved.stops_found(), result }
            }
            FileJob::Remember { address, may_drive } => FileReport {
                stops_found: self.saved.stops_found(),
                result: self.permissions.remember(*address, *may_drive),
            },
        }
    }
}

/// Does the jobs of the bridge's files.
pub trait FileWorker: JobWorker<FileJob, FileReport> {}

impl<W: JobWorker<FileJob, FileReport>> FileWorker for W {}

/// Does a job of the bridge at once.
pub type ImmediateFiles<S> = ImmediateJobs<ControlFiles<S>>;

/// The thread of the bridge's files.
pub type FileThread = JobThread<FileJob, FileReport>;
