//! A world outside this fleet, whose scans, transforms and clock come from a headset application or real robots.
//!
//! ```text
//!   LaserScan  ─▶ checked ──────────────────────────────▶ robotK/scan
//!   Odometry   ─▶ checked ──────────────────────────────▶ robotK/odometry, robotK/transforms
//!   TFMessage  ─▶ the fleet's frames ─▶ robotK/transforms; odom -> base ─▶ robotK/odometry
//!   TFMessage  ─▶ where the LiDARs are mounted, which each scan carries: one upside down is mirrored ([`MountError`])
//!   BatteryState ▶ once a second ───────────────────────▶ robotK/battery
//!   Clock      ─────────────────────────────────────────▶ clock
//!                 every stamp: the source's clock -> the run's ([`SourceClock`])
//! ```
//! There is one [`ExternalWorld`] for each bridge, and one [`SourceClock`] for each machine that sends to it. The
//! transform `map` -> `odom` belongs to SLAM (REP-105): it is refused and left out, and the rest of its message taken.

mod battery;
mod checks;
mod clock;
mod error;
mod frame_tree;
mod frozen;
mod input;
mod mount;
mod notices;
mod publishers;
mod restart;
mod suspects;
mod transforms;
mod watch;

pub(crate) use checks::floor_pose;
pub use checks::{ScanError, TransformError};
pub use clock::{ClockEstimate, ClockOffset, SourceClock};
pub use error::WorldError;
pub(crate) use input::{DDS_SOURCE, WorldInput};
pub use mount::MountError;
pub use publishers::{PublisherId, RobotTopic, Sender};
pub use suspects::OutlierError;

use battery::BatteryRate;
use checks::{check_scan, check_transform, empty_scan, planar_pose};
use frozen::RepeatedScan;
use mount::Mounts;
use msg::{
    Battery, Clock, Odometry, Pose2, ROBOTS_MAX, RobotFrame, RobotFrameTransform, RobotId, Scan, Stamp,
    Transforms,
};
use notices::Notices;
use publishers::RobotPublishers;
use restart::Drivers;
use ros_messages::cdr::Reader;
use ros_messages::names::RobotNames;
use ros_messages::read;
use watch::SensorWatch;

/// A robot keeps its source for so long after the source's last message, seconds; then another may take its place.
const SOURCE_TIMEOUT_S: f64 = 2.0;
/// A velocity is computed from two poses at most this far apart, seconds.
const VELOCITY_SPAN_MAX_S: f64 = 1.0;

