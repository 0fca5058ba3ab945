//! The sensor data of a fleet in its own recording, for replay: what each robot measured, and when it was sent.

use crate::RecordedMessage;
use msg::{Header, Odometry, Pose2, RobotId, Scan, Stamp};
use ros_messages::cdr::Reader;
use ros_messages::{
    Message as _, Odometry as RosOdometry, Pose2D, RobotNames, Text, decode, read, spatial_pose,
};
use std::collections::{BTreeSet, HashMap};
use std::time::Duration;

/// Most bytes of ranges that are kept, bytes: ten hours of 16 robots with 360 beams.
const RANGES_BYTES_MAX: usize = 8 << 30;
/// Most messages of all robots.
const MESSAGES_MAX: usize = 50_000_000;

/// Odometry up to which a robot is where it began, metres and radians.
const AT_START_M: f64 = 0.05;
const AT_START_RAD: f64 = 0.05;

/// A robot that stands nearer to where it began, and was farther away at the message before, has a driver that was started again, metres.
const RETURN_MIN_M: f64 = 0.5;
/// Pause within a recording from which a message has a wrong time, and the unit in which times are compared. The clock is recorded all
/// the time, and a recorder that was killed is back within seconds.
const PAUSE_MAX: Duration = Duration::from_secs(3600);

/// Last part of the name of a robot's topic that says from which incarnation of its driver its odometry is.
pub const ODOMETRY_INCARNATION: &str = "odom_incarnation";

/// A scan without the unused part of its ranges.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedScan {
    stamp: Stamp,
    angle_min_rad: f32,
    angle_increment_rad: f32,
    time_increment_s: f32,
    scan_time_s: f32,
    range_min_m: f32,
    range_max_m: f32,
    ranges_m: Box<[f32]>,
}

impl RecordedScan {
    fn new(scan: &Scan) -> Self {
        Self {
            stamp: scan.header.stamp,
            angle_min_rad: scan.angle_min_rad,
            angle_increment_rad: scan.angle_increment_rad,
            time_increment_s: scan.time_increment_s,
            scan_time_s: scan.scan_time_s,
            range_min_m: scan.range_min_m,
            range_max_m: scan.range_max_m,
            ranges_m: scan.ranges_m().into(),
        }
    }

    /// Writes the scan into a message that is all zero.
    pub fn write_to(&self, scan: &mut Scan) {
        scan.header.stamp = self.stamp;
        (scan.angle_min_rad, scan.angle_increment_rad) = (self.angle_min_rad, self.angle_increment_rad);
        (scan.time_increment_s, scan.scan_time_s) = (self.time_increment_s, self.scan_time_s);
        (scan.range_min_m, scan.range_max_m) = (self.range_min_m, self.range_max_m);
        scan.ranges_m[..self.ranges_m.len()].copy_from_slice(&self.ranges_m);
        scan.len = self.ranges_m.len() as u32;
    }
}

/// A message that a robot's simulator, or the robot, sent.
#[derive(Clone, Debug, PartialEq)]
pub enum SensorMessage {
    /// One turn of the LiDAR.
    Scan(RecordedScan),
    /// Wheel odometry of the robot.
    Odometry(Odometry),
}

impl SensorMessage {
    /// Whether it is a scan, and its stamp: no robot sends two such messages of one stamp.
    fn kind_and_stamp(&self) -> (bool, Stamp) {
        match self {
            Self::Odometry(odometry) => (false, odometry.header.stamp),
            Self::Scan(scan) => (true, scan.stamp),
        }
    }
}

/// What one robot sent, in order of time.
#[derive(Clone, Debug, Default)]
pub struct RobotRecording {
    /// Messages, each with the time of the run at which it was sent.
    pub messages: Vec<(Stamp, SensorMessage)>,
    /// Incarnations of the driver, each with the time from which the odometry is its.
    incarnations: Vec<(Stamp, u64)>,
}

impl RobotRecording {
    /// Returns how often the driver had been started again when a message of this time was sent.
    pub fn restarts_until(&self, at: Stamp) -> usize {
        self.incarnations.partition_point(|(since, _)| *since <= at).saturating_sub(1)
    }

