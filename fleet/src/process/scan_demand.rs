//! Demand for scans of robots on other machines: bridge, recorder and navigation send it, the link follows it.

use crate::channel;
use crate::config::RobotSource;
use crate::ports::{ChannelError, Ports, WritePort};
use crate::run::Run;
use msg::{Monotonic, RobotId, ScanDemand, ScanPurpose};
use std::time::Duration;

/// Period at which a demand is repeated.
const REPEAT_PERIOD: Duration = Duration::from_millis(500);
/// Time after which a demand that is not repeated has ended: three periods, for a process that is late.
pub const DEMAND_LASTS: Duration = Duration::from_millis(1500);

/// Tells the link whose scans this process wants. Where the robots are not on other machines it does nothing.
pub struct ScanDemandSender<P: Ports> {
    writer: Option<P::Writer<ScanDemand>>,
    purpose: ScanPurpose,
    /// Robots of the last demand, and when it is to be repeated.
    sent: (u64, Monotonic),
}

impl<P: Ports> ScanDemandSender<P> {
    /// Opens the channel.
    ///
    /// # Errors
    /// The channel cannot be opened.
    pub fn open(ports: &P, run: &Run, purpose: ScanPurpose) -> Result<Self, ChannelError> {
        let is_base = run.config.world == RobotSource::Robots;
        let writer = is_base.then(|| ports.writer(&channel::scan_demand())).transpose()?;
        Ok(Self { writer, purpose, sent: (0, Monotonic(0)) })
    }

    /// Sends the demand for these robots' scans, if it is new or due again. Call it several times a second.
    pub fn update(&mut self, robots: impl IntoIterator<Item = RobotId>, now: Monotonic) {
        let Some(writer) = &mut self.writer else { return };
        let robots = ScanDemand::set_of(robots);
        let (before, due) = self.sent;
        if robots == 0 {
            self.sent = (0, now);
        } else if robots & !before != 0 || now >= due {
            let purpose = self.purpose as u32;
            writer.send(&ScanDemand { robots, purpose, ..ScanDemand::default() });
            self.sent = (robots, now + REPEAT_PERIOD);
        }
    }
}
