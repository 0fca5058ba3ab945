//! This machine's emergency stop, as the link reads and sets it. `link::StopFollower` decides when a robot's is set.

use crate::control::{self, AskError, Request};
use crate::emergency_stop_file::{LatchedStop, latch_while};
use crate::process::control::saved_state::stop_file;
use crate::run::Run;
use ::link::LocalControl;
use std::io;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Period at which the base's bridge is asked whether it is stopped: a part of the time that a stop takes to a robot.
pub const BASE_STATE_PERIOD: Duration = Duration::from_millis(40);
/// Period at which a robot's bridge is asked: a stop or a hand there is to reach the base before it is over.
pub const ROBOT_STATE_PERIOD: Duration = Duration::from_millis(50);
/// Longest wait for the bridge's answer.
const PATIENCE: Duration = Duration::from_millis(500);

/// This machine's emergency stop, which its bridge keeps.
pub trait StopControl {
    /// Returns whether it is set; `None` if the bridge does not answer.
    fn is_stopped(&self) -> Option<bool> {
        self.local_control().is_stopped
    }
    /// Returns who controls the robots of this machine here, as its bridge has said last.
    fn local_control(&self) -> LocalControl;
    /// Sets or releases it. Never waits.
    fn request(&mut self, stop: bool);
}

/// The emergency stop of a run, over its bridge's control socket. A thread of its own waits for the bridge.
#[derive(Debug)]
pub struct RunStop {
    state: Arc<Mutex<LocalControl>>,
    /// The newest request that the thread has not taken.
    newest: Arc<Mutex<Option<bool>>>,
    wake: SyncSender<()>,
}

impl RunStop {
    /// Starts the thread, which asks the bridge once a `period` and ends with this value.
    pub fn start(run: &Run, period: Duration) -> io::Result<Self> {
        let (state, newest) = (Arc::new(Mutex::default()), Arc::new(Mutex::default()));
        let (wake, woken) = sync_channel(1);
        let (run, shared, requests) = (run.clone(), state.clone(), newest.clone());
        std::thread::Builder::new()
            .name("stop".into())
            .spawn(move || serve(&run, period, &woken, &requests, &shared))?;
        Ok(Self { state, newest, wake })
    }
}

impl StopControl for RunStop {
    fn local_control(&self) -> LocalControl {
        *self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn request(&mut self, stop: bool) {
        *self.newest.lock().unwrap_or_else(PoisonError::into_inner) = Some(stop);
        // A full queue wakes the thread, too.
        let _ = self.wake.try_send(());
    }
}

/// What the bridge is asked next. A release that no bridge has received is repeated.
#[derive(Debug, Default)]
struct NextRequest {
    /// The stop on the disk for which a release waits.
    waiting: Option<LatchedStop>,
}

impl NextRequest {
    /// Returns the next request. `stop`: what is to be done, if that is new; `latched`: the stop on the disk.
    fn choose(&mut self, stop: Option<bool>, latched: Option<LatchedStop>) -> Request {
        self.waiting = match stop {
            Some(true) => None,
            Some(false) => latched,
            // It is not for a stop that somebody has set since.
            None => self.waiting.filter(|waiting| latched == Some(*waiting)),
        };
        match (stop, self.waiting) {
            (Some(true), _) => Request::Stop,
            (None, None) => Request::State,
            (Some(false), _) | (None, Some(_)) => Request::Release,
        }
    }

    /// Ends the wait unless no bridge listened. One that did may still carry out the release, whatever the answer was: a second
    /// one could release a stop that somebody has set since.
    fn on_result<T>(&mut self, result: &Result<T, AskError>) {
        if !matches!(result, Err(AskError::NoAnswer { is_listening: false, .. })) {
            self.waiting = None;
        }
    }
}

fn serve(
    run: &Run,
    period: Duration,
    woken: &Receiver<()>,
    newest: &Mutex<Option<bool>>,
    state: &Mutex<LocalControl>,
) {
    let mut next = NextRequest::default();
    while woken.recv_timeout(period) != Err(RecvTimeoutError::Disconnected) {
        let stop = newest.lock().unwrap_or_else(PoisonError::into_inner).take();
        let request = next.choose(stop, LatchedStop::look(&stop_file(&run.dir)));
        let ask = || control::ask(run, request, PATIENCE);
        let (asked, latched) = match request {
            Request::Stop => latch_while(&stop_file(&run.dir), ask),
            _ => (ask(), Ok(())),
        };
        if let Err(why) = latched {
            tracing::warn!("the emergency stop of the base is not on the disk: {why}");
        }
        next.on_result(&asked);
        let mut state = state.lock().unwrap_or_else(PoisonError::into_inner);
        *state = match asked {
            Ok(bridge) => LocalControl {
                is_stopped: Some(bridge.stopped),
                is_driven_by_hand: bridge.driven_by_client,
                interruptions: bridge.interruptions as u32,
            },
            Err(_) => LocalControl { is_stopped: None, ..*state },
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emergency_stop_file::latch_stop;
    use crate::storage::DiskStorage;
    use msg::Monotonic;

    fn no_answer(is_listening: bool) -> Result<(), AskError> {
        Err(AskError::NoAnswer { source: io::ErrorKind::TimedOut.into(), is_listening })
    }

    #[test]
    fn a_release_that_no_bridge_receives_is_repeated_for_the_same_stop_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = stop_file(folder.path());
        let latched = || {
            latch_stop(&DiskStorage, &path, Monotonic(1)).unwrap();
            LatchedStop::look(&path)
        };
        let first = latched();
        let mut next = NextRequest::default();
        assert_eq!(next.choose(Some(false), first), Request::Release);
        next.on_result(&no_answer(false));
        assert_eq!(next.choose(None, first), Request::Release, "the bridge is being started");

        let second = latched();
        assert_eq!(next.choose(None, second), Request::State, "somebody has stopped the robot again");
        assert_eq!(next.choose(None, first), Request::State);
        assert_eq!(next.choose(Some(false), second), Request::Release);
        assert_eq!(next.choose(Some(true), second), Request::Stop, "the base has stopped again");
        assert_eq!(next.choose(None, second), Request::State);
        assert_eq!(next.choose(Some(false), None), Request::Release);
        assert_eq!(next.choose(None, None), Request::State, "no bridge starts with a stop");
    }

    #[test]
    fn a_release_that_a_bridge_may_have_received_is_not_repeated() {
        let folder = tempfile::tempdir().unwrap();
        let path = stop_file(folder.path());
        latch_stop(&DiskStorage, &path, Monotonic(1)).unwrap();
        let latched = LatchedStop::look(&path);
        for result in [Ok(()), no_answer(true), Err(AskError::Refused("the disk is busy".into()))] {
            let mut next = NextRequest::default();
            assert_eq!(next.choose(Some(false), latched), Request::Release);
            next.on_result(&no_answer(false));
            assert_eq!(next.choose(None, latched), Request::Release);
            next.on_result(&result);
            assert_eq!(next.choose(None, latched), Request::State, "after {result:?}");
        }
    }
}
