//! A world that is not ours to simulate: scans, transforms and the clock come in from a headset, or from real robots.
//!
//! ```text
//!   LaserScan  ─▶ checked, bounded ──────────────────────────────▶ robotK/scan
//!   Odometry   ─▶ checked ───────────────────────────────────────▶ robotK/odometry, robotK/transforms
//!   TFMessage  ─▶ the fleet's links ─▶ robotK/transforms, odom -> base ─▶ robotK/odometry
//!   Clock      ─▶ ─────────────────────────────────────────────────▶ clock
//!                  every stamp: the source's clock -> the run's ([`SourceClock`])
//! ```
//! One [`World`] a bridge, whichever door messages come in by; one [`SourceClock`] for each machine they come from.
//! SLAM's own transform, `map` -> `odom`, is not for a source to publish (REP-105): it is left out and reported,
//! whatever else comes in the same message is taken.

mod clock;

pub use clock::{ClockEstimate, ClockOffset, SourceClock};

use crate::cdr::{DecodeError, Reader};
use crate::ros::names::{FleetFrame, is_correction, meaning};
use crate::ros::read::{self, Transform};
use msg::{
    BEAMS_MAX, Clock, Header, LINKS_MAX, Link, LinkTransform, Odometry, Pose2, ROBOTS_MAX, RobotId, Scan,
    Stamp, Transforms,
};
use std::f64::consts::TAU;
use thiserror::Error;

/// A robot keeps its source for so long after its last scan or transform; then another may take its place.
const SOURCE_KEPT_S: f64 = 2.0;
/// A quaternion's length may be off by this much; it is made 1.
const UNIT_TOLERANCE: f64 = 1e-2;
/// A robot on a floor leans less than this, radians: more is another convention of axes.
const TILT_MAX_RAD: f64 = 0.35;
/// Farther from where its odometry began no robot gets, metres.
const DISTANCE_MAX_M: f64 = 1e5;
/// Velocity is taken from two poses no further apart than this, seconds.
const VELOCITY_SPAN_S: f64 = 1.0;

