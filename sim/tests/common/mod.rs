//! Helpers of all tests.
#![allow(dead_code)]

use bytemuck::Zeroable;
use core::ops::Range;
use msg::pose::wrap_angle;
use msg::{GroundTruth, Odometry, RobotId, Scan, VelocityCommand};
use sim::{NoiseConfig, SimConfig, Simulator};

pub fn robot(number: usize) -> RobotId {
    RobotId::new(number).unwrap()
}

/// Configuration without sensor errors.
pub fn quiet() -> SimConfig {
    SimConfig { noise: NoiseConfig::OFF, ..SimConfig::default() }
}

pub fn drive(linear_m_s: f64, angular_rad_s: f64) -> VelocityCommand {
    VelocityCommand { linear_m_s, angular_rad_s, ..VelocityCommand::default() }
}

pub fn scan(simulator: &mut Simulator) -> Box<Scan> {
    let mut scan = Box::new(Scan::zeroed());
    simulator.scan_into(&mut scan);
    scan
}

/// Messages of a simulator that receives the same command repeatedly.
pub struct Run {
    pub truths: Vec<GroundTruth>,
    pub odometry: Vec<Odometry>,
}

impl Run {
    pub fn of(simulator: &mut Simulator, linear_m_s: f64, angular_rad_s: f64, ticks: usize) -> Self {
        let mut run = Self { truths: Vec::new(), odometry: Vec::new() };
        for _ in 0..ticks {
            simulator.set_velocity_command(&drive(linear_m_s, angular_rad_s));
            let tick = simulator.step();
            run.truths.push(tick.truth);
            run.odometry.extend(tick.odometry);
        }
        run
    }

    pub fn turned_rad(&self, ticks: Range<usize>) -> f64 {
        let yaw = |i: usize| self.truths[i].world_from_base.yaw_rad;
        ticks.map(|i| wrap_angle(yaw(i) - yaw(i - 1))).sum()
    }
}
