//! The gate that every velocity passes on its way to a robot: lease, limits, dead man, emergency stop.
//!
//! It reads no clock: time comes in as `now`. What passes waits in [`VelocityGate::next_output`].

#[cfg(test)]
mod tests;

use crate::config::VelocityConfig;
use crate::drive::{DriveArbiter, DriveClient, DriveDecision};
use crate::router::ClientId;
use msg::{Monotonic, ROBOTS_MAX, RobotId};
use std::collections::VecDeque;
use std::time::Duration;

/// Zeros are repeated for this long after a robot is stopped: one may be lost, or a reader may not be matched yet.
pub const STOP_REPEATED: Duration = Duration::from_secs(1);
/// Period of the repeated zeros: 20 Hz, as operators send velocities.
const ZERO_PERIOD: Duration = Duration::from_millis(50);
/// Period of the zeros while the emergency stop is set: a robot that is switched on meanwhile gets one soon.
const STOPPED_ZERO_PERIOD: Duration = Duration::from_millis(500);
/// Velocities that may wait; they are taken after each call.
const OUTPUTS_MAX: usize = 4 * ROBOTS_MAX;

/// A velocity of a robot on the floor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Velocity {
    /// Speed forward, m/s.
    pub linear_m_s: f64,
    /// Turning rate counter-clockwise, rad/s.
    pub angular_rad_s: f64,
}

impl Velocity {
    /// The robot stands.
    pub const ZERO: Self = Self { linear_m_s: 0.0, angular_rad_s: 0.0 };

    fn is_moving(self) -> bool {
        self != Self::ZERO
    }

    fn is_finite(self) -> bool {
        self.linear_m_s.is_finite() && self.angular_rad_s.is_finite()
    }
}

/// Largest speeds of a robot in either direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotLimits {
    /// Forward and backward, m/s.
    pub linear_m_s: f64,
    /// In either direction, rad/s.
    pub angular_rad_s: f64,
}

impl RobotLimits {
    /// Returns a robot's own limits, or else those of all robots.
    pub fn new(config: &VelocityConfig, robot: RobotId) -> Self {
        let own = config.robots.iter().find(|limits| limits.robot == robot.number());
        let (linear_m_s, angular_rad_s) = own.map_or((config.linear_m_s, config.angular_rad_s), |limits| {
            (limits.linear_m_s, limits.angular_rad_s)
        });
        Self { linear_m_s, angular_rad_s }
    }

    /// Returns the velocity with each component within its limit; it must be finite.
    pub fn clamp(&self, velocity: Velocity) -> Velocity {
        Velocity {
            linear_m_s: velocity.linear_m_s.clamp(-self.linear_m_s, self.linear_m_s),
            angular_rad_s: velocity.angular_rad_s.clamp(-self.angular_rad_s, self.angular_rad_s),
        }
    }
}

/// What the gate does with a velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GateDecision {
    /// It goes to the robot, clamped to its limits.
    Passed(Velocity),
    /// It is dropped without an error: a zero velocity from a client that does not drive the robot.
    Ignored,
    /// It is refused: another client drives the robot.
    DrivenBy(DriveClient),
    /// It is refused: the base on another machine drives the robot.
    DrivenByBase,
    /// It is refused: the emergency stop is set.
    Stopped,
    /// It is refused: a component is infinite or not a number.
    NotFinite,
}

/// How a robot was commanded last.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Motion {
    /// A zero was sent; the next tick begins to repeat it.
    StopRequested,
    /// Zeros are repeated until this time.
    Stopping { until: Monotonic },
    /// The robot has got its zeros.
    Standing,
    /// The last velocity was not zero, and is valid until this time.
    Driven { until: Monotonic },
}

#[derive(Clone, Copy, Debug)]
struct RobotGate {
    limits: RobotLimits,
    motion: Motion,
    /// When the next zero is due, unless the robot is driven.
    next_zero: Monotonic,
}

