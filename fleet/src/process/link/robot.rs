//! The link's end on a robot's machine: its map, poses and state go to the base, velocities and the stop come back.

use super::{
    BASE_HEARD_MAX, FirstHeard, InvalidMessages, POLL_PERIOD, RECEIVED_MAX, StopControl, run_number,
};
use crate::channel;
use crate::clock::Epoch;
use crate::ports::{ChannelError, Clock as _, Ports, ReadMapPort, ReadPort, WritePort};
use crate::process::{Listens, ProcessLoop};
use crate::run::Run;
use ::link::{RobotEnd, RobotEvent, ScanRate, SenderConfig, StopRequest};
use link_transport::Transport;
use msg::{
    Battery, Header, Monotonic, PoseEstimate, RobotId, Scan, Submap, SubmapPoses, SubmapRequest, Transforms,
    VelocityCommand,
};

/// The robot of a robot's machine: its fleet has no other.
const ROBOT: RobotId = RobotId::new(1).expect("1 is the first robot's number");

struct Inputs<P: Ports> {
    pose_estimates: P::Reader<PoseEstimate>,
    transforms: P::Reader<Transforms>,
    scans: P::Reader<Scan>,
    batteries: P::Reader<Battery>,
    map: P::MapReader,
    submaps: P::Reader<Submap>,
    submap_poses: P::Reader<SubmapPoses>,
}

struct Outputs<P: Ports> {
    /// To the robot's own bridge, whose gate limits it and sends a zero when no other follows.
    velocity: P::Writer<VelocityCommand>,
    submap_request: P::Writer<SubmapRequest>,
}

/// Mirrors a robot's channels to the base that leads.
pub struct RobotLink<P: Ports, T, S> {
    name: String,
    transport: T,
    stop: S,
    end: RobotEnd,
    inputs: Inputs<P>,
    outputs: Outputs<P>,
    clock: P::Clock,
    epoch: Epoch,
    listeners: Vec<P::Listener>,
    invalid: InvalidMessages,
    reported: Reported,
    first_heard: FirstHeard,
}

/// What the log says of the base at present.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Reported {
    is_heard: bool,
    is_refused: bool,
    is_late: bool,
}

impl<P: Ports, T: Transport, S: StopControl> RobotLink<P, T, S> {
    /// Opens the channels. `session` is a random number that tells this process from every other.
    pub fn open(ports: &P, run: &Run, transport: T, stop: S, session: u64) -> Result<Self, ChannelError> {
        let inputs = Inputs {
            pose_estimates: ports.reader(&channel::pose_estimate(ROBOT))?,
            transforms: ports.reader(&channel::transforms(ROBOT))?,
            scans: ports.reader(&channel::scan(ROBOT))?,
            batteries: ports.reader(&channel::battery(ROBOT))?,
            map: ports.map_reader(&channel::map(ROBOT))?,
            submaps: ports.reader(&channel::submap(ROBOT))?,
            submap_poses: ports.reader(&channel::submap_poses(ROBOT))?,
        };
        let outputs = Outputs {
            velocity: ports.writer(&channel::base_velocity(ROBOT))?,
            submap_request: ports.writer(&channel::submap_request(ROBOT))?,
        };
        let (link, clock) = (&run.config.link, ports.clock());
        let scans = ScanRate::new(link.scan_rate_hz.max(link.drive_rate_hz), link.scan_beams);
        Ok(Self {
            name: run.config.robot_name(ROBOT),
            transport,
            stop,
            end: RobotEnd::new(session, run_number(run), SenderConfig::default(), scans),
            inputs,
            outputs,
            first_heard: FirstHeard::after(clock.now(), BASE_HEARD_MAX),
            clock,
            epoch: run.epoch,
            listeners: vec![ports.listener(&channel::pose_estimate(ROBOT))?],
            invalid: InvalidMessages::default(),
            reported: Reported::default(),
        })
    }

    /// Returns the number of messages of other bases than the one that leads.
    #[cfg(test)]
    pub fn refused(&self) -> u64 {
        self.end.refused()
    }

    pub(super) fn end(&self) -> &RobotEnd {
        &self.end
    }

