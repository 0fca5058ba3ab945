//! Whose commands a robot obeys: the selected robot, one lease a robot, the emergency stop.

use crate::client::ClientId;
use msg::{ROBOTS_MAX, RobotId};
use std::time::{Duration, Instant};

/// What becomes of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// To the robot.
    Pass,
    /// Nothing to obey and nothing to complain of: "stand still" from one who does not drive.
    Ignore,
    /// Another client drives this robot.
    Held(ClientId),
    /// The emergency stop is set.
    Stopped,
}

#[derive(Clone, Copy, Debug, Default)]
struct Robot {
    /// Who keeps the robot, until when.
    lease: Option<(ClientId, Instant)>,
    /// Whose command was the last to pass.
    driver: Option<ClientId>,
}

/// The state of driving, all robots.
#[derive(Debug)]
pub struct Drive {
    robots: [Robot; ROBOTS_MAX],
    robot_count: usize,
    selected: RobotId,
    stopped: bool,
    lease: Duration,
}

impl Drive {
    /// For the first `robot_count` robots; `first` is selected.
    pub fn new(robot_count: usize, first: RobotId, lease: Duration) -> Self {
        Self { robots: [Robot::default(); ROBOTS_MAX], robot_count, selected: first, stopped: false, lease }
    }

    /// Which robot `/cmd_vel` goes to.
    pub fn selected(&self) -> RobotId {
        self.selected
    }

    /// The robot of a number that a client sent; `None` if the fleet has none such.
    pub fn robot(&self, number: i32) -> Option<RobotId> {
        let number = usize::try_from(number).ok()?;
        RobotId::new(number).filter(|robot| robot.number() <= self.robot_count)
    }

    /// Selects a robot of the fleet.
    pub fn select(&mut self, robot: RobotId) {
        self.selected = robot;
    }

    /// Whether the emergency stop is set.
    pub fn stopped(&self) -> bool {
        self.stopped
    }

    /// Sets or releases the emergency stop.
    pub fn set_stopped(&mut self, stopped: bool) {
        self.stopped = stopped;
    }

    /// Who keeps the robot now.
    pub fn holder(&self, robot: RobotId, now: Instant) -> Option<ClientId> {
        self.robots[robot.index()].lease.filter(|(_, until)| now < *until).map(|(client, _)| client)
    }

    /// One command. A moving one takes or renews the lease of a robot that is free; "stand still" does not, so
    /// that a client that idles at 20 Hz keeps no robot from others.
    pub fn command(&mut self, client: ClientId, robot: RobotId, moving: bool, now: Instant) -> Verdict {
        let holder = self.holder(robot, now);
        if self.stopped {
            return if moving { Verdict::Stopped } else { Verdict::Ignore };
        }
        match holder {
            Some(holder) if holder != client => {
                return if moving { Verdict::Held(holder) } else { Verdict::Ignore };
            }
            _ => {}
        }
        let state = &mut self.robots[robot.index()];
        if moving {
            state.lease = Some((client, now + self.lease));
        }
        state.driver = Some(client);
        Verdict::Pass
    }

    /// Gives a robot to a client, whoever has it; who had it.
    pub fn take(&mut self, client: ClientId, robot: RobotId, now: Instant) -> Option<ClientId> {
        let before = self.holder(robot, now).filter(|holder| *holder != client);
        self.robots[robot.index()].lease = Some((client, now + self.lease));
        before
    }

    /// A client is gone: the robots it drove last, which must now stop.
    pub fn leave(&mut self, client: ClientId) -> Vec<RobotId> {
        let mut driven = Vec::new();
        for robot in RobotId::first(self.robot_count) {
            let state = &mut self.robots[robot.index()];
            state.lease = state.lease.filter(|(holder, _)| *holder != client);
            if state.driver == Some(client) {
                state.driver = None;
                driven.push(robot);
            }
        }
        driven
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn client(serial: u64) -> ClientId {
        ClientId { slot: serial as usize, serial }
    }

    #[test]
    fn one_client_at_a_time() {
        let (one, two) = (client(1), client(2));
        let robot = RobotId::new(1).unwrap();
        let mut drive = Drive::new(2, robot, Duration::from_secs(1));
        let begin = Instant::now();
        let after = |ms| begin + Duration::from_millis(ms);
        assert_eq!(
            drive.command(two, robot, false, begin),
            Verdict::Pass,
            "nobody drives: stand still is fine"
        );
        assert_eq!(drive.command(one, robot, true, begin), Verdict::Pass);
        assert_eq!(drive.command(two, robot, true, after(900)), Verdict::Held(one));
        assert_eq!(drive.command(two, robot, false, after(900)), Verdict::Ignore);
        assert_eq!(drive.command(one, robot, false, after(950)), Verdict::Pass);
        assert_eq!(
            drive.command(two, robot, true, after(1001)),
            Verdict::Pass,
            "standing still renews no lease"
        );
        assert_eq!(drive.take(one, robot, after(1100)), Some(two));
        assert_eq!(drive.command(two, robot, true, after(1200)), Verdict::Held(one));
        assert_eq!(drive.command(one, robot, true, after(1300)), Verdict::Pass);
        assert_eq!(drive.leave(one), [robot]);
        assert_eq!(
            drive.command(two, robot, true, after(1400)),
            Verdict::Pass,
            "the lease left with its holder"
        );
    }

    #[test]
    fn the_stop_holds_everyone() {
        let robot = RobotId::new(1).unwrap();
        let mut drive = Drive::new(1, robot, Duration::from_secs(1));
        let now = Instant::now();
        drive.set_stopped(true);
        assert_eq!(drive.command(client(1), robot, true, now), Verdict::Stopped);
        assert_eq!(drive.command(client(1), robot, false, now), Verdict::Ignore);
        drive.set_stopped(false);
        assert_eq!(drive.command(client(1), robot, true, now), Verdict::Pass);
        assert_eq!(drive.robot(1), Some(robot));
        assert_eq!((drive.robot(0), drive.robot(2), drive.robot(-1)), (None, None, None));
    }
}
