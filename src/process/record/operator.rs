//! Watches the operators: who drives, the selected robot, the emergency stop, and how they rate their workload.

use crate::control::{self, Request};
use crate::nasa_tlx;
use crate::run::Run;
use crate::stop::Stop;
use reports::{BridgeState, TlxEntry};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

/// Period at which the bridge is asked.
const PERIOD: Duration = Duration::from_millis(200);
/// Longest time that an answer may take.
const PATIENCE: Duration = Duration::from_millis(500);
/// States that may wait for the recorder.
const WAITING_MAX: usize = 16;

/// What has changed.
pub enum OperatorChange {
    /// The bridge's state.
    State(BridgeState),
    /// Answers about workload, all of the run.
    Workload(Vec<TlxEntry>),
}

/// Receives changes from a thread that looks for them.
pub struct OperatorWatch {
    changes: Receiver<OperatorChange>,
}

impl OperatorWatch {
    /// Starts the thread. It ends when the watch is dropped or the process is asked to stop.
    pub fn start(run: Run, stop: Stop) -> Self {
        let (to_recorder, changes) = sync_channel(WAITING_MAX);
        std::thread::spawn(move || watch(&run, &stop, &to_recorder));
        Self { changes }
    }

    /// Returns the next change.
    pub fn changed(&mut self) -> Option<OperatorChange> {
        self.changes.try_recv().ok()
    }
}

fn watch(run: &Run, stop: &Stop, to_recorder: &SyncSender<OperatorChange>) {
    let (mut newest, mut answers): (Option<serde_json::Value>, usize) = (None, 0);
    while !stop.requested() {
        // Before the bridge, whose answer may take as long as a short recording. A file that cannot be read is looked at again.
        let entries = nasa_tlx::read(&run.dir, run.begun).unwrap_or_default();
        if entries.len() > answers {
            answers = entries.len();
            if to_recorder.send(OperatorChange::Workload(entries)).is_err() {
                return;
            }
        }
        if let Ok(state) = control::ask(run, Request::State, PATIENCE) {
            let json = state.operator_json();
            if newest.as_ref() != Some(&json) {
                newest = Some(json);
                if to_recorder.send(OperatorChange::State(state)).is_err() {
                    return;
                }
            }
        }
        std::thread::sleep(PERIOD);
    }
}
