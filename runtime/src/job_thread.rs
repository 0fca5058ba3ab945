//! A thread that does the long jobs of a process beside its loop, such as those on files.
//!
//! A disk may not answer for seconds while others write much. A loop that sends velocities must not wait for it.

use crate::progress::ProgressCounter;
use crate::{realtime, time_slice};
use std::io;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;
use tokio::sync::oneshot;

/// Most jobs that wait for the thread; further ones are refused.
const JOBS_MAX: usize = 8;

/// Longest time after which a thread that is watched and has nothing to do says that it works.
const PROGRESS_PERIOD: Duration = Duration::from_secs(1);

/// Does jobs of one kind, and keeps what they need from one to the next.
pub trait JobRunner: 'static {
    /// Name of the thread that does the jobs.
    const THREAD: &'static str = "files";
    /// Niceness of that thread (nice(2)): 0 is the priority of its process.
    const NICENESS: i32 = 0;
    /// Whether jobs leave state, so that the process waits at its end until the last one is done.
    const LEAVES_STATE: bool = true;
    /// Something to be done.
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

/// Does a job at once: for lockstep, where the disk is in memory and a computation takes no time.
pub struct ImmediateJobs<R>(pub R);

impl<R: JobRunner> JobWorker<R::Job, R::Report> for ImmediateJobs<R> {
    fn submit(&mut self, job: R::Job) -> oneshot::Receiver<R::Report> {
        let (sender, receiver) = oneshot::channel();
        // The receiver is still here.
        let _ = sender.send(self.0.run(&job));
        receiver
    }
}

/// A job, and where its report goes.
type Submitted<J, R> = (J, oneshot::Sender<R>);

/// A thread that does the jobs.
pub struct JobThread<J, R> {
    /// `None` once the thread is to end.
    jobs: Option<SyncSender<Submitted<J, R>>>,
    /// `None` if nobody waits for its end.
    thread: Option<JoinHandle<()>>,
}

impl<J: Send + 'static, R: Send + 'static> JobThread<J, R> {
    /// Starts the thread.
    ///
    /// # Errors
    /// The system has no memory for a thread.
    pub fn start<W: JobRunner<Job = J, Report = R> + Send>(runner: W) -> io::Result<Self> {
        Self::start_with(runner, |jobs, do_job| jobs.into_iter().for_each(do_job))
    }

    /// Starts the thread, which the supervisor watches by `progress`: a job that hangs is noticed.
    ///
    /// # Errors
    /// The system has no memory for a thread.
    pub fn start_watched<W: JobRunner<Job = J, Report = R> + Send>(
        runner: W,
        mut progress: ProgressCounter,
    ) -> io::Result<Self> {
        Self::start_with(runner, move |jobs, do_job| {
            loop {
                progress.advance();
                match jobs.recv_timeout(PROGRESS_PERIOD) {
                    Ok(job) => do_job(job),
                    Err(RecvTimeoutError::Timeout) => {}
                    Err(RecvTimeoutError::Disconnected) => return,
                }
            }
        })
    }

    fn start_with<W: JobRunner<Job = J, Report = R> + Send>(
        mut runner: W,
        serve: impl FnOnce(Receiver<Submitted<J, R>>, &mut dyn FnMut(Submitted<J, R>)) + Send + 'static,
    ) -> io::Result<Self> {
        let (sender, jobs) = sync_channel(JOBS_MAX);
        let thread = std::thread::Builder::new().name(W::THREAD.into()).spawn(move || {
            match W::NICENESS {
                0 => time_slice::request_default(),
                niceness => realtime::work_in_background(niceness),
            }
            serve(jobs, &mut |(job, report)| {
                // The sender of the job may have gone.
                let _ = report.send(runner.run(&job));
            });
        })?;
        Ok(Self { jobs: Some(sender), thread: W::LEAVES_STATE.then_some(thread) })
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
    /// Waits until the last job is done where jobs leave state. A job that panicked ends the caller too: its state is lost.
    fn drop(&mut self) {
        self.jobs = None;
        if let Some(Err(why)) = self.thread.take().map(JoinHandle::join)
            && !std::thread::panicking()
        {
            std::panic::resume_unwind(why);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::{ProgressBoard, WatchedThread};
    use crate::shared_memory::Domain;

    /// Longest wait of a test for what must happen.
    const WATCHDOG: Duration = Duration::from_secs(600);

    /// Jobs that say that they begin, and end when they are released.
    struct HeldJobs {
        begun: SyncSender<()>,
        released: Receiver<()>,
    }

    impl JobRunner for HeldJobs {
        const LEAVES_STATE: bool = false;
        type Job = ();
        type Report = ();

        fn run(&mut self, (): &()) {
            self.begun.send(()).unwrap();
            // The test may have ended.
            let _ = self.released.recv();
        }
    }

    #[test]
    fn a_thread_is_watched_and_nobody_waits_for_a_job_that_leaves_no_state() {
        let folder = tempfile::tempdir().unwrap();
        let domain = Domain::new(&format!("{}_jobs", std::process::id()), folder.path()).unwrap();
        let mut board = ProgressBoard::create(&domain, 1).unwrap();
        let ((begun, begins), (release, released)) = (sync_channel(1), sync_channel(1));
        let progress = ProgressCounter::open(&domain, Some(0), WatchedThread::Second);
        let mut jobs = JobThread::start_watched(HeldJobs { begun, released }, progress).unwrap();
        let mut report = jobs.submit(());
        begins.recv_timeout(WATCHDOG).unwrap();
        board.read().unwrap();
        let entry = board.entry(0, WatchedThread::Second);
        assert!(entry.count > 0 && entry.thread > 0, "{entry:?}");
        let (sender, dropped) = sync_channel(1);
        std::thread::spawn(move || {
            drop(jobs);
            sender.send(())
        });
        dropped.recv_timeout(WATCHDOG).unwrap();
        assert!(report.try_recv().is_err(), "the job is under way");
        board.read().unwrap();
        assert_eq!(board.entry(0, WatchedThread::Second), entry, "a job that hangs does not count on");
        drop(release);
        domain.remove();
    }
}
