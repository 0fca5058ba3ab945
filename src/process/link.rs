//! The process between a robot's machine and the base: it mirrors the channels that leave the machine.
//!
//! [`RobotLink`] runs beside a robot's fleet of one, [`BaseLink`] beside the base's processes. Both are loops over ports and a
//! [`link_transport::Transport`]; the crate `link` has the messages and all decisions about what is sent when.

mod base;
mod robot;
mod stop;
#[cfg(test)]
mod tests;

pub use base::BaseLink;
pub use robot::RobotLink;
pub use stop::{RunStop, StopControl};

use crate::channel::{Opener, Program};
use crate::ports::ChannelError;
use crate::process::{Listens, ProcessLoop, serve};
use crate::progress::{ProgressCounter, WatchedThread};
use crate::run::Run;
use crate::shared_memory::{Listener, Participant};
use ::link::WireError;
use std::time::Duration;

/// Longest time until a message of the other machine is read: the transport wakes nobody.
pub const POLL_PERIOD: Duration = Duration::from_millis(20);
/// Messages read in one step, so that a peer that sends without end does not hold up the others.
const RECEIVED_MAX: usize = 256;

/// Counts messages that are not of this format, and warns of the first.
#[derive(Debug, Default)]
struct InvalidMessages(u64);

impl InvalidMessages {
    fn count(&mut self, name: &str, why: &WireError) {
        if self.0 == 0 {
            tracing::warn!("a message of or for {name} is refused: {why}");
        }
        self.0 += 1;
    }
}

/// Runs one end of the link until `over` returns true.
pub fn serve_link(run: &Run, link: &mut (impl ProcessLoop + Listens<Listener>), over: &dyn Fn() -> bool) {
    // The launcher watches the end of the process, but counts no passes of its loop.
    serve(link, ProgressCounter::open(&run.domain, None, WatchedThread::Main), over);
}

/// Attaches the link's process to a run.
pub fn attach(run: &Run) -> Result<Participant, ChannelError> {
    Participant::open(&run.domain, Opener::of_fleet(Program::LinkTool), "link")
}
