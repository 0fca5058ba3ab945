//! Whose scans somebody at the base looks at, and how many of them.

use crate::channel;
use crate::ports::{ChannelError, Ports, ReadPort};
use crate::process::scan_demand::DEMAND_LASTS;
use crate::run::Run;
use ::link::ScanRate;
use msg::{Monotonic, RobotId, ScanDemand, ScanPurpose};

/// Demands of the base's processes for scans, each until it is not repeated any more.
pub struct ScanDemands<P: Ports> {
    demands: P::Reader<ScanDemand>,
    /// Scans for those who look, and for navigation.
    rates: [ScanRate; 2],
    /// Ends of each robot's demands, likewise.
    until: Vec<[Monotonic; 2]>,
}

impl<P: Ports> ScanDemands<P> {
    /// Opens the channel.
    pub fn open(ports: &P, run: &Run) -> Result<Self, ChannelError> {
        let link = &run.config.link;
        let rates = [link.scan_rate_hz, link.drive_rate_hz].map(|hz| ScanRate::new(hz, link.scan_beams));
        let until = vec![[Monotonic(0); 2]; run.config.fleet.robots];
        Ok(Self { demands: ports.reader(&channel::scan_demand())?, rates, until })
    }

    /// Takes the demands that have come.
    pub fn receive(&mut self, now: Monotonic) {
        while let Some(demand) = self.demands.receive() {
            let purpose = usize::from(demand.purpose == ScanPurpose::Navigation as u32);
            for (robot, until) in RobotId::first(self.until.len()).zip(&mut self.until) {
                if demand.includes(robot) {
                    until[purpose] = now + DEMAND_LASTS;
                }
            }
        }
    }

    /// Returns which scans of a robot are wanted now: the most that anybody asks for.
    pub fn of(&self, robot: RobotId, now: Monotonic) -> Option<ScanRate> {
        let until = self.until.get(robot.index())?;
        let wanted = self.rates.iter().zip(until).filter(|(_, until)| now < **until);
        wanted.map(|(rate, _)| *rate).min_by_key(|rate| rate.period_ms)
    }
}
