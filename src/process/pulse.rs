//! A process's account of itself, once a second.

use crate::channel;
use crate::clock::{cpu_ns, memory_bytes, now};
use crate::ports::{ChannelError, Gaps};
use crate::run::Run;
use crate::shared_memory::{Participant, Writer};
use msg::{Monotonic, ProcessHealth, RobotId, Role};

/// How often.
const PERIOD_NS: u64 = 1_000_000_000;
/// Units of work measured in one period: twice the busiest loop's 100 ticks.
const SAMPLES_MAX: usize = 256;

/// Collects what a process measures of itself, and sends it.
pub struct Pulse {
    beats: Writer<ProcessHealth>,
    run: Run,
    role: Role,
    robot: Option<RobotId>,
    due: Monotonic,
    work_us: heapless::Vec<f32, SAMPLES_MAX>,
    late_us: heapless::Vec<f32, SAMPLES_MAX>,
}

/// What only the process itself knows.
#[derive(Clone, Copy, Debug, Default)]
pub struct Account {
    /// Of its main input.
    pub gaps: Gaps,
    /// Clients attached.
    pub clients: u32,
    /// Messages dropped for slow readers.
    pub dropped: u64,
    /// Messages refused.
    pub refused: u64,
}

impl Pulse {
    /// Begins to beat.
    pub fn new(
        node: &Participant,
        run: &Run,
        role: Role,
        robot: Option<RobotId>,
    ) -> Result<Self, ChannelError> {
        Ok(Self {
            beats: node.writer(&channel::process_health(role, robot))?,
            run: run.clone(),
            role,
            robot,
            due: Monotonic(now().0 + PERIOD_NS),
            work_us: heapless::Vec::new(),
            late_us: heapless::Vec::new(),
        })
    }

    /// Does a unit of work and measures it.
    pub fn work<R>(&mut self, work: impl FnOnce() -> R) -> R {
        let start = now();
        let result = work();
        // A full list keeps the period's first samples.
        let _ = self.work_us.push(now().since(start) as f32 * 1e-3);
        result
    }

    /// Notes how late periodic work began.
    pub fn late(&mut self, due: Monotonic) {
        let _ = self.late_us.push(now().since(due) as f32 * 1e-3);
    }

    /// When the next account is due.
    pub fn due(&self) -> Monotonic {
        self.due
    }

    /// Sends the account if it is due.
    pub fn beat(&mut self, account: impl FnOnce() -> Account) {
        let at = now();
        if at < self.due {
            return;
        }
        self.due = Monotonic((self.due.0 + PERIOD_NS).max(at.0));
        let Account { gaps, clients, dropped, refused } = account();
        let (work_p50_us, work_max_us) = median_and_max(&mut self.work_us);
        let (late_p50_us, late_max_us) = median_and_max(&mut self.late_us);
        let (role, robot, epoch) = (self.role as u32, self.robot, self.run.epoch);
        self.beats.send_with(|beat| {
            beat.header.stamp = epoch.stamp(at);
            beat.role = role;
            beat.robot = robot.map_or(0, |robot| robot.number() as u32);
            beat.pid = std::process::id();
            beat.clients = clients;
            beat.received = gaps.received;
            beat.lost = gaps.lost;
            beat.dropped = dropped;
            beat.refused = refused;
            beat.work_p50_us = work_p50_us;
            beat.work_max_us = work_max_us;
            beat.late_p50_us = late_p50_us;
            beat.late_max_us = late_max_us;
            beat.memory_bytes = memory_bytes();
            beat.cpu_ns = cpu_ns();
        });
    }
}

/// Of the samples, which are then forgotten.
fn median_and_max(samples: &mut heapless::Vec<f32, SAMPLES_MAX>) -> (f32, f32) {
    samples.sort_unstable_by(f32::total_cmp);
    let result = (samples.get(samples.len() / 2).copied(), samples.last().copied());
    samples.clear();
    (result.0.unwrap_or(0.0), result.1.unwrap_or(0.0))
}
