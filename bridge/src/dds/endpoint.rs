//! The ROS 2 endpoint as one DDS participant with one ROS node.

use super::entities::{EndpointError, EntityFactory, RawReader, cannot_create, join_domain, node_name};
use super::graph::NodeGraphAnnouncer;
use super::inputs::{self, InputTopic};
use super::queues::DdsQueues;
use super::relay::TopicRelay;
use super::services::ServiceRelay;
use super::writers::TopicWriters;
use crate::config::{BridgeConfig, DdsConfig};
use crate::fleet_topics::{FleetMessage, FleetPublisher, FleetTopic, RobotTransformPolicy};
use crate::input::InputPurpose;
use crate::relay::{ReceivedMessage, RosCommand, RosEvent};
use crate::transport::Transport;
use futures::StreamExt;
use msg::{Monotonic, RobotId, VelocityCommand};
use ros_messages::RobotNames;
use ros2_client::dds::rustdds::{
    DomainParticipant, DomainParticipantStatusEvent, GUID, RTPSEntity, StatusEvented,
};
use std::cell::RefCell;
use std::rc::Rc;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::task::JoinSet;
use tokio::time::{MissedTickBehavior, interval};

/// How often what could not be written is tried again.
const TICK: Duration = Duration::from_millis(100);
/// Ticks after which the graph is published once more: 1 s. RustDDS may lose a message that is written while a reader is being matched,
/// and the graph changes just when a node of others begins.
const GRAPH_REPEAT_TICKS: u32 = 10;

/// Time in which the disposals of all readers and writers are sent: some hundred datagrams.
const DISPOSAL: Duration = Duration::from_millis(100);

/// What the endpoint has counted since its start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DdsCounters {
    /// Readers of other participants that are matched with the endpoint's writers now.
    pub readers: u32,
    /// Messages written, to readers of all topics together.
    pub sent: u64,
    /// Messages dropped because a reader did not acknowledge, or the bridge or the endpoint did not take them in time.
    pub dropped: u64,
    /// Messages received on all topics and services together.
    pub received: u64,
}

/// The fleet's topics and services on DDS. It belongs to one thread; its methods return without waiting.
pub struct DdsEndpoint {
    // Before the participant, so that readers and writers are dropped first.
    state: RefCell<EndpointState>,
    inputs: Vec<(InputTopic, Rc<RawReader>)>,
    participant: DomainParticipant,
    queues: Arc<DdsQueues>,
    started: Instant,
    /// Time between two repetitions of the transforms map -> odom.
    transform_period: Option<Duration>,
}

struct EndpointState {
    writers: TopicWriters,
    relay: TopicRelay,
    publisher: FleetPublisher,
    services: ServiceRelay,
    graph: Rc<NodeGraphAnnouncer>,
    input_guids: Vec<GUID>,
    /// The writer of another participant that sent the last velocity.
    last_driver: Option<GUID>,
    queues: Arc<DdsQueues>,
    /// Whether readers or writers have come or gone that the graph does not show yet.
    is_graph_due: bool,
    /// Ticks until the graph is published again.
    graph_repeat_ticks: Option<u32>,
}

impl DdsEndpoint {
    /// Joins the domain and creates every topic. Blocks for a moment.
    ///
    /// `is_external`: the robots are ROS's own. Their scans, odometry and time are received, and velocities published.
    /// `queues`: the queues to the bridge.
    pub fn open(
        config: &BridgeConfig,
        robots: impl Into<RobotNames>,
        is_external: bool,
        queues: Arc<DdsQueues>,
    ) -> Result<Self, EndpointError> {
        let robots: RobotNames = robots.into();
        let dds: &DdsConfig = &config.dds;
        let participant = join_domain(dds)?;
        let node = node_name(dds)?;
        let factory = EntityFactory::new(&participant, node.clone(), dds)?;
        let graph = NodeGraphAnnouncer::new(&participant, factory.publisher(), node);
        let graph = graph.map_err(cannot_create("the node graph"))?;
        let inputs = inputs::topics(&robots, dds.velocity, is_external, config.may_ros_drive());
        let writers = TopicWriters::open(&factory, &robots, is_external.then_some(dds.velocity), &inputs)?;
        // After the writers of the same topics, which would wait for them (`EntityFactory::do_own_readers_acknowledge`).
        let inputs = inputs
            .into_iter()
            .map(|input| factory.input_reader(&input).map(|reader| (input, reader)))
            .collect::<Result<Vec<_>, EndpointError>>()?;
        let robot_transforms =
            if is_external { RobotTransformPolicy::ByRobots } else { RobotTransformPolicy::Split };
        let mut publisher = FleetPublisher::new(config.frame_names, &robots, robot_transforms);
        publisher.set_odometry_sigmas(config.odometry_sigmas);
        publisher.set_repetition(dds.repetition());
        let mut state = EndpointState {
            writers,
            relay: TopicRelay::new(&participant, factory, queues.clone()),
            publisher,
            services: ServiceRelay::new(participant.guid(), queues.clone()),
            graph: Rc::new(graph),
            input_guids: inputs.iter().map(|(_, reader)| reader.guid()).collect(),
            last_driver: None,
            queues: queues.clone(),
            is_graph_due: false,
            graph_repeat_ticks: None,
        };
        state.publish_graph();
        Ok(Self {
            state: RefCell::new(state),
            inputs,
            participant,
            queues,
            started: Instant::now(),
            transform_period: dds.transform_period(),
        })
    }