/// An accepted message, as the fleet's channels carry it.
#[derive(Clone, Copy, Debug)]
pub enum WorldMessage<'a> {
    /// A scan for the channel `robotK/scan`.
    Scan(RobotId, &'a Scan),
    /// For `robotK/odometry`; sent before the transforms of the same stamp, which wake the readers.
    Odometry(RobotId, &'a Odometry),
    /// The driver was started again and counts odometry from a new origin: what follows is of another writer of `robotK/odometry`.
    OdometryRestart(RobotId),
    /// The robot's own frames, for the channel `robotK/transforms`.
    Transforms(RobotId, &'a Transforms),
    /// The state of a robot's battery, for the channel `robotK/battery`.
    Battery(RobotId, &'a Battery),
    /// The run's time, for the channel `clock`.
    Clock(&'a Clock),
}

/// Number of a source, chosen by the caller.
pub type SourceId = u64;

/// The newest pose by a robot's wheels.
#[derive(Clone, Copy, Debug)]
struct SentPose {
    /// Its stamp by the source's clock.
    sent: Stamp,
    /// The same by the run's.
    stamp: Stamp,
    odom_from_base: Pose2,
    /// Whether it is TF's, and not the odometry topic's.
    is_of_transform: bool,
}

/// What is known of one robot from its source.
#[derive(Clone, Copy, Debug, Default)]
struct RobotState {
    /// The source, and the run's time of its last message.
    source: Option<(SourceId, Stamp)>,
    last_scan: Option<Stamp>,
    /// The newest of the scans in a row that were stamped much earlier than that, and their number.
    set_back: Option<(Stamp, usize)>,
    last_pose: Option<SentPose>,
    /// When TF had odom -> base last, by the run's time.
    last_transform: Option<Stamp>,
    battery: BatteryRate,
    /// Whether odom -> base_footprint was received: base_link, which moves the same, is then not needed.
    has_footprint: bool,
    publishers: RobotPublishers,
    drivers: Drivers,
    watch: SensorWatch,
    repeated_scan: RepeatedScan,
}

/// One message from a source, behind its encapsulation header.
#[derive(Clone, Debug)]
pub enum Incoming<'a> {
    /// sensor_msgs/LaserScan of a robot.
    Scan(RobotId, Reader<'a>),
    /// tf2_msgs/TFMessage; its frame names tell which robots it is about.
    Transforms(Reader<'a>),
    /// tf2_msgs/TFMessage of one robot, whose frames may be plain: `odom`, `base_footprint`.
    RobotTransforms(RobotId, Reader<'a>),
    /// tf2_msgs/TFMessage with transforms that never change: of all robots, or on one's own topic.
    StaticTransforms(Option<RobotId>, Reader<'a>),
    /// nav_msgs/Odometry of a robot, whatever its frames are called.
    Odometry(RobotId, Reader<'a>),
    /// sensor_msgs/BatteryState of a robot.
    Battery(RobotId, Reader<'a>),
    /// rosgraph_msgs/Clock of the whole world.
    Clock(Reader<'a>),
}

/// The context of one message: who sent it, by which clock, and when it arrived.
struct MessageContext<'a> {
    source: SourceId,
    publisher: Option<PublisherId>,
    clock: &'a mut SourceClock,
    /// Arrival, by the run's time.
    received: Stamp,
}

/// Where accepted messages go.
type MessageSink = Box<dyn FnMut(WorldMessage<'_>)>;

/// Checks the sensor data of an external world, converts its time and splits it into the fleet's channels.
///
/// It has no socket and no clock.
pub struct ExternalWorld {
    names: RobotNames,
    robots: Box<[RobotState; ROBOTS_MAX]>,
    /// The scan that is being decoded.
    scan: Box<Scan>,
    /// The transforms of each robot in the message that is being decoded.
    transforms: Box<[Transforms; ROBOTS_MAX]>,
    /// The newest time that was passed on.
    clock: Stamp,
    /// The source of the clock, and the run's time of its last message.
    clock_source: Option<(SourceId, Stamp)>,
    /// Whose scans show that a clock was set back and by how many seconds, until [`ExternalWorld::take_step`].
    step: Option<(RobotId, f64)>,
    /// Where the robots' LiDARs are.
    mounts: Mounts,
    /// What the operator's log is to be told.
    notices: Notices,
    sink: MessageSink,
}

impl ExternalWorld {
    /// Creates a world of robots: their number, or their names. `sink` gets what is accepted; it must not call back.
    pub fn new(robots: impl Into<RobotNames>, sink: impl FnMut(WorldMessage<'_>) + 'static) -> Self {
        let names: RobotNames = robots.into();
        Self {
            mounts: Mounts::new(names.count()),
            names,
            robots: Box::new([RobotState::default(); ROBOTS_MAX]),
            scan: empty_scan(),
            transforms: Box::new([Transforms::default(); ROBOTS_MAX]),
            clock: Stamp(i64::MIN),
            clock_source: None,
            step: None,
            notices: Notices::default(),
            sink: Box::new(sink),
        }
    }

    /// Returns the robots' names.
    pub fn robot_names(&self) -> &RobotNames {
        &self.names
    }

    /// Takes a message that arrived at `received`, by the run's time.
    ///
    /// Transforms between frames that are not the fleet's are ignored. Refused transforms are left out and the others
    /// of the message taken; the error is the first one's.
    pub fn receive(
        &mut self,
        sender: impl Into<Sender>,
        clock: &mut SourceClock,
        message: Incoming<'_>,
        received: Stamp,
    ) -> Result<(), WorldError> {
        let Sender { source, publisher } = sender.into();
        let mut context = MessageContext { source, publisher, clock, received };
        match message {
            Incoming::Scan(robot, from) => self.receive_scan(&mut context, robot, from),
            Incoming::Transforms(from) => self.receive_transforms(&mut context, None, &from),
            Incoming::RobotTransforms(robot, from) => {
                self.receive_transforms(&mut context, Some(robot), &from)
            }
            Incoming::StaticTransforms(of, from) => self.receive_static_transforms(source, of, &from),
            Incoming::Odometry(robot, from) => self.receive_odometry(&mut context, robot, from),
            Incoming::Battery(robot, from) => self.receive_battery(&context, robot, from),
            Incoming::Clock(from) => self.receive_clock(&mut context, from),
        }
    }

    fn receive_scan(
        &mut self,
        context: &mut MessageContext<'_>,
        robot: RobotId,
        mut from: Reader<'_>,
    ) -> Result<(), WorldError> {
        self.check_source(context, robot)?;
        if !self.is_of_one_publisher(context, robot, RobotTopic::Scan)? {
            return Ok(());
        }
        let frame = read::laser_scan(&mut from, &mut self.scan)?;
        check_scan(&mut self.scan)?;
        let state = &mut self.robots[robot.index()];
        let odom_from_base = state.last_pose.map(|last| last.odom_from_base);
        if state.repeated_scan.is_frozen(&self.scan, odom_from_base) {
            return Err(WorldError::FrozenScans { robot });
        }
        if !self.mount_scan(context, robot, frame)? {
            return Ok(());
        }
        let sent = self.scan.header.stamp;
        let stamp = context.clock.convert(sent, context.received)?;
        if let Some(before) = self.robots[robot.index()].last_scan.filter(|before| stamp <= *before) {
            if !self.was_set_back(robot, stamp - before, stamp) {
                return Err(ScanError::NotNewer { stamp_s: sent.seconds() }.into());
            }
            let step_s = self.robots[robot.index()].watch.clock_step_s(stamp, context.received);
            self.restart(context.source, robot, step_s.unwrap_or(stamp - before));
        }
        let has_own_time = self.clock_source.is_some();
        let state = &mut self.robots[robot.index()];
        state.watch.add_scan(robot, stamp, context.received, has_own_time, &mut self.notices);
        state.set_back = None;
        (state.last_scan, state.source) = (Some(stamp), Some((context.source, context.received)));
        self.scan.header.stamp = stamp;
        (self.sink)(WorldMessage::Scan(robot, &self.scan));
        Ok(())
    }

    /// Takes odometry as the transform odom -> base_footprint, for robots that do not number their frames.
    ///
    /// A robot with odom -> base in TF is located by that: `map` -> `odom` belongs to it (REP-105), and the topic may be another
    /// estimate of the motion, as of the wheels alone beside that of robot_localization.
    fn receive_odometry(
        &mut self,
        context: &mut MessageContext<'_>,
        robot: RobotId,
        mut from: Reader<'_>,
    ) -> Result<(), WorldError> {
        self.check_source(context, robot)?;
        let transform = read::odometry(&mut from)?;
        self.mounts.learn_odometry(robot, transform.frame_id, transform.child_frame_id);
        let parent_from_child = check_transform(RobotFrame::Odom, RobotFrame::BaseFootprint, &transform)?;
        let stamp = context.clock.convert(transform.stamp, context.received)?;
        let state = &mut self.robots[robot.index()];
        state.source = Some((context.source, context.received));
        if state.last_transform.is_some_and(|last| context.received - last < SOURCE_TIMEOUT_S) {
            return Ok(());
        }
        if !self.is_of_one_publisher(context, robot, RobotTopic::Odometry)? {
            self.note_waiting(context, robot, transform.stamp, &parent_from_child, false)?;
            return Ok(());
        }
        let state = &self.robots[robot.index()];
        let is_new = state.last_pose.is_none_or(|last| stamp > last.stamp);
        self.send_odometry(context, robot, [transform.stamp, stamp], &parent_from_child, false)?;
        if is_new {
            let transforms = &mut self.transforms[robot.index()];
            (transforms.header.stamp, transforms.len, transforms.transforms[0]) =
                (stamp, 1, parent_from_child);
            self.send_transforms(robot);
        }
        Ok(())
    }

    fn receive_clock(
        &mut self,
        context: &mut MessageContext<'_>,
        mut from: Reader<'_>,
    ) -> Result<(), WorldError> {
        if is_held_by_other(self.clock_source, context) {
            return Err(WorldError::OtherSource { what: "the clock".into() });
        }
        let stamp = context.clock.convert(read::stamp(&mut from, "clock")?, context.received)?;
        self.clock_source = Some((context.source, context.received));
        // The fleet's time does not run backwards for a message that is late, only if the clock was set back.
        if stamp > self.clock {
            self.clock = stamp;
            let mut message = Clock::default();
            message.header.stamp = stamp;
            (self.sink)(WorldMessage::Clock(&message));
        }
        Ok(())
    }

    /// Forgets a source that has left, so that another may take its robots at once.
    pub fn disconnect(&mut self, source: SourceId) {
        for robot in self.names.robots() {
            let state = &mut self.robots[robot.index()];
            if state.source.take_if(|(of, _)| *of == source).is_some() {
                self.mounts.await_transforms(robot);
            }
        }
        self.clock_source = self.clock_source.filter(|(of, _)| *of != source);
        self.mounts.trees.forget(source);
    }

    /// Takes the next notice for the operator's log.
    pub fn take_notice(&mut self) -> Option<String> {
        self.notices.take()
    }

    fn check_source(&self, context: &MessageContext<'_>, robot: RobotId) -> Result<(), WorldError> {
        let robot_count = self.names.count();
        if robot.number() > robot_count {
            return Err(TransformError::NoSuchRobot { robot_count }.into());
        }
        if is_held_by_other(self.robots[robot.index()].source, context) {
            return Err(WorldError::OtherSource { what: robot.to_string() });
        }
        Ok(())
    }

    /// Sends a robot's pose by its wheels, with the velocity since the pose before. The stamps are the source's and the run's.
    fn send_odometry(
        &mut self,
        context: &MessageContext<'_>,
        robot: RobotId,
        [sent, stamp]: [Stamp; 2],
        transform: &RobotFrameTransform,
        is_of_transform: bool,
    ) -> Result<(), TransformError> {
        let odom_from_base = planar_pose(transform)?;
        if self.begins_anew(context, robot, sent, &odom_from_base, is_of_transform) {
            self.robots[robot.index()].last_pose = None;
            (self.sink)(WorldMessage::OdometryRestart(robot));
        }
        let state = &mut self.robots[robot.index()];
        state.watch.add_odometry(context.received);
        let mut odometry = Odometry { odom_from_base, ..Odometry::default() };
        odometry.header.stamp = stamp;
        if let Some(last) = state.last_pose {
            // A client that publishes at its frame rate repeats poses: nothing new.
            if stamp <= last.stamp {
                return Ok(());
            }
            let span_s = sent - last.sent;
            let is_same = last.is_of_transform == is_of_transform;
            if is_same && span_s > 0.0 && span_s <= VELOCITY_SPAN_MAX_S {
                let step = last.odom_from_base.inverse() * odom_from_base;
                odometry.linear_m_s = step.x_m / span_s;
                odometry.angular_rad_s = step.yaw_rad / span_s;
            }
        }
        state.last_pose = Some(SentPose { sent, stamp, odom_from_base, is_of_transform });
        (self.sink)(WorldMessage::Odometry(robot, &odometry));
        Ok(())
    }
}

fn is_held_by_other(holder: Option<(SourceId, Stamp)>, context: &MessageContext<'_>) -> bool {
    holder.is_some_and(|(of, at)| of != context.source && context.received - at < SOURCE_TIMEOUT_S)
}

#[cfg(test)]
mod driver_trials;
#[cfg(test)]
mod mount_tests;
#[cfg(test)]
mod tests;