/// What has come in, as the fleet's channels carry it.
#[derive(Clone, Copy, Debug)]
pub enum Heard<'a> {
    /// For `robotK/scan`.
    Scan(RobotId, &'a Scan),
    /// For `robotK/odometry`; written before the transforms of the same stamp, which wake the readers.
    Odometry(RobotId, &'a Odometry),
    /// For `robotK/transforms`.
    Transforms(RobotId, &'a Transforms),
    /// For `clock`.
    Clock(&'a Clock),
}

/// Why a message, or a part of one, was not taken.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum WorldError {
    /// It is not the message it should be.
    #[error(transparent)]
    Payload(#[from] DecodeError),
    /// It says what cannot be.
    #[error("{0}")]
    Content(String),
    /// Another source speaks for this robot, or keeps the clock.
    #[error("{what} has another source, which spoke less than {SOURCE_KEPT_S} s ago")]
    OtherSource {
        /// A robot, or the clock.
        what: String,
    },
    /// Algorithm 1's guard.
    #[error(
        "{parent} -> {child} is refused: SLAM owns map -> odom (REP-105); the rest of the message is taken"
    )]
    Correction {
        /// As it was written.
        parent: String,
        /// As it was written.
        child: String,
    },
}

/// Tells sources apart: any number of the caller's.
pub type SourceId = u64;

/// One robot as its source tells of it.
#[derive(Clone, Copy, Debug, Default)]
struct Robot {
    source: Option<(SourceId, Stamp)>,
    scan: Option<Stamp>,
    /// The newest pose, by the source's own clock, with its stamp on the run's.
    pose: Option<(Stamp, Stamp, Pose2)>,
    /// odom -> base_footprint has been seen: base_link, which moves the same, is not needed.
    has_footprint: bool,
}

/// One message from a source, behind its encapsulation header.
#[derive(Clone, Debug)]
pub enum Incoming<'a> {
    /// sensor_msgs/LaserScan of a robot.
    Scan(RobotId, Reader<'a>),
    /// tf2_msgs/TFMessage.
    Transforms(Reader<'a>),
    /// nav_msgs/Odometry of a robot, whatever it calls its frames.
    Odometry(RobotId, Reader<'a>),
    /// rosgraph_msgs/Clock.
    Clock(Reader<'a>),
}

/// Where what has come in goes.
type Sink = Box<dyn FnMut(Heard<'_>)>;

/// The world as its sources tell of it. No sockets, no clock of its own.
pub struct World {
    robot_count: usize,
    robots: [Robot; ROBOTS_MAX],
    scan: Box<Scan>,
    links: Box<[Transforms; ROBOTS_MAX]>,
    /// The newest clock, and who keeps it.
    clock: Stamp,
    timekeeper: Option<(SourceId, Stamp)>,
    sink: Sink,
}

impl World {
    /// For robots 1 to `robot_count`. `sink` is called with all that is taken; it must not call back.
    pub fn new(robot_count: usize, sink: impl FnMut(Heard<'_>) + 'static) -> Self {
        Self {
            robot_count: robot_count.clamp(1, ROBOTS_MAX),
            robots: [Robot::default(); ROBOTS_MAX],
            scan: empty_scan(),
            links: Box::new([Transforms::default(); ROBOTS_MAX]),
            clock: Stamp(i64::MIN),
            timekeeper: None,
            sink: Box::new(sink),
        }
    }

    /// How many robots it has.
    pub fn robot_count(&self) -> usize {
        self.robot_count
    }

    /// Takes a message that arrived at `received` (the run's time). Transforms of frames that are not the fleet's are
    /// passed over.
    ///
    /// Of a message's transforms those that are refused are left out, the others are taken; the error is the first's.
    pub fn hear(
        &mut self,
        source: SourceId,
        clock: &mut SourceClock,
        message: Incoming<'_>,
        received: Stamp,
    ) -> Result<(), WorldError> {
        match message {
            Incoming::Scan(robot, from) => self.scan(source, clock, robot, from, received),
            Incoming::Transforms(from) => self.transforms(source, clock, &from, received),
            Incoming::Odometry(robot, from) => self.wheels(source, clock, robot, from, received),
            Incoming::Clock(from) => self.clock(source, clock, from, received),
        }
    }

    fn scan(
        &mut self,
        source: SourceId,
        clock: &mut SourceClock,
        robot: RobotId,
        mut from: Reader<'_>,
        received: Stamp,
    ) -> Result<(), WorldError> {
        self.check_source(source, robot, received)?;
        read::laser_scan(&mut from, &mut self.scan)?;
        check_scan(&mut self.scan).map_err(WorldError::Content)?;
        let sent = self.scan.header.stamp;
        let stamp = clock.take(sent, received);
        let state = &mut self.robots[robot.index()];
        if state.scan.is_some_and(|before| stamp <= before) {
            let text = format!("the scan's stamp, {:.3} s, is not newer than the last one's", sent.seconds());
            return Err(WorldError::Content(text));
        }
        (state.scan, state.source) = (Some(stamp), Some((source, received)));
        self.scan.header.stamp = stamp;
        (self.sink)(Heard::Scan(robot, &self.scan));
        Ok(())
    }

    fn transforms(
        &mut self,
        source: SourceId,
        clock: &mut SourceClock,
        from: &Reader<'_>,
        received: Stamp,
    ) -> Result<(), WorldError> {
        // All of it must be sound before any of it is taken.
        read::transforms(&mut from.clone(), |_| {})?;
        self.links.iter_mut().for_each(|links| links.len = 0);
        let mut refused = Ok(());
        read::transforms(&mut from.clone(), |transform| {
            let taken = self.transform(source, clock, &transform, received);
            if refused.is_ok() {
                refused = taken;
            }
        })?;
        RobotId::first(self.robot_count).for_each(|robot| self.pass_links(robot));
        refused
    }

    /// The same as the transform odom -> base_footprint, for robots that do not number their frames.
    fn wheels(
        &mut self,
        source: SourceId,
        clock: &mut SourceClock,
        robot: RobotId,
        mut from: Reader<'_>,
        received: Stamp,
    ) -> Result<(), WorldError> {
        self.check_source(source, robot, received)?;
        let transform = read::odometry(&mut from)?;
        let sound = link(Link::Odom, Link::BaseFootprint, &transform).map_err(WorldError::Content)?;
        let stamp = clock.take(transform.stamp, received);
        let state = &mut self.robots[robot.index()];
        let is_new = state.pose.is_none_or(|(_, before, _)| stamp > before);
        state.source = Some((source, received));
        state.has_footprint = true;
        self.odometry(robot, transform.stamp, stamp, &sound).map_err(WorldError::Content)?;
        if is_new {
            let links = &mut self.links[robot.index()];
            (links.header.stamp, links.len, links.links[0]) = (stamp, 1, sound);
            self.pass_links(robot);
        }
        Ok(())
    }

    fn clock(
        &mut self,
        source: SourceId,
        clock: &mut SourceClock,
        mut from: Reader<'_>,
        received: Stamp,
    ) -> Result<(), WorldError> {
        if is_taken(self.timekeeper, source, received) {
            return Err(WorldError::OtherSource { what: "the clock".into() });
        }
        let stamp = clock.take(read::stamp(&mut from, "clock")?, received);
        self.timekeeper = Some((source, received));
        // The fleet's time does not run backwards, whoever is late.
        if stamp > self.clock {
            self.clock = stamp;
            let mut message = Clock::default();
            message.header.stamp = stamp;
            (self.sink)(Heard::Clock(&message));
        }
        Ok(())
    }

    /// A source is gone: its robots may have another at once.
    pub fn leave(&mut self, source: SourceId) {
        for robot in &mut self.robots {
            robot.source = robot.source.filter(|(of, _)| *of != source);
        }
        self.timekeeper = self.timekeeper.filter(|(of, _)| *of != source);
    }

    fn check_source(&self, source: SourceId, robot: RobotId, received: Stamp) -> Result<(), WorldError> {
        if robot.number() > self.robot_count {
            return Err(WorldError::Content(format!("the fleet has robots 1 to {}", self.robot_count)));
        }
        if is_taken(self.robots[robot.index()].source, source, received) {
            return Err(WorldError::OtherSource { what: robot.to_string() });
        }
        Ok(())
    }

    /// One transform, if it is of the fleet's frames.
    fn transform(
        &mut self,
        source: SourceId,
        clock: &mut SourceClock,
        transform: &Transform<'_>,
        received: Stamp,
    ) -> Result<(), WorldError> {
        let (parent, child) = (transform.frame_id, transform.child_frame_id);
        if is_correction(parent, child, self.robot_count) {
            return Err(WorldError::Correction { parent: parent.into(), child: child.into() });
        }
        let of_fleet = |name| meaning(name, self.robot_count);
        let Some((robot, FleetFrame::Link(child_link))) = of_fleet(child) else { return Ok(()) };
        let wrong = |why: String| WorldError::Content(format!("{parent} -> {child}: {why}"));
        let count = self.robot_count;
        if robot.number() > count {
            return Err(wrong(format!("the fleet has robots 1 to {count}")));
        }
        let Some((_, FleetFrame::Link(parent_link))) = of_fleet(parent).filter(|(of, _)| *of == robot) else {
            return Err(wrong(format!("its parent should be a frame of {robot}, such as its odom")));
        };
        self.check_source(source, robot, received)?;
        let link = link(parent_link, child_link, transform).map_err(wrong)?;
        let stamp = clock.take(transform.stamp, received);
        let state = &mut self.robots[robot.index()];
        state.source = Some((source, received));
        if parent_link == Link::Odom && matches!(child_link, Link::BaseFootprint | Link::BaseLink) {
            state.has_footprint |= child_link == Link::BaseFootprint;
            if child_link == Link::BaseFootprint || !state.has_footprint {
                self.odometry(robot, transform.stamp, stamp, &link).map_err(wrong)?;
            }
        }
        if self.links[robot.index()].len > 0 && self.links[robot.index()].header.stamp != stamp {
            self.pass_links(robot);
        }
        let links = &mut self.links[robot.index()];
        links.header.stamp = stamp;
        if let Some(place) = links.links.get_mut((links.len as usize).min(LINKS_MAX)) {
            *place = link;
            links.len += 1;
        }
        Ok(())
    }

    /// A robot's pose by its wheels, with the velocity since the one before.
    fn odometry(
        &mut self,
        robot: RobotId,
        sent: Stamp,
        stamp: Stamp,
        link: &LinkTransform,
    ) -> Result<(), String> {
        let odom_from_base = planar(link)?;
        let state = &mut self.robots[robot.index()];
        let mut odometry = Odometry { odom_from_base, ..Odometry::default() };
        odometry.header.stamp = stamp;
        if let Some((sent_before, before, pose)) = state.pose {
            // The same again, as a client sends that publishes at its frame rate: nothing new.
            if stamp <= before {
                return Ok(());
            }
            let span_s = sent - sent_before;
            if span_s > 0.0 && span_s <= VELOCITY_SPAN_S {
                let step = pose.inverse() * odom_from_base;
                odometry.linear_m_s = step.x_m / span_s;
                odometry.angular_rad_s = step.yaw_rad / span_s;
            }
        }
        state.pose = Some((sent, stamp, odom_from_base));
        (self.sink)(Heard::Odometry(robot, &odometry));
        Ok(())
    }

    fn pass_links(&mut self, robot: RobotId) {
        let links = &mut self.links[robot.index()];
        if links.len > 0 {
            (self.sink)(Heard::Transforms(robot, links));
            links.len = 0;
        }
    }
}

fn is_taken(holder: Option<(SourceId, Stamp)>, source: SourceId, received: Stamp) -> bool {
    holder.is_some_and(|(of, heard)| of != source && received - heard < SOURCE_KEPT_S)
}

fn empty_scan() -> Box<Scan> {
    Box::new(Scan {
        header: Header::default(),
        angle_min_rad: 0.0,
        angle_increment_rad: 0.0,
        time_increment_s: 0.0,
        scan_time_s: 0.0,
        range_min_m: 0.0,
        range_max_m: 0.0,
        len: 0,
        reserved: 0,
        ranges_m: [0.0; BEAMS_MAX],
    })
}

/// Whether the numbers make a scan. Ranges that mean nothing become NaN, those beyond the limit infinite (REP-117).
fn check_scan(scan: &mut Scan) -> Result<(), String> {
    let Scan { angle_min_rad, angle_increment_rad, range_min_m, range_max_m, .. } = *scan;
    let beams = scan.len as usize;
    if beams < 2 {
        return Err(format!("a scan has {beams} beams; at least 2 are needed"));
    }
    let step = f64::from(angle_increment_rad);
    let turn = step.abs() * (beams - 1) as f64;
    if !angle_min_rad.is_finite() || !step.is_finite() || step == 0.0 || turn > TAU + step.abs() {
        return Err(format!(
            "{beams} beams from {angle_min_rad} rad in steps of {angle_increment_rad} rad; one turn at most is needed"
        ));
    }
    let in_order = range_min_m >= 0.0 && range_min_m < range_max_m && range_max_m.is_finite();
    if !in_order {
        return Err(format!(
            "ranges from {range_min_m} to {range_max_m} m; expected 0 <= range_min < range_max"
        ));
    }
    let seconds = |value: f32| value.is_finite() && (0.0..=10.0).contains(&value);
    if !seconds(scan.time_increment_s * beams as f32) || !seconds(scan.scan_time_s) {
        return Err(format!(
            "time_increment {} s, scan_time {} s; a scan takes 0 to 10 s",
            scan.time_increment_s, scan.scan_time_s
        ));
    }
    for range in &mut scan.ranges_m[..beams] {
        if *range > range_max_m {
            *range = f32::INFINITY;
        } else if *range < range_min_m {
            *range = f32::NAN;
        }
    }
    Ok(())
}

/// A transform's numbers, with its quaternion made a unit one.
fn link(parent: Link, child: Link, transform: &Transform<'_>) -> Result<LinkTransform, String> {
    let near = |value: &&f64| value.abs() <= DISTANCE_MAX_M;
    if let Some(value) = transform.translation.iter().find(|value| !near(value)) {
        return Err(format!("a translation of {value} m"));
    }
    let length = transform.rotation.iter().map(|value| value * value).sum::<f64>().sqrt();
    let is_unit = (length - 1.0).abs() <= UNIT_TOLERANCE;
    if !is_unit {
        return Err(format!("its rotation {:?} is no unit quaternion (x, y, z, w)", transform.rotation));
    }
    Ok(LinkTransform {
        parent: parent as u32,
        child: child as u32,
        translation_m: transform.translation,
        rotation_xyzw: transform.rotation.map(|value| value / length),
    })
}

/// A robot's pose on the floor, told by a transform.
pub(crate) fn floor_pose(transform: &Transform<'_>) -> Result<Pose2, String> {
    planar(&link(Link::Odom, Link::BaseFootprint, transform)?)
}

/// The pose on the floor. A robot that leans is another convention of axes, such as Unity's own.
fn planar(link: &LinkTransform) -> Result<Pose2, String> {
    let [x, y, z, w] = link.rotation_xyzw;
    let up = 1.0 - 2.0 * (x * x + y * y);
    if up < TILT_MAX_RAD.cos() {
        return Err(format!(
            "it leans by {:.0} degrees; expected ROS's axes: x forward, y left, z up",
            up.clamp(-1.0, 1.0).acos().to_degrees()
        ));
    }
    let yaw_rad = (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
    Ok(Pose2::new(link.translation_m[0], link.translation_m[1], yaw_rad))
}

#[cfg(test)]
mod tests;
