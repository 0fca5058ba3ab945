//! A process's account of itself, once a second.

use crate::channel;
use crate::clock::{cpu_ns, memory_bytes, now};
use crate::run::Run;
use crate::shared_memory::{ChannelError, Gaps, Node, Writer};
use msg::{Monotonic, ProcessHealth, RobotId, Role};

/// How often.
const PERIOD_NS: u64 = 1_000_000_000;
/// Units of work measured in one period: twice the busiest loop's 100 ticks.
const SAMPLES_MAX: usize = 256;

/// Collects what a process measures of itself, and sends it.
pub struct Pulse {
    health: Writer<ProcessHealth>,
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
    /// Opens the channel of the process health.
    pub fn new(node: &Node, run: &Run, role: Role, robot: Option<RobotId>) -> Result<Self, ChannelError> {
        Ok(Self {
            health: node.writer(&channel::process_health(role, robot))?,
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
        self.health.send_with(|health| {
            health.header.stamp = epoch.stamp(at);
            health.role = role;
            health.robot = robot.map_or(0, |robot| robot.number() as u32);
            health.pid = std::process::id();
            health.clients = clients;
            health.received = gaps.received;
            health.lost = gaps.lost;
            health.dropped = dropped;
            health.refused = refused;
            health.work_p50_us = work_p50_us;
            health.work_max_us = work_max_us;
            health.late_p50_us = late_p50_us;
            health.late_max_us = late_max_us;
            health.memory_bytes = memory_bytes();
            health.cpu_ns = cpu_ns();
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