    fn now(&self) -> Monotonic {
        Monotonic(self.started.elapsed().as_nanos() as u64)
    }

    /// Returns what has been counted.
    pub fn counters(&self) -> DdsCounters {
        let state = self.state.borrow();
        let counted = state.writers.counters();
        let (readers, received) = state.relay.counts();
        DdsCounters {
            readers: counted.readers + readers as u32,
            received: counted.received + received + state.services.received(),
            dropped: counted.dropped + self.queues.dropped(),
            ..counted
        }
    }

    /// Receives messages, requests and responses until it is dropped. Runs inside a [`tokio::task::LocalSet`].
    ///
    /// They go to the queues, and the bridge's commands come from there.
    pub async fn serve(self: Rc<Self>) {
        let mut tasks = JoinSet::new();
        self.spawn_input_tasks(&mut tasks);
        let listener = self.participant.status_listener();
        let mut events = listener.as_async_status_stream();
        let mut tick = interval(TICK);
        tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut repeat = self.transform_period.map(interval);
        if let Some(repeat) = &mut repeat {
            repeat.set_missed_tick_behavior(MissedTickBehavior::Delay);
        }
        loop {
            tokio::select! {
                event = events.next() => match event {
                    Some(event) => {
                        self.state.borrow_mut().apply_event(&event, self.now());
                    }
                    None => return,
                },
                command = self.queues.next_command() => self.state.borrow_mut().apply(command, self.now()),
                _ = tick.tick() => self.state.borrow_mut().tick(self.now()),
                () = next_tick(&mut repeat) => self.state.borrow_mut().repeat_transforms(self.now()),
            }
        }
    }

    fn spawn_input_tasks(self: &Rc<Self>, tasks: &mut JoinSet<()>) {
        let own = self.participant.guid().prefix;
        for (input, reader) in &self.inputs {
            let (input, reader) = (input.clone(), reader.clone());
            let endpoint = self.clone();
            tasks.spawn_local(async move {
                let mut samples = std::pin::pin!(reader.as_async_stream());
                while let Some(sample) = samples.next().await {
                    let Ok(sample) = sample else { continue };
                    let writer = sample.writer_guid();
                    if writer.prefix == own {
                        continue;
                    }
                    let message =
                        input.message(sample.into_value().0.to_vec()).with_publisher(writer.to_bytes());
                    endpoint.state.borrow_mut().record(&message, writer);
                    endpoint.queues.send_event(RosEvent::Input(message));
                }
            });
        }
    }

    /// Leaves ROS's graph: tells the other participants that the node, its readers and its writers are gone.
    ///
    /// Call it when nobody serves the endpoint any more. It takes `DISPOSAL`, and half a second more where a participant
    /// does not answer.
    pub async fn leave(self: Rc<Self>) {
        let graph = self.state.borrow().graph.clone();
        graph.leave().await;
        let participant = self.participant.clone();
        drop((graph, self));
        // DDS sends the disposals of readers and writers on a thread of the participant, which ends with it.
        tokio::time::sleep(DISPOSAL).await;
        drop(participant);
    }

    /// Publishes a velocity to a robot of an external world.
    pub fn publish_velocity(&self, robot: RobotId, command: &VelocityCommand) {
        let state = &mut *self.state.borrow_mut();
        state.writers.publish_velocity(robot, command, state.publisher.names(), self.now());
    }
}