    pub(super) fn name(&self) -> &str {
        &self.name
    }

    pub(super) fn now(&self) -> Monotonic {
        self.clock.now()
    }

    fn receive(&mut self, now: Monotonic) {
        let mut velocity = None;
        for _ in 0..RECEIVED_MAX {
            let Some((_, bytes)) = self.transport.receive() else { break };
            let events = match self.end.receive(&bytes, now) {
                Ok(events) => events,
                Err(why) => {
                    self.invalid.count(&self.name, &why);
                    continue;
                }
            };
            for event in events {
                match event {
                    // Of several in one step the newest alone counts.
                    RobotEvent::Velocity(command) => velocity = Some(command),
                    RobotEvent::Stop(request) => self.stop.request(request == StopRequest::Set),
                    RobotEvent::BaseLeads { base, before } => {
                        let how = if before.is_some() { "another base leads" } else { "a base leads" };
                        tracing::warn!("{how}: session {base:016x}");
                    }
                }
            }
        }
        if let Some(command) = velocity {
            let header = Header { stamp: self.epoch.stamp(now), ..Header::default() };
            self.outputs.velocity.send(&VelocityCommand { header, ..command });
        }
    }

    fn read_channels(&mut self, now: Monotonic) {
        let Self { end, inputs, .. } = self;
        if let Some(pose_estimate) = inputs.pose_estimates.newest() {
            end.put_pose_estimate(&pose_estimate);
        }
        if let Some(transforms) = inputs.transforms.newest() {
            end.put_transforms(&transforms);
        }
        if let Some(battery) = inputs.batteries.newest() {
            end.put_battery(&battery, now);
        }
        let scan = inputs.scans.newest();
        if let Some(scan) = scan.filter(|_| end.is_scan_wanted(now)) {
            end.put_scan(&scan, now);
        }
        if inputs.map.poll() {
            end.put_map(inputs.map.map(), now);
        }
        while let Some(submap) = inputs.submaps.receive() {
            end.put_submap(&submap, now);
        }
        if let Some(poses) = inputs.submap_poses.newest() {
            end.put_submap_poses(&poses, now);
        }
        if end.needs_submaps(now) {
            self.outputs.submap_request.send(&SubmapRequest::default());
        }
    }
}

impl Reported {
    /// Says what is new.
    fn update(&mut self, new: Self, name: &str) {
        if self.is_heard && !new.is_heard {
            tracing::warn!("no base is heard any more; the robot stops, and goes on mapping");
        }
        if !self.is_refused && new.is_refused {
            tracing::warn!(
                "the base has accepted another machine named {name}: this one's velocities do not come from it, and its \
                 map is not taken; give each robot a name of its own"
            );
        }
        if !self.is_late && new.is_late {
            tracing::warn!(
                "the link is too slow: the base's velocities answer what the robot said more than 0.5 s before, and \
                 are not obeyed"
            );
        }
        *self = new;
    }
}

impl<P: Ports, T: Transport, S: StopControl> ProcessLoop for RobotLink<P, T, S> {
    fn step(&mut self) -> Monotonic {
        let now = self.clock.now();
        self.end.set_local_control(self.stop.local_control());
        self.receive(now);
        self.read_channels(now);
        let (is_heard, is_late) = (self.end.is_heard(now), self.end.is_late(now));
        let is_refused = is_heard && self.end.is_refused();
        self.reported.update(Reported { is_heard, is_refused, is_late }, &self.name);
        if self.first_heard.is_overdue(is_heard, now) {
            tracing::warn!(
                "no base has been heard yet; the robot maps meanwhile. Look whether the base runs, and names {} in --names",
                self.name
            );
        }
        let transport = &mut self.transport;
        self.end.poll(now, &mut |kind, bytes: &[u8]| transport.send(ROBOT.index(), kind, bytes));
        now + POLL_PERIOD
    }
}

impl<P: Ports, T, S> Listens<P::Listener> for RobotLink<P, T, S> {
    fn listeners(&self) -> impl Iterator<Item = &P::Listener> {
        self.listeners.iter()
    }
}
