//! Health report of a process, once a second.

use crate::channel;
use crate::clock::Epoch;
use crate::ports::{ChannelError, Clock, Ports, ReceiveCounts, WritePort};
use crate::run::Run;
use msg::{Monotonic, ProcessHealth, RobotId, Role};

/// Period of the reports, nanoseconds.
const PERIOD_NS: u64 = 1_000_000_000;
/// Units of work measured in one period: twice the busiest loop's 100 ticks.
const SAMPLES_MAX: usize = 256;

/// Measures a process's loop and publishes the report.
pub struct Heartbeat<P: Ports> {
    writer: P::Writer<ProcessHealth>,
    clock: P::Clock,
    epoch: Epoch,
    role: Role,
    robot: Option<RobotId>,
    due: Monotonic,
    work_us: heapless::Vec<f32, SAMPLES_MAX>,
    late_us: heapless::Vec<f32, SAMPLES_MAX>,
}

/// Counters that only the process itself knows.
#[derive(Clone, Copy, Debug, Default)]
pub struct HealthCounters {
    /// Messages received and missed on its main input.
    pub receive_counts: ReceiveCounts,
    /// Clients that are connected now (bridge only).
    pub clients: u32,
    /// Messages dropped for slow readers.
    pub dropped: u64,
    /// Messages refused because their content is invalid.
    pub refused: u64,
}

impl<P: Ports> Heartbeat<P> {
    /// Opens the process's channel; the first report is due in a second.
    pub fn new(ports: &P, run: &Run, role: Role, robot: Option<RobotId>) -> Result<Self, ChannelError> {
        let clock = ports.clock();
        Ok(Self {
            writer: ports.writer(&channel::process_health(role, robot))?,
            epoch: run.epoch,
            role,
            robot,
            due: Monotonic(clock.now().0 + PERIOD_NS),
            clock,
            work_us: heapless::Vec::new(),
            late_us: heapless::Vec::new(),
        })
    }

    /// Does a unit of work and measures how long it takes.
    pub fn measure<R>(&mut self, work: impl FnOnce() -> R) -> R {
        let start = self.clock.now();
        let result = work();
        self.record_work(self.clock.now().since(start));
        result
    }

    /// Records how long a unit of work took, nanoseconds.
    pub fn record_work(&mut self, took_ns: u64) {
        // A full list keeps the period's first samples.
        let _ = self.work_us.push(took_ns as f32 * 1e-3);
    }

    /// Records how late periodic work begins.
    pub fn record_lateness(&mut self, due: Monotonic) {
        let _ = self.late_us.push(self.clock.now().since(due) as f32 * 1e-3);
    }

    /// Returns when the next report is due.
    pub fn due(&self) -> Monotonic {
        self.due
    }

    /// Publishes the report if it is due.
    pub fn publish_if_due(&mut self, counters: impl FnOnce() -> HealthCounters) {
        let at = self.clock.now();
        if at < self.due {
            return;
        }
        self.due = Monotonic((self.due.0 + PERIOD_NS).max(at.0));
        let HealthCounters { receive_counts, clients, dropped, refused } = counters();
        let (work_p50_us, work_max_us) = median_and_max(&mut self.work_us);
        let (late_p50_us, late_max_us) = median_and_max(&mut self.late_us);
        let (role, robot, epoch) = (self.role as u32, self.robot, self.epoch);
        let usage = self.clock.usage();
        self.writer.send_with(|health| {
            health.header.stamp = epoch.stamp(at);
            health.role = role;
            health.robot = robot.map_or(0, |robot| robot.number() as u32);
            health.pid = usage.pid;
            health.clients = clients;
            health.received = receive_counts.received;
            health.lost = receive_counts.lost;
            health.dropped = dropped;
            health.refused = refused;
            health.work_p50_us = work_p50_us;
            health.work_max_us = work_max_us;
            health.late_p50_us = late_p50_us;
            health.late_max_us = late_max_us;
            health.memory_bytes = usage.memory_bytes;
            health.cpu_ns = usage.cpu_ns;
            health.restarts = usage.restarts;
        });
    }
}

/// Returns the median and the largest of the samples, and clears them.
fn median_and_max(samples: &mut heapless::Vec<f32, SAMPLES_MAX>) -> (f32, f32) {
    samples.sort_unstable_by(f32::total_cmp);
    let result = (samples.get(samples.len() / 2).copied(), samples.last().copied());
    samples.clear();
    (result.0.unwrap_or(0.0), result.1.unwrap_or(0.0))
}