impl Transport for DdsEndpoint {
    fn publish(&self, message: FleetMessage<'_>) {
        let state = &mut *self.state.borrow_mut();
        let now = self.now();
        state.publisher.publish(message, &mut state.writers.sink(now));
        if let FleetMessage::PoseEstimate(robot, pose_estimate) = message {
            state.publisher.receive_pose_estimate(robot, pose_estimate, now);
            state.repeat_transforms(now);
        }
    }

    fn has_subscriber(&self, topic: FleetTopic, robot: RobotId) -> bool {
        self.state.borrow().writers.has_subscriber(topic, robot)
    }
}

/// Waits for the next tick of an interval; without one for ever.
async fn next_tick(interval: &mut Option<tokio::time::Interval>) {
    match interval {
        Some(interval) => drop(interval.tick().await),
        None => std::future::pending().await,
    }
}

impl EndpointState {
    /// Publishes which readers and writers the node has, now and once again later.
    fn publish_graph(&mut self) {
        self.announce_graph();
        self.graph_repeat_ticks = Some(GRAPH_REPEAT_TICKS);
    }

    /// Publishes which readers and writers the node has. What fails is tried again at the next tick.
    fn announce_graph(&mut self) {
        let (requests, replies) = self.services.guids();
        let (relay_readers, relay_writers) = self.relay.guids();
        let readers = self.input_guids.iter().copied().chain(requests).chain(relay_readers);
        self.is_graph_due =
            !self.graph.publish(readers, self.writers.guids().chain(replies).chain(relay_writers));
    }

    fn apply_event(&mut self, event: &DomainParticipantStatusEvent, now: Monotonic) {
        self.report_drivers(event);
        self.services.apply_event(event, now);
        let has_changed = self.writers.apply_event(event, now);
        if self.relay.apply_event(event, now) || has_changed {
            self.publish_graph();
        }
    }

    /// Tells the bridge that a robot begins to listen, or that the sender of the last velocity is gone.
    fn report_drivers(&mut self, event: &DomainParticipantStatusEvent) {
        use DomainParticipantStatusEvent::{ParticipantLost, WriterLost};
        if let Some(robot) = self.writers.new_listener(event) {
            self.queues.send_event(RosEvent::RobotListens(robot));
        }
        let is_gone = |driver: &GUID| match event {
            WriterLost { guid, .. } => driver == guid,
            ParticipantLost { id, .. } => driver.prefix == *id,
            _ => false,
        };
        if self.last_driver.take_if(|driver| is_gone(driver)).is_some() {
            self.queues.send_event(RosEvent::DriverLost);
        }
    }

    /// Does what the bridge asks.
    fn apply(&mut self, command: RosCommand, now: Monotonic) {
        if let RosCommand::Publish { topic, payload } = &command {
            match self.writers.publish_state(self.relay.factory(), topic, payload.clone(), now) {
                Ok(false) => {}
                Ok(true) => {
                    self.is_graph_due = true;
                    return;
                }
                Err(why) => return self.relay.report(topic.clone(), &why),
            }
        }
        let topic = command.name().clone();
        if command.is_of_service() {
            match self.services.apply(command, self.relay.factory(), now) {
                Ok(has_changed) => self.is_graph_due |= has_changed,
                Err(why) => self.services.report(topic, &why),
            }
            return;
        }
        match self.relay.apply(command, now) {
            Ok((outcome, has_changed)) => {
                outcome.into_iter().for_each(|outcome| self.writers.count(outcome));
                self.is_graph_due |= has_changed;
            }
            Err(why) => self.relay.report(topic, &why),
        }
    }

    fn record(&mut self, message: &ReceivedMessage, writer: GUID) {
        self.writers.count_received();
        if let InputPurpose::SelectedCommand | InputPurpose::Command(_) = message.input() {
            self.last_driver = Some(writer);
        }
        self.publisher.learn_frames(message.input(), message.payload());
    }

    fn repeat_transforms(&mut self, now: Monotonic) {
        self.publisher.repeat_transforms(now, &mut self.writers.sink(now));
    }

    fn tick(&mut self, now: Monotonic) {
        self.services.tick(now);
        let is_replaced = self.writers.tick(now);
        let has_changed = self.relay.tick(now);
        if std::mem::take(&mut self.is_graph_due) || is_replaced || has_changed {
            self.publish_graph();
        }
        self.graph_repeat_ticks = match self.graph_repeat_ticks {
            Some(0) => {
                self.announce_graph();
                None
            }
            ticks => ticks.map(|ticks| ticks - 1),
        };
        self.publisher.tick(now, &mut self.writers.sink(now));
    }
}