/// Decides on each velocity, and sends zeros when a robot must stop.
#[derive(Debug)]
pub struct VelocityGate {
    drive: DriveArbiter,
    robots: Vec<RobotGate>,
    timeout: Duration,
    outputs: VecDeque<(RobotId, Velocity)>,
}

impl VelocityGate {
    /// Creates the gate of robots 1 to `robot_count`, and sends each a zero: what moved it before is not known.
    pub fn new(config: &VelocityConfig, robot_count: usize, drive: DriveArbiter) -> Self {
        let robot_gate = |robot| RobotGate {
            limits: RobotLimits::new(config, robot),
            motion: Motion::StopRequested,
            next_zero: Monotonic(0),
        };
        let mut gate = Self {
            drive,
            robots: RobotId::first(robot_count).map(robot_gate).collect(),
            timeout: config.timeout(),
            outputs: VecDeque::with_capacity(OUTPUTS_MAX),
        };
        gate.stop_all();
        gate
    }

    /// Returns who drives, and which robot is selected.
    pub fn drive(&self) -> &DriveArbiter {
        &self.drive
    }

    /// Returns the arbiter, to select a robot or to restore its state; it sends no velocity.
    pub fn drive_mut(&mut self) -> &mut DriveArbiter {
        &mut self.drive
    }

    /// Decides on one velocity of a driver, and sends it to the robot if it passes.
    pub fn request(
        &mut self,
        driver: DriveClient,
        robot: RobotId,
        velocity: Velocity,
        now: Monotonic,
    ) -> GateDecision {
        let Some(velocity) = self.clamp(robot, velocity) else { return GateDecision::NotFinite };
        let decision = self.drive.decide(driver, robot, velocity.is_moving(), now);
        self.apply(robot, velocity, decision, now)
    }

    /// Decides on one velocity of the navigator, and sends it to the robot if it passes.
    pub fn request_navigation(&mut self, robot: RobotId, velocity: Velocity, now: Monotonic) -> GateDecision {
        let Some(velocity) = self.clamp(robot, velocity) else { return GateDecision::NotFinite };
        let decision = self.drive.decide_navigation(robot, now);
        self.apply(robot, velocity, decision, now)
    }

    /// Decides on one velocity of the base on another machine, and sends it to the robot if it passes.
    pub fn request_base(&mut self, robot: RobotId, velocity: Velocity, now: Monotonic) -> GateDecision {
        let Some(velocity) = self.clamp(robot, velocity) else { return GateDecision::NotFinite };
        let decision = self.drive.decide_base(robot, velocity.is_moving(), now);
        self.apply(robot, velocity, decision, now)
    }

    /// Returns a velocity within the robot's limits; `None` if a component is infinite or not a number.
    fn clamp(&self, robot: RobotId, velocity: Velocity) -> Option<Velocity> {
        let limits = self.robots.get(robot.index()).map(|state| state.limits);
        velocity.is_finite().then(|| limits.map_or(Velocity::ZERO, |limits| limits.clamp(velocity)))
    }

    /// Sends a velocity within limits to the robot if the decision is to pass it.
    fn apply(
        &mut self,
        robot: RobotId,
        velocity: Velocity,
        decision: DriveDecision,
        now: Monotonic,
    ) -> GateDecision {
        let Some(state) = self.robots.get_mut(robot.index()) else { return GateDecision::Ignored };
        match decision {
            DriveDecision::Pass => {}
            DriveDecision::Ignore => return GateDecision::Ignored,
            DriveDecision::Stopped => return GateDecision::Stopped,
            DriveDecision::DrivenBy(holder) => return GateDecision::DrivenBy(holder),
            DriveDecision::DrivenByBase => return GateDecision::DrivenByBase,
        }
        if velocity.is_moving() {
            state.motion = Motion::Driven { until: now + self.timeout };
        } else if let Motion::Driven { .. } = state.motion {
            state.motion = Motion::Stopping { until: now + STOP_REPEATED };
        }
        state.next_zero = now + ZERO_PERIOD;
        self.push_output(robot, velocity);
        GateDecision::Passed(velocity)
    }

