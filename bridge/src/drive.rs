//! Decides whose velocities a robot gets: the selected robot, one lease for each robot, the emergency stop.

pub mod velocity_gate;

use crate::router::ClientId;
use msg::{Monotonic, ROBOTS_MAX, RobotId};
use std::net::IpAddr;
use std::time::Duration;

/// A client that drives a robot or asks to, or one that drove it before the bridge was restarted and is not connected yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DriveClient {
    /// The connection; `None` for a driver of before the restart.
    pub client: Option<ClientId>,
    /// The client's address; `None` for all participants on DDS together.
    pub address: Option<IpAddr>,
}

impl DriveClient {
    /// Returns whether `other` may use this driver's lease: the same connection, or the same address after a restart.
    pub(crate) fn is_same(&self, other: &Self) -> bool {
        match self.client {
            Some(client) => other.client == Some(client),
            None => self.address == other.address,
        }
    }
}

/// What happens to a velocity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DriveDecision {
    /// It is sent to the robot.
    Pass,
    /// It is dropped without an error: a zero velocity from a client that does not drive the robot.
    Ignore,
    /// It is refused: another client drives the robot.
    DrivenBy(DriveClient),
    /// It is refused: the base on another machine drives the robot.
    DrivenByBase,
    /// It is refused: the emergency stop is set.
    Stopped,
}

#[derive(Clone, Copy, Debug, Default)]
struct RobotDrive {
    /// Who holds the robot, and until when.
    lease: Option<(DriveClient, Monotonic)>,
    /// Until when the base on another machine drives the robot.
    base_until: Option<Monotonic>,
    /// The client whose velocity moved the robot last, until the navigator, the base or another client takes over.
    last_driver: Option<ClientId>,
    /// Whether the navigator drives the robot to a goal.
    is_navigated: bool,
    /// Whether the robot takes part in the fleet's exploration.
    is_exploring: bool,
    /// Number of the newest command to drive the robot that the navigator has not answered; 0 without one.
    unanswered: u64,
}

impl RobotDrive {
    fn is_driven_by_base(&self, now: Monotonic) -> bool {
        self.base_until.is_some_and(|until| now < until)
    }
}

/// Arbitrates between the clients that want to drive robots.
#[derive(Debug)]
pub struct DriveArbiter {
    robots: [RobotDrive; ROBOTS_MAX],
    robot_count: usize,
    selected: RobotId,
    is_stopped: bool,
    /// Number of stops, and of times that a client has begun to drive a robot or has taken it over from another.
    interruptions: u64,
    lease: Duration,
    /// The robot that a client's thumb stick moves while its grip (the dead man's switch) is held.
    stick_targets: Vec<(ClientId, RobotId)>,
}

impl DriveArbiter {
    /// Creates the arbiter of the first `robot_count` robots. A lease lasts for `lease` after a moving velocity.
    pub fn new(robot_count: usize, selected: RobotId, lease: Duration) -> Self {
        Self {
            robots: [RobotDrive::default(); ROBOTS_MAX],
            robot_count,
            selected,
            is_stopped: false,
            interruptions: 0,
            lease,
            stick_targets: Vec::new(),
        }
    }

    /// Returns the robot that `/cmd_vel` drives.
    pub fn selected(&self) -> RobotId {
        self.selected
    }

    /// Returns the robot of a number that a client sent, or `None` if the fleet has no such robot.
    pub fn robot(&self, number: i32) -> Option<RobotId> {
        let number = usize::try_from(number).ok()?;
        RobotId::new(number).filter(|robot| robot.number() <= self.robot_count)
    }

    /// Selects the robot that `/cmd_vel` drives.
    pub fn select(&mut self, robot: RobotId) {
        self.selected = robot;
    }

    /// Returns whether the emergency stop is set.
    pub fn is_stopped(&self) -> bool {
        self.is_stopped
    }

    /// Sets or releases the emergency stop.
    pub fn set_stopped(&mut self, is_stopped: bool) {
        self.interruptions += u64::from(is_stopped && !self.is_stopped);
        self.is_stopped = is_stopped;
    }

    /// Returns the number of stops, and of times that a client has begun to drive a robot or has taken it over from another,
    /// since the start.
    pub fn interruptions(&self) -> u64 {
        self.interruptions
    }

    /// Returns whether a client holds a robot's lease now.
    pub fn is_driven_by_client(&self, now: Monotonic) -> bool {
        RobotId::first(self.robot_count).any(|robot| self.leaseholder(robot, now).is_some())
    }

    /// Returns who holds the robot's lease now.
    pub fn leaseholder(&self, robot: RobotId, now: Monotonic) -> Option<DriveClient> {
        self.robots[robot.index()].lease.filter(|(_, until)| now < *until).map(|(driver, _)| driver)
    }

    /// Decides on one velocity of a driver.
    ///
    /// A moving velocity takes or renews the lease of a robot that nobody else holds. A zero velocity does not, so
    /// that a client that sends zeros at 20 Hz keeps no robot from others.
    pub fn decide(
        &mut self,
        driver: DriveClient,
        robot: RobotId,
        is_moving: bool,
        now: Monotonic,
    ) -> DriveDecision {
        if self.is_stopped {
            return if is_moving { DriveDecision::Stopped } else { DriveDecision::Ignore };
        }
        let before = self.leaseholder(robot, now);
        match before {
            Some(holder) if !holder.is_same(&driver) => {
                return if is_moving { DriveDecision::DrivenBy(holder) } else { DriveDecision::Ignore };
            }
            _ => {}
        }
        let state = &mut self.robots[robot.index()];
        // A client that sends zeros at 20 Hz does not stop a robot that the navigator or the base drives.
        let is_driven = state.is_navigated || state.is_driven_by_base(now);
        if !is_moving && is_driven && state.lease.is_none_or(|(_, until)| now >= until) {
            return DriveDecision::Ignore;
        }
        if is_moving {
            state.lease = Some((driver, now + self.lease));
            state.base_until = None;
            // A zero makes nobody the driver: a client that only watches and sends zeros stops nothing when it leaves.
            state.last_driver = driver.client;
            self.interruptions += u64::from(before.is_none());
        }
        DriveDecision::Pass
    }

