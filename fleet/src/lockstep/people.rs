//! The people around a fleet in lockstep: the operator, other clients' drivers, and the person at the laptop.

use super::drivers::Driver;
use super::headset::Headset;
use super::operator::Operator;
use super::queues::Network;
use super::tcp::Port;
use crate::config::RobotSource;
use crate::ports::Clock;
use crate::process::Error;
use crate::run::Run;
use msg::{Monotonic, RobotId};
use std::rc::Rc;

/// All that act from outside of the fleet's processes.
pub struct People {
    /// The scripted operator.
    pub operator: Operator,
    /// A second operator that contends for a robot.
    pub contender: Driver,
    /// A client without permission; only in a fleet with faults.
    intruder: Option<Driver>,
    /// The headset in which the robots live; only in that world.
    headset: Option<Headset>,
    network: Rc<Network>,
    /// Requests to SLAM that are due later: `Resume` after `Pause`.
    pub resume_at: Vec<(Monotonic, RobotId)>,
    /// When the person at the laptop releases the emergency stop.
    pub release_at: Option<Monotonic>,
}

impl People {
    /// Creates the people of a fleet; in one with faults, there is a client without permission.
    ///
    /// # Errors
    /// The headset's robots cannot be put into their room.
    pub fn new(network: &Rc<Network>, port: &Rc<Port>, run: &Run, together: bool) -> Result<Self, Error> {
        let has_intruder = network.faults().is_shuffled();
        let has_headset = run.config.world == RobotSource::Headset;
        Ok(Self {
            operator: Operator::new(network, port, run, together),
            contender: Driver::contender(network, port),
            intruder: has_intruder.then(|| Driver::intruder(network, port, run.robots())),
            headset: has_headset.then(|| Headset::new(network, port, run)).transpose()?,
            network: network.clone(),
            resume_at: Vec::new(),
            release_at: None,
        })
    }

    /// Returns when a client acts next.
    pub fn due(&self) -> Monotonic {
        let intruder = self.intruder.as_ref().map_or(Monotonic(u64::MAX), |intruder| intruder.due);
        let headset = self.headset.as_ref().map_or(Monotonic(u64::MAX), |headset| headset.due);
        self.operator.due.min(self.contender.due).min(intruder).min(headset)
    }

    /// Returns when a request of the person at the laptop is due next.
    pub fn request_due(&self) -> Option<Monotonic> {
        self.resume_at.iter().map(|(at, _)| *at).chain(self.release_at).min()
    }

    /// Runs one step of the first client that is due.
    pub fn step(&mut self) {
        let now = self.network.clock().now();
        if let Some(headset) = self.headset.as_mut().filter(|headset| headset.due <= now) {
            headset.step();
        } else if self.operator.due <= now {
            self.operator.step();
        } else if self.contender.due <= now {
            self.contender.step();
        } else if let Some(intruder) = self.intruder.as_mut().filter(|intruder| intruder.due <= now) {
            intruder.step();
        }
    }
}
