//! The bridge's side of navigation: commands to the navigator, and its velocities.

use super::Bridge;
use msg::{Monotonic, NavigationCommand, RobotId, VelocityCommand};

impl Bridge {
    /// Sets where goals and other commands to the navigator go. It must not call the bridge.
    pub fn on_navigation(&self, sink: impl FnMut(RobotId, NavigationCommand) + 'static) {
        *self.on_navigation.borrow_mut() = Box::new(sink);
    }

    /// Handles a velocity of the navigator, which drives a robot that nobody else drives.
    pub fn receive_navigation_velocity(&self, robot: RobotId, command: &VelocityCommand, now: Monotonic) {
        self.update(|core| core.receive_navigation_velocity(robot, command, now));
    }
}
