//! Encodes the fleet's messages by the bridge's tables and writes them to the files of a recording.

mod commands;

use super::operator::operator_json;
use super::{Summary, TopicSummary};
use crate::clock::Epoch;
use crate::recording_files::{RecordingCounts, RecordingFiles};
use crate::run::Run;
use ::bridge::{
    Delivery, FleetMessage, FleetPublisher, FleetTopic, OUTGOING_TOPICS, RobotTransformPolicy, TopicSink,
};
use ::recording::bag::GROUND_TRUTH;
use ::recording::fleet::ODOMETRY_INCARNATION;
use ::recording::{Durability, RecordingWriter, TopicIndex, WriteError};
use msg::{CommandSource, GroundTruth, Monotonic, Odometry, RobotFrame, RobotId, Stamp};
use reports::{BridgeState, TlxEntry};
use ros_messages::cdr::Writer;
use ros_messages::{
    Bool, FrameNames, Int32, Message, Odometry as RosOdometry, Pose2D, RobotNames, Text, Twist, write,
};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Topics of the fleet that repeat others: `/map` and its probabilities, updates and tiles of whole grids that are recorded.
const REPEATING: [FleetTopic; 4] = [
    FleetTopic::MergedMapAlias,
    FleetTopic::MapUpdates,
    FleetTopic::MergedMapTiles,
    FleetTopic::MergedMapProbability,
];
/// Name of a robot's topic with its odometry as the fleet has it: an angle and not a quaternion, so that replay is exact.
pub const PLANAR_ODOMETRY: &str = "odom_2d";
/// Name of a robot's topic with the goals that it was given.
const NAVIGATION_COMMAND: &str = "navigation_command";
/// Frame of the true poses.
const WORLD: &str = "world";

/// A topic of a recording beside the fleet's on TCP and DDS.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum OwnTopic {
    /// Velocities that a robot gets.
    Command,
    /// Odometry as the fleet has it.
    PlanarOdometry,
    /// True poses of a simulated robot.
    GroundTruth,
    /// The fleet's figures and the health of its processes, as JSON.
    FleetStats,
    /// Who drives, waits and may drive, as JSON.
    OperatorState,
    /// Goals of a robot, and their cancellations, pauses and resumptions, as JSON.
    NavigationCommand,
    /// Answers to the form of workload, all of the run, as JSON.
    Workload,
    /// Who sends a robot's velocities, on change.
    CommandSender,
    /// Incarnation of the driver whose odometry is recorded, on change: a new one counts from another origin.
    OdometryIncarnation,
    /// Requests to a robot's SLAM, as JSON.
    SlamRequest,
    /// Commands about merge edges, as JSON.
    EdgeCommand,
    /// Emergency stop, its release, selection and takeover of robots, as JSON.
    OperatorEvent,
}

/// One topic of a recording.
struct Topic {
    name: String,
    message_type: &'static str,
    durability: Durability,
    /// The newest message of a latched topic, with which the next file begins.
    newest: Option<Vec<u8>>,
    total: TopicSummary,
}

/// Records messages of the fleet.
pub struct Recorder {
    publisher: Option<FleetPublisher>,
    names: FrameNames,
    epoch: Epoch,
    file: FileTopics,
    /// Who sent each robot's newest messages.
    senders: Vec<Senders>,
}

/// Who sent the newest messages of a robot.
#[derive(Clone, Copy, Default)]
struct Senders {
    /// Sender of the velocity; `None` before the first.
    velocity: Option<CommandSource>,
    /// Incarnation of the driver that sent the odometry.
    odometry: Option<u64>,
}

