//! The exchange of clients' topics with ROS, without sockets and with a simulated clock: the test is the ROS 2 endpoint.

mod in_memory;

use bridge::command::{Call, Notice, Registration, TopicList, name};
use bridge::frame::Side;
use bridge::relay::{RosCommand, RosEvent, RosGraph, RosTopic};
use bridge::{Bridge, BridgeConfig, ClientId, FleetMessage, Permission};
use msg::Monotonic;
use std::cell::RefCell;
use std::net::SocketAddr;
use std::rc::Rc;

const PATH: &str = "nav_msgs/Path";
const POSE: &str = "geometry_msgs/PoseStamped";
/// A message of any type: the bridge does not look into it.
const MESSAGE: &[u8] = &[0, 1, 0, 0, 1, 2, 3, 4];

/// A bridge of two robots, what it asks of ROS, and its simulated clock.
struct Simulation {
    bridge: Bridge,
    commands: Rc<RefCell<Vec<RosCommand>>>,
    now: Monotonic,
}

impl Simulation {
    fn with(change: impl FnOnce(&mut BridgeConfig)) -> Self {
        let mut config = BridgeConfig::default();
        change(&mut config);
        let bridge = Bridge::new(config, 2, |_, _| {}).unwrap();
        let commands = Rc::new(RefCell::new(Vec::new()));
        let sink = commands.clone();
        bridge.on_ros_command(move |command| sink.borrow_mut().push(command));
        commands.borrow_mut().clear();
        Self { bridge, commands, now: Monotonic(0) }
    }

    fn new() -> Self {
        Self::with(|_| {})
    }

    fn advance_s(&mut self, seconds: u64) {
        for _ in 0..4 * seconds {
            self.now = Monotonic(self.now.0 + 250_000_000);
            self.bridge.tick(self.now);
        }
    }

    /// Connects a client on this machine, which has every permission.
    fn connect(&self) -> ClientId {
        self.connect_from([127, 0, 0, 1])
    }

    fn connect_from(&self, address: [u8; 4]) -> ClientId {
        let client = self.bridge.connect(SocketAddr::from((address, 5000))).unwrap();
        self.frames(client);
        client
    }

    fn receive(&self, client: ClientId, bytes: &[u8]) {
        in_memory::receive(&self.bridge, client, bytes, self.now);
    }

    fn register(&self, client: ClientId, command: &str, topic: &str, message_type: &str) {
        let (topic, message_name) = (topic.to_owned(), message_type.to_owned());
        let registration = Registration { topic, message_name, queue_size: 10, latch: false };
        let mut bytes = Vec::new();
        Side::Client.write_command(&mut bytes, command, &registration);
        self.receive(client, &bytes);
    }

    fn send(&self, client: ClientId, topic: &str, payload: &[u8]) {
        let mut bytes = Vec::new();
        Side::Client.write(&mut bytes, topic, payload);
        self.receive(client, &bytes);
    }

    fn on_ros_event(&self, event: RosEvent) {
        self.bridge.receive_ros(event, self.now);
    }

    /// Takes the frames that wait for a client: name and payload.
    fn frames(&self, client: ClientId) -> Vec<(String, Vec<u8>)> {
        in_memory::take_frames(&self.bridge, client)
    }

    /// Takes the frames that wait for a client; returns the texts for a person.
    fn notices(&self, client: ClientId) -> Vec<String> {
        let frames = self.frames(client);
        let notices = frames.iter().filter(|(of, _)| [name::WARN, name::ERROR].contains(&of.as_str()));
        notices.map(|(_, payload)| serde_json::from_slice::<Notice>(payload).unwrap().text).collect()
    }

