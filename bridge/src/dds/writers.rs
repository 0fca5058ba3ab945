//! The writers of all topics that the fleet publishes on DDS.

use super::endpoint::DdsCounters;
use super::entities::{EndpointError, EntityFactory};
use super::inputs::InputTopic;
use super::topic_writer::{
    self, TopicWriter, WriteOutcome, latched_qos, latched_qos_beside_own_reader, stream_qos,
};
use crate::config::VelocityMessage;
use crate::fleet_topics::{Delivery, FleetTopic, OUTGOING_TOPICS, OutgoingTopic, TopicSink};
use msg::{Monotonic, RobotFrame, RobotId, VelocityCommand};
use ros_messages::cdr::Writer;
use ros_messages::{FrameNames, Message, RobotNames, Twist, TwistStamped, write};
use ros2_client::dds::rustdds::bytes::Bytes;
use ros2_client::dds::rustdds::{DomainParticipantStatusEvent, GUID};

/// Velocities that a writer keeps for a slow robot: half a minute at 20 Hz.
const VELOCITY_DEPTH: usize = 1024;

/// All writers of the fleet's topics.
pub struct TopicWriters {
    writers: Vec<TopicWriter>,
    /// Indices of writers, by row of [`OUTGOING_TOPICS`], then by robot; empty if the topic is not on DDS.
    by_topic: [Vec<usize>; OUTGOING_TOPICS.len()],
    /// Indices of the writers of `/robotN/cmd_vel`, by robot, and whether each writes TwistStamped.
    velocity: Vec<Vec<(usize, bool)>>,
    counted: DdsCounters,
}

impl TopicWriters {
    /// Creates the writers of a fleet. `velocity`: the robots are external, and get velocities of this type. `inputs`: the topics
    /// that the endpoint reads.
    pub fn open(
        factory: &EntityFactory,
        robots: &RobotNames,
        velocity: Option<VelocityMessage>,
        inputs: &[InputTopic],
    ) -> Result<Self, EndpointError> {
        let mut all = Self {
            writers: Vec::new(),
            by_topic: [const { Vec::new() }; OUTGOING_TOPICS.len()],
            velocity: Vec::new(),
            counted: DdsCounters::default(),
        };
        let is_external = velocity.is_some();
        for row in OUTGOING_TOPICS.iter().filter(|row| row.is_on_dds(is_external)) {
            all.by_topic[row.topic as usize] = all.open_topic(factory, row, robots, inputs)?;
        }
        let Some(velocity) = velocity else { return Ok(all) };
        for robot in robots.robots() {
            let name = format!("{}{}", factory.namespace(), robots.topic(robot, "cmd_vel"));
            let mut of_robot = Vec::new();
            for is_stamped in velocity.is_stamped() {
                let message_type = if *is_stamped { TwistStamped::TYPE } else { Twist::TYPE };
                of_robot.push((all.writers.len(), *is_stamped));
                all.writers.push(factory.topic_writer(&name, message_type, stream_qos(VELOCITY_DEPTH))?);
            }
            all.velocity.push(of_robot);
        }
        Ok(all)
    }

    fn open_topic(
        &mut self,
        factory: &EntityFactory,
        row: &OutgoingTopic,
        robots: &RobotNames,
        inputs: &[InputTopic],
    ) -> Result<Vec<usize>, EndpointError> {
        // The bridge's states have no channel: their writers are opened when the first comes.
        let Some(delivery) = row.dds.filter(|_| !row.channel.is_empty()) else { return Ok(Vec::new()) };
        let names = row.names(robots);
        let qos = match delivery {
            Delivery::Latched if inputs.iter().any(|input| names.contains(&input.name)) => {
                latched_qos_beside_own_reader()
            }
            Delivery::Latched => latched_qos(),
            stream => stream_qos(stream.depth(robots.count())),
        };
        let namespace = if row.is_global() { "" } else { factory.namespace() };
        let mut indices = Vec::new();
        for name in names {
            let name = format!("{namespace}{name}");
            indices.push(self.writers.len());
            self.writers.push(factory.topic_writer(&name, row.message_type, qos.clone())?);
        }
        Ok(indices)
    }

    /// Returns the counters.
    pub fn counters(&self) -> DdsCounters {
        let readers = self.writers.iter().map(TopicWriter::readers).sum::<usize>() as u32;
        DdsCounters { readers, ..self.counted }
    }

    /// Counts a message from another participant.
    pub fn count_received(&mut self) {
        self.counted.received += 1;
    }

    /// Returns whether another participant reads a robot's topic.
    pub fn has_subscriber(&self, topic: FleetTopic, robot: RobotId) -> bool {
        let index = self.by_topic[topic as usize].get(robot.index());
        index.is_some_and(|index| self.writers[*index].readers() > 0)
    }

