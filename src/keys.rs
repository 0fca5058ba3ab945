//! Single keys from the terminal, while a fleet is watched. Nothing is touched unless both ends are a terminal and
//! this process is in its foreground; what was changed is put back.

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::termios::{LocalModes, OptionalActions, Termios, isatty, tcgetattr, tcgetpgrp, tcsetattr};
use std::io::stdin;

/// The keyboard, or none.
pub struct Keys {
    before: Option<Termios>,
}

impl Keys {
    /// Keys come one by one from now on, and are not shown. Ctrl-C goes on meaning what it does.
    pub fn new() -> Self {
        let keyboard = stdin();
        let foreground = || {
            isatty(&keyboard) && tcgetpgrp(&keyboard).is_ok_and(|group| group == rustix::process::getpgrp())
        };
        let set = || {
            let before = tcgetattr(&keyboard).ok()?;
            let mut single = before.clone();
            single.local_modes.remove(LocalModes::ICANON | LocalModes::ECHO);
            tcsetattr(&keyboard, OptionalActions::Now, &single).ok()?;
            Some(before)
        };
        Self { before: foreground().then(set).flatten() }
    }

    /// Whether there is a keyboard at all.
    pub fn work(&self) -> bool {
        self.before.is_some()
    }

    /// The next key that was pressed, if one was. Never waits.
    pub fn pressed(&self) -> Option<char> {
        self.before.as_ref()?;
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

impl Default for Keys {
    fn default() -> Self {
        Self::new()
    }
}

impl Drop for Keys {
    fn drop(&mut self) {
        if let Some(before) = &self.before {
            let _ = tcsetattr(stdin(), OptionalActions::Now, before);
        }
    }
}
