//! The files of [`super::Control`], read and written beside the bridge's loop.
//!
//! A disk may not answer for seconds while others write much. The bridge sends zeros to robots whose driver is gone meanwhile.

use super::permission_files::PermissionFiles;
use super::saved_state::{BridgeSnapshot, SavedFiles};
use crate::storage::Storage;
use std::io;
use std::net::IpAddr;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;
use tokio::sync::oneshot;

/// Most jobs that wait for the disk; further ones are refused.
const JOBS_MAX: usize = 8;

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
    /// Number of stops found in the stop's file since the start; see [`SavedFiles::update`].
    pub stops_found: u64,
    /// Whether an address was kept.
    pub result: io::Result<()>,
}

/// The files, with what to do about a job.
pub struct ControlFiles<S> {
    /// What a restarted bridge continues with.
    pub saved: SavedFiles<S>,
    /// Who may drive in later runs, and who may not in this one.
    pub permissions: PermissionFiles<S>,
}

impl<S: Storage> ControlFiles<S> {
    fn run(&mut self, job: &FileJob) -> FileReport {
        match job {
            FileJob::Update(snapshot) => {
                FileReport { stops_found: self.saved.update(snapshot), result: Ok(()) }
            }
            FileJob::Remember { address, may_drive } => FileReport {
                stops_found: self.saved.stops_found(),
                result: self.permissions.remember(*address, *may_drive),
            },
        }
    }
}

/// Does jobs in the order in which they were submitted.
pub trait FileWorker {
    /// Submits a job. The report is an error if the job was refused, because too many wait.
    fn submit(&mut self, job: FileJob) -> oneshot::Receiver<FileReport>;
}

/// Does a job at once: for lockstep, where the disk is in memory.
pub struct ImmediateFiles<S>(pub ControlFiles<S>);

impl<S: Storage> FileWorker for ImmediateFiles<S> {
    fn submit(&mut self, job: FileJob) -> oneshot::Receiver<FileReport> {
        let (sender, receiver) = oneshot::channel();
        // The receiver is still here.
        let _ = sender.send(self.0.run(&job));
        receiver
    }
}

/// A thread that does the jobs.
pub struct FileThread {
    /// `None` once the thread is to end.
    jobs: Option<SyncSender<(FileJob, oneshot::Sender<FileReport>)>>,
    thread: Option<JoinHandle<()>>,
}

impl FileThread {
    /// Starts the thread.
    pub fn start<S: Storage + Send>(mut files: ControlFiles<S>) -> io::Result<Self> {
        let (sender, jobs) = sync_channel::<(FileJob, oneshot::Sender<FileReport>)>(JOBS_MAX);
        let thread = std::thread::Builder::new().name("files".into()).spawn(move || {
            for (job, report) in jobs {
                // Who asked may have gone.
                let _ = report.send(files.run(&job));
            }
        })?;
        Ok(Self { jobs: Some(sender), thread: Some(thread) })
    }
}

impl FileWorker for FileThread {
    fn submit(&mut self, job: FileJob) -> oneshot::Receiver<FileReport> {
        let (sender, receiver) = oneshot::channel();
        // A job that is refused drops its sender, which tells the receiver.
        if let Some(jobs) = &self.jobs {
            let _ = jobs.try_send((job, sender));
        }
        receiver
    }
}

impl Drop for FileThread {
    /// Waits until the last job is done: a bridge that ends leaves its state.
    fn drop(&mut self) {
        self.jobs = None;
        let _ = self.thread.take().map(JoinHandle::join);
    }
}
