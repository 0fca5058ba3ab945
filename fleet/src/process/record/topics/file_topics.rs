//! Topics and files of a recording: what was appended counts, what was not is dropped.

use super::super::Summary;
use super::{OwnTopic, PLANAR_ODOMETRY};
use crate::recording_files::{RecordingCounts, RecordingFiles};
use ::bridge::{Delivery, FleetTopic, OUTGOING_TOPICS, TopicSink};
use ::recording::bag::GROUND_TRUTH;
use ::recording::fleet::ODOMETRY_INCARNATION;
use ::recording::rosbag2::{Bag, BagFile, BagTopic};
use ::recording::{Durability, Part, RecordingWriter, TopicCount, TopicIndex, WriteError};
use msg::{RobotId, Stamp};
use ros_messages::cdr::Writer;
use ros_messages::{Message, Odometry as RosOdometry, Pose2D, RobotNames, Text, Twist};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Topics of the fleet that repeat others: `/map` and its probabilities, updates and tiles of whole grids that are recorded.
const REPEATING: [FleetTopic; 4] = [
    FleetTopic::MergedMapAlias,
    FleetTopic::MapUpdates,
    FleetTopic::MergedMapTiles,
    FleetTopic::MergedMapProbability,
];
/// Name of a robot's topic with the goals that it was given.
const NAVIGATION_COMMAND: &str = "navigation_command";

/// One topic of a recording.
struct Topic {
    name: String,
    message_type: &'static str,
    durability: Durability,
    /// The newest message of a latched topic, with which the next file begins.
    newest: Option<Vec<u8>>,
    /// What of it is in the files.
    total: TopicCount,
}

/// The topics, and the file that is being written.
pub struct FileTopics {
    topics: Vec<Topic>,
    /// Indices by row of [`OUTGOING_TOPICS`], then by robot; empty if the topic is not recorded.
    by_fleet_topic: [Vec<TopicIndex>; OUTGOING_TOPICS.len()],
    /// Indices by [`OwnTopic`], then by robot.
    own: [Vec<TopicIndex>; 13],
    description: BTreeMap<String, String>,
    /// The file; `None` once the recording has ended.
    writer: Option<RecordingWriter>,
    files: RecordingFiles,
    /// What of each file is on the disk.
    written: Vec<BagFile>,
    split_bytes: u64,
    /// Time of the message that is being encoded.
    pub(super) at: Stamp,
    payload: Vec<u8>,
    pub(super) counts: Arc<RecordingCounts>,
    ended: Option<String>,
}

impl FileTopics {
    /// Names the topics of a run; no file is begun yet.
    pub fn new(
        robots: &RobotNames,
        description: BTreeMap<String, String>,
        files: RecordingFiles,
        split_bytes: u64,
    ) -> Self {
        let mut topics = Vec::new();
        let mut add = |name: String, message_type, durability| {
            let total = TopicCount { topic: name.clone(), ..Default::default() };
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
            vec![add("/moving_objects".into(), Text::TYPE, Durability::Volatile)],
        ];
        Self {
            topics,
            by_fleet_topic,
            own,
            description,
            writer: None,
            files,
            written: Vec::new(),
            split_bytes,
            at: Stamp(0),
            payload: Vec::new(),
            counts: Arc::default(),
            ended: None,
        }
    }

    /// Begins a file with all topics and the newest latched messages.
    pub fn begin(&mut self) -> Result<(), WriteError> {
        let mut writer = RecordingWriter::new(&self.description)?;
        for topic in &self.topics {
            writer.add_topic(&topic.name, topic.message_type, topic.durability)?;
        }
        for (index, topic) in self.topics.iter().enumerate() {
            if let Some(payload) = &topic.newest {
                writer.write(index, self.at, payload)?;
            }
        }
        match self.files.begin_file() {
            Ok(name) => {
                self.written.push(BagFile { name, ..BagFile::default() });
                self.writer = Some(writer);
            }
            Err(why) => self.end(why.to_string()),
        }
        Ok(())
    }

