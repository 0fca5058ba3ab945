//! Pauses of navigation: a person who drives or stops robots has them until they are resumed.

use super::Core;
use crate::drive::velocity_gate::Velocity;
use msg::{CommandSource, Monotonic, NavigationCommand, PauseReason, RobotId};
use std::net::IpAddr;

impl Core {
    /// Pauses a robot's navigation if a person's velocity moves it. One who begins to drive pauses what this bridge does not know of, too: a
    /// command line tells the navigator itself, and a bridge that was started again has forgotten what others have sent.
    pub(super) fn pause_if_moving(
        &mut self,
        robot: RobotId,
        velocity: Velocity,
        now: Monotonic,
        is_new_driver: bool,
    ) {
        if velocity == Velocity::ZERO {
            return;
        }
        self.commands.record_time(now);
        if is_new_driver {
            self.push_pause(robot, PauseReason::Person);
        } else {
            self.pause_navigation([robot]);
        }
    }

    /// Pauses the navigation of robots that the navigator drives, because a person drives or stops them.
    pub(super) fn pause_navigation(&mut self, robots: impl IntoIterator<Item = RobotId>) {
        self.pause_navigation_because(robots, PauseReason::Person);
    }

    /// Pauses the navigation of robots that the navigator drives.
    pub(super) fn pause_navigation_because(
        &mut self,
        robots: impl IntoIterator<Item = RobotId>,
        reason: PauseReason,
    ) {
        for robot in robots {
            if self.gate.drive().is_or_will_be_navigated(robot) {
                self.push_pause(robot, reason);
            }
        }
    }

    /// Sets the emergency stop at this time: its pauses are numbered by it, above what other programs have sent before.
    pub(super) fn set_emergency_stop_at(&mut self, now: Monotonic) {
        self.commands.record_time(now);
        self.set_emergency_stop();
    }

    /// Pauses the navigation of all robots, those included of which this bridge does not know that somebody has sent them: a command
    /// line tells the navigator itself, which may hang or be starting again.
    pub(super) fn pause_all_navigation(&mut self, reason: PauseReason) {
        let robots: Vec<RobotId> = self.fleet.robots().collect();
        robots.into_iter().for_each(|robot| self.push_pause(robot, reason));
    }

    pub(super) fn push_pause(&mut self, robot: RobotId, reason: PauseReason) {
        self.gate.drive_mut().end_navigation(robot);
        let number = self.commands.next_navigation_number();
        self.commands.push_navigation(robot, NavigationCommand::pause(number, reason));
    }

    /// Pauses the robots that drive to goals of an address, and those that explore because of it.
    pub fn pause_robots_of(&mut self, address: IpAddr) {
        let is_theirs =
            |sender: CommandSource| sender.address().is_some_and(|peer| peer.ip() == address.to_canonical());
        let explores = is_theirs(self.commands.exploration_sender());
        let is_unanswered = self.commands.is_exploration_unanswered();
        let robots: Vec<RobotId> = self
            .fleet
            .robots()
            .filter(|robot| {
                is_theirs(self.commands.goal_sender(*robot))
                    || explores && (is_unanswered || self.gate.drive().is_exploring(*robot))
            })
            .collect();
        // Whether they drive is not asked: a bridge that was just started does not know yet.
        robots.into_iter().for_each(|robot| self.push_pause(robot, PauseReason::Person));
    }
}
