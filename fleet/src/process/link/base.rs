//! The link's end at the base: it writes the channels of robots that are on other machines.

use super::demand::ScanDemands;
use super::{
    FirstHeard, InvalidMessages, POLL_PERIOD, RECEIVED_MAX, ROBOT_HEARD_MAX, StopControl, run_number,
};
use crate::channel;
use crate::clock::Epoch;
use crate::ports::{ChannelError, Clock as _, MAP_PAUSE, Ports, ReadPort, WriteMapPort, WritePort};
use crate::process::{Listens, ProcessLoop};
use crate::run::Run;
use ::bridge::world::{ClockOffset, SourceClock};
use ::link::{BaseEnd, BaseEvent, DecimatedScan, Hold, UnknownRobots};
use link_transport::Transport;
use msg::{
    Battery, Clock, Monotonic, PoseEstimate, RobotHold, RobotId, Scan, Stamp, Submap, SubmapPoses,
    SubmapRequest, TileMap, Transforms, VelocityCommand,
};
use std::collections::BTreeSet;
use std::time::Duration;

/// Longest age of a velocity that is sent on: this process may have waited for the disk, and the sender may be dead.
const VELOCITY_AGE_MAX: Duration = Duration::from_millis(200);
/// Period of the base's clock.
const CLOCK_PERIOD: Duration = Duration::from_millis(20);
/// More generations than a process of SLAM has.
const GENERATIONS: u32 = 1 << 20;
/// Shortest time between two submaps: readers have room for eight.
const SUBMAP_PAUSE: Duration = Duration::from_millis(100);
/// Time by which a scan may be older than the newest pose, nanoseconds. A link that is too slow for scans delivers them late,
/// while poses overtake them.
const SCAN_BEHIND_MAX_NS: i64 = 500_000_000;
/// Longest time after a robot joins until its map is published although parts are missing. Until then readers keep what an
/// earlier process of the link published.
const WHOLE_MAP_WAIT_MAX: Duration = Duration::from_secs(5);

struct Channels<P: Ports> {
    pose_estimate: P::Writer<PoseEstimate>,
    transforms: P::Writer<Transforms>,
    scan: P::Writer<Scan>,
    battery: P::Writer<Battery>,
    map: P::MapWriter,
    submap: P::Writer<Submap>,
    submap_poses: P::Writer<SubmapPoses>,
    hold: P::Writer<RobotHold>,
    commands: P::Reader<VelocityCommand>,
    submap_requests: P::Reader<SubmapRequest>,
}

impl<P: Ports> Channels<P> {
    fn open(ports: &P, robot: RobotId) -> Result<Self, ChannelError> {
        Ok(Self {
            pose_estimate: ports.writer(&channel::pose_estimate(robot))?,
            transforms: ports.writer(&channel::transforms(robot))?,
            scan: ports.writer(&channel::scan(robot))?,
            battery: ports.writer(&channel::battery(robot))?,
            map: ports.map_writer(&channel::map(robot))?,
            submap: ports.writer(&channel::submap(robot))?,
            submap_poses: ports.writer(&channel::submap_poses(robot))?,
            hold: ports.writer(&channel::hold(robot))?,
            commands: ports.reader(&channel::command(robot))?,
            submap_requests: ports.reader(&channel::submap_request(robot))?,
        })
    }
}

/// What has arrived of a robot's map and is not on its channels yet.
#[derive(Default)]
struct Unpublished {
    /// The map with stamps of this machine; `None` before the first was published.
    map: Option<TileMap>,
    has_map_changed: bool,
    map_due: Monotonic,
    /// Submaps to publish.
    submaps: BTreeSet<u32>,
    submap_due: Monotonic,
    poses: Option<Box<SubmapPoses>>,
    /// Time until which parts of the map that are missing are waited for.
    wait_until: Monotonic,
}

/// What tells a robot's submaps from those that it had before.
#[derive(Default)]
struct SubmapNumbers {
    /// Added to their generations: those of another process of the robot's link are others.
    generation: u32,
    /// Number of the run on the robot's machine; 0 before it is known.
    run: u32,
}

/// What log and channel say of a robot at present.
struct Reported {
    is_heard: bool,
    is_contested: bool,
    first_heard: FirstHeard,
    /// `None` before the first.
    hold: Option<Hold>,
}

