//! Work that nobody waits for, done in its order in the processor time that others leave.
//!
//! A thread of the scheduling policy `SCHED_IDLE` (sched(7)) works as long as a core has nothing else to do, and leaves its core at
//! once to any other thread. Where all cores stay busy, such a thread hardly runs: then a second one of normal priority works for it.

use crate::realtime::yield_to_all_others;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// Period at which the second thread looks how much waits.
const LOOK_PERIOD: Duration = Duration::from_millis(200);

/// What a job does.
pub type Action<S> = Box<dyn FnOnce(&mut S) + Send>;

/// One piece of work on the state `S`.
struct Job<S> {
    bytes: usize,
    run: Action<S>,
}

/// What the threads and their caller know of the jobs.
#[derive(Debug, Default)]
struct JobCounts {
    /// Memory of the jobs that wait or are being done, bytes.
    waiting_bytes: AtomicUsize,
    /// Whether a job has panicked: the state may be half changed.
    has_panicked: AtomicBool,
}

/// The state, and the jobs that wait for it. Who holds its lock does the next job.
struct Worker<S> {
    state: S,
    jobs: Receiver<Job<S>>,
    counts: Arc<JobCounts>,
}

impl<S> Worker<S> {
    /// Does a job. After one has panicked the others are dropped: the state may be half changed.
    fn run(&mut self, Job { bytes, run }: Job<S>) {
        if !self.counts.has_panicked.load(Ordering::Relaxed) {
            // The state is not used any more after a panic.
            if catch_unwind(AssertUnwindSafe(|| run(&mut self.state))).is_err() {
                self.counts.has_panicked.store(true, Ordering::Relaxed);
                let thread = thread::current();
                tracing::error!(
                    "a job of the thread {} panicked: no further jobs are done",
                    thread.name().unwrap_or("main")
                );
            }
        }
        self.counts.waiting_bytes.fetch_sub(bytes, Ordering::Relaxed);
    }

    /// Does what waits, until no more than this is left.
    fn run_down_to(&mut self, bytes: usize) {
        while self.counts.waiting_bytes.load(Ordering::Relaxed) > bytes {
            let Ok(job) = self.jobs.try_recv() else { return };
            self.run(job);
        }
    }
}

/// How much may wait, bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WaitingLimits {
    /// Above this the thread of normal priority works too.
    pub help: usize,
    /// Above this jobs are refused.
    pub refuse: usize,
}

/// Does jobs on a state in threads of their own.
pub struct SpareTime<S> {
    worker: Arc<Mutex<Worker<S>>>,
    jobs: Sender<Job<S>>,
    counts: Arc<JobCounts>,
    limits: WaitingLimits,
    idle: JoinHandle<()>,
    helper: JoinHandle<()>,
    end_helper: Sender<()>,
}

impl<S: Send + 'static> SpareTime<S> {
    /// Starts the threads. Where the system refuses the policy, all work is done at the caller's priority.
    ///
    /// # Errors
    /// The system has no memory for a thread.
    pub fn start(state: S, limits: WaitingLimits) -> io::Result<Self> {
        let (jobs, received) = channel();
        let counts = Arc::new(JobCounts::default());
        let worker = Worker { state, jobs: received, counts: counts.clone() };
        let worker = Arc::new(Mutex::new(worker));
        let (end_helper, ends) = channel::<()>();
        let idle = spawn("work-idle", {
            let worker = worker.clone();
            move || {
                if let Err(why) = yield_to_all_others() {
                    tracing::debug!("SCHED_IDLE is refused: {why:?}");
                }
                while do_next(&worker) {}
            }
        })?;
        let helper = spawn("work-helper", {
            let (worker, counts) = (worker.clone(), counts.clone());
            move || {
                while ends.recv_timeout(LOOK_PERIOD) == Err(RecvTimeoutError::Timeout) {
                    if counts.waiting_bytes.load(Ordering::Relaxed) > limits.help {
                        lock(&worker).run_down_to(limits.help / 2);
                    }
                }
            }
        })?;
        Ok(Self { worker, jobs, counts, limits, idle, helper, end_helper })
    }

    /// Adds a job that stands for so many bytes of memory. Returns false, and drops it, if too much waits or a job has panicked.
    pub fn push(&self, bytes: usize, run: Action<S>) -> bool {
        let waiting_bytes = &self.counts.waiting_bytes;
        let is_full = waiting_bytes.load(Ordering::Relaxed).saturating_add(bytes) > self.limits.refuse;
        if is_full || self.has_panicked() {
            return false;
        }
        waiting_bytes.fetch_add(bytes, Ordering::Relaxed);
        // The threads live until this is dropped.
        self.jobs.send(Job { bytes, run }).is_ok()
    }

    /// Returns whether a job has panicked, after which none is done.
    pub fn has_panicked(&self) -> bool {
        self.counts.has_panicked.load(Ordering::Relaxed)
    }

    /// Does what is left, at the caller's priority, and returns the state; `None` if a job panicked.
    pub fn finish(self) -> Option<S> {
        let Self { worker, jobs, counts, idle, helper, end_helper, .. } = self;
        drop((jobs, end_helper));
        {
            let mut worker = lock(&worker);
            while let Ok(job) = worker.jobs.try_recv() {
                worker.run(job);
            }
        }
        let ended = [idle.join(), helper.join()];
        let worker = Arc::into_inner(worker)?.into_inner().ok()?;
        let has_panicked = counts.has_panicked.load(Ordering::Relaxed);
        (!has_panicked && ended.iter().all(Result::is_ok)).then_some(worker.state)
    }
}