    /// Returns when odometry first jumps back to where it began, though the recording does not say that the driver was started again:
    /// recordings of before do not say it.
    pub fn unexplained_return(&self) -> Option<Stamp> {
        if !self.incarnations.is_empty() {
            return None;
        }
        let mut before: Option<Pose2> = None;
        self.messages.iter().find_map(|(at, message)| {
            let SensorMessage::Odometry(Odometry { odom_from_base: pose, .. }) = message else { return None };
            let was_away =
                before.replace(*pose).is_some_and(|before| before.distance_m(*pose) > RETURN_MIN_M);
            (was_away && pose.x_m.hypot(pose.y_m) < AT_START_M).then_some(*at)
        })
    }
}

/// A pause that no recording has: a message has a wrong time, or files are not of one recording.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "nothing was recorded for {hours} h before {ends_s:.0} s of the run: a message has a wrong time, or the files are not of one recording"
)]
pub struct PauseError {
    /// Duration of the pause, whole hours.
    pub hours: i64,
    /// About when it ends, seconds of the run.
    pub ends_s: f64,
}

/// What a message of a recording means for replay.
#[derive(Clone, Copy)]
enum Meaning {
    Scan(RobotId),
    Odometry(RobotId),
    PlanarOdometry(RobotId),
    Incarnation(RobotId),
    Clock,
}

/// The sensor data of all robots.
pub struct FleetRecording {
    meanings: HashMap<String, Meaning>,
    /// Each robot's messages, by its index.
    pub robots: Vec<RobotRecording>,
    /// Times at which the clock was sent.
    pub clock: Vec<Stamp>,
    /// Times of the first and the last message that is used; `None` without any.
    used: Option<(Stamp, Stamp)>,
    /// Hours of the run in which messages were sent.
    hours: BTreeSet<i64>,
    /// Messages that could not be decoded.
    pub malformed: u64,
    /// Messages that were left out, because there are too many.
    pub left_out: u64,
    /// Messages that were left out, because another file has them, too.
    pub duplicates: u64,
    ranges_bytes: usize,
    scan: Box<Scan>,
    /// Whether the room of the fleet's configuration is the one in which it was recorded.
    pub has_room: bool,
}

impl FleetRecording {
    /// Begins without messages. `planar_odometry` is the last part of the name of a robot's odometry as an angle.
    pub fn new(names: &RobotNames, planar_odometry: &str, scan: Box<Scan>) -> Self {
        let mut meanings = HashMap::from([("/clock".to_owned(), Meaning::Clock)]);
        for robot in names.robots() {
            meanings.insert(names.topic(robot, "scan"), Meaning::Scan(robot));
            meanings.insert(names.topic(robot, "odom"), Meaning::Odometry(robot));
            meanings.insert(names.topic(robot, planar_odometry), Meaning::PlanarOdometry(robot));
            meanings.insert(names.topic(robot, ODOMETRY_INCARNATION), Meaning::Incarnation(robot));
        }
        let robots = vec![RobotRecording::default(); names.count()];
        Self {
            meanings,
            robots,
            clock: Vec::new(),
            used: None,
            hours: BTreeSet::new(),
            malformed: 0,
            left_out: 0,
            duplicates: 0,
            ranges_bytes: 0,
            scan,
            has_room: true,
        }
    }

    /// Adds a message of the recording. Those of other topics are ignored, malformed ones are counted.
    pub fn add(&mut self, message: &RecordedMessage) {
        let Some(meaning) = self.meanings.get(&*message.topic).copied() else { return };
        let messages =
            self.robots.iter().map(|robot| robot.messages.len() + robot.incarnations.len()).sum::<usize>()
                + self.clock.len();
        if messages >= MESSAGES_MAX || self.ranges_bytes >= RANGES_BYTES_MAX {
            self.left_out += 1;
        } else if self.decode(meaning, message).is_none() {
            self.malformed += 1;
        } else {
            let (first, last) = self.used.unwrap_or((message.at, message.at));
            self.used = Some((first.min(message.at), last.max(message.at)));
            self.hours.insert(message.at.0.div_euclid(PAUSE_MAX.as_nanos() as i64));
        }
    }

    /// Returns the time of the first message that is used, whole seconds of the run. Periods of processes that begin there are as in the run.
    pub fn begins(&self) -> Stamp {
        const SECOND_NS: i64 = 1_000_000_000;
        self.used.map_or(Stamp(0), |(first, _)| Stamp(first.0.max(0) / SECOND_NS * SECOND_NS))
    }

    /// Returns the time of the last message that is used.
    pub fn ends(&self) -> Stamp {
        self.used.map_or(Stamp(0), |(_, last)| Stamp(last.0.max(0)))
    }

