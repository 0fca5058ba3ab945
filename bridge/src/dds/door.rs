//! The door itself: one participant, one node, the fleet's topics out, commands in.

use super::config::DdsConfig;
use super::graph::Graph;
use super::heard::{Heard, InputTopic, inputs};
use super::raw::{Adapter, Raw};
use super::sender::{Sender, Sent, state_qos, stream_qos};
use crate::config::{BridgeConfig, Permission};
use crate::ros::{FrameNames, write};
use futures::StreamExt;
use msg::{Anchors, RobotId, Stamp, Transforms};
use ros2_client::dds::rustdds::dds::CreateResult;
use ros2_client::dds::rustdds::no_key::SimpleDataReader;
use ros2_client::dds::rustdds::policy::{Durability, History};
use ros2_client::dds::rustdds::{
    DomainParticipant, DomainParticipantBuilder, DomainParticipantStatusEvent, Duration, GUID, Publisher,
    QosPolicies, QosPolicyBuilder, StatusEvented, Topic, TopicKind,
};
use ros2_client::{MessageTypeName, Name, NodeName};
use std::cell::RefCell;
use std::net::Ipv4Addr;
use std::rc::Rc;
use std::time::Instant;
use tokio::task::JoinSet;
use tokio::time::{MissedTickBehavior, interval};

/// How often what could not be sent is tried again, and whether anchors are due is looked at.
const TICK: std::time::Duration = std::time::Duration::from_millis(100);
/// Where each robot's map lies is told again this often, for whoever has just come.
const ANCHORS_PERIOD: std::time::Duration = std::time::Duration::from_secs(1);
/// Messages a writer sends in at least half a minute, at 100, 20, 10 and 1 a second; transforms of a large fleet.
const WINDOW_CLOCK: i32 = 4096;
const WINDOW_TRANSFORMS: i32 = 8192;
const WINDOW_MOTION: i32 = 1024;
const WINDOW_SCANS: i32 = 512;
const WINDOW_STATS: i32 = 64;

/// Why there is no ROS 2 door.
#[derive(Debug, thiserror::Error)]
#[error("the ROS 2 door cannot be opened: {0}")]
pub struct DoorError(String);

/// What the door has counted since its start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DoorCounters {
    /// Readers of other participants that are sent something now.
    pub readers: u32,
    /// Messages written.
    pub sent: u64,
    /// Messages dropped because a reader did not acknowledge.
    pub dropped: u64,
    /// Messages heard.
    pub received: u64,
}

/// Places of the fleet's topics in [`Out`].
pub(super) struct FleetTopics {
    pub scan: Vec<usize>,
    pub odometry: Vec<usize>,
    pub pose: Vec<usize>,
    pub stats: Vec<usize>,
    pub map: Vec<usize>,
    pub transforms: usize,
    pub fixed_transforms: usize,
    pub clock: usize,
    pub merged_map: usize,
    pub merged_map_as_map: usize,
}

type Reader = SimpleDataReader<Raw, Adapter>;

/// The door. One thread; its methods return at once.
pub struct Door {
    // Before the participant, so that readers and writers go first.
    inner: RefCell<Inner>,
    readers: Vec<(Heard, Rc<Reader>)>,
    participant: DomainParticipant,
}

pub(super) struct Inner {
    pub out: Out,
    pub topics: FleetTopics,
    graph: Graph,
    reader_guids: Vec<GUID>,
    pub names: FrameNames,
    pub percent: [i8; 256],
    pub now: Stamp,
    pub anchors: Option<Anchors>,
    anchors_told: Option<Instant>,
    /// Each robot's links that do not move, once seen.
    pub fixed: Vec<Option<Transforms>>,
}

/// All topics out.
pub(super) struct Out {
    senders: Vec<Sender>,
    counted: DoorCounters,
}

impl Out {
    /// Encodes a message if anybody wants it, and sends it.
    pub fn send(&mut self, topic: usize, now: Instant, message: impl FnOnce(&mut crate::cdr::Writer<'_>)) {
        let sent = self.senders[topic].send(now, message);
        self.count(sent);
    }

    /// Sends what another topic has just been given.
    pub fn send_as(&mut self, topic: usize, same_as: usize, now: Instant) {
        if let Some(bytes) = self.senders[same_as].newest() {
            let sent = self.senders[topic].send_bytes(now, bytes);
            self.count(sent);
        }
    }

    fn count(&mut self, sent: Sent) {
        match sent {
            Sent::Yes => self.counted.sent += 1,
            Sent::Dropped => self.counted.dropped += 1,
            Sent::Unwanted => {}
        }
    }
}

/// Makes topics and what hangs on them.
struct Maker<'a> {
    participant: &'a DomainParticipant,
    publisher: Publisher,
    node: NodeName,
    namespace: &'a str,
    senders: Vec<Sender>,
}