    /// Takes what was asked of ROS about topics, as text without the messages' bytes.
    fn asked(&self) -> Vec<String> {
        let text = |command: RosCommand| match command {
            RosCommand::Subscribe { topic, message_type } => format!("subscribe {topic} {message_type}"),
            RosCommand::Unsubscribe { topic } => format!("unsubscribe {topic}"),
            RosCommand::Advertise { topic, message_type, latch: false } => {
                format!("advertise {topic} {message_type}")
            }
            RosCommand::Advertise { topic, message_type, latch: true } => {
                format!("advertise {topic} {message_type} latched")
            }
            RosCommand::Unadvertise { topic } => format!("unadvertise {topic}"),
            RosCommand::Publish { topic, payload } => format!("publish {topic} {}", payload.len()),
            other => format!("{other:?}"),
        };
        let mut commands = self.commands.borrow_mut();
        commands.drain(..).filter(|command| !command.is_of_service()).map(text).collect()
    }
}

fn message(topic: &str) -> RosEvent {
    RosEvent::Message { topic: topic.into(), payload: MESSAGE.to_vec().into() }
}

/// A graph in which a node publishes one topic.
fn graph(topic: &str, message_type: &str, is_latched: bool) -> RosEvent {
    let known = RosTopic { published: vec![message_type.into()], is_latched, ..RosTopic::default() };
    RosEvent::Graph(RosGraph { topics: [(topic.to_owned(), known)].into(), ..RosGraph::default() })
}

#[test]
fn a_topic_of_ros_reaches_its_subscribers_until_the_last_leaves() {
    let simulation = Simulation::new();
    let (one, two) = (simulation.connect(), simulation.connect());
    simulation.register(one, name::SUBSCRIBE, "/plan", PATH);
    simulation.register(two, name::SUBSCRIBE, "/plan", PATH);
    assert_eq!(simulation.asked(), ["subscribe /plan nav_msgs/Path"]);
    simulation.on_ros_event(message("/plan"));
    for client in [one, two] {
        assert_eq!(simulation.frames(client), [("/plan".to_owned(), MESSAGE.to_vec())]);
    }
    assert!(simulation.asked().is_empty(), "what comes from ROS does not go back");
    simulation.register(one, name::REMOVE_SUBSCRIBER, "/plan", PATH);
    assert!(simulation.asked().is_empty());
    simulation.bridge.disconnect(two);
    assert_eq!(simulation.asked(), ["unsubscribe /plan"]);
}

#[test]
fn a_clients_message_reaches_ros_and_clients() {
    let simulation = Simulation::new();
    let (driver, other) = (simulation.connect(), simulation.connect());
    simulation.register(other, name::SUBSCRIBE, "/goal_pose", POSE);
    simulation.register(driver, name::PUBLISH, "/goal_pose", POSE);
    simulation.send(driver, "/goal_pose", MESSAGE);
    let expected = [
        "subscribe /goal_pose geometry_msgs/PoseStamped",
        "advertise /goal_pose geometry_msgs/PoseStamped",
        "publish /goal_pose 8",
    ];
    assert_eq!(simulation.asked(), expected);
    assert_eq!(simulation.frames(other), [("/goal_pose".to_owned(), MESSAGE.to_vec())]);
    simulation.bridge.disconnect(driver);
    assert_eq!(simulation.asked(), ["unadvertise /goal_pose"]);
}

#[test]
fn only_who_may_drive_publishes_in_ros_but_on_open_topics() {
    let simulation = Simulation::with(|config| {
        config.drive = Permission::Allowed;
        config.open_topics = vec!["chat".into()];
    });
    let guest = simulation.connect_from([192, 168, 1, 20]);
    simulation.register(guest, name::PUBLISH, "/goal_pose", POSE);
    simulation.register(guest, name::PUBLISH, "/chat", "std_msgs/String");
    assert_eq!(simulation.asked(), ["advertise /chat std_msgs/String"]);
    for _ in 0..3 {
        simulation.send(guest, "/goal_pose", MESSAGE);
        simulation.send(guest, "/chat", MESSAGE);
    }
    assert_eq!(simulation.asked(), ["publish /chat 8"; 3]);
    let notices = simulation.notices(guest);
    assert_eq!(notices.len(), 1, "said once: {notices:?}");
    assert!(notices[0].contains("mr-slam allow 192.168.1.20"), "{notices:?}");
    simulation.bridge.allow([192, 168, 1, 20].into()).unwrap();
    simulation.send(guest, "/goal_pose", MESSAGE);
    assert_eq!(
        simulation.asked(),
        ["advertise /goal_pose geometry_msgs/PoseStamped", "publish /goal_pose 8"]
    );
    simulation.bridge.deny([192, 168, 1, 20].into()).unwrap();
    simulation.send(guest, "/goal_pose", MESSAGE);
    assert!(simulation.asked().is_empty());
}

