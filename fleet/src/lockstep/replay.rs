//! Recorded robots in place of simulators: each sends what its robot sent, at the same moments of virtual time.

use crate::channel;
use crate::clock::Epoch;
use crate::ports::{ChannelError, Clock as _, Ports, WritePort};
use crate::process::ProcessLoop;
use crate::run::Run;
use ::recording::fleet::{FleetRecording, RobotRecording, SensorMessage};
use msg::{Clock, Monotonic, Odometry, RobotId, Scan, Stamp, Transforms};
use sim::transforms_of;
use std::rc::Rc;

/// The robot that sends the fleet's clock.
const TIMEKEEPER: usize = 1;

/// Sends the messages of one recorded robot.
pub struct RecordedRobot<P: Ports> {
    recording: Rc<FleetRecording>,
    robot: RobotId,
    scans: P::Writer<Scan>,
    odometry: P::Writer<Odometry>,
    /// Transforms of the robot's links, where somebody looks on; SLAM needs none.
    transforms: Option<P::Writer<Transforms>>,
    time: Option<P::Writer<Clock>>,
    clock: P::Clock,
    epoch: Epoch,
    /// Index of the next message of the robot, and of the clock.
    next: usize,
    next_time: usize,
    /// How often the robot's driver has been started again.
    restarts: usize,
}

impl<P: Ports> RecordedRobot<P> {
    /// Opens the robot's channels.
    pub fn open(
        ports: &P,
        run: &Run,
        robot: RobotId,
        recording: Rc<FleetRecording>,
        sends_transforms: bool,
    ) -> Result<Self, ChannelError> {
        let keeps_time = robot.number() == TIMEKEEPER;
        Ok(Self {
            recording,
            robot,
            scans: ports.writer(&channel::scan(robot))?,
            odometry: ports.writer(&channel::odometry(robot))?,
            transforms: sends_transforms.then(|| ports.writer(&channel::transforms(robot))).transpose()?,
            time: keeps_time.then(|| ports.writer(&channel::clock())).transpose()?,
            clock: ports.clock(),
            epoch: run.epoch,
            next: 0,
            next_time: 0,
            restarts: 0,
        })
    }

    fn robot(&self) -> Option<&RobotRecording> {
        self.recording.robots.get(self.robot.index())
    }

    fn send_time(&mut self, now: Stamp) {
        let Some(time) = &mut self.time else { return };
        while let Some(at) = self.recording.clock.get(self.next_time).filter(|at| **at <= now) {
            time.send_with(|clock| clock.header.stamp = *at);
            self.next_time += 1;
        }
    }
}

impl<P: Ports> ProcessLoop for RecordedRobot<P> {
    fn step(&mut self) -> Monotonic {
        let now = self.epoch.stamp(self.clock.now());
        self.send_time(now);
        let recording = self.recording.clone();
        let of_robot = recording.robots.get(self.robot.index());
        let messages = of_robot.map_or(&[][..], |robot| &robot.messages);
        while let Some((at, message)) = messages.get(self.next).filter(|(at, _)| *at <= now) {
            match message {
                SensorMessage::Odometry(odometry) => {
                    let restarts = of_robot.map_or(0, |robot| robot.restarts_until(*at));
                    if std::mem::replace(&mut self.restarts, restarts) != restarts {
                        self.odometry.begin_anew();
                    }
                    self.odometry.send(odometry);
                    if let Some(transforms) = &mut self.transforms {
                        transforms.send(&transforms_of(odometry));
                    }
                }
                SensorMessage::Scan(scan) => self.scans.send_with(|slot| scan.write_to(slot)),
            }
            self.next += 1;
        }
        let next = self.robot().and_then(|robot| robot.messages.get(self.next)).map(|(at, _)| *at);
        let next_time = self.time.as_ref().and_then(|_| self.recording.clock.get(self.next_time).copied());
        let due = next.into_iter().chain(next_time).min();
        due.map_or(Monotonic(u64::MAX), |at| self.epoch.moment(at))
    }
}