impl Maker<'_> {
    /// `class` is `package/Type`.
    fn topic(&self, name: &str, class: &str, qos: &QosPolicies) -> Result<Topic, DoorError> {
        let wrong = |why: String| DoorError(format!("{name}: {why}"));
        let ros_name = Name::parse(name).map_err(|why| wrong(format!("{why:?}")))?;
        let dds_name = ros_name.to_dds_name("rt", &self.node, "");
        let (package, kind) = class.split_once('/').unwrap_or(("", class));
        let dds_type = MessageTypeName::new(package, kind).dds_msg_type();
        let made = self.participant.create_topic(dds_name, dds_type, qos, TopicKind::NoKey);
        made.map_err(|why| wrong(why.to_string()))
    }

    fn sender(&mut self, name: &str, class: &str, qos: QosPolicies) -> Result<usize, DoorError> {
        let topic = self.topic(name, class, &qos)?;
        let sender = Sender::new(&self.publisher, topic, qos).map_err(create_error)?;
        self.senders.push(sender);
        Ok(self.senders.len() - 1)
    }

    fn each(
        &mut self,
        robots: usize,
        name: &str,
        class: &str,
        qos: QosPolicies,
    ) -> Result<Vec<usize>, DoorError> {
        let prefix = self.namespace;
        RobotId::first(robots)
            .map(|robot| self.sender(&format!("{prefix}/{robot}/{name}"), class, qos.clone()))
            .collect()
    }
}

fn create_error(why: ros2_client::dds::rustdds::dds::CreateError) -> DoorError {
    DoorError(why.to_string())
}

impl Door {
    /// Joins the domain and makes every topic. Blocks for a moment.
    pub fn open(config: &BridgeConfig, robot_count: usize) -> Result<Self, DoorError> {
        let dds: &DdsConfig = &config.dds;
        let mut builder = DomainParticipantBuilder::new(dds.domain);
        if dds.loopback_only {
            builder = builder.with_only_networks([Ipv4Addr::LOCALHOST]);
        }
        let participant = builder.build().map_err(create_error)?;
        let publisher =
            participant.create_publisher(&QosPolicyBuilder::new().build()).map_err(create_error)?;
        let space = if dds.namespace.is_empty() { "/" } else { &dds.namespace };
        let node =
            NodeName::new(space, &dds.node).map_err(|why| DoorError(format!("{}: {why:?}", dds.node)))?;
        let graph = Graph::new(&participant, &publisher, node.clone()).map_err(create_error)?;
        let mut maker = Maker {
            participant: &participant,
            publisher,
            node,
            namespace: &dds.namespace,
            senders: Vec::new(),
        };
        let topics = FleetTopics::new(&mut maker, robot_count)?;
        let readers = if may_drive(config) { open_inputs(&maker, robot_count)? } else { Vec::new() };
        let inner = Inner {
            out: Out { senders: maker.senders, counted: DoorCounters::default() },
            topics,
            graph,
            reader_guids: readers.iter().map(|(_, reader)| reader.guid()).collect(),
            names: FrameNames::new(config.frame_names),
            percent: msg::grid::percent_table(),
            now: Stamp(0),
            anchors: None,
            anchors_told: None,
            fixed: vec![None; robot_count],
        };
        inner.tell_graph();
        Ok(Self { inner: RefCell::new(inner), readers, participant })
    }

    /// What has been counted.
    pub fn counters(&self) -> DoorCounters {
        let inner = self.inner.borrow();
        let readers = inner.out.senders.iter().map(Sender::readers).sum::<usize>() as u32;
        DoorCounters { readers, ..inner.out.counted }
    }

    /// Hears, and looks after readers that come and go, until it is dropped. Runs inside a
    /// [`tokio::task::LocalSet`]. What is heard goes to `hear`.
    pub async fn serve(self: Rc<Self>, hear: impl Fn(Heard) + 'static) {
        let hear = Rc::new(hear);
        let mut tasks = JoinSet::new();
        for (heard, reader) in &self.readers {
            let (heard, reader) = (heard.clone(), reader.clone());
            let (door, hear) = (self.clone(), hear.clone());
            tasks.spawn_local(async move {
                let mut samples = std::pin::pin!(reader.as_async_stream());
                while let Some(sample) = samples.next().await {
                    let Ok(sample) = sample else { continue };
                    door.inner.borrow_mut().out.counted.received += 1;
                    let payload = sample.into_value().0.to_vec();
                    hear(Heard { payload, ..heard.clone() });
                }
            });
        }
        let listener = self.participant.status_listener();
        let mut events = listener.as_async_status_stream();
        let mut tick = interval(TICK);
        tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                event = events.next() => match event {
                    Some(event) => self.inner.borrow_mut().noticed(&event, Instant::now()),
                    None => return,
                },
                _ = tick.tick() => self.inner.borrow_mut().tick(Instant::now()),
            }
        }
    }

    pub(super) fn with(&self, change: impl FnOnce(&mut Inner, Instant)) {
        change(&mut self.inner.borrow_mut(), Instant::now());
    }

    pub(super) fn of_robot(&self, robot: RobotId, change: impl FnOnce(&mut Inner, Instant)) {
        let mut inner = self.inner.borrow_mut();
        if robot.index() < inner.fixed.len() {
            change(&mut inner, Instant::now());
        }
    }
}

