//! Robots on other machines that do not follow the base, as the link says: their goals are paused.

use super::NavigationProcess;
use crate::channel;
use crate::config::RobotSource;
use crate::job_thread::JobWorker;
use crate::ports::{ChannelError, Ports, ReadPort};
use crate::process::nav::state_file::SavedState;
use crate::run::Run;
use msg::{PauseReason, RobotHold, RobotId};

/// Hold of one robot.
struct HoldReader<P: Ports> {
    robot: RobotId,
    reader: P::Reader<RobotHold>,
    /// Newest message of the link; `None` before the first.
    newest: Option<RobotHold>,
    /// What it said of interruptions when it knew of them last; 0: never.
    interruptions: u64,
}

/// Holds of all robots; none where the robots are not on other machines.
pub(super) struct Holds<P: Ports>(Vec<HoldReader<P>>);

impl<P: Ports> Holds<P> {
    pub(super) fn open(ports: &P, run: &Run) -> Result<Self, ChannelError> {
        let is_base = run.config.world == RobotSource::Robots;
        let open = |robot| {
            let reader = ports.reader(&channel::hold(robot))?;
            Ok(HoldReader { robot, reader, newest: None, interruptions: 0 })
        };
        Ok(Self(run.robots().filter(|_| is_base).map(open).collect::<Result<_, ChannelError>>()?))
    }

    /// Reads what has arrived; returns the robots that were stopped or driven by hand at their machines since the last call.
    pub(super) fn receive(&mut self) -> Vec<RobotId> {
        let mut interrupted = Vec::new();
        for HoldReader { robot, reader, newest, interruptions } in &mut self.0 {
            let Some(hold) = reader.newest() else { continue };
            *newest = Some(*hold);
            let before = *interruptions;
            if hold.interruptions != 0 {
                *interruptions = hold.interruptions;
            }
            // What was before the first process of the run is no interruption.
            if before != 0 && before != *interruptions {
                interrupted.push(*robot);
            }
        }
        interrupted
    }

    /// Returns what a process that takes this one's place has to know: each robot's number and its interruptions.
    pub(super) fn saved(&self) -> Vec<(usize, u64)> {
        self.0.iter().map(|hold| (hold.robot.number(), hold.interruptions)).collect()
    }

    /// Goes on with what an earlier process of the run knew.
    pub(super) fn restore(&mut self, saved: &[(usize, u64)]) {
        for hold in &mut self.0 {
            let of_robot = saved.iter().find(|(number, _)| *number == hold.robot.number());
            hold.interruptions = of_robot.map_or(0, |(_, interruptions)| *interruptions);
        }
    }

    /// Returns the robots that are held now, with the reasons.
    pub(super) fn held(&self) -> impl Iterator<Item = (RobotId, PauseReason)> + '_ {
        self.0.iter().filter_map(|hold| Some((hold.robot, hold.newest?.reason()?)))
    }
}

impl<P: Ports, W: JobWorker<SavedState, bool>> NavigationProcess<P, W> {
    /// Pauses a robot's goal, and takes the robot out of the exploration until it is resumed.
    fn pause(&mut self, robot: RobotId, reason: PauseReason) {
        self.exploration.set_manual(robot, false);
        self.navigator.pause(robot);
        if let Some(channels) = self.robots.iter_mut().find(|channels| channels.robot == robot) {
            channels.pause_reason = reason;
        }
    }

    /// Pauses a robot that drives to a goal or explores; returns whether it did.
    pub(super) fn pause_if_driven(&mut self, robot: RobotId, reason: PauseReason) -> bool {
        let has_goal =
            self.navigator.robots().any(|driven| driven.robot == robot && driven.state.is_active());
        let is_driven = has_goal || self.exploration.includes(robot);
        if is_driven {
            self.pause(robot, reason);
        }
        is_driven
    }

    /// Pauses robots on other machines that were stopped or driven by hand there since the last step.
    pub(super) fn pause_interrupted(&mut self) -> bool {
        let interrupted = self.holds.receive();
        let held: Vec<(RobotId, PauseReason)> = self.holds.held().collect();
        let paused = interrupted.into_iter().map(|robot| {
            let reason = held.iter().find(|(known, _)| *known == robot).map(|(_, reason)| *reason);
            self.pause_if_driven(robot, reason.unwrap_or(PauseReason::InterruptedAtRobot))
        });
        paused.filter(|is_paused| *is_paused).count() > 0
    }

    /// Pauses robots on other machines that do not follow the base now, whatever goal they have got.
    pub(super) fn pause_held(&mut self) -> bool {
        let held: Vec<(RobotId, PauseReason)> = self.holds.held().collect();
        let paused = held.into_iter().map(|(robot, reason)| self.pause_if_driven(robot, reason));
        paused.filter(|is_paused| *is_paused).count() > 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::channel::{Opener, Program};
    use crate::config::FleetConfig;
    use crate::lockstep::faults::FaultPlan;
    use crate::lockstep::queues::{MemoryPorts, Network};
    use crate::ports::WritePort;
    use msg::Role;

    #[test]
    fn an_interruption_is_noticed_once_also_while_this_process_or_the_link_is_started_again() {
        let mut config = FleetConfig { world: RobotSource::Robots, ..FleetConfig::default() };
        config.fleet.robots = 1;
        let run = Run::in_memory(config).unwrap();
        let robot = RobotId::new(1).unwrap();
        let network = Network::new(FaultPlan::none());
        let ports = MemoryPorts::attach(&network, Opener::of_fleet(Role::Nav.into()));
        let link = MemoryPorts::attach(&network, Opener::of_fleet(Program::LinkTool));
        let mut holds = Holds::open(&ports, &run).unwrap();
        let mut writer = link.writer(&channel::hold(robot)).unwrap();
        let mut say = |interruptions| writer.send(&RobotHold { interruptions, ..RobotHold::default() });
        say(7);
        assert!(holds.receive().is_empty(), "of before the run's first process");
        say(8);
        assert_eq!(holds.receive(), [robot]);
        // A link that was started again does not know yet.
        say(0);
        assert!(holds.receive().is_empty());
        say(8);
        assert!(holds.receive().is_empty(), "the same as before");
        let saved = holds.saved();
        say(9);
        let mut restarted = Holds::open(&ports, &run).unwrap();
        restarted.restore(&saved);
        say(9);
        assert_eq!(restarted.receive(), [robot], "in between");
        say(9);
        assert!(restarted.receive().is_empty());
    }
}
