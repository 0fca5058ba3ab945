//! Requests to end this process: SIGINT, SIGTERM, SIGHUP, or the death of the launcher.

use rustix::event::{PollFd, PollFlags, poll};
use rustix::io::Errno;
use rustix::process::{Pid, PidfdFlags, Signal, getpid, getppid, kill_process, pidfd_open};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use std::io;
use std::os::fd::OwnedFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{Builder, sleep};
use std::time::Duration;

/// Time after the launcher's death in which a child may end by itself: more than the slowest has to write its files. Then it hangs.
const ORPHAN_GRACE: Duration = Duration::from_secs(30);
/// Stack of the thread that waits for the launcher's death, bytes: it hardly needs any.
const WATCH_STACK_BYTES: usize = 64 << 10;

/// Flag that is set when this process should end. Clones share the flag.
#[derive(Clone, Debug, Default)]
pub struct Stop {
    /// Set by a request.
    request: Arc<AtomicBool>,
    /// Set by a request of a person, SIGINT.
    interrupt: Arc<AtomicBool>,
    /// Set when a request was acknowledged, which tells a further one from it.
    is_acknowledged: Arc<AtomicBool>,
}

impl Stop {
    /// Creates a flag that SIGINT, SIGTERM and SIGHUP set. SIGHUP says that the terminal was closed; where it is ignored,
    /// as after `nohup`, it stays so.
    pub fn on_signals() -> std::io::Result<Self> {
        let stop = Self::default();
        // Before the request, so that the interrupt that makes a request is known when that is acknowledged.
        signal_hook::flag::register(SIGINT, stop.interrupt.clone())?;
        for signal in [SIGINT, SIGTERM, SIGHUP] {
            if signal != SIGHUP || !is_ignored(SIGHUP) {
                signal_hook::flag::register(signal, stop.request.clone())?;
            }
        }
        Ok(stop)
    }

    /// Creates a flag that signals and the death of the parent process set. How long this process takes to end is its own.
    pub fn on_death_of(parent_pid: u32) -> std::io::Result<Self> {
        let stop = Self::on_signals()?;
        rustix::process::set_parent_process_death_signal(Some(Signal::TERM))?;
        // The parent may have died before the line above.
        if getppid() != Pid::from_raw(parent_pid as i32) {
            stop.request();
        }
        Ok(stop)
    }

    /// Creates a flag for a child of the launcher. It is set by signals and by the death of the launcher. A child that has not ended
    /// 30 s after that death hangs, and is killed: nobody else would.
    pub fn for_child(launcher_pid: u32) -> std::io::Result<Self> {
        let stop = Self::on_death_of(launcher_pid)?;
        // Where the system has no such descriptors, or no thread, a child that hangs stays.
        if let Some(launcher) = Pid::from_raw(launcher_pid as i32) {
            let _ = kill_after_death(launcher, getpid(), ORPHAN_GRACE);
        }
        Ok(stop)
    }

    /// Sets the flag.
    pub fn request(&self) {
        self.request.store(true, Ordering::Relaxed);
    }

    /// Acknowledges a request that has come, if one has. Later requests count as further ones.
    pub fn acknowledge(&self) {
        if self.request.swap(false, Ordering::SeqCst) {
            self.interrupt.store(false, Ordering::SeqCst);
            self.is_acknowledged.store(true, Ordering::SeqCst);
        }
    }

    /// Returns whether SIGINT has come after a request that was acknowledged. The first request may come late: it is acknowledged here.
    /// A closed terminal and `timeout` send SIGHUP or SIGTERM several times, and mean one request.
    pub fn is_requested_again(&self) -> bool {
        if self.is_acknowledged.load(Ordering::SeqCst) {
            return self.interrupt.load(Ordering::SeqCst);
        }
        self.acknowledge();
        false
    }

    /// Returns whether the process should end.
    pub fn requested(&self) -> bool {
        self.request.load(Ordering::Relaxed) || self.is_acknowledged.load(Ordering::Relaxed)
    }

    /// Returns the flag of requests that were not acknowledged, for libraries that poll it.
    pub fn flag(&self) -> &AtomicBool {
        &self.request
    }
}