/// Mirror of one robot.
pub(super) struct RobotMirror<P: Ports> {
    robot: RobotId,
    pub(super) name: String,
    end: BaseEnd,
    /// How far the robot's clock is from ours, from when its poses arrive.
    clock: SourceClock,
    /// Poses that were published: fewer than the robot's scans.
    pose_estimates: u64,
    reported: Reported,
    numbers: SubmapNumbers,
    /// Stamp of the newest pose, on the robot's clock.
    newest_pose: Stamp,
    /// Scans that were dropped because they came late.
    late_scans: u64,
    channels: Channels<P>,
    unpublished: Unpublished,
    invalid: InvalidMessages,
}

/// Mirrors the channels of all robots of the configuration.
pub struct BaseLink<P: Ports, T, S> {
    pub(super) transport: T,
    stop: S,
    pub(super) robots: Vec<RobotMirror<P>>,
    scan_demands: ScanDemands<P>,
    pub(super) unknown: UnknownRobots,
    fleet_clock: P::Writer<Clock>,
    clock_due: Monotonic,
    clock: P::Clock,
    epoch: Epoch,
    listeners: Vec<P::Listener>,
}

impl<P: Ports, T: Transport, S: StopControl> BaseLink<P, T, S> {
    /// Opens the channels. `session` is a random number that tells this base from every other.
    pub fn open(ports: &P, run: &Run, transport: T, stop: S, session: u64) -> Result<Self, ChannelError> {
        let robots = run.robots().map(|robot| RobotMirror::open(ports, robot, run, session));
        let listeners = run.robots().map(|robot| ports.listener(&channel::command(robot)));
        Ok(Self {
            transport,
            stop,
            robots: robots.collect::<Result<_, _>>()?,
            scan_demands: ScanDemands::open(ports, run)?,
            unknown: UnknownRobots::default(),
            fleet_clock: ports.writer(&channel::clock())?,
            clock_due: Monotonic(0),
            clock: ports.clock(),
            epoch: run.epoch,
            listeners: listeners.collect::<Result<_, _>>()?,
        })
    }

    /// Name of each robot, this end of its link, and the number of its scans that came late.
    pub(super) fn ends(&self) -> impl Iterator<Item = (&str, &BaseEnd, u64)> {
        self.robots.iter().map(|robot| (robot.name.as_str(), &robot.end, robot.late_scans))
    }

    pub(super) fn now(&self) -> Monotonic {
        self.clock.now()
    }
}

impl<P: Ports, T: Transport, S: StopControl> ProcessLoop for BaseLink<P, T, S> {
    fn step(&mut self) -> Monotonic {
        let now = self.clock.now();
        if now >= self.clock_due {
            let stamp = self.epoch.stamp(now);
            self.fleet_clock.send_with(|clock| clock.header.stamp = stamp);
            self.clock_due = now + CLOCK_PERIOD;
        }
        for _ in 0..RECEIVED_MAX {
            let Some((index, bytes)) = self.transport.receive() else { break };
            if let Some(robot) = self.robots.get_mut(index) {
                robot.receive(&bytes, self.epoch, now);
            }
        }
        self.hear_unknown(now);
        self.scan_demands.receive(now);
        let is_stopped = self.stop.is_stopped();
        for robot in &mut self.robots {
            robot.end.set_stopped(is_stopped);
            robot.end.set_scans(self.scan_demands.of(robot.robot, now));
            robot.send(&mut self.transport, now);
            robot.publish(self.epoch, now);
        }
        now + POLL_PERIOD
    }
}

impl<P: Ports, T, S> Listens<P::Listener> for BaseLink<P, T, S> {
    fn listeners(&self) -> impl Iterator<Item = &P::Listener> {
        self.listeners.iter()
    }
}

impl<P: Ports> RobotMirror<P> {
    fn open(ports: &P, robot: RobotId, run: &Run, session: u64) -> Result<Self, ChannelError> {
        Ok(Self {
            robot,
            name: run.config.robot_name(robot),
            end: BaseEnd::new(session, run_number(run)),
            clock: SourceClock::new(ClockOffset::Measured),
            pose_estimates: 0,
            reported: Reported {
                is_heard: false,
                is_contested: false,
                first_heard: FirstHeard::after(ports.clock().now(), ROBOT_HEARD_MAX),
                hold: None,
            },
            numbers: SubmapNumbers::default(),
            newest_pose: Stamp(0),
            late_scans: 0,
            channels: Channels::open(ports, robot)?,
            unpublished: Unpublished::default(),
            invalid: InvalidMessages::default(),
        })
    }

