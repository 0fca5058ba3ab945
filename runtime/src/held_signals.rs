//! Holds signals back while a channel is opened.
//!
//! iceoryx2 sleeps and waits for file locks while it opens a channel, and gives up if a signal arrives meanwhile: a fleet that is
//! stopped while it starts would end with an error and without a report.

use nix::sys::signal::{SigSet, SigmaskHow};

/// While it lives, no signal is handled on this thread. They are handled when it is dropped.
pub struct HeldSignals {
    before: Option<SigSet>,
    /// A mask is of one thread.
    _thread: core::marker::PhantomData<*const ()>,
}

impl HeldSignals {
    /// Lets signals wait.
    pub fn hold() -> Self {
        let before = SigSet::all().thread_swap_mask(SigmaskHow::SIG_BLOCK).ok();
        Self { before, _thread: core::marker::PhantomData }
    }
}

impl Drop for HeldSignals {
    fn drop(&mut self) {
        if let Some(before) = &self.before {
            let _ = before.thread_set_mask();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nix::sys::signal::{Signal, raise};
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};

    #[test]
    fn a_signal_waits_until_the_last_of_those_that_hold_it_is_dropped() {
        let handled = Arc::new(AtomicBool::new(false));
        signal_hook::flag::register(signal_hook::consts::SIGUSR1, handled.clone()).unwrap();
        let outer = HeldSignals::hold();
        let inner = HeldSignals::hold();
        raise(Signal::SIGUSR1).unwrap();
        drop(inner);
        assert!(!handled.load(Ordering::Relaxed), "the outer one holds it");
        drop(outer);
        assert!(handled.load(Ordering::Relaxed));
    }
}
