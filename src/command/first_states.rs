//! What a fleet says in the first moment after a command, for tools that do not wait for the end.

use std::time::{Duration, Instant};

/// Time in which the states after the first one show whether robots go: what stands in their way, such as the emergency stop, comes a
/// moment later.
const SHOWN_AFTER: Duration = Duration::from_millis(500);

/// The states after a command, of which the newest counts when the first moment is over.
pub(super) struct FirstStates<S> {
    newest: Option<S>,
    begun: Option<Instant>,
}

impl<S: Copy> FirstStates<S> {
    /// Waits for the first state.
    pub(super) fn new() -> Self {
        Self { newest: None, begun: None }
    }

    /// Adds a state that came after the command.
    pub(super) fn add(&mut self, state: S) {
        self.newest = Some(state);
        self.begun.get_or_insert_with(Instant::now);
    }

    /// Returns the newest state when half a second has passed since the first one.
    pub(super) fn outcome(&self) -> Option<S> {
        self.newest.filter(|_| self.begun.is_some_and(|begun| begun.elapsed() > SHOWN_AFTER))
    }
}