/// Starts a thread that kills a process some time after the death of another one.
fn kill_after_death(of: Pid, victim: Pid, grace: Duration) -> io::Result<()> {
    act_after_death(pidfd_open(of, PidfdFlags::empty())?, grace, move || {
        let _ = kill_process(victim, Signal::KILL);
    })
}

/// Starts a thread that acts some time after the death of a process. It does not act if it cannot wait for it.
fn act_after_death(process: OwnedFd, grace: Duration, act: impl FnOnce() + Send + 'static) -> io::Result<()> {
    let wait = move || {
        // It becomes readable with the death; a signal may interrupt the wait.
        let mut ended = Err(Errno::INTR);
        while ended == Err(Errno::INTR) {
            ended = poll(&mut [PollFd::new(&process, PollFlags::IN)], None);
        }
        if ended.is_ok() {
            sleep(grace);
            act();
        }
    };
    Builder::new().name("launcher-watch".into()).stack_size(WATCH_STACK_BYTES).spawn(wait).map(drop)
}

/// Returns whether this process ignores a signal.
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::process::ExitStatusExt;
    use std::process::{Child, Command, Stdio};
    use std::sync::mpsc::sync_channel;

    /// Longest wait of a test for what must happen.
    const WATCHDOG: Duration = Duration::from_secs(600);

    /// Starts a process that ends with its input, and returns its id, too.
    fn start() -> (Child, Pid) {
        let process = Command::new("cat").stdin(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
        let pid = Pid::from_raw(process.id() as i32).unwrap();
        (process, pid)
    }

    #[test]
    fn an_action_waits_for_the_death_of_a_process() {
        let (mut process, pid) = start();
        let (sender, acted) = sync_channel(1);
        let descriptor = pidfd_open(pid, PidfdFlags::empty()).unwrap();
        let may_end = Arc::new(AtomicBool::new(false));
        let seen = may_end.clone();
        let act = move || sender.send(seen.load(Ordering::SeqCst)).unwrap();
        act_after_death(descriptor, Duration::ZERO, act).unwrap();
        may_end.store(true, Ordering::SeqCst);
        drop(process.stdin.take());
        assert_eq!(acted.recv_timeout(WATCHDOG), Ok(true), "it acts after the death");
        process.wait().unwrap();
    }

    #[test]
    fn a_process_that_does_not_end_after_the_death_of_another_is_killed() {
        let ((mut launcher, of), (mut child, victim)) = (start(), start());
        kill_after_death(of, victim, Duration::ZERO).unwrap();
        assert!(child.try_wait().unwrap().is_none(), "the launcher lives");
        drop(launcher.stdin.take());
        launcher.wait().unwrap();
        let (sender, ended) = sync_channel(1);
        // The input of a process ends with its wait.
        let input = child.stdin.take();
        std::thread::spawn(move || sender.send(child.wait().unwrap().signal()));
        assert_eq!(ended.recv_timeout(WATCHDOG), Ok(Some(Signal::KILL.as_raw())));
        drop(input);
    }

    #[test]
    fn an_interrupt_after_an_acknowledged_request_is_a_further_one_and_other_signals_are_not() {
        let stop = Stop::on_signals().unwrap();
        for first in [Signal::INT, Signal::TERM] {
            for is_acknowledged_early in [true, false] {
                // A request is acknowledged once: begin anew with the same signals.
                for flag in [&stop.request, &stop.interrupt, &stop.is_acknowledged] {
                    flag.store(false, Ordering::SeqCst);
                }
                assert!(!stop.is_requested_again() && !stop.requested());
                raise(first);
                if is_acknowledged_early {
                    stop.acknowledge();
                }
                assert!(!stop.is_requested_again() && stop.requested());
                for other in [Signal::TERM, Signal::HUP] {
                    raise(other);
                    stop.acknowledge();
                    assert!(!stop.is_requested_again() && stop.requested(), "{other:?} after {first:?}");
                }
                raise(Signal::INT);
                assert!(stop.clone().is_requested_again() && stop.requested());
            }
        }
    }

    /// Sends a signal to the calling thread, which handles it before it goes on.
    fn raise(signal: Signal) {
        nix::sys::signal::raise(nix::sys::signal::Signal::try_from(signal.as_raw()).unwrap()).unwrap();
    }
}