#[test]
fn velocities_for_the_fleets_robots_never_go_around_the_bridge() {
    let simulation = Simulation::new();
    let client = simulation.connect();
    let twist = "geometry_msgs/Twist";
    for topic in ["/cmd_vel_nav", "/robot1/cmd_vel_unstamped", "/robot2/wheels", "/cmd_vel_1"] {
        simulation.register(client, name::PUBLISH, topic, twist);
        simulation.send(client, topic, MESSAGE);
        assert!(simulation.asked().is_empty(), "{topic}");
        assert_eq!(simulation.notices(client).len(), 1, "{topic}");
    }
    simulation.register(client, name::PUBLISH, "/turtle1/cmd_vel", twist);
    assert_eq!(simulation.asked(), ["advertise /turtle1/cmd_vel geometry_msgs/Twist"]);
}

#[test]
fn a_subscription_to_what_nobody_publishes_is_told_once() {
    let mut simulation = Simulation::new();
    let client = simulation.connect();
    simulation.register(client, name::SUBSCRIBE, "/plan", PATH);
    simulation.register(client, name::SUBSCRIBE, "/scan_matched", PATH);
    simulation.register(client, name::SUBSCRIBE, "/robot1/map", "nav_msgs/OccupancyGrid");
    simulation.on_ros_event(graph("/scan_matched", PATH, false));
    simulation.advance_s(2);
    assert!(simulation.notices(client).is_empty(), "publishers have time to appear");
    simulation.advance_s(10);
    let notices = simulation.notices(client);
    assert_eq!(notices.len(), 1, "{notices:?}");
    assert!(notices[0].contains("nobody publishes '/plan'"), "{notices:?}");
    simulation.on_ros_event(message("/plan"));
    assert_eq!(simulation.frames(client), [("/plan".to_owned(), MESSAGE.to_vec())]);
}

#[test]
fn another_type_in_ros_is_told_to_who_registers_and_to_who_has() {
    let simulation = Simulation::new();
    let client = simulation.connect();
    simulation.register(client, name::SUBSCRIBE, "/plan", PATH);
    for _ in 0..3 {
        simulation.on_ros_event(graph("/plan", POSE, false));
    }
    let notices = simulation.notices(client);
    assert_eq!(notices.len(), 1, "{notices:?}");
    assert!(
        notices[0].contains("'/plan' is geometry_msgs/PoseStamped in ROS, not nav_msgs/Path"),
        "{notices:?}"
    );
    let late = simulation.connect();
    simulation.register(late, name::SUBSCRIBE, "/plan", PATH);
    assert_eq!(simulation.notices(late).len(), 1);
    simulation.on_ros_event(RosEvent::OtherEncoding { topic: "/plan".into() });
    assert_eq!(simulation.bridge.counters().refused, 1);
}

