//! The door itself: one participant, one node, the fleet's topics out, commands in.

use super::config::DdsConfig;
use super::graph::Graph;
use super::heard::{self, Heard, InputTopic};
use super::raw::{Adapter, Raw};
use super::sender::{Sender, Sent, state_qos, stream_qos};
use super::servers::Servers;
use crate::config::{BridgeConfig, Permission};
use crate::ros::{FrameNames, write};
use futures::StreamExt;
use msg::{Link, MapTransforms, RobotId, SlamRequest, SlamResponse, Stamp, Transforms, VelocityCommand};
use ros2_client::dds::rustdds::dds::CreateResult;
use ros2_client::dds::rustdds::no_key::{DeserializedCacheChange, SimpleDataReader};
use ros2_client::dds::rustdds::policy::{Durability, History};
use ros2_client::dds::rustdds::{
    DomainParticipant, DomainParticipantBuilder, DomainParticipantStatusEvent, Duration, GUID, Publisher,
    QosPolicies, QosPolicyBuilder, RTPSEntity, StatusEvented, Subscriber, Topic, TopicKind,
};
use ros2_client::{MessageTypeName, Name, NodeName};
use std::cell::RefCell;
use std::net::Ipv4Addr;
use std::rc::Rc;
use std::time::Instant;
use tokio::task::JoinSet;
use tokio::time::{MissedTickBehavior, interval};

/// How often what could not be sent is tried again, and whether map transforms are due is looked at.
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
    /// What robots outside say themselves is not told again: these are empty there.
    pub scan: Vec<usize>,
    pub odometry: Vec<usize>,
    pub fixed_transforms: Option<usize>,
    pub clock: Option<usize>,
    /// To robots outside; else empty.
    pub command: Vec<usize>,
    pub pose: Vec<usize>,
    pub stats: Vec<usize>,
    pub map: Vec<usize>,
    pub transforms: usize,
    pub merged_map: usize,
    pub merged_map_as_map: usize,
    pub merge_edges: usize,
}

type Reader = SimpleDataReader<Raw, Adapter>;

/// The door. One thread; its methods return at once.
pub struct Door {
    // Before the participant, so that readers and writers go first.
    inner: RefCell<Inner>,
    readers: Vec<(Heard, Rc<Reader>)>,
    requests: Vec<Rc<Reader>>,
    participant: DomainParticipant,
}