    /// Decides on a velocity of the navigator, which takes no lease and gives way to everybody who has one.
    pub fn decide_navigation(&mut self, robot: RobotId, now: Monotonic) -> DriveDecision {
        match self.leaseholder(robot, now) {
            _ if self.is_stopped => DriveDecision::Stopped,
            Some(holder) => DriveDecision::DrivenBy(holder),
            None if self.robots[robot.index()].is_driven_by_base(now) => DriveDecision::DrivenByBase,
            None => {
                self.robots[robot.index()].last_driver = None;
                DriveDecision::Pass
            }
        }
    }

    /// Decides on a velocity of the base on another machine. It gives way to every client, and the navigator gives way to it:
    /// a moving velocity keeps the robot for the base as long as a lease lasts.
    pub fn decide_base(&mut self, robot: RobotId, is_moving: bool, now: Monotonic) -> DriveDecision {
        let refusal = match self.leaseholder(robot, now) {
            _ if self.is_stopped => Some(DriveDecision::Stopped),
            holder => holder.map(DriveDecision::DrivenBy),
        };
        if let Some(refusal) = refusal {
            return if is_moving { refusal } else { DriveDecision::Ignore };
        }
        let state = &mut self.robots[robot.index()];
        if is_moving {
            state.base_until = Some(now + self.lease);
            state.last_driver = None;
        } else if state.is_navigated && !state.is_driven_by_base(now) {
            return DriveDecision::Ignore;
        }
        DriveDecision::Pass
    }

    /// Returns whether a robot takes part in the exploration.
    pub fn is_exploring(&self, robot: RobotId) -> bool {
        self.robots[robot.index()].is_exploring
    }

    /// Returns whether the navigator drives a robot, or will when it has read what it was told: it may hang or be starting again.
    pub fn is_or_will_be_navigated(&self, robot: RobotId) -> bool {
        let state = &self.robots[robot.index()];
        state.is_navigated || state.is_exploring || state.unanswered > 0
    }

    /// Records that the navigator was told to drive a robot, by the command with this number.
    pub fn expect_navigation(&mut self, robot: RobotId, number: u64) {
        self.robots[robot.index()].unanswered = number;
    }

    /// Records that the navigator has answered the robot's commands up to this number.
    pub fn confirm_navigation(&mut self, robot: RobotId, number: u64) {
        let state = &mut self.robots[robot.index()];
        if state.unanswered <= number {
            state.unanswered = 0;
        }
    }

    /// Records that the navigator was told to leave a robot to people.
    pub fn end_navigation(&mut self, robot: RobotId) {
        let state = &mut self.robots[robot.index()];
        (state.is_navigated, state.is_exploring, state.unanswered) = (false, false, 0);
    }

    /// Records whether a robot takes part in the exploration. It does so between two goals too.
    pub fn set_exploring(&mut self, robot: RobotId, is_exploring: bool) {
        self.robots[robot.index()].is_exploring = is_exploring;
    }

    /// Records whether the navigator drives a robot to a goal.
    pub fn set_navigated(&mut self, robot: RobotId, is_navigated: bool) {
        self.robots[robot.index()].is_navigated = is_navigated;
    }

    /// Gives the lease of a robot to a driver; returns the other one that held it.
    pub fn take_control(
        &mut self,
        driver: DriveClient,
        robot: RobotId,
        now: Monotonic,
    ) -> Option<DriveClient> {
        let holder = self.leaseholder(robot, now);
        let before = holder.filter(|holder| !holder.is_same(&driver));
        self.interruptions += u64::from(holder.is_none() || before.is_some());
        let state = &mut self.robots[robot.index()];
        state.lease = Some((driver, now + self.lease));
        state.last_driver = state.last_driver.filter(|last| Some(*last) == driver.client);
        before
    }

    /// Keeps a robot for a driver of before a restart until `until`: nobody else may drive it without taking it over.
    pub fn restore_lease(&mut self, robot: RobotId, address: Option<IpAddr>, until: Monotonic) {
        if let Some(state) = self.robots.get_mut(robot.index()) {
            state.lease = Some((DriveClient { client: None, address }, until));
        }
    }

    /// Sets which robot a client's thumb stick moves; returns the robot that it moved before.
    pub fn set_stick_target(&mut self, client: ClientId, robot: Option<RobotId>) -> Option<RobotId> {
        let place = self.stick_targets.iter().position(|(known, _)| *known == client);
        let before = place.map(|place| self.stick_targets.swap_remove(place).1);
        self.stick_targets.extend(robot.map(|robot| (client, robot)));
        before
    }

    /// Ends a client's leases; returns the robots that it moved and nobody else since, which must be stopped.
    pub fn release_client(&mut self, client: ClientId) -> Vec<RobotId> {
        self.set_stick_target(client, None);
        let mut driven = Vec::new();
        for robot in RobotId::first(self.robot_count) {
            let state = &mut self.robots[robot.index()];
            state.lease = state.lease.filter(|(holder, _)| holder.client != Some(client));
            if state.last_driver == Some(client) {
                state.last_driver = None;
                driven.push(robot);
            }
        }
        driven
    }
}

#[cfg(test)]
mod tests;
