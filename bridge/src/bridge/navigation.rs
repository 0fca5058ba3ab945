//! The bridge's side of navigation: commands to the navigator, and its velocities.

use super::Bridge;
use msg::{
    CommandSource, ExplorationCommand, Monotonic, NavigationCommand, RobotId, VelocityCommand, ZoneCommand,
};

impl Bridge {
    /// Sets where goals and other commands to the navigator go. It must not call the bridge.
    pub fn on_navigation(&self, sink: impl FnMut(RobotId, NavigationCommand) + 'static) {
        *self.on_navigation.borrow_mut() = Box::new(sink);
    }

    /// Sets where commands about the fleet's exploration go. It must not call the bridge.
    pub fn on_exploration(&self, sink: impl FnMut(ExplorationCommand) + 'static) {
        *self.on_exploration.borrow_mut() = Box::new(sink);
    }

    /// Sets where commands about the exclusion zones go. It must not call the bridge.
    pub fn on_zone(&self, sink: impl FnMut(ZoneCommand) + 'static) {
        *self.on_zone.borrow_mut() = Box::new(sink);
    }

    /// Handles a velocity of the navigator, which drives a robot that nobody else drives.
    pub fn receive_navigation_velocity(&self, robot: RobotId, command: &VelocityCommand, now: Monotonic) {
        self.update(|core| {
            core.commands.set_sender(CommandSource::NAVIGATION);
            core.receive_navigation_velocity(robot, command, now);
        });
    }

    /// Handles a velocity of the base, on the machine of its robot.
    pub fn receive_base_velocity(&self, robot: RobotId, command: &VelocityCommand, now: Monotonic) {
        self.update(|core| {
            core.commands.set_sender(CommandSource::BASE);
            core.receive_base_velocity(robot, command, now);
        });
    }

    /// Returns the number of stops, and of times that a client has begun to drive, since the start.
    pub fn interruptions(&self) -> u64 {
        self.core.borrow().gate.drive().interruptions()
    }

    /// Returns whether a client drives a robot now.
    pub fn is_driven_by_client(&self, now: Monotonic) -> bool {
        self.core.borrow().gate.drive().is_driven_by_client(now)
    }

    /// Passes on what clients want of the navigator.
    pub(super) fn pass_navigation_commands(&self) {
        if let Ok(mut sink) = self.on_navigation.try_borrow_mut() {
            while let Some((robot, command)) = { self.core.borrow_mut().commands.next_navigation() } {
                sink(robot, command);
            }
        }
        if let Ok(mut sink) = self.on_exploration.try_borrow_mut() {
            while let Some(command) = { self.core.borrow_mut().commands.next_exploration() } {
                sink(command);
            }
        }
        if let Ok(mut sink) = self.on_zone.try_borrow_mut() {
            while let Some(command) = { self.core.borrow_mut().commands.next_zone() } {
                sink(command);
            }
        }
    }
}
