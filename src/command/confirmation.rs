//! Waits until a process of a running fleet has confirmed a command.

use crate::shared_memory::{Reader, Writer, wait};
use msg::{Message, Monotonic};
use std::time::{Duration, Instant};

/// Period at which answers are looked for, nanoseconds.
const POLL_NS: u64 = 50_000_000;

/// Returns the first message that confirms the command that was just written; `None`: there was none within `patience`.
pub(super) fn confirmation<C: Message, A: Message>(
    commands: &Writer<C>,
    answers: &mut Reader<A>,
    patience: Duration,
    confirms: impl Fn(&A) -> bool,
) -> Option<A> {
    let begun = Instant::now();
    while begun.elapsed() < patience {
        // A process that starts again needs the command once more.
        commands.refresh();
        while let Some(answer) = answers.receive() {
            if confirms(&answer) {
                return Some(*answer);
            }
        }
        wait([], Monotonic(crate::clock::now().0 + POLL_NS));
    }
    None
}