    /// Gives a robot to a driver; returns the other client that drove it. The robot stops, unless the driver had it already.
    pub fn take_control(&mut self, driver: DriveClient, robot: RobotId, now: Monotonic) -> Option<ClientId> {
        let had_it = self.drive.leaseholder(robot, now).is_some_and(|holder| holder.is_same(&driver));
        let before = self.drive.take_control(driver, robot, now);
        if !had_it {
            self.stop(robot);
        }
        before?.client
    }

    /// Ends a client's leases, and stops the robots that it drove last.
    pub fn release_client(&mut self, client: ClientId) {
        for robot in self.drive.release_client(client) {
            self.stop(robot);
        }
    }

    /// Sets the emergency stop, which stops every robot, or releases it.
    pub fn set_stopped(&mut self, is_stopped: bool) {
        self.drive.set_stopped(is_stopped);
        if is_stopped {
            self.stop_all();
        }
    }

    /// Sends zeros to a robot that nobody drives: somebody has begun to listen who may not know that it stands.
    pub fn repeat_stop(&mut self, robot: RobotId) {
        let is_driven = |state: &RobotGate| matches!(state.motion, Motion::Driven { .. });
        if self.robots.get(robot.index()).is_some_and(|state| !is_driven(state)) {
            self.stop(robot);
        }
    }

    /// Sends the zeros that are due: to robots whose last velocity is too old, and the repeated ones.
    pub fn tick(&mut self, now: Monotonic) {
        let is_stopped = self.drive.is_stopped();
        for index in 0..self.robots.len() {
            let state = &mut self.robots[index];
            if state.due(is_stopped).is_none_or(|due| due > now) {
                continue;
            }
            state.advance(now);
            if let Some(robot) = RobotId::new(index + 1) {
                self.push_output(robot, Velocity::ZERO);
            }
        }
    }

    /// Returns when [`Self::tick`] has something to send next.
    pub fn next_due(&self) -> Option<Monotonic> {
        let is_stopped = self.drive.is_stopped();
        self.robots.iter().filter_map(|state| state.due(is_stopped)).min()
    }

    /// Returns how long a velocity is valid.
    pub fn timeout(&self) -> Duration {
        self.timeout
    }

    /// Takes the oldest velocity that must be sent now.
    pub fn next_output(&mut self) -> Option<(RobotId, Velocity)> {
        self.outputs.pop_front()
    }

    fn stop_all(&mut self) {
        RobotId::first(self.robots.len()).for_each(|robot| self.stop(robot));
    }

    fn stop(&mut self, robot: RobotId) {
        if let Some(state) = self.robots.get_mut(robot.index()) {
            state.motion = Motion::StopRequested;
            self.push_output(robot, Velocity::ZERO);
        }
    }

    fn push_output(&mut self, robot: RobotId, velocity: Velocity) {
        if self.outputs.len() == OUTPUTS_MAX {
            self.outputs.pop_front();
        }
        self.outputs.push_back((robot, velocity));
    }
}

impl RobotGate {
    /// Returns when the robot must get its next zero.
    fn due(&self, is_stopped: bool) -> Option<Monotonic> {
        match self.motion {
            Motion::StopRequested => Some(Monotonic(0)),
            Motion::Driven { until } => Some(until),
            Motion::Stopping { .. } => Some(self.next_zero),
            Motion::Standing => is_stopped.then_some(self.next_zero),
        }
    }

    /// Records that the zero that was due is sent.
    fn advance(&mut self, now: Monotonic) {
        self.motion = match self.motion {
            Motion::StopRequested | Motion::Driven { .. } => Motion::Stopping { until: now + STOP_REPEATED },
            Motion::Stopping { until } if now < until => Motion::Stopping { until },
            Motion::Stopping { .. } | Motion::Standing => Motion::Standing,
        };
        let period = if self.motion == Motion::Standing { STOPPED_ZERO_PERIOD } else { ZERO_PERIOD };
        self.next_zero = now + period;
    }
}
