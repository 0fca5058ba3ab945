//! Progress of the fleet's threads: a counter for each in a small file of the run's shared memory.
//!
//! A thread counts on in its loop. The launcher reads all counters at once, and so sees which thread stands still. The
//! file is written and read as a file: nobody waits for anybody. The launcher holds its lock, which says that the fleet lives.

use crate::clock::now;
use crate::shared_memory::Domain;
use crate::watchdog::{ThreadSample, ThreadState};
use msg::Monotonic;
use rustix::fs::{FlockOperation, flock};
use std::fs::{File, OpenOptions};
use std::io;
use std::os::unix::fs::{FileExt, OpenOptionsExt};
use std::time::Duration;

/// Bytes of a thread's entry: its count and its id in the operating system, each 8 bytes.
const ENTRY_BYTES: usize = 16;
/// Bytes of a process: its threads' entries, and 8 bytes that the launcher writes: whether the process is failing.
const PROCESS_BYTES: usize = WatchedThread::COUNT * ENTRY_BYTES + 8;
/// Shortest time between two counts: the watchdog needs no more, and a loop that is woken often pays nothing.
const COUNT_PERIOD_NS: u64 = 50_000_000;

/// A thread that is watched. Every process has the first; the second is its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WatchedThread {
    /// The process's main thread.
    Main,
    /// The thread that [`crate::processes::ProcessRow::second_thread`] names.
    Second,
}

impl WatchedThread {
    /// Number of watched threads of a process.
    pub const COUNT: usize = 2;
}

/// Entry of a thread as it was read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Entry {
    /// Grows while the thread works; 0 until it does.
    pub count: u64,
    /// The thread's id in the operating system; 0 until it works.
    pub thread: u32,
}

/// All counters of a fleet, as the launcher and the commands that show a running fleet read them.
pub struct ProgressBoard {
    file: File,
    bytes: Vec<u8>,
}

impl ProgressBoard {
    /// Creates the file with a counter of 0 for each thread of `processes` processes.
    pub fn create(domain: &Domain, processes: usize) -> io::Result<Self> {
        let bytes = vec![0; processes * PROCESS_BYTES];
        let mut options = OpenOptions::new();
        let file =
            options.read(true).write(true).create_new(true).mode(0o600).open(domain.progress_file())?;
        file.write_all_at(&bytes, 0)?;
        flock(&file, FlockOperation::NonBlockingLockExclusive)?;
        Ok(Self { file, bytes })
    }

    /// Opens the file of a running fleet of `processes` processes, to look at it.
    pub fn open(domain: &Domain, processes: usize) -> io::Result<Self> {
        let file = File::open(domain.progress_file())?;
        Ok(Self { file, bytes: vec![0; processes * PROCESS_BYTES] })
    }

    /// Reads all counters.
    pub fn read(&mut self) -> io::Result<()> {
        self.file.read_exact_at(&mut self.bytes, 0)
    }

    /// Returns the entry of a thread of the process with this index, as of the last [`ProgressBoard::read`].
    pub fn entry(&self, process: usize, thread: WatchedThread) -> Entry {
        let at = entry_offset(process, thread);
        Entry { count: self.word(at), thread: self.word(at + 8) as u32 }
    }

    /// Returns whether the launcher says of a process that it dies again and again, as of the last [`ProgressBoard::read`].
    pub fn is_failing(&self, process: usize) -> bool {
        self.word(failing_offset(process)) != 0
    }

    /// Says of a process whether it dies again and again.
    pub fn set_failing(&self, process: usize, is_failing: bool) -> io::Result<()> {
        self.file.write_all_at(&u64::from(is_failing).to_le_bytes(), failing_offset(process) as u64)
    }

    fn word(&self, at: usize) -> u64 {
        let bytes = self.bytes.get(at..at + 8).and_then(|bytes| bytes.try_into().ok());
        u64::from_le_bytes(bytes.unwrap_or_default())
    }

    /// Clears the entries of a process that is to be started.
    pub fn clear(&self, process: usize) -> io::Result<()> {
        self.file.write_all_at(
            &[0; WatchedThread::COUNT * ENTRY_BYTES],
            entry_offset(process, WatchedThread::Main) as u64,
        )
    }
}

fn entry_offset(process: usize, thread: WatchedThread) -> usize {
    process * PROCESS_BYTES + thread as usize * ENTRY_BYTES
}

fn failing_offset(process: usize) -> usize {
    process * PROCESS_BYTES + WatchedThread::COUNT * ENTRY_BYTES
}

/// Counter of one thread. It belongs to the thread that opened it.
pub struct ProgressCounter {
    /// `None`: nobody watches, or the file cannot be used.
    file: Option<File>,
    offset: u64,
    count: u64,
    due: Monotonic,
}

impl ProgressCounter {
    /// Opens the counter of the calling thread of a process, by the process's index among the fleet's. A process that was
    /// started by hand has no index and no counter; it works without.
    pub fn open(domain: &Domain, process: Option<usize>, thread: WatchedThread) -> Self {
        let file = OpenOptions::new().write(true).open(domain.progress_file()).ok();
        Self {
            file: file.filter(|_| process.is_some()),
            offset: entry_offset(process.unwrap_or(0), thread) as u64,
            count: 0,
            due: Monotonic(0),
        }
    }