/// The topics, and the file that is being written.
struct FileTopics {
    topics: Vec<Topic>,
    /// Indices by row of [`OUTGOING_TOPICS`], then by robot; empty if the topic is not recorded.
    by_fleet_topic: [Vec<TopicIndex>; OUTGOING_TOPICS.len()],
    /// Indices by [`OwnTopic`], then by robot.
    own: [Vec<TopicIndex>; 12],
    description: BTreeMap<String, String>,
    /// The file; `None` once the recording has ended.
    writer: Option<RecordingWriter>,
    files: RecordingFiles,
    split_bytes: u64,
    file_bytes: u64,
    /// Time of the message that is being encoded.
    at: Stamp,
    payload: Vec<u8>,
    counts: Arc<RecordingCounts>,
    ended: Option<String>,
}

impl Recorder {
    /// Begins the first file of a run's recording.
    ///
    /// # Errors
    /// A topic's type has no known definition.
    pub fn new(
        run: &Run,
        description: BTreeMap<String, String>,
        files: RecordingFiles,
    ) -> Result<Self, WriteError> {
        let (robots, config) = (run.config.robot_names(), run.config.bridge_config());
        let mut publisher = FleetPublisher::new(config.frame_names, &robots, RobotTransformPolicy::Split);
        publisher.set_odometry_sigmas(config.odometry_sigmas);
        let mut file = FileTopics::new(&robots, description, files, run.config.recording.split_bytes());
        file.begin()?;
        let names = FrameNames::new(config.frame_names, &robots);
        let senders = vec![Senders::default(); robots.count()];
        Ok(Self { publisher: Some(publisher), names, epoch: run.epoch, file, senders })
    }

    /// Records a message of the fleet that was sent at this moment.
    pub fn publish(&mut self, message: FleetMessage<'_>, sent: Monotonic) {
        self.file.at = self.epoch.stamp(sent);
        if let Some(publisher) = &mut self.publisher {
            publisher.publish(message, &mut self.file);
        }
    }

    /// Records a robot's odometry, also as the fleet has it, and before it the driver's incarnation, if that has changed.
    pub fn record_odometry(&mut self, robot: RobotId, odometry: &Odometry) {
        self.file.at = self.epoch.stamp(odometry.header.sent);
        let incarnation = odometry.header.incarnation;
        if let Some(newest) = self.senders.get_mut(robot.index())
            && newest.odometry != Some(incarnation)
        {
            let text = incarnation.to_string();
            if self.file.record(OwnTopic::OdometryIncarnation, robot.index(), |to| to.string(&text)) {
                newest.odometry = Some(incarnation);
            }
        }
        self.publish(FleetMessage::Odometry(robot, odometry), odometry.header.sent);
        let pose = odometry.odom_from_base;
        let pose = Pose2D { x: pose.x_m, y: pose.y_m, theta: pose.yaw_rad };
        self.file.record(OwnTopic::PlanarOdometry, robot.index(), |to| pose.write(to));
    }

    /// Records a robot's true pose.
    pub fn record_truth(&mut self, robot: RobotId, truth: &GroundTruth) {
        self.file.at = self.epoch.stamp(truth.header.sent);
        let pose = Odometry {
            header: truth.header,
            odom_from_base: truth.world_from_base,
            linear_m_s: truth.linear_m_s,
            angular_rad_s: truth.angular_rad_s,
        };
        let child = self.names.robot_frame(robot, RobotFrame::BaseFootprint);
        self.file.record(OwnTopic::GroundTruth, robot.index(), |to| {
            write::odometry(to, WORLD, child, &pose, &[0.0; 36], &[0.0; 36]);
        });
    }

    /// Records the fleet's figures.
    pub fn record_stats(&mut self, json: &str, sent: Monotonic) {
        self.file.at = self.epoch.stamp(sent);
        self.file.record(OwnTopic::FleetStats, 0, |to| to.string(json));
    }

