//! Robots on other machines that do not follow the base, as the link says: their goals are paused.

use super::NavigationProcess;
use crate::channel;
use crate::config::RobotSource;
use crate::ports::{ChannelError, Ports, ReadPort};
use crate::process::file_thread::JobWorker;
use crate::process::nav::state_file::SavedState;
use crate::run::Run;
use msg::{PauseReason, RobotHold, RobotId};

/// Hold of one robot.
struct HoldReader<P: Ports> {
    robot: RobotId,
    reader: P::Reader<RobotHold>,
    /// Newest message of the link; `None` before the first.
    newest: Option<RobotHold>,
}

/// Holds of all robots; none where the robots are not on other machines.
pub(super) struct Holds<P: Ports>(Vec<HoldReader<P>>);

impl<P: Ports> Holds<P> {
    pub(super) fn open(ports: &P, run: &Run) -> Result<Self, ChannelError> {
        let is_base = run.config.world == RobotSource::Robots;
        let open =
            |robot| Ok(HoldReader { robot, reader: ports.reader(&channel::hold(robot))?, newest: None });
        Ok(Self(run.robots().filter(|_| is_base).map(open).collect::<Result<_, ChannelError>>()?))
    }

    /// Reads what has arrived; returns the robots that were stopped or driven by hand at their machines since the last call.
    pub(super) fn receive(&mut self) -> Vec<RobotId> {
        let mut interrupted = Vec::new();
        for HoldReader { robot, reader, newest } in &mut self.0 {
            let Some(hold) = reader.newest() else { continue };
            let before = newest.replace(*hold);
            // The first message says what was before this process.
            if before.is_some_and(|before| before.interruptions != hold.interruptions) {
                interrupted.push(*robot);
            }
        }
        interrupted
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
