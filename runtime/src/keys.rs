//! Single keys from the terminal, for the live view of a fleet.
//!
//! The terminal's mode is changed only if this process is in its foreground. It is restored at the end.

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::termios::{LocalModes, OptionalActions, Termios, isatty, tcgetattr, tcgetpgrp, tcsetattr};
use std::io::stdin;

/// Keyboard of the terminal, if there is one.
pub struct Keys {
    /// Mode of the terminal before it was changed.
    original_mode: Option<Termios>,
}

impl Keys {
    /// Makes the terminal deliver keys one by one without echo. Ctrl-C keeps its meaning.
    pub fn new() -> Self {
        let keyboard = stdin();
        let set = || {
            let original_mode = tcgetattr(&keyboard).ok()?;
            let mut single_keys = original_mode.clone();
            single_keys.local_modes.remove(LocalModes::ICANON | LocalModes::ECHO);
            tcsetattr(&keyboard, OptionalActions::Now, &single_keys).ok()?;
            Some(original_mode)
        };
        Self { original_mode: is_in_foreground().then(set).flatten() }
    }

    /// Returns whether keys can be read.
    pub fn available(&self) -> bool {
        self.original_mode.is_some()
    }

    /// Returns the next pressed key, if there is one. It never waits. In the background it reads nothing: the terminal would stop
    /// the process.
    pub fn next_key(&self) -> Option<char> {
        self.original_mode.as_ref().filter(|_| is_in_foreground())?;
        let keyboard = stdin();
        let mut ready = [PollFd::new(&keyboard, PollFlags::IN)];
        let now = Timespec { tv_sec: 0, tv_nsec: 0 };
        if !matches!(poll(&mut ready, Some(&now)), Ok(1)) || !ready[0].revents().contains(PollFlags::IN) {
            return None;
        }
        let mut byte = [0; 1];
        (rustix::io::read(&keyboard, &mut byte).ok()? == 1).then(|| char::from(byte[0]))
    }
}

/// Returns whether this process is in the foreground of its terminal.
fn is_in_foreground() -> bool {
    let keyboard = stdin();
    isatty(&keyboard) && tcgetpgrp(&keyboard).is_ok_and(|group| group == rustix::process::getpgrp())
}

impl Default for Keys {
    fn default() -> Self {
        Self::new()
    }
}

impl Drop for Keys {
    fn drop(&mut self) {
        if let Some(mode) = &self.original_mode {
            let _ = tcsetattr(stdin(), OptionalActions::Now, mode);
        }
    }
}