pub(super) struct Inner {
    pub out: Out,
    pub topics: FleetTopics,
    graph: Graph,
    pub servers: Servers,
    reader_guids: Vec<GUID>,
    pub stamped_commands: bool,
    pub outside: bool,
    pub names: FrameNames,
    pub percent: [i8; 256],
    pub now: Stamp,
    pub map_transforms: Option<MapTransforms>,
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
pub(super) struct Maker<'a> {
    participant: &'a DomainParticipant,
    pub publisher: Publisher,
    node: NodeName,
    pub namespace: &'a str,
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
        self.dds_topic(&dds_name, dds_type, qos)
    }

    /// By its name and type on DDS.
    pub fn dds_topic(&self, name: &str, class: String, qos: &QosPolicies) -> Result<Topic, DoorError> {
        let made = self.participant.create_topic(name.to_owned(), class, qos, TopicKind::NoKey);
        made.map_err(|why| DoorError(format!("{name}: {why}")))
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

pub(super) fn create_error(why: ros2_client::dds::rustdds::dds::CreateError) -> DoorError {
    DoorError(why.to_string())
}

impl Door {
    /// Joins the domain and makes every topic. Blocks for a moment. `outside`: the robots are ROS's own; their
    /// scans, odometry and time are heard, and commands told.
    pub fn open(config: &BridgeConfig, robot_count: usize, outside: bool) -> Result<Self, DoorError> {
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
        let command = if dds.stamped_commands { "geometry_msgs/TwistStamped" } else { "geometry_msgs/Twist" };
        let topics = FleetTopics::new(&mut maker, robot_count, outside.then_some(command))?;
        let subscriber =
            participant.create_subscriber(&QosPolicyBuilder::new().build()).map_err(create_error)?;
        let mut heard = if outside { heard::world(robot_count) } else { Vec::new() };
        let may_drive = may_drive(config);
        if may_drive {
            heard.extend(heard::commands(robot_count, outside));
        }
        let readers = heard
            .into_iter()
            .map(|input| open_input(&maker, &subscriber, input))
            .collect::<Result<Vec<_>, DoorError>>()?;
        // Who may not drive may not reset maps either.
        let servers = Servers::open(&maker, &subscriber, if may_drive { robot_count } else { 0 })?;
        let requests = servers.all.iter().map(|server| server.requests.clone()).collect();
        let inner = Inner {
            out: Out { senders: maker.senders, counted: DoorCounters::default() },
            topics,
            graph,
            servers,
            stamped_commands: dds.stamped_commands,
            outside,
            reader_guids: readers.iter().map(|(_, reader)| reader.guid()).collect(),
            names: FrameNames::new(config.frame_names),
            percent: msg::grid::percent_table(),
            now: Stamp(0),
            map_transforms: None,
            anchors_told: None,
            fixed: vec![None; robot_count],
        };
        inner.tell_graph();
        Ok(Self { inner: RefCell::new(inner), readers, requests, participant })
    }

    /// What has been counted.
    pub fn counters(&self) -> DoorCounters {
        let inner = self.inner.borrow();
        let readers = inner.out.senders.iter().map(Sender::readers).sum::<usize>() as u32;
        DoorCounters { readers, ..inner.out.counted }
    }

    /// Hears, and looks after readers that come and go, until it is dropped. Runs inside a
    /// [`tokio::task::LocalSet`]. What is heard goes to `hear`, what is asked of a robot's SLAM to `ask`, whose
    /// answers come back by [`Door::answered`].
    pub async fn serve(
        self: Rc<Self>,
        hear: impl Fn(Heard) + 'static,
        ask: impl FnMut(RobotId, SlamRequest) + 'static,
    ) {
        let hear = Rc::new(hear);
        let ask = Rc::new(RefCell::new(ask));
        let own = self.participant.guid().prefix;
        let mut tasks = JoinSet::new();
        for (index, requests) in self.requests.iter().enumerate() {
            let (door, requests, ask) = (self.clone(), requests.clone(), ask.clone());
            tasks.spawn_local(async move {
                let mut samples = std::pin::pin!(requests.as_async_stream());
                while let Some(sample) = samples.next().await {
                    let Ok(sample) = sample else { continue };
                    let asked = door.inner.borrow_mut().request(index, sample);
                    if let Some((robot, request)) = asked {
                        (ask.borrow_mut())(robot, request);
                    }
                }
            });
        }
        for (heard, reader) in &self.readers {
            let (heard, reader) = (heard.clone(), reader.clone());
            let (door, hear) = (self.clone(), hear.clone());
            tasks.spawn_local(async move {
                let mut samples = std::pin::pin!(reader.as_async_stream());
                while let Some(sample) = samples.next().await {
                    let Ok(sample) = sample else { continue };
                    if sample.writer_guid().prefix == own {
                        continue;
                    }
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

    /// What a robot's SLAM has answered; `ours` if we have asked. What is to be asked next.
    pub fn answered(&self, robot: RobotId, answer: &SlamResponse, ours: bool) -> Option<SlamRequest> {
        self.inner.borrow_mut().servers.answered(robot, answer, ours)
    }

    /// A velocity for a robot outside.
    pub fn command(&self, robot: RobotId, command: &VelocityCommand) {
        self.with(|door, now| {
            let Some(topic) = door.topics.command.get(robot.index()) else { return };
            let (frame, stamped) = (door.names.link(robot, Link::BaseFootprint), door.stamped_commands);
            door.out.send(*topic, now, |to| {
                if stamped {
                    write::header(to, command.header.stamp, frame);
                }
                to.f64s(&[command.linear_m_s, 0.0, 0.0, 0.0, 0.0, command.angular_rad_s]);
            });
        });
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

fn open_input(
    maker: &Maker<'_>,
    subscriber: &Subscriber,
    input: InputTopic,
) -> Result<(Heard, Rc<Reader>), DoorError> {
    let history = History::KeepLast { depth: 10 };
    let qos = QosPolicyBuilder::new().durability(Durability::Volatile).history(history);
    // Streams from whoever sends, best-effort senders too; what is said once must arrive.
    let qos = if input.is_stream() { qos.best_effort() } else { qos.reliable(Duration::ZERO) }.build();
    let space = if input.is_global() { "" } else { maker.namespace };
    let topic = maker.topic(&format!("{space}{}", input.name), input.class, &qos)?;
    let reader = subscriber.create_simple_datareader_no_key(&topic, Some(qos)).map_err(create_error)?;
    Ok((input.heard, Rc::new(reader)))
}

impl FleetTopics {
    /// `command` is the type of robots' commands, if they are outside.
    fn new(maker: &mut Maker<'_>, robots: usize, command: Option<&str>) -> Result<Self, DoorError> {
        let outside = command.is_some();
        let ours = if outside { 0 } else { robots };
        let motion = stream_qos(WINDOW_MOTION);
        let grid = "nav_msgs/OccupancyGrid";
        let merged = format!("{}/merged_map", maker.namespace);
        let map = format!("{}/map", maker.namespace);
        let edges = format!("{}/merge_edges", maker.namespace);
        let pose = "geometry_msgs/PoseWithCovarianceStamped";
        Ok(Self {
            scan: maker.each(ours, "scan", "sensor_msgs/LaserScan", stream_qos(WINDOW_SCANS))?,
            odometry: maker.each(ours, "odom", "nav_msgs/Odometry", motion.clone())?,
            command: match command {
                Some(class) => maker.each(robots, "cmd_vel", class, motion)?,
                None => Vec::new(),
            },
            pose: maker.each(robots, "pose", pose, stream_qos(WINDOW_SCANS))?,
            stats: maker.each(
                robots,
                "slam_stats",
                "std_msgs/Float32MultiArray",
                stream_qos(WINDOW_STATS),
            )?,
            map: maker.each(robots, "map", grid, state_qos())?,
            transforms: maker.sender("/tf", "tf2_msgs/TFMessage", stream_qos(WINDOW_TRANSFORMS))?,
            fixed_transforms: match outside {
                true => None,
                false => Some(maker.sender("/tf_static", "tf2_msgs/TFMessage", state_qos())?),
            },
            clock: match outside {
                true => None,
                false => Some(maker.sender("/clock", "rosgraph_msgs/Clock", stream_qos(WINDOW_CLOCK))?),
            },
            merged_map: maker.sender(&merged, grid, state_qos())?,
            merged_map_as_map: maker.sender(&map, grid, state_qos())?,
            merge_edges: maker.sender(&edges, "std_msgs/String", state_qos())?,
        })
    }
}

impl Inner {
    fn tell_graph(&self) {
        let (requests, replies) = self.servers.guids();
        let readers = self.reader_guids.iter().copied().chain(requests);
        self.graph.tell(readers, self.out.senders.iter().map(Sender::guid).chain(replies));
    }

    /// A service's request.
    fn request(
        &mut self,
        server: usize,
        sample: DeserializedCacheChange<Raw>,
    ) -> Option<(RobotId, SlamRequest)> {
        self.servers.request(server, sample, Instant::now())
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
        self.servers.tick(now);
        let mut renewed = false;
        for sender in &mut self.out.senders {
            renewed |= sender.unstick(now).unwrap_or(false);
        }
        if renewed {
            self.tell_graph();
        }
        if self.anchors_told.is_some_and(|told| now >= told + ANCHORS_PERIOD) {
            self.send_map_transforms(now);
        }
    }

    pub fn send_map_transforms(&mut self, now: Instant) {
        let Some(map_transforms) =
            self.map_transforms.filter(|map_transforms| map_transforms.robots.iter().any(|a| a.known == 1))
        else {
            return;
        };
        let stamp = Stamp(self.now.0.max(map_transforms.header.stamp.0));
        self.out.send(self.topics.transforms, now, |to| {
            write::map_transforms(to, &self.names, stamp, &map_transforms)
        });
        self.anchors_told = Some(now);
    }
}
