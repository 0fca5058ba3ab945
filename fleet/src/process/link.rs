//! The process between a robot's machine and the base: it mirrors the channels that leave the machine.
//!
//! [`RobotLink`] runs beside a robot's fleet of one, [`BaseLink`] beside the base's processes. Both are loops over ports and a
//! [`link_transport::Transport`]; the crate `link` has the messages and all decisions about what is sent when.

mod base;
mod demand;
mod report;
mod robot;
mod stop;
#[cfg(test)]
mod tests;

pub use base::BaseLink;
use report::ReportFile;
pub use report::{LinkReport, PeerReport, ReportLink};
pub use robot::RobotLink;
pub use stop::{BASE_STATE_PERIOD, ROBOT_STATE_PERIOD, RunStop, StopControl};

use crate::channel::{Opener, Program};
use crate::clock::now;
use crate::job_thread::{JobThread, JobWorker as _};
use crate::ports::ChannelError;
use crate::process::{Listens, ProcessLoop};
use crate::progress::ProgressCounter;
use crate::run::Run;
use crate::shared_memory::{Listener, Participant, wait};
use ::link::WireError;
use msg::Monotonic;
use std::time::Duration;

/// Longest time until a message of the other machine is read: the transport wakes nobody.
pub const POLL_PERIOD: Duration = Duration::from_millis(20);
/// Messages read in one step, so that a peer that sends without end does not hold up the others.
const RECEIVED_MAX: usize = 256;

/// Time after which a robot that was never heard is named at the base: it may be switched on later.
const ROBOT_HEARD_MAX: Duration = Duration::from_secs(30);
/// Time after which a robot's machine says that its base was never heard.
const BASE_HEARD_MAX: Duration = Duration::from_secs(8);

/// Tells once that a peer has not been heard since the start.
#[derive(Clone, Copy, Debug)]
struct FirstHeard(Option<Monotonic>);

impl FirstHeard {
    fn after(start: Monotonic, longest: Duration) -> Self {
        Self(Some(start + longest))
    }

    /// Returns, once, whether the time is over and the peer was not heard.
    fn is_overdue(&mut self, is_heard: bool, now: Monotonic) -> bool {
        if is_heard {
            self.0 = None;
        }
        self.0.take_if(|at| now >= *at).is_some()
    }
}

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

/// Period at which the figures are written.
const REPORT_PERIOD: Duration = Duration::from_secs(1);
/// Age of the figures above which they say nothing of the present.
pub const REPORT_AGE_MAX: Duration = Duration::from_secs(3);

/// Runs one end of the link until `over` returns true. Its figures are written on a thread of their own: a disk that is full or does
/// not answer holds up no message.
///
/// # Errors
/// The thread cannot be started.
pub fn serve_link(
    run: &Run,
    link: &mut (impl ProcessLoop + Listens<Listener> + ReportLink),
    mut progress: ProgressCounter,
    over: &dyn Fn() -> bool,
) -> std::io::Result<()> {
    let mut files = JobThread::start(ReportFile::new(run))?;
    let mut report_due = now();
    while !over() {
        progress.advance();
        let due = link.step();
        if now() >= report_due {
            report_due = now() + REPORT_PERIOD;
            // While the disk does not answer, the newer figures follow later.
            drop(files.submit(link.report().of_now()));
        }
        wait(link.listeners(), due);
    }
    Ok(())
}

/// Returns a number that other runs of this machine do not have, above 0.
fn run_number(run: &Run) -> u32 {
    let begun = run.begun.0;
    (begun as u32 ^ (begun >> 32) as u32 ^ run.pid.rotate_left(16)).max(1)
}

/// Attaches the link's process to a run. `base`: on a robot's machine, the robot's name and the endpoint of its base, which
/// `link.json` has until that is heard.
pub fn attach(run: &Run, base: Option<(&str, String)>) -> Result<Participant, ChannelError> {
    if let Some((robot, base)) = base
        && let Err(why) = LinkReport::begin(run, robot, &base)
    {
        tracing::warn!("{}: link.json: {why}", run.dir.display());
    }
    Participant::open(&run.domain, Opener::of_fleet(Program::LinkTool), "link")
}
