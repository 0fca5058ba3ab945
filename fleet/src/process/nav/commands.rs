//! Commands of people and programs, applied in the order of their numbers.

use super::NavigationProcess;
use super::state_file::SavedState;
use crate::job_thread::JobWorker;
use crate::ports::{Ports, ReadPort};
use msg::{ExplorationCommand, Monotonic, NavigationAction, NavigationCommand, PauseReason};

/// What waits in a channel of commands.
enum Command {
    /// For the robot with this index.
    OfRobot(usize, Box<NavigationCommand>),
    Exploration(ExplorationCommand),
}

impl<P: Ports, W: JobWorker<SavedState, bool>> NavigationProcess<P, W> {
    /// Applies the commands that wait; returns whether there were any.
    pub(super) fn receive_commands(&mut self, now: Monotonic) -> bool {
        let mut has_changed = false;
        // After a hang, an exploration and the stop that came after it may wait: they are in different channels.
        let mut received = Vec::new();
        for (index, channels) in self.robots.iter_mut().enumerate() {
            while let Some(command) = channels.commands.receive() {
                received.push((command.number, Command::OfRobot(index, Box::new(*command))));
            }
        }
        while let Some(command) = self.exploration.receive() {
            received.push((command.number, Command::Exploration(command)));
        }
        received.sort_by_key(|(number, _)| *number);
        for (number, command) in received {
            match command {
                Command::OfRobot(index, command) if number > self.robots[index].newest => {
                    self.apply(index, &command, now);
                    has_changed = true;
                }
                Command::OfRobot(..) => {}
                Command::Exploration(command) => {
                    self.inputs.receive(now);
                    let stamp = self.epoch.stamp(now);
                    let is_known = self.exploration.apply(&mut self.navigator, &command, stamp);
                    self.refused += u64::from(!is_known);
                    has_changed = true;
                }
            }
        }
        if let Some(refused) = self.zones.receive() {
            self.refused += refused;
            has_changed = true;
        }
        has_changed
    }

    fn apply(&mut self, index: usize, command: &NavigationCommand, now: Monotonic) {
        let stamp = self.epoch.stamp(now);
        let robot = self.robots[index].robot;
        self.robots[index].newest = command.number;
        match command.action() {
            Some(NavigationAction::Goal) => {
                // What has arrived while nobody had a goal is old.
                self.inputs.receive(now);
                let goal = self.inputs.goal(robot, command);
                self.exploration.set_manual(robot, true);
                let channels = &mut self.robots[index];
                (channels.goal, channels.refusal) = (command.number, goal.as_ref().err().copied());
                match goal {
                    Ok(goal) => self.navigator.set_goal(stamp, robot, goal),
                    Err(_) => {
                        self.refused += 1;
                        self.navigator.cancel(robot);
                    }
                }
            }
            Some(NavigationAction::Cancel)
                if command.cancelled != 0 && command.cancelled != self.robots[index].goal => {}
            Some(NavigationAction::Cancel) => {
                self.exploration.set_manual(robot, true);
                self.navigator.cancel(robot);
            }
            Some(NavigationAction::Pause) => {
                let reason = PauseReason::from_code(command.pause_reason).unwrap_or_default();
                let is_driven = self.pause_if_driven(robot, reason);
                // The stop has to be released before all else; else the reason of one that is paused already stays.
                let before = &mut self.robots[index].pause_reason;
                if !is_driven && reason == PauseReason::EmergencyStop && *before == PauseReason::Person {
                    *before = reason;
                }
            }
            Some(NavigationAction::Resume) => {
                self.exploration.release_manual(&self.navigator, robot);
                self.navigator.resume(stamp, robot);
            }
            None => self.refused += 1,
        }
    }
}