    /// Writes a message of a topic of the recording's own.
    pub fn record(&mut self, topic: OwnTopic, robot: usize, encode: impl FnOnce(&mut Writer<'_>)) {
        if let Some(index) = self.own[topic as usize].get(robot).copied() {
            self.encode(index, encode);
        }
    }

    /// Writes a message; one of a recording that has ended is dropped.
    fn encode(&mut self, index: TopicIndex, encode: impl FnOnce(&mut Writer<'_>)) {
        let (Some(writer), Some(topic)) = (&mut self.writer, self.topics.get_mut(index)) else {
            return self.counts.add_dropped(1);
        };
        self.payload.clear();
        encode(&mut Writer::new(&mut self.payload));
        if topic.durability == Durability::Latched {
            topic.newest = Some(self.payload.clone());
        }
        match writer.write(index, self.at, &self.payload) {
            // A chunk that is full is on its way at once.
            Ok(()) => {
                let part = writer.take_part();
                self.append(&part);
            }
            Err(why) => {
                self.counts.add_dropped(1);
                self.end(why.to_string());
            }
        }
    }

    /// Appends chunks to the file, and counts their messages.
    fn append(&mut self, part: &Part) {
        if part.bytes.is_empty() {
            return;
        }
        if let Err(why) = self.files.append(&part.bytes) {
            self.counts.add_dropped(part.counts.messages);
            return self.end(why.to_string());
        }
        self.counts.add_messages(part.counts.messages);
        if let Some(file) = self.written.last_mut() {
            file.add(&part.counts);
        }
        for (index, topic) in self.topics.iter_mut().enumerate() {
            let (messages, bytes) = part.counts.of_topic(index);
            topic.total.messages += messages;
            topic.total.bytes += bytes;
        }
    }

    /// Ends the chunk and passes it on to the disk, and begins the next file if this one is large enough.
    pub fn flush(&mut self) {
        self.end_chunk();
        if self.writer.is_some() && self.files.file_bytes() >= self.split_bytes {
            self.finish_file();
            if self.ended.is_none()
                && let Err(why) = self.begin()
            {
                self.end(why.to_string());
            }
        }
    }

    fn end_chunk(&mut self) {
        let Some(writer) = &mut self.writer else { return };
        match writer.flush() {
            Ok(()) => {
                let part = writer.take_part();
                self.append(&part);
            }
            Err(why) => self.end(why.to_string()),
        }
    }

    fn finish_file(&mut self) {
        self.end_chunk();
        let Some(writer) = self.writer.take() else { return };
        let bytes = writer.finish().map_err(|why| why.to_string());
        let appended = bytes.and_then(|bytes| self.files.append(&bytes).map_err(|why| why.to_string()));
        if let Err(why) = appended {
            self.end(why);
        }
    }

    /// Ends the recording; the fleet goes on.
    fn end(&mut self, why: String) {
        if self.ended.is_none() {
            tracing::error!("the recording has ended: {why}; the fleet goes on");
            let waiting = self.writer.take().map_or(0, |writer| writer.waiting_messages());
            self.counts.add_dropped(waiting);
            self.ended = Some(why);
            self.counts.set_ended();
        }
    }

    /// Ends the last file and returns what was recorded.
    pub fn finish(mut self) -> Summary {
        self.finish_file();
        let bag_topic = |topic: &Topic| BagTopic {
            message_type: topic.message_type.to_owned(),
            durability: topic.durability,
            count: topic.total.clone(),
        };
        let written = self.files.finish();
        Summary {
            files: written.files,
            earlier: written.earlier,
            topics: self.topics.iter().map(|topic| topic.total.clone()).collect(),
            dropped: Some(self.counts.dropped()),
            lost: None,
            ended: self.ended,
            bag: Bag { files: self.written, topics: self.topics.iter().map(bag_topic).collect() },
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