    fn receive(&mut self, bytes: &[u8], epoch: Epoch, now: Monotonic) {
        let events = match self.end.receive(bytes, now) {
            Ok(events) => events,
            Err(why) => return self.invalid.count(&self.name, &why),
        };
        for event in events {
            self.apply(event, epoch, now);
        }
    }

    fn apply(&mut self, event: BaseEvent, epoch: Epoch, now: Monotonic) {
        match event {
            BaseEvent::RobotJoined { robot, before } => {
                let how =
                    if before.is_some() { "has joined again, with another process" } else { "has joined" };
                tracing::warn!("{} {how}: session {robot:016x}", self.name);
                self.clock = SourceClock::new(ClockOffset::Measured);
                self.newest_pose = Stamp(0);
                if before.is_some() {
                    // Closures refer to submaps and nodes by number: merging must forget those of before.
                    self.numbers.generation = self.numbers.generation.wrapping_add(GENERATIONS);
                }
                self.unpublished.wait_until = now + WHOLE_MAP_WAIT_MAX;
            }
            BaseEvent::NewRun(run) => {
                if self.numbers.run != 0 {
                    tracing::warn!(
                        "{} began anew: its former map and place are forgotten until its new map is merged",
                        self.name
                    );
                }
                self.numbers.run = run;
                let wait_until = self.unpublished.wait_until;
                self.unpublished = Unpublished { wait_until, ..Unpublished::default() };
                // Without submaps: merging must not draw the robot where its former run was.
                self.unpublished.poses = Some(bytemuck::allocation::zeroed_box());
            }
            BaseEvent::PoseEstimate(mut pose_estimate) => {
                self.newest_pose = pose_estimate.header.stamp;
                // Only this message estimates the clock: it comes at a steady rate and is small.
                let stamp = self.clock.convert(pose_estimate.header.stamp, epoch.stamp(now));
                if let Ok(stamp) = stamp {
                    pose_estimate.header.stamp = stamp;
                    pose_estimate.scan_sent = epoch.moment(stamp);
                    // Numbered anew: scans whose poses stay on the robot's machine are not lost.
                    pose_estimate.scan_seq = self.pose_estimates;
                    self.pose_estimates += 1;
                    self.channels.pose_estimate.send(&pose_estimate);
                }
            }
            BaseEvent::Transforms(mut transforms) if self.clock.estimate().is_some() => {
                transforms.header.stamp = self.clock.translate(transforms.header.stamp);
                self.channels.transforms.send(&transforms);
            }
            BaseEvent::Scan(scan) if self.clock.estimate().is_some() => self.publish_scan(&scan),
            BaseEvent::Battery(mut battery) => {
                battery.header.stamp = epoch.stamp(now);
                self.channels.battery.send(&battery);
            }
            // Before the first pose the offset of the clocks is not known.
            BaseEvent::Transforms(_) | BaseEvent::Scan(_) => {}
            BaseEvent::Map => self.unpublished.has_map_changed = true,
            BaseEvent::Submap(id) => drop(self.unpublished.submaps.insert(id)),
            BaseEvent::SubmapPoses(poses) => self.unpublished.poses = Some(poses),
        }
    }

    /// Publishes a scan, unless poses have overtaken it: navigation takes what arrives for what is ahead of the robot now.
    fn publish_scan(&mut self, scan: &DecimatedScan) {
        if self.newest_pose.0.saturating_sub(scan.stamp.0) > SCAN_BEHIND_MAX_NS {
            if self.late_scans == 0 {
                tracing::warn!(
                    "{}: scans come late over the link, and are dropped; it is too slow for them",
                    self.name
                );
            }
            self.late_scans += 1;
            return;
        }
        let stamp = self.clock.translate(scan.stamp);
        self.channels.scan.send_with(|message| {
            scan.write_to(message);
            message.header.stamp = stamp;
        });
    }

