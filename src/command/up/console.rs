//! Console of the person at the laptop: single keys that allow, deny, stop and release.

use crate::control::{self, Request};
use crate::emergency_stop_file::latch_while;
use crate::keys::Keys;
use crate::process::control::saved_state::stop_file;
use crate::run::Run;
use reports::{BridgeState, FleetView};
use std::time::Duration;

/// How long the launcher waits for the bridge, once a second and at a key. It has children to look after meanwhile.
const PATIENCE: Duration = Duration::from_millis(200);

/// Console of a fleet's operator.
pub(super) struct OperatorConsole<'a> {
    run: &'a Run,
    keys: Keys,
    newest: Option<BridgeState>,
    /// Why the bridge did not answer when it was asked last.
    silence: Option<String>,
}

impl<'a> OperatorConsole<'a> {
    /// Takes over the keyboard, if there is one.
    pub fn new(run: &'a Run) -> Self {
        Self { run, keys: Keys::new(), newest: None, silence: None }
    }

    /// Asks the bridge for its state. If it does not answer, the newest known state stays.
    pub fn refreshed(&mut self) -> &Self {
        match control::ask(self.run, Request::State, PATIENCE) {
            Ok(state) => (self.newest, self.silence) = (Some(state), None),
            Err(why) => self.silence = Some(why.to_string()),
        }
        self
    }

    /// Puts the newest known state of the bridge into the figures, and why it is not the present one.
    pub fn fill(&self, fleet: FleetView) -> FleetView {
        // A fleet that starts has no bridge yet.
        let bridge_silence = self.silence.clone().filter(|_| self.newest.is_some());
        FleetView { bridge_silence, ..fleet.with_bridge(self.newest.clone()) }
    }

    /// Keys that work now, for people.
    pub fn help(&self) -> &'static str {
        let somebody_waits = self.newest.as_ref().is_some_and(|bridge| !bridge.waiting.is_empty());
        match (self.keys.available(), somebody_waits) {
            (true, true) => "keys: a allows, d denies   s stops all robots   r releases   Ctrl-C ends",
            (true, false) => "keys: s stops all robots   r releases   Ctrl-C ends",
            (false, _) => "Ctrl-C ends",
        }
    }

    /// Does what the next key asks for. Returns what was done, or why not.
    pub fn handle_key(&mut self) -> Option<String> {
        let first_waiting = || self.newest.as_ref().and_then(|bridge| bridge.waiting.first().copied());
        let (request, done) = match self.keys.next_key()? {
            'a' => first_waiting()
                .map(|who| (Request::Allow(who), format!("{who} may drive, now and in later runs")))?,
            'd' => first_waiting().map(|who| (Request::Deny(who), format!("{who} may not drive")))?,
            's' => (Request::Stop, "every robot is stopped until r is pressed".into()),
            'r' => (Request::Release, "the robots may be driven again".into()),
            _ => return None,
        };
        let ask = || control::ask(self.run, request, PATIENCE);
        let (answer, is_latched) = match request {
            Request::Stop => {
                let (answer, latched) = latch_while(&stop_file(&self.run.dir), ask);
                (answer, latched.is_ok())
            }
            _ => (ask(), false),
        };
        Some(match answer {
            Ok(state) => {
                let not_saved = state.not_saved.clone().filter(|_| !is_latched);
                self.newest = Some(state);
                not_saved.map_or(done.clone(), |why| format!("{done}; but it is NOT SAVED: {why}"))
            }
            Err(why) if is_latched => {
                format!("stop NOT CONFIRMED: the bridge sets it as soon as it goes on or is replaced ({why})")
            }
            Err(why) => why.to_string(),
        })
    }
}