#[test]
fn types_of_unknown_packages_are_accepted_if_ros_has_the_topic_and_topics_of_ros_are_listed() {
    let simulation = Simulation::new();
    let client = simulation.connect();
    simulation.register(client, name::SUBSCRIBE, "/odd", "odd_msgs/Odd");
    assert_eq!(simulation.notices(client).len(), 1, "an unknown type");
    simulation.on_ros_event(graph("/odd", "odd_msgs/Odd", false));
    simulation.register(client, name::SUBSCRIBE, "/odd", "odd_msgs/Odd");
    assert_eq!(simulation.asked(), ["subscribe /odd odd_msgs/Odd"]);
    let mut bytes = Vec::new();
    Side::Client.write_command(&mut bytes, name::TOPIC_LIST, &serde_json::json!({}));
    simulation.receive(client, &bytes);
    let frames = simulation.frames(client);
    let (_, payload) = frames.iter().find(|(of, _)| of == name::TOPIC_LIST).unwrap();
    let list: TopicList = serde_json::from_slice(payload).unwrap();
    let at = list.topics.iter().position(|topic| topic == "/odd").unwrap();
    assert_eq!(list.types[at], "odd_msgs/Odd");
}

#[test]
fn late_subscribers_get_what_ros_keeps_for_late_subscribers() {
    let simulation = Simulation::new();
    let (early, late) = (simulation.connect(), simulation.connect());
    simulation.register(early, name::SUBSCRIBE, "/robot_description", "std_msgs/String");
    simulation.on_ros_event(graph("/robot_description", "std_msgs/String", true));
    simulation.on_ros_event(message("/robot_description"));
    simulation.register(late, name::SUBSCRIBE, "/robot_description", "std_msgs/String");
    assert_eq!(simulation.frames(late), [("/robot_description".to_owned(), MESSAGE.to_vec())]);
}

#[test]
fn the_number_of_relayed_topics_is_limited() {
    let simulation = Simulation::with(|config| config.dds.relayed_topics_max = 2);
    let client = simulation.connect();
    for topic in ["/a", "/b", "/c"] {
        simulation.register(client, name::SUBSCRIBE, topic, PATH);
    }
    assert_eq!(simulation.asked().len(), 2);
    let notices = simulation.notices(client);
    assert_eq!(notices.len(), 1);
    assert!(notices[0].contains("relayed_topics_max"), "{notices:?}");
    simulation.register(client, name::REMOVE_SUBSCRIBER, "/a", PATH);
    simulation.register(client, name::SUBSCRIBE, "/d", PATH);
    assert_eq!(simulation.asked(), ["unsubscribe /a", "subscribe /d nav_msgs/Path"]);
}

#[test]
fn fixed_transforms_are_latched_on_tcp() {
    let simulation = Simulation::new();
    let transforms = msg::Transforms::default();
    simulation.bridge.publish(FleetMessage::Transforms(msg::RobotId::new(1).unwrap(), &transforms));
    let client = simulation.connect();
    simulation.register(client, name::SUBSCRIBE, "/tf_static", "tf2_msgs/TFMessage");
    let frames = simulation.frames(client);
    assert_eq!(frames.len(), 1);
    assert_eq!(frames[0].0, "/tf_static");
}

#[test]
fn a_failed_call_never_reads_as_success() {
    let simulation = Simulation::new();
    let client = simulation.connect();
    let call = |service: &str| {
        let mut bytes = Vec::new();
        Side::Client.write_command(&mut bytes, name::REQUEST, &Call { srv_id: 101 });
        Side::Client.write(&mut bytes, service, &[0, 1, 0, 0, 0]);
        simulation.receive(client, &bytes);
        let frames = simulation.frames(client);
        assert!(frames.iter().any(|(of, _)| of == name::ERROR), "{service}");
        frames.iter().filter(|(of, _)| of == service).map(|(_, payload)| payload.clone()).collect::<Vec<_>>()
    };
    for (service, service_type) in [("/clear", "std_srvs/Empty"), ("/own", "nav2_msgs/ClearEntireCostmap")] {
        simulation.register(client, name::ROS_SERVICE, service, service_type);
        assert!(call(service).is_empty(), "{service}: an empty response would read as success");
    }
    simulation.register(client, name::ROS_SERVICE, "/trigger", "std_srvs/Trigger");
    assert_eq!(call("/trigger"), [[0, 1, 0, 0]], "no std_srvs/Trigger: the caller stops waiting");
}
