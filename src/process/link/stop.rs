//! This machine's emergency stop, as the link reads and sets it. `link::StopFollower` decides when a robot's is set.

use crate::control::{self, Request};
use crate::emergency_stop_file::latch_while;
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
    requests: SyncSender<bool>,
}

impl RunStop {
    /// Starts the thread, which asks the bridge once a `period` and ends with this value.
    pub fn start(run: &Run, period: Duration) -> io::Result<Self> {
        let state = Arc::new(Mutex::default());
        // The newest request counts; two wait while the disk or the bridge is slow.
        let (requests, received) = sync_channel(2);
        let (run, shared) = (run.clone(), state.clone());
        std::thread::Builder::new()
            .name("stop".into())
            .spawn(move || serve(&run, period, &received, &shared))?;
        Ok(Self { state, requests })
    }
}

impl StopControl for RunStop {
    fn local_control(&self) -> LocalControl {
        *self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn request(&mut self, stop: bool) {
        // A full queue holds the same request, or the next state of the base repeats it.
        let _ = self.requests.try_send(stop);
    }
}

fn serve(run: &Run, period: Duration, requests: &Receiver<bool>, state: &Mutex<LocalControl>) {
    loop {
        let request = match requests.recv_timeout(period) {
            Ok(true) => Request::Stop,
            Ok(false) => Request::Release,
            Err(RecvTimeoutError::Timeout) => Request::State,
            Err(RecvTimeoutError::Disconnected) => return,
        };
        let ask = || control::ask(run, request, PATIENCE);
        let (asked, latched) = match request {
            Request::Stop => latch_while(&stop_file(&run.dir), ask),
            _ => (ask(), Ok(())),
        };
        if let Err(why) = latched {
            tracing::warn!("the emergency stop of the base is not on the disk: {why}");
        }
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