/// Does jobs at once, or in the processor time that others leave.
pub enum JobExecutor<S> {
    /// In the caller's thread, for lockstep.
    Now(Box<S>),
    /// In threads of their own.
    Later(SpareTime<S>),
}

impl<S: Send + 'static> JobExecutor<S> {
    /// Does a job that takes so many bytes of memory while it waits. Returns false, and drops it, if too much waits or a
    /// job has panicked.
    pub fn push(&mut self, bytes: usize, run: Action<S>) -> bool {
        match self {
            Self::Now(state) => {
                run(state);
                true
            }
            Self::Later(work) => work.push(bytes, run),
        }
    }

    /// Returns whether a job has panicked, after which none is done. A panic of a job that is done at once is the caller's.
    pub fn has_panicked(&self) -> bool {
        matches!(self, Self::Later(work) if work.has_panicked())
    }

    /// Does what is left, and returns the state; `None` if a job panicked.
    pub fn finish(self) -> Option<S> {
        match self {
            Self::Now(state) => Some(*state),
            Self::Later(work) => work.finish(),
        }
    }
}

/// Waits for a job and does it. Returns false if there will be none.
fn do_next<S>(worker: &Mutex<Worker<S>>) -> bool {
    let mut worker = lock(worker);
    let Ok(job) = worker.jobs.recv() else { return false };
    worker.run(job);
    true
}

fn spawn(name: &str, work: impl FnOnce() + Send + 'static) -> io::Result<JoinHandle<()>> {
    thread::Builder::new().name(name.into()).spawn(work)
}

fn lock<S>(worker: &Mutex<Worker<S>>) -> std::sync::MutexGuard<'_, Worker<S>> {
    worker.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::sync_channel;

    const LIMITS: WaitingLimits = WaitingLimits { help: 100, refuse: 1000 };

    #[test]
    fn jobs_are_done_in_their_order_and_all_before_the_end() {
        let work = SpareTime::start(Vec::new(), LIMITS).unwrap();
        let done = (0..500).filter(|index| {
            let index = *index;
            // What is refused because too much waits is not done at all.
            work.push(10, Box::new(move |list: &mut Vec<i32>| list.push(index)))
        });
        let pushed: Vec<i32> = done.collect();
        assert_eq!(work.finish().unwrap(), pushed);
    }

    #[test]
    fn what_waits_is_bounded() {
        let work = SpareTime::start(0, LIMITS).unwrap();
        let (go, blocked) = sync_channel::<()>(0);
        let (begins, begun) = sync_channel::<()>(0);
        let block = move |_: &mut i32| {
            begins.send(()).unwrap();
            blocked.recv().unwrap();
        };
        assert!(work.push(10, Box::new(block)));
        begun.recv().unwrap();
        let taken = (0..200).filter(|_| work.push(10, Box::new(|count: &mut i32| *count += 1))).count();
        assert_eq!(taken, 99, "990 bytes beside the 10 of the one that is being done");
        go.send(()).unwrap();
        assert_eq!(work.finish(), Some(99));
    }

    #[test]
    fn a_panic_is_known_at_once_and_what_waits_is_given_back() {
        let work = SpareTime::start(0, LIMITS).unwrap();
        let (go, blocked) = sync_channel::<()>(0);
        let panic = move |_: &mut i32| {
            blocked.recv().unwrap();
            panic!("a job of a test panics");
        };
        assert!(work.push(10, Box::new(panic)));
        let waiting = (0..20).filter(|_| work.push(10, Box::new(|count: &mut i32| *count += 1))).count();
        assert_eq!((waiting, work.has_panicked()), (20, false));
        go.send(()).unwrap();
        // The thread gives back the memory of the job that panicked, and of those that it drops.
        while work.counts.waiting_bytes.load(Ordering::Relaxed) > 0 {
            thread::yield_now();
        }
        assert!(work.has_panicked());
        assert!(!work.push(10, Box::new(|_: &mut i32| {})), "nothing is done any more");
        assert_eq!(work.finish(), None);
    }

    #[test]
    fn a_helper_leaves_what_is_not_much() {
        let (jobs, received) = channel();
        let counts = Arc::new(JobCounts::default());
        let mut worker = Worker { state: 0, jobs: received, counts: counts.clone() };
        for _ in 0..20 {
            counts.waiting_bytes.fetch_add(10, Ordering::Relaxed);
            jobs.send(Job { bytes: 10, run: Box::new(|count: &mut i32| *count += 1) }).unwrap();
        }
        worker.run_down_to(LIMITS.help / 2);
        assert_eq!((worker.state, counts.waiting_bytes.load(Ordering::Relaxed)), (15, 50));
    }
}
