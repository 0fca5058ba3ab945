//! Watches the operators: who drives, the selected robot, the emergency stop, and how they rate their workload.

use crate::control::{self, Request};
use crate::nasa_tlx;
use crate::run::Run;
use crate::stop::Stop;
use reports::{BridgeState, TlxEntry};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, Instant};

/// Period at which the bridge is asked.
const PERIOD: Duration = Duration::from_millis(200);
/// Shortest time between two changes of batteries alone: their figures change all the time.
const BATTERY_PERIOD: Duration = Duration::from_secs(10);
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

/// What the recorder was told last.
#[derive(Default)]
struct ReportedState {
    /// Operators and batteries, and when; `None` before the first.
    newest: Option<(serde_json::Value, serde_json::Value, Instant)>,
}

impl ReportedState {
    /// Returns whether a state is to be told, and records it if so.
    fn is_news(&mut self, state: &BridgeState, now: Instant) -> bool {
        let (operators, batteries) = (state.operators_json(), state.batteries_json());
        let is_known = self.newest.as_ref().is_some_and(|(known, known_batteries, at)| {
            let is_early = now.duration_since(*at) < BATTERY_PERIOD;
            *known == operators && (is_early || *known_batteries == batteries)
        });
        if !is_known {
            self.newest = Some((operators, batteries, now));
        }
        !is_known
    }
}

fn watch(run: &Run, stop: &Stop, to_recorder: &SyncSender<OperatorChange>) {
    let (mut reported, mut answers) = (ReportedState::default(), 0);
    while !stop.requested() {
        // Before the bridge, whose answer may take as long as a short recording. A file that cannot be read is looked at again.
        let entries = nasa_tlx::read(&run.dir, run.begun).unwrap_or_default();
        if entries.len() > answers {
            answers = entries.len();
            if to_recorder.send(OperatorChange::Workload(entries)).is_err() {
                return;
            }
        }
        if let Ok(state) = control::ask(run, Request::State, PATIENCE)
            && reported.is_news(&state, Instant::now())
            && to_recorder.send(OperatorChange::State(state)).is_err()
        {
            return;
        }
        std::thread::sleep(PERIOD);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bridge::BatteryStatus;

    #[test]
    fn operators_are_told_at_once_and_batteries_every_ten_seconds() {
        let begun = Instant::now();
        let state = |stopped, charge| {
            let battery = BatteryStatus {
                charge: Some(charge),
                voltage_v: None,
                is_charging: None,
                level: None,
                last_charge: Some(charge),
                age_s: 0.0,
            };
            BridgeState { stopped, batteries: vec![None, Some(battery)], ..BridgeState::default() }
        };
        let mut reported = ReportedState::default();
        let mut is_news =
            |state: &BridgeState, at_s| reported.is_news(state, begun + Duration::from_secs(at_s));
        assert!(is_news(&state(false, 0.5), 0));
        assert!(!is_news(&state(false, 0.4), 9));
        assert!(is_news(&state(false, 0.3), 10));
        assert!(is_news(&state(true, 0.3), 11));
        assert!(!is_news(&state(true, 0.3), 60), "nothing has changed");
        let json = state(true, 0.3).operator_json();
        assert_eq!(json["batteries"][0]["robot"], 2, "{json}");
        assert_eq!((&json["batteries"][0]["charge"], &json["emergency_stop"]), (&0.3.into(), &true.into()));
    }
}
