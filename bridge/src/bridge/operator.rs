//! The bridge's side of the operator at the laptop, and the actions of all operators, for the record.

use super::Bridge;
use crate::core::Core;
use msg::{CommandSource, OperatorEvent, RobotId};
use std::net::IpAddr;

impl Bridge {
    /// Sets where actions of operators go, for the record. It must not call the bridge.
    pub fn on_operator_event(&self, sink: impl FnMut(OperatorEvent) + 'static) {
        *self.on_operator_event.borrow_mut() = Box::new(sink);
    }

    /// Stops every robot until [`Bridge::release_stop`], as `/emergency_stop` does.
    pub fn stop_robots(&self) {
        self.update_from_laptop(Core::set_emergency_stop);
    }

    /// Releases the emergency stop, as `/emergency_stop_release` does.
    pub fn release_stop(&self) {
        self.update_from_laptop(Core::release_emergency_stop);
    }

    /// Returns whether the emergency stop is set.
    pub fn is_stopped(&self) -> bool {
        self.core.borrow().gate.drive().is_stopped()
    }

    /// Returns the robot that `/cmd_vel` drives.
    pub fn selected_robot(&self) -> RobotId {
        self.core.borrow().gate.drive().selected()
    }

    /// Selects the robot that `/cmd_vel` drives, as `/selected_robot` does; a robot that the fleet has not is ignored.
    pub fn select_robot(&self, robot: RobotId) {
        self.update_from_laptop(|core| select_present(core, robot));
    }

    /// Sets the emergency stop again that held before this bridge began: no operator has done so now.
    pub fn restore_stop(&self) {
        self.update(Core::set_emergency_stop);
    }

    /// Selects the robot again that was selected before this bridge began.
    pub fn restore_selection(&self, robot: RobotId) {
        self.update(|core| select_present(core, robot));
    }

    /// Returns the addresses of those who gave robots their newest goals, and of who started the exploration that may go on, where clients
    /// did.
    pub fn navigation_senders(&self) -> (Vec<(RobotId, IpAddr)>, Option<IpAddr>) {
        let core = self.core.borrow();
        let ip = |sender: CommandSource| sender.address().map(|peer| peer.ip());
        let of_robot = |robot| Some((robot, ip(core.commands.goal_sender(robot))?));
        (core.fleet.robots().filter_map(of_robot).collect(), ip(core.commands.exploration_sender()))
    }

    /// Sets what [`Bridge::navigation_senders`] returned in an earlier bridge of the run: who is denied now loses these goals, too.
    pub fn restore_navigation_senders(&self, goals: &[(RobotId, IpAddr)], exploration: Option<IpAddr>) {
        let client = |address: IpAddr| CommandSource::client((address, 0).into());
        let core = &mut *self.core.borrow_mut();
        let robot_count = core.fleet.robot_count();
        let known = goals.iter().filter(|(robot, _)| robot.number() <= robot_count);
        let goals: Vec<_> = known.map(|(robot, address)| (*robot, client(*address))).collect();
        core.commands.restore_senders(&goals, exploration.map_or_else(CommandSource::default, client));
    }

    /// Changes the core in the name of the person at the laptop.
    fn update_from_laptop(&self, change: impl FnOnce(&mut Core)) {
        self.update(|core| {
            core.commands.set_sender(CommandSource::LAPTOP);
            change(core);
        });
    }
}

/// Selects a robot if the fleet has it.
fn select_present(core: &mut Core, robot: RobotId) {
    if robot.number() <= core.fleet.robot_count() {
        core.select(robot);
    }
}