    /// Says that the thread works. Call it in every pass of its loop, at least once a second.
    pub fn advance(&mut self) {
        let Some(file) = &self.file else { return };
        let at = now();
        if at < self.due {
            return;
        }
        self.due = Monotonic(at.0 + COUNT_PERIOD_NS);
        self.count += 1;
        let thread = rustix::thread::gettid().as_raw_nonzero().get() as u64;
        let mut entry = [0; ENTRY_BYTES];
        entry[..8].copy_from_slice(&self.count.to_le_bytes());
        entry[8..].copy_from_slice(&thread.to_le_bytes());
        // A count that is lost is made up for by the next.
        let _ = file.write_all_at(&entry, self.offset);
    }
}

/// Returns how often a process's main thread was scheduled: progress of a process that has no counter.
pub fn switches(process: u32) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let switches = status.lines().filter_map(|line| line.split_once("ctxt_switches:"));
    switches.filter_map(|(_, count)| count.trim().parse::<u64>().ok()).sum()
}

/// Asks the operating system what a thread does.
pub fn sample(process: u32, thread: u32) -> ThreadSample {
    let gone = ThreadSample { state: ThreadState::Gone, cpu: Duration::ZERO };
    let Ok(stat) = std::fs::read_to_string(format!("/proc/{process}/task/{thread}/stat")) else {
        return gone;
    };
    parse_stat(&stat).unwrap_or(gone)
}

/// Returns whether a process of this machine is stopped by a signal, as by Ctrl-Z.
pub fn is_stopped(process: u32) -> bool {
    sample(process, process).state == ThreadState::Stopped
}

/// Returns whether a process of this machine runs or can run on.
pub fn is_alive(process: u32) -> bool {
    sample(process, process).state != ThreadState::Gone
}

/// Parses the content of `/proc/PID/task/TID/stat`: see proc_pid_stat(5).
fn parse_stat(stat: &str) -> Option<ThreadSample> {
    // The name in parentheses may hold anything.
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace();
    let state = match fields.next()? {
        "R" => ThreadState::Runnable,
        "S" | "I" => ThreadState::Sleeping,
        "D" => ThreadState::Disk,
        "T" => ThreadState::Stopped,
        "t" => ThreadState::Traced,
        _ => ThreadState::Gone,
    };
    // The state is field 3; user and system time are fields 14 and 15.
    let ticks: u64 = fields.skip(10).take(2).map(|ticks| ticks.parse::<u64>().unwrap_or(0)).sum();
    let cpu = Duration::from_secs_f64(ticks as f64 / rustix::param::clock_ticks_per_second() as f64);
    Some(ThreadSample { state, cpu })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_launcher_reads_what_a_thread_counts() {
        let folder = tempfile::tempdir().unwrap();
        let domain = Domain::new(&format!("{}_progress", std::process::id()), folder.path()).unwrap();
        let (processes, merge) = (3, 1);
        let mut board = ProgressBoard::create(&domain, processes).unwrap();
        assert!(ProgressBoard::create(&domain, processes).is_err(), "an existing file is never taken over");
        let mut counter = ProgressCounter::open(&domain, Some(merge), WatchedThread::Second);
        counter.advance();
        board.read().unwrap();
        let thread = rustix::thread::gettid().as_raw_nonzero().get() as u32;
        assert_eq!(board.entry(merge, WatchedThread::Second), Entry { count: 1, thread });
        assert_eq!(board.entry(merge, WatchedThread::Main), Entry::default());
        board.set_failing(merge, true).unwrap();
        board.clear(merge).unwrap();
        let mut reader = ProgressBoard::open(&domain, processes).unwrap();
        reader.read().unwrap();
        assert_eq!(reader.entry(merge, WatchedThread::Second), Entry::default());
        assert_eq!(
            [0, 1, 2].map(|process| reader.is_failing(process)),
            [false, true, false],
            "it is kept over a start"
        );
        board.set_failing(merge, false).unwrap();
        reader.read().unwrap();
        assert!(!reader.is_failing(merge));
        domain.remove();
        assert!(!domain.progress_file().exists());
        // Nobody watches any more: the thread works on.
        ProgressCounter::open(&domain, Some(merge), WatchedThread::Main).advance();
    }

    #[test]
    fn a_thread_is_sampled_whatever_its_name() {
        let stat = "42 (a) S b) T 1 2 3 4 5 6 7 8 9 10 250 50 0 0";
        let cpu = Duration::from_secs_f64(300.0 / rustix::param::clock_ticks_per_second() as f64);
        assert_eq!(parse_stat(stat), Some(ThreadSample { state: ThreadState::Stopped, cpu }));
        let own = sample(std::process::id(), rustix::thread::gettid().as_raw_nonzero().get() as u32);
        assert_eq!(own.state, ThreadState::Runnable);
        assert!(switches(std::process::id()) > 0);
    }
}
