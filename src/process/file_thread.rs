//! A thread that reads and writes files beside the loop of a process.
//!
//! A disk may not answer for seconds while others write much. A loop that sends velocities must not wait for it.

use crate::time_slice;
use std::io;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;
use tokio::sync::oneshot;

/// Most jobs that wait for the disk; further ones are refused.
const JOBS_MAX: usize = 8;

/// Files, with what is done to them.
pub trait FileJobs: 'static {
    /// Something to be done with the files.
    type Job: Send + 'static;
    /// What came of a job.
    type Report: Send + 'static;

    /// Does a job.
    fn run(&mut self, job: &Self::Job) -> Self::Report;
}

/// Does jobs in the order in which they were submitted.
pub trait JobWorker<J, R> {
    /// Submits a job. The report is an error if the job was refused, because too many wait.
    fn submit(&mut self, job: J) -> oneshot::Receiver<R>;
}

/// Does a job at once: for lockstep, where the disk is in memory.
pub struct ImmediateJobs<F>(pub F);

impl<F: FileJobs> JobWorker<F::Job, F::Report> for ImmediateJobs<F> {
    fn submit(&mut self, job: F::Job) -> oneshot::Receiver<F::Report> {
        let (sender, receiver) = oneshot::channel();
        // The receiver is still here.
        let _ = sender.send(self.0.run(&job));
        receiver
    }
}

/// A thread that does the jobs.
pub struct JobThread<J, R> {
    /// `None` once the thread is to end.
    jobs: Option<SyncSender<(J, oneshot::Sender<R>)>>,
    thread: Option<JoinHandle<()>>,
}

impl<J: Send + 'static, R: Send + 'static> JobThread<J, R> {
    /// Starts the thread.
    pub fn start<F: FileJobs<Job = J, Report = R> + Send>(mut files: F) -> io::Result<Self> {
        let (sender, jobs) = sync_channel::<(J, oneshot::Sender<R>)>(JOBS_MAX);
        let thread = std::thread::Builder::new().name("files".into()).spawn(move || {
            time_slice::request_default();
            for (job, report) in jobs {
                // The sender of the job may have gone.
                let _ = report.send(files.run(&job));
            }
        })?;
        Ok(Self { jobs: Some(sender), thread: Some(thread) })
    }
}

impl<J, R> JobWorker<J, R> for JobThread<J, R> {
    fn submit(&mut self, job: J) -> oneshot::Receiver<R> {
        let (sender, receiver) = oneshot::channel();
        // A job that is refused drops its sender, which tells the receiver.
        if let Some(jobs) = &self.jobs {
            let _ = jobs.try_send((job, sender));
        }
        receiver
    }
}

impl<J, R> Drop for JobThread<J, R> {
    /// Waits until the last job is done: a process that ends leaves its state.
    fn drop(&mut self) {
        self.jobs = None;
        let _ = self.thread.take().map(JoinHandle::join);
    }
}