/// Whose commands are obeyed: this machine's, as on TCP; others' only if anyone's.
fn may_drive(config: &BridgeConfig) -> bool {
    config.drive == Permission::Anyone || (config.dds.loopback_only && config.trust_loopback)
}

fn open_inputs(maker: &Maker<'_>, robots: usize) -> Result<Vec<(Heard, Rc<Reader>)>, DoorError> {
    let unset = QosPolicyBuilder::new().build();
    let subscriber = maker.participant.create_subscriber(&unset).map_err(create_error)?;
    let open = |input: InputTopic| {
        let history = History::KeepLast { depth: 10 };
        let qos = QosPolicyBuilder::new().durability(Durability::Volatile).history(history);
        // Velocities from whoever sends, best-effort senders too; what is said once must arrive.
        let qos = if input.is_stream() { qos.best_effort() } else { qos.reliable(Duration::ZERO) }.build();
        let topic = maker.topic(&format!("{}{}", maker.namespace, input.name), input.class, &qos)?;
        let reader = subscriber.create_simple_datareader_no_key(&topic, Some(qos)).map_err(create_error)?;
        Ok((input.heard, Rc::new(reader)))
    };
    inputs(robots).into_iter().map(open).collect()
}

impl FleetTopics {
    fn new(maker: &mut Maker<'_>, robots: usize) -> Result<Self, DoorError> {
        let grid = "nav_msgs/OccupancyGrid";
        let merged = format!("{}/merged_map", maker.namespace);
        let map = format!("{}/map", maker.namespace);
        let pose = "geometry_msgs/PoseWithCovarianceStamped";
        Ok(Self {
            scan: maker.each(robots, "scan", "sensor_msgs/LaserScan", stream_qos(WINDOW_SCANS))?,
            odometry: maker.each(robots, "odom", "nav_msgs/Odometry", stream_qos(WINDOW_MOTION))?,
            pose: maker.each(robots, "pose", pose, stream_qos(WINDOW_SCANS))?,
            stats: maker.each(
                robots,
                "slam_stats",
                "std_msgs/Float32MultiArray",
                stream_qos(WINDOW_STATS),
            )?,
            map: maker.each(robots, "map", grid, state_qos())?,
            transforms: maker.sender("/tf", "tf2_msgs/TFMessage", stream_qos(WINDOW_TRANSFORMS))?,
            fixed_transforms: maker.sender("/tf_static", "tf2_msgs/TFMessage", state_qos())?,
            clock: maker.sender("/clock", "rosgraph_msgs/Clock", stream_qos(WINDOW_CLOCK))?,
            merged_map: maker.sender(&merged, grid, state_qos())?,
            merged_map_as_map: maker.sender(&map, grid, state_qos())?,
        })
    }
}

impl Inner {
    fn tell_graph(&self) {
        self.graph.tell(self.reader_guids.iter().copied(), self.out.senders.iter().map(Sender::guid));
    }

    /// A reader has come or gone.
    fn noticed(&mut self, event: &DomainParticipantStatusEvent, now: Instant) {
        use DomainParticipantStatusEvent::{ParticipantLost, ReaderLost, RemoteReaderMatched};
        let mut renewed = false;
        let mut look = |result: CreateResult<bool>| renewed |= result.unwrap_or(false);
        match event {
            RemoteReaderMatched { local_writer, remote_reader } => {
                let of = self.out.senders.iter_mut().find(|sender| sender.guid() == *local_writer);
                of.into_iter().for_each(|sender| look(sender.matched(*remote_reader, now)));
            }
            ReaderLost { guid, .. } => {
                self.out.senders.iter_mut().for_each(|sender| look(sender.lost(|reader| reader == guid)));
            }
            ParticipantLost { id, .. } => {
                self.out
                    .senders
                    .iter_mut()
                    .for_each(|sender| look(sender.lost(|reader| reader.prefix == *id)));
            }
            _ => {}
        }
        if renewed {
            self.tell_graph();
        }
    }

    fn tick(&mut self, now: Instant) {
        let mut renewed = false;
        for sender in &mut self.out.senders {
            renewed |= sender.unstick(now).unwrap_or(false);
        }
        if renewed {
            self.tell_graph();
        }
        if self.anchors_told.is_some_and(|told| now >= told + ANCHORS_PERIOD) {
            self.tell_anchors(now);
        }
    }

    pub fn tell_anchors(&mut self, now: Instant) {
        let Some(anchors) = self.anchors.filter(|anchors| anchors.robots.iter().any(|a| a.known == 1)) else {
            return;
        };
        let stamp = Stamp(self.now.0.max(anchors.header.stamp.0));
        self.out.send(self.topics.transforms, now, |to| write::anchors(to, &self.names, stamp, &anchors));
        self.anchors_told = Some(now);
    }
}