    /// Records the bridge's state: selected robot, emergency stop, drivers.
    pub fn record_operator(&mut self, state: &BridgeState, now: Monotonic) {
        self.file.at = self.epoch.stamp(now);
        self.file.send(FleetTopic::SelectedRobot, None, |to| Int32(state.selected as i32).write(to));
        self.file.send(FleetTopic::EmergencyStop, None, |to| Bool(state.stopped).write(to));
        let json = operator_json(state).to_string();
        self.file.record(OwnTopic::OperatorState, 0, |to| to.string(&json));
    }

    /// Records the answers to the form of workload.
    pub fn record_workload(&mut self, entries: &[TlxEntry], now: Monotonic) {
        self.file.at = self.epoch.stamp(now);
        let json = serde_json::to_string(entries).unwrap_or_default();
        self.file.record(OwnTopic::Workload, 0, |to| to.string(&json));
    }

    /// Ends the chunk and passes it on to the disk, and begins the next file if this one is large enough.
    pub fn flush(&mut self) {
        self.file.flush();
    }

    /// Returns the numbers of messages.
    pub fn counts(&self) -> Arc<RecordingCounts> {
        self.file.counts.clone()
    }

    /// Ends the last file and returns what was recorded.
    pub fn finish(self) -> Summary {
        self.file.finish()
    }
}

impl FileTopics {
    fn new(
        robots: &RobotNames,
        description: BTreeMap<String, String>,
        files: RecordingFiles,
        split_bytes: u64,
    ) -> Self {
        let mut topics = Vec::new();
        let mut add = |name: String, message_type, durability| {
            let total = TopicSummary { topic: name.clone(), ..Default::default() };
            topics.push(Topic { name, message_type, durability, newest: None, total });
            topics.len() - 1
        };
        let by_fleet_topic = OUTGOING_TOPICS.each_ref().map(|row| {
            if REPEATING.contains(&row.topic) || row.external_only {
                return Vec::new();
            }
            let is_latched = [row.tcp, row.dds].contains(&Some(Delivery::Latched));
            let durability = if is_latched { Durability::Latched } else { Durability::Volatile };
            row.names(robots).into_iter().map(|name| add(name, row.message_type, durability)).collect()
        });
        let mut of_robots = |rest: &str, message_type, durability| -> Vec<TopicIndex> {
            let names = robots.robots().map(|robot| robots.topic(robot, rest));
            names.map(|name| add(name, message_type, durability)).collect()
        };
        let navigation_commands = of_robots(NAVIGATION_COMMAND, Text::TYPE, Durability::Volatile);
        let command_senders = of_robots("cmd_vel_sender", Text::TYPE, Durability::Latched);
        let incarnations = of_robots(ODOMETRY_INCARNATION, Text::TYPE, Durability::Latched);
        let slam_requests = of_robots("slam_request", Text::TYPE, Durability::Volatile);
        let own = [
            of_robots("cmd_vel", Twist::TYPE, Durability::Volatile),
            of_robots(PLANAR_ODOMETRY, Pose2D::TYPE, Durability::Volatile),
            of_robots(GROUND_TRUTH, RosOdometry::TYPE, Durability::Volatile),
            vec![add("/fleet_stats".into(), Text::TYPE, Durability::Volatile)],
            vec![add("/operator_state".into(), Text::TYPE, Durability::Latched)],
            navigation_commands,
            vec![add("/nasa_tlx".into(), Text::TYPE, Durability::Latched)],
            command_senders,
            incarnations,
            slam_requests,
            vec![add("/merge_edge_command".into(), Text::TYPE, Durability::Volatile)],
            vec![add("/operator_event".into(), Text::TYPE, Durability::Volatile)],
        ];
        Self {
            topics,
            by_fleet_topic,
            own,
            description,
            writer: None,
            files,
            split_bytes,
            file_bytes: 0,
            at: Stamp(0),
            payload: Vec::new(),
            counts: Arc::default(),
            ended: None,
        }
    }

