//! Watches what the bridge knows of its operators: who drives, the selected robot, the emergency stop.

use crate::control::{self, BridgeState, Request};
use crate::run::Run;
use crate::stop::Stop;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

/// Period at which the bridge is asked.
const PERIOD: Duration = Duration::from_millis(200);
/// Longest time that an answer may take.
const PATIENCE: Duration = Duration::from_millis(500);
/// States that may wait for the recorder.
const WAITING_MAX: usize = 16;

/// Receives the bridge's state from a thread that asks for it.
pub struct OperatorWatch {
    states: Receiver<BridgeState>,
}

impl OperatorWatch {
    /// Starts the thread. It ends when the watch is dropped or the process is asked to stop.
    pub fn start(run: Run, stop: Stop) -> Self {
        let (to_recorder, states) = sync_channel(WAITING_MAX);
        std::thread::spawn(move || watch(&run, &stop, &to_recorder));
        Self { states }
    }

    /// Returns the next state that differs from the one before.
    pub fn changed(&mut self) -> Option<BridgeState> {
        self.states.try_recv().ok()
    }
}

fn watch(run: &Run, stop: &Stop, to_recorder: &SyncSender<BridgeState>) {
    let mut newest: Option<serde_json::Value> = None;
    while !stop.requested() {
        if let Ok(state) = control::ask(run, Request::State, PATIENCE) {
            let json = operator_json(&state);
            if newest.as_ref() != Some(&json) {
                newest = Some(json);
                if to_recorder.send(state).is_err() {
                    return;
                }
            }
        }
        std::thread::sleep(PERIOD);
    }
}

/// Returns what is recorded of the bridge's state: not the counters, which change all the time.
pub fn operator_json(state: &BridgeState) -> serde_json::Value {
    let driving = state.clients.iter().flat_map(|client| {
        client.drives.iter().map(|robot| serde_json::json!({ "robot": robot, "address": client.address }))
    });
    serde_json::json!({
        "selected_robot": state.selected,
        "emergency_stop": state.stopped,
        "drivers": driving.collect::<Vec<_>>(),
        "clients": state.clients.iter().map(|client| client.address).collect::<Vec<_>>(),
        "allowed": state.allowed,
        "waiting": state.waiting,
    })
}