    /// Returns the writers' identifiers.
    pub fn guids(&self) -> impl Iterator<Item = GUID> + '_ {
        self.writers.iter().filter_map(TopicWriter::guid)
    }

    /// Publishes a velocity to a robot of an external world.
    pub fn publish_velocity(
        &mut self,
        robot: RobotId,
        command: &VelocityCommand,
        names: &FrameNames,
        now: Monotonic,
    ) {
        let writers = self.velocity.get(robot.index()).map_or(0, Vec::len);
        for writer in 0..writers {
            let (index, is_stamped) = self.velocity[robot.index()][writer];
            self.write(index, now, |to| {
                if is_stamped {
                    write::header(
                        to,
                        command.header.stamp,
                        names.robot_frame(robot, RobotFrame::BaseFootprint),
                    );
                }
                to.f64s(&[command.linear_m_s, 0.0, 0.0, 0.0, 0.0, command.angular_rad_s]);
            });
        }
    }

    /// Publishes a state that the bridge has encoded; returns whether the topic is one of the fleet's states.
    ///
    /// The first state opens its writer.
    pub fn publish_state(
        &mut self,
        factory: &EntityFactory,
        name: &str,
        payload: Bytes,
        now: Monotonic,
    ) -> Result<bool, EndpointError> {
        let states = [FleetTopic::SelectedRobot, FleetTopic::EmergencyStop];
        let Some(topic) = states.into_iter().find(|topic| topic.row().name == name) else { return Ok(false) };
        if self.by_topic[topic as usize].is_empty() {
            let name = format!("{}{name}", factory.namespace());
            // Both are read as commands.
            let qos = latched_qos_beside_own_reader();
            let writer = factory.topic_writer(&name, topic.row().message_type, qos)?;
            self.by_topic[topic as usize].push(self.writers.len());
            self.writers.push(writer);
        }
        for index in self.by_topic[topic as usize].clone() {
            let outcome = self.writers[index].write_bytes(now, payload.clone());
            self.count(outcome);
        }
        Ok(true)
    }

    /// Returns the robot whose velocities a reader of another participant begins to receive by this event.
    pub fn new_listener(&self, event: &DomainParticipantStatusEvent) -> Option<RobotId> {
        let DomainParticipantStatusEvent::RemoteReaderMatched { local_writer, .. } = event else {
            return None;
        };
        let is_matched = |(index, _): &(usize, bool)| self.writers[*index].guid() == Some(*local_writer);
        let robot = self.velocity.iter().position(|writers| writers.iter().any(is_matched))?;
        RobotId::new(robot + 1)
    }

    fn write(&mut self, index: usize, now: Monotonic, encode: impl FnOnce(&mut Writer<'_>)) {
        let outcome = self.writers[index].write(now, encode);
        self.count(outcome);
    }

    /// Counts what happened to a message.
    pub fn count(&mut self, outcome: WriteOutcome) {
        match outcome {
            WriteOutcome::Written => self.counted.sent += 1,
            WriteOutcome::Dropped => self.counted.dropped += 1,
            WriteOutcome::NoReader => {}
        }
    }

    /// Handles a reader of another participant that has come or gone; returns whether a writer was replaced.
    pub fn apply_event(&mut self, event: &DomainParticipantStatusEvent, now: Monotonic) -> bool {
        topic_writer::apply_event(self.writers.iter_mut(), event, now)
    }

    /// Retries what could not be written; returns whether a writer was replaced.
    pub fn tick(&mut self, now: Monotonic) -> bool {
        let mut replaced = false;
        for writer in &mut self.writers {
            replaced |= writer.retry(now).unwrap_or(false);
        }
        replaced
    }

    /// Returns the writers as a sink of the fleet's messages.
    pub fn sink(&mut self, now: Monotonic) -> DdsSink<'_> {
        DdsSink { writers: self, now }
    }
}

/// The writers at one moment.
pub struct DdsSink<'a> {
    writers: &'a mut TopicWriters,
    now: Monotonic,
}

impl TopicSink for DdsSink<'_> {
    fn send(&mut self, topic: FleetTopic, robot: Option<RobotId>, encode: impl FnOnce(&mut Writer<'_>)) {
        let index = self.writers.by_topic[topic as usize].get(robot.map_or(0, RobotId::index)).copied();
        if let Some(index) = index {
            self.writers.write(index, self.now, encode);
        }
    }

    fn send_again(&mut self, topic: FleetTopic, newest_of: FleetTopic) {
        let index = |topic: FleetTopic| self.writers.by_topic[topic as usize].first().copied();
        let (Some(to), Some(from)) = (index(topic), index(newest_of)) else { return };
        if let Some(bytes) = self.writers.writers[from].newest() {
            let outcome = self.writers.writers[to].write_bytes(self.now, bytes);
            self.writers.count(outcome);
        }
    }

    fn is_subscribed(&self, topic: FleetTopic) -> bool {
        let of_topic = &self.writers.by_topic[topic as usize];
        of_topic.iter().any(|index| self.writers.writers[*index].readers() > 0)
    }
}
