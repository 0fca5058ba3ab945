//! The bridge's side of the operator at the laptop, and the actions of all operators, for the record.

use super::Bridge;
use crate::core::Core;
use msg::{CommandSource, OperatorEvent, RobotId};

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