    /// Checks that messages were recorded all the time, but for pauses of up to an hour or two.
    ///
    /// # Errors
    /// There is a longer pause.
    pub fn check_pauses(&self) -> Result<(), PauseError> {
        let (mut hours, mut before) = (self.hours.iter(), None);
        let pause = hours.find_map(|hour| {
            let pause = before.replace(*hour).map_or(0, |before: i64| hour - before - 1);
            (pause > 0).then_some((pause, *hour))
        });
        match pause {
            Some((hours, hour)) => Err(PauseError { hours, ends_s: hour as f64 * PAUSE_MAX.as_secs_f64() }),
            None => Ok(()),
        }
    }

    fn decode(&mut self, meaning: Meaning, message: &RecordedMessage) -> Option<()> {
        let (at, payload) = (message.at, &message.payload);
        match meaning {
            Meaning::Clock => self.clock.push(at),
            Meaning::Incarnation(robot) => {
                let incarnation = decode::<Text>(payload).ok()?.0.parse().ok()?;
                self.robots.get_mut(robot.index())?.incarnations.push((at, incarnation));
            }
            Meaning::Scan(robot) => {
                read::laser_scan(&mut Reader::new(payload).ok()?, &mut self.scan).ok()?;
                let scan = RecordedScan::new(&self.scan);
                self.ranges_bytes += size_of_val(&*scan.ranges_m);
                self.push(robot, at, SensorMessage::Scan(scan));
            }
            Meaning::Odometry(robot) => {
                let RosOdometry { stamp, position, orientation, twist, .. } = decode(payload).ok()?;
                let odometry = Odometry {
                    header: Header { stamp, ..Header::default() },
                    odom_from_base: spatial_pose::planar_pose(position, orientation)?,
                    linear_m_s: twist.linear[0],
                    angular_rad_s: twist.angular[2],
                };
                self.push(robot, at, SensorMessage::Odometry(odometry));
            }
            Meaning::PlanarOdometry(robot) => {
                let Pose2D { x, y, theta } = Pose2D::read(&mut Reader::new(payload).ok()?).ok()?;
                let messages = &mut self.robots.get_mut(robot.index())?.messages;
                // It follows the odometry that it is the exact pose of; only messages of the same moment lie between.
                let same = messages.iter_mut().rev().take_while(|(sent, _)| *sent == at);
                let odometry = same.filter_map(|(_, message)| match message {
                    SensorMessage::Odometry(odometry) => Some(odometry),
                    SensorMessage::Scan(_) => None,
                });
                for odometry in odometry.take(1) {
                    odometry.odom_from_base = Pose2::new(x, y, theta);
                }
            }
        }
        Some(())
    }

    fn push(&mut self, robot: RobotId, at: Stamp, message: SensorMessage) {
        if let Some(robot) = self.robots.get_mut(robot.index()) {
            robot.messages.push((at, message));
        }
    }

    /// Sorts each robot's messages by time, odometry before the scan of the same moment. A message that is in several files is kept
    /// once.
    pub fn sort(&mut self) {
        for robot in &mut self.robots {
            robot.messages.sort_by_key(|(at, message)| (*at, message.kind_and_stamp()));
            let all = robot.messages.len();
            robot.messages.dedup_by_key(|(_, message)| message.kind_and_stamp());
            self.duplicates += (all - robot.messages.len()) as u64;
            robot.incarnations.sort();
            robot.incarnations.dedup_by_key(|(_, incarnation)| *incarnation);
        }
        self.clock.sort();
        self.clock.dedup();
    }

    /// Returns whether it begins after the robots: one of them has driven by its first odometry, which begins at zero.
    pub fn begins_midway(&self) -> bool {
        let first = |robot: &RobotRecording| {
            robot.messages.iter().find_map(|(_, message)| match message {
                SensorMessage::Odometry(odometry) => Some(odometry.odom_from_base),
                SensorMessage::Scan(_) => None,
            })
        };
        let has_driven =
            |pose: Pose2| pose.x_m.hypot(pose.y_m) > AT_START_M || pose.yaw_rad.abs() > AT_START_RAD;
        self.robots.iter().filter_map(first).any(has_driven)
    }

    /// Returns whether a robot has scans.
    pub fn has_scans(&self) -> bool {
        let is_scan = |(_, message): &(Stamp, SensorMessage)| matches!(message, SensorMessage::Scan(_));
        self.robots.iter().any(|robot| robot.messages.iter().any(is_scan))
    }
}