    /// Says in the log what is new of the robot, and to navigation whether it follows.
    fn report_changes(&mut self, now: Monotonic) {
        let (is_heard, is_contested) = (self.end.is_heard(now), self.end.is_contested(now));
        if self.reported.is_heard && !is_heard {
            tracing::warn!("{} is not heard any more; its map stays as it is", self.name);
        }
        if self.reported.first_heard.is_overdue(is_heard, now) {
            tracing::warn!("{} has not been heard yet", self.name);
        }
        if !self.reported.is_contested && is_contested {
            tracing::warn!(
                "another machine bears the name {}, too: it is refused; give each robot a name of its own",
                self.name
            );
        }
        let hold = self.end.hold();
        if self.reported.hold == Some(hold) || self.end.state_received() == Monotonic(0) {
            self.channels.hold.refresh();
        } else {
            let before = self.reported.hold.and_then(|hold| hold.reason);
            if let Some(reason) = hold.reason.filter(|reason| before != Some(*reason)) {
                tracing::warn!("{}: {}", self.name, reason.text());
            }
            let reason = hold.reason.map_or(0, |reason| reason as u32);
            let interruptions = hold.interruptions;
            self.channels.hold.send(&RobotHold { interruptions, reason, ..RobotHold::default() });
            self.reported.hold = Some(hold);
        }
        (self.reported.is_heard, self.reported.is_contested) = (is_heard, is_contested);
    }

    /// Sends what is due to the robot.
    fn send(&mut self, transport: &mut impl Transport, now: Monotonic) {
        self.report_changes(now);
        let index = self.robot.index();
        let mut send = |kind, bytes: &[u8]| transport.send(index, kind, bytes);
        let is_timely =
            |command: &VelocityCommand| now.since(command.header.sent) <= VELOCITY_AGE_MAX.as_nanos() as u64;
        if let Some(command) = self.channels.commands.newest().filter(|command| is_timely(command)) {
            self.end.send_velocity(&command, now, &mut send);
        }
        self.end.poll(now, &mut send);
    }

    /// Writes what has arrived of the map, at the pace of its readers. Stamps need the offset of the clocks.
    fn publish(&mut self, epoch: Epoch, now: Monotonic) {
        if self.channels.submap_requests.newest().is_some() {
            self.unpublished.submaps.extend(self.end.submap_ids());
        }
        if self.clock.estimate().is_none() {
            return;
        }
        if now >= self.unpublished.map_due {
            self.unpublished.map_due = now + MAP_PAUSE;
            self.publish_map(epoch, now);
        }
        if now >= self.unpublished.submap_due
            && let Some(id) = self.unpublished.submaps.pop_first()
        {
            self.unpublished.submap_due = now + SUBMAP_PAUSE;
            // A submap that was removed meanwhile is not there.
            if let Some(mut submap) = self.end.submap(id) {
                submap.generation = submap.generation.wrapping_add(self.numbers.generation);
                submap.grid.header.stamp = self.clock.translate(submap.grid.header.stamp);
                self.channels.submap.send(&submap);
            }
        }
        match self.unpublished.poses.take() {
            Some(mut poses) => {
                poses.generation = poses.generation.wrapping_add(self.numbers.generation);
                poses.map_frame = ::link::run_and_frame(self.numbers.run, poses.map_frame);
                poses.header.stamp = self.clock.translate(poses.header.stamp);
                self.channels.submap_poses.send(&poses);
            }
            None => self.channels.submap_poses.refresh(),
        }
    }

    fn publish_map(&mut self, epoch: Epoch, now: Monotonic) {
        let is_whole = self.end.robot_state().waiting == 0;
        if self.unpublished.has_map_changed
            && (is_whole || now >= self.unpublished.wait_until)
            && let Some(map) = self.end.map()
        {
            let mut map = map.clone();
            map.header.header.stamp = self.clock.translate(map.header.header.stamp);
            map.header.scan_sent = epoch.moment(map.header.header.stamp);
            (self.unpublished.map, self.unpublished.has_map_changed) = (Some(map), false);
        }
        // An unchanged map is sent to readers that come late.
        if let Some(map) = &self.unpublished.map {
            self.channels.map.send(map);
        }
    }
}