    /// Begins a file with all topics and the newest latched messages.
    fn begin(&mut self) -> Result<(), WriteError> {
        let mut writer = RecordingWriter::new(&self.description)?;
        for topic in &self.topics {
            writer.add_topic(&topic.name, topic.message_type, topic.durability)?;
        }
        for (index, topic) in self.topics.iter_mut().enumerate() {
            if let Some(payload) = &topic.newest {
                writer.write(index, self.at, payload)?;
                topic.total.messages += 1;
                topic.total.bytes += payload.len() as u64;
            }
        }
        self.files.begin_file();
        (self.writer, self.file_bytes) = (Some(writer), 0);
        Ok(())
    }

    /// Returns whether the message was written.
    fn record(&mut self, topic: OwnTopic, robot: usize, encode: impl FnOnce(&mut Writer<'_>)) -> bool {
        let index = self.own[topic as usize].get(robot).copied();
        index.is_some_and(|index| self.encode(index, encode))
    }

    /// Returns whether the message was written.
    fn encode(&mut self, index: TopicIndex, encode: impl FnOnce(&mut Writer<'_>)) -> bool {
        let (Some(writer), Some(topic)) = (&mut self.writer, self.topics.get_mut(index)) else {
            // Nothing of a recording that has ended counts as recorded.
            if self.ended.is_some() {
                self.counts.add_dropped();
            }
            return false;
        };
        self.payload.clear();
        encode(&mut Writer::new(&mut self.payload));
        if topic.durability == Durability::Latched {
            topic.newest = Some(self.payload.clone());
        }
        match writer.write(index, self.at, &self.payload) {
            Ok(()) => {
                self.counts.add_message();
                topic.total.messages += 1;
                topic.total.bytes += self.payload.len() as u64;
                // A chunk that is full is on its way at once.
                self.pass_on();
                true
            }
            Err(why) => {
                self.end(why.to_string());
                false
            }
        }
    }

    fn pass_on(&mut self) {
        let Some(writer) = &mut self.writer else { return };
        let bytes = writer.take_bytes();
        if !bytes.is_empty() {
            self.file_bytes += bytes.len() as u64;
            self.files.append(&bytes);
        }
    }

    fn flush(&mut self) {
        if let Some(why) = self.files.failure() {
            return self.end(why);
        }
        let Some(writer) = &mut self.writer else { return };
        if let Err(why) = writer.flush() {
            return self.end(why.to_string());
        }
        self.pass_on();
        if self.file_bytes >= self.split_bytes {
            self.finish_file();
            if let Err(why) = self.begin() {
                self.end(why.to_string());
            }
        }
    }

    fn finish_file(&mut self) {
        let Some(writer) = self.writer.take() else { return };
        match writer.finish() {
            Ok(bytes) => self.files.append(&bytes),
            Err(why) => self.end(why.to_string()),
        }
    }

    /// Ends the recording; the fleet goes on.
    fn end(&mut self, why: String) {
        if self.ended.is_none() {
            tracing::error!("the recording has ended: {why}; the fleet goes on");
            (self.writer, self.ended) = (None, Some(why));
            self.counts.set_ended();
        }
    }

    fn finish(mut self) -> Summary {
        self.finish_file();
        let topics = self.topics.into_iter().map(|topic| topic.total).collect();
        let written = self.files.finish();
        Summary {
            files: written.files,
            earlier: written.earlier,
            topics,
            dropped: self.counts.dropped(),
            lost: 0,
            ended: self.ended.or(written.failure),
        }
    }
}

impl TopicSink for FileTopics {
    fn send(&mut self, topic: FleetTopic, robot: Option<RobotId>, encode: impl FnOnce(&mut Writer<'_>)) {
        let indices = &self.by_fleet_topic[topic as usize];
        if let Some(index) = indices.get(robot.map_or(0, RobotId::index)).copied() {
            self.encode(index, encode);
        }
    }

    fn send_again(&mut self, _: FleetTopic, _: FleetTopic) {}

    fn is_subscribed(&self, _: FleetTopic) -> bool {
        false
    }
}
