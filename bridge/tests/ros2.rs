//! The ROS 2 endpoint against another implementation's node on loopback: ros2-client's own readers and writers.
//! `.ci/interop` tests it against ROS 2 itself.

mod watched;

use bridge::dds::{DdsConfig, DdsEndpoint, DdsQueues};
use bridge::world::{ExternalWorld, WorldMessage};
use bridge::{Bridge, BridgeConfig, FleetMessage, Transport, process_clock};
use futures::StreamExt;
use msg::{
    GridHeader, GridView, Header, Monotonic, Odometry, Pose2, RobotId, SlamOutcome, SlamRequest,
    SlamRequestKind, SlamResponse, Stamp, VelocityCommand,
};
use ros2_client::builtin_topics::ros_discovery;
use ros2_client::dds::rustdds::{self, DomainParticipantBuilder, QosPolicyBuilder, TopicKind, policy};
use ros2_client::dds::{Node, Subscription};
use ros2_client::entities_info::ParticipantEntitiesInfo;
use ros2_client::qos::{Durability, QosProfile};
use ros2_client::{Message, MessageTypeName, Name, ServiceMapping, ServiceTypeName};
use serde::{Deserialize, Serialize};
use std::cell::RefCell;
use std::net::Ipv4Addr;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::spawn_local;
use watched::{connect, node, run};

/// Whatever else is on its way arrives within this time.
const QUIET: Duration = Duration::from_millis(400);
/// Period of what a test sends or looks at.
const PERIOD: Duration = Duration::from_millis(20);

#[derive(Serialize, Deserialize)]
struct Grid {
    stamp: (i32, u32),
    frame_id: String,
    loaded: (i32, u32),
    resolution: f32,
    width: u32,
    height: u32,
    origin: [f64; 7],
    data: Vec<i8>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct Twist([f64; 6]);

/// A domain that no other test uses at the same time, in all probability: ports belong to the machine.
fn config(offset: u32) -> BridgeConfig {
    let domain = (1 + (std::process::id() * 7 + offset) % 100) as u16;
    BridgeConfig {
        dds: DdsConfig { enabled: true, domain: domain.into(), ..DdsConfig::default() },
        ..BridgeConfig::default()
    }
}

/// Creates a node while the endpoint goes on: on one thread it could not react to the discovery of the node's readers.
async fn node_elsewhere(config: &BridgeConfig) -> Node {
    let config = config.clone();
    tokio::task::spawn_blocking(move || node(&config)).await.unwrap()
}

fn maps(node: &mut Node) -> Subscription<Grid> {
    maps_on(node, "/robot1/map")
}

fn maps_on(node: &mut Node, name: &str) -> Subscription<Grid> {
    let qos = QosProfile::publisher_default().durability(Durability::TransientLocal);
    let name = Name::parse(name).unwrap();
    let topic = node.create_topic(&name, MessageTypeName::new("nav_msgs", "OccupancyGrid"), &qos).unwrap();
    node.create_subscription(&topic, None).unwrap()
}

fn robot() -> RobotId {
    RobotId::new(1).unwrap()
}

fn send_map(endpoint: &DdsEndpoint, second: i64, side: u32) {
    let header = Header { stamp: Stamp(second * 1_000_000_000), ..Header::default() };
    let (origin, resolution_m) = (Pose2::IDENTITY, 0.05);
    let header =
        GridHeader { header, origin, resolution_m, width: side, height: side, ..GridHeader::default() };
    let cells = vec![second as i8; (side * side) as usize];
    endpoint.publish(FleetMessage::Map(robot(), GridView::new(&header, &cells).unwrap()));
}

/// Returns the stamps that arrive until nothing does for [`QUIET`]; waits for the first.
async fn stamps(subscription: &Subscription<Grid>) -> Vec<i32> {
    let mut stream = std::pin::pin!(subscription.async_stream());
    let mut stamps = vec![];
    while let Some(grid) = match stamps.is_empty() {
        true => stream.next().await,
        false => tokio::time::timeout(QUIET, stream.next()).await.unwrap_or(None),
    } {
        let (grid, _) = grid.unwrap();
        assert_eq!(grid.data.len(), (grid.width * grid.height) as usize);
        assert_eq!(grid.frame_id, "map_1");
        stamps.push(grid.stamp.0);
    }
    stamps
}

#[test]
fn a_late_reader_gets_the_newest_map_once() {
    run(async {
        let config = config(0);
        let endpoint = Rc::new(DdsEndpoint::open(&config, 1, false, Arc::default()).unwrap());
        spawn_local(endpoint.clone().serve());
        (1..=20).for_each(|second| send_map(&endpoint, second, 50));
        let mut other = node_elsewhere(&config).await;
        let first = maps(&mut other);
        assert_eq!(stamps(&first).await, [20]);
        // The reader now gets every map, at least the last one.
        for second in 21..=24 {
            send_map(&endpoint, second, 50);
            tokio::task::yield_now().await;
        }
        assert_eq!(stamps(&first).await.last(), Some(&24));
        let mut another = node_elsewhere(&config).await;
        let late = maps(&mut another);
        assert_eq!(stamps(&late).await, [24]);
    });
}

#[test]
fn topics_are_in_the_configured_namespace() {
    run(async {
        let mut config = config(25);
        config.dds.namespace = "/lab/floor_2".into();
        let endpoint = Rc::new(DdsEndpoint::open(&config, 1, false, Arc::default()).unwrap());
        spawn_local(endpoint.clone().serve());
        send_map(&endpoint, 7, 20);
        let mut other = node(&config);
        let there = maps_on(&mut other, "/lab/floor_2/robot1/map");
        assert_eq!(stamps(&there).await, [7]);
    });
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct SaveMapRequest {
    /// A std_msgs/String.
    name: (String,),
}
impl Message for SaveMapRequest {}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct SaveMapResponse {
    result: u8,
}
impl Message for SaveMapResponse {}

#[test]
fn slam_toolboxs_save_map_reaches_slam_and_is_answered() {
    run(async {
        let config = config(75);
        let queues = Arc::new(DdsQueues::default());
        let endpoint = Rc::new(DdsEndpoint::open(&config, 1, false, queues.clone()).unwrap());
        let bridge = Rc::new(Bridge::new(config.clone(), 1, |_, _| {}).unwrap());
        // SLAM saves the map that is named `monday` only.
        let answering = Rc::downgrade(&bridge);
        bridge.on_slam_request(move |robot: RobotId, request: SlamRequest| {
            assert_eq!(request.kind, SlamRequestKind::SaveMap as u32);
            let done = request.text.as_str() == "monday";
            let outcome = if done { SlamOutcome::Done } else { SlamOutcome::Refused } as u32;
            let answer = SlamResponse { id: request.id, outcome, ..SlamResponse::default() };
            let answering = answering.clone();
            spawn_local(async move {
                answering.upgrade().map(|bridge| bridge.receive_slam_response(robot, &answer, true))
            });
        });
        connect(&bridge, endpoint.clone(), queues);
        let mut other = node(&config);
        let client = other
            .create_client::<SaveMapRequest, SaveMapResponse>(
                ServiceMapping::Enhanced,
                &Name::parse("/robot1/slam_toolbox/save_map").unwrap(),
                &ServiceTypeName::new("slam_toolbox", "SaveMap"),
                QosProfile::publisher_default(),
                QosProfile::subscription_default(),
            )
            .unwrap();
        for (name, result) in [("monday", 0), ("sunday", 255), ("../monday", 255)] {
            // Requests are lost until discovery is complete.
            let answer = loop {
                client.send_request(SaveMapRequest { name: (name.into(),) }).unwrap();
                tokio::time::sleep(Duration::from_millis(100)).await;
                if let Ok(Some((_, answer))) = client.receive_response() {
                    break answer;
                }
            };
            assert_eq!(answer.result, result, "{name}");
            tokio::time::sleep(QUIET).await;
            while let Ok(Some(_)) = client.receive_response() {}
        }
    });
}

#[test]
fn a_velocity_reaches_the_robot_and_invalid_bytes_do_not() {
    run(async {
        let config = config(50);
        let queues = Arc::new(DdsQueues::default());
        let endpoint = Rc::new(DdsEndpoint::open(&config, 1, false, queues.clone()).unwrap());
        let commands = Rc::new(RefCell::new(Vec::<VelocityCommand>::new()));
        let taken = commands.clone();
        let bridge = Rc::new(
            Bridge::new(config.clone(), 1, move |_, command| taken.borrow_mut().push(command)).unwrap(),
        );
        let receiver = bridge.clone();
        spawn_local(endpoint.clone().serve());
        spawn_local(async move {
            loop {
                receiver.receive_ros(queues.next_event().await, process_clock());
            }
        });
        let mut other = node(&config);
        let qos = QosProfile::publisher_default();
        let name = Name::parse("/robot1/cmd_vel").unwrap();
        let topic = other.create_topic(&name, MessageTypeName::new("geometry_msgs", "Twist"), &qos).unwrap();
        let short = other.create_publisher::<u32>(&topic, None).unwrap();
        let valid = other.create_publisher::<Twist>(&topic, None).unwrap();
        let moving = |c: &&VelocityCommand| (c.linear_m_s, c.angular_rad_s) != (0.0, 0.0);
        while commands.borrow().iter().filter(moving).count() < 3 || bridge.counters().refused < 3 {
            short.publish(7).unwrap();
            valid.publish(Twist([f64::NAN, 0.0, 0.0, 0.0, 0.0, 0.0])).unwrap();
            valid.publish(Twist([0.1, 0.0, 0.0, 0.0, 0.0, -0.5])).unwrap();
            tokio::time::sleep(PERIOD).await;
        }
        let all = |commands: &[VelocityCommand]| {
            commands.iter().filter(moving).all(|c| (c.linear_m_s, c.angular_rad_s) == (0.1, -0.5))
        };
        assert!(all(&commands.borrow()), "{:?}", commands.borrow());
    });
}

#[test]
fn a_robot_stops_at_once_when_its_writer_is_gone_and_the_stop_can_be_read() {
    run(async {
        let mut config = config(12);
        config.velocity.timeout_s = 10.0;
        let queues = Arc::new(DdsQueues::default());
        let endpoint = Rc::new(DdsEndpoint::open(&config, 1, false, queues.clone()).unwrap());
        let commands = Rc::new(RefCell::new(Vec::<f64>::new()));
        let taken = commands.clone();
        let take = move |_, command: VelocityCommand| taken.borrow_mut().push(command.linear_m_s);
        let bridge = Rc::new(Bridge::new(config.clone(), 1, take).unwrap());
        connect(&bridge, endpoint.clone(), queues);
        let mut other = node(&config);
        let qos = QosProfile::publisher_default();
        let name = Name::parse("/cmd_vel").unwrap();
        let topic = other.create_topic(&name, MessageTypeName::new("geometry_msgs", "Twist"), &qos).unwrap();
        let driver = other.create_publisher::<Twist>(&topic, None).unwrap();
        while commands.borrow().last() != Some(&0.1) {
            driver.publish(Twist([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])).unwrap();
            tokio::time::sleep(PERIOD).await;
        }
        drop(driver);
        // Nobody calls `tick`: only the end of the writer stops the robot.
        while commands.borrow().last() != Some(&0.0) {
            tokio::time::sleep(PERIOD).await;
        }

        bridge.stop_robots();
        let qos = QosProfile::publisher_default().durability(Durability::TransientLocal);
        let name = Name::parse("/emergency_stop").unwrap();
        let topic = other.create_topic(&name, MessageTypeName::new("std_msgs", "Bool"), &qos).unwrap();
        let stop = other.create_subscription::<bool>(&topic, None).unwrap();
        let mut states = std::pin::pin!(stop.async_stream());
        // A late reader learns that the stop is set. It may have come before the state that was written last.
        while !states.next().await.unwrap().unwrap().0 {}
        bridge.release_stop();
        assert!(!states.next().await.unwrap().unwrap().0);
        let name = Name::parse("/selected_robot").unwrap();
        let topic = other.create_topic(&name, MessageTypeName::new("std_msgs", "Int32"), &qos).unwrap();
        let selected = other.create_subscription::<i32>(&topic, None).unwrap();
        let mut states = std::pin::pin!(selected.async_stream());
        assert_eq!(states.next().await.unwrap().unwrap().0, 1);
    });
}

#[test]
fn an_external_robot_that_begins_to_listen_is_sent_a_zero() {
    run(async {
        let config = config(37);
        let queues = Arc::new(DdsQueues::default());
        let endpoint = Rc::new(DdsEndpoint::open(&config, 1, true, queues.clone()).unwrap());
        let robots = endpoint.clone();
        let send = move |robot, command: VelocityCommand| robots.publish_velocity(robot, &command);
        let world = ExternalWorld::new(1, |_| {});
        let bridge =
            Bridge::with_external_world(config.clone(), world, |now| Stamp(now.0 as i64), send).unwrap();
        connect(&Rc::new(bridge), endpoint.clone(), queues);
        let mut other = node(&config);
        let qos = QosProfile::publisher_default();
        let name = Name::parse("/robot1/cmd_vel").unwrap();
        let topic = other.create_topic(&name, MessageTypeName::new("geometry_msgs", "Twist"), &qos).unwrap();
        let robot = other.create_subscription::<Twist>(&topic, None).unwrap();
        let mut velocities = std::pin::pin!(robot.async_stream());
        let (velocity, _) = velocities.next().await.unwrap().unwrap();
        assert_eq!(velocity.0, [0.0; 6], "although nobody drives, and zeros of the start found no reader");
    });
}

#[test]
fn nothing_is_taken_while_two_robots_send_under_one_name_and_the_operator_is_told() {
    run(async {
        let config = config(53);
        let taken_x_m = Rc::new(RefCell::new(Vec::<f64>::new()));
        let sink = taken_x_m.clone();
        let world = ExternalWorld::new(1, move |message| {
            if let WorldMessage::Odometry(_, odometry) = message {
                sink.borrow_mut().push(odometry.odom_from_base.x_m);
            }
        });
        let queues = Arc::new(DdsQueues::default());
        let endpoint = Rc::new(DdsEndpoint::open(&config, 1, true, queues.clone()).unwrap());
        let stamp_at = |now: Monotonic| Stamp(now.0 as i64);
        let bridge =
            Rc::new(Bridge::with_external_world(config.clone(), world, stamp_at, |_, _| {}).unwrap());
        connect(&bridge, endpoint.clone(), queues);
        let open = || {
            let endpoint = Rc::new(DdsEndpoint::open(&config, 1, false, Arc::default()).unwrap());
            spawn_local(endpoint.clone().serve());
            endpoint
        };
        // Sends a pose of each of these robots.
        let send = async |robots: &[(&DdsEndpoint, f64)]| {
            for (endpoint, x_m) in robots {
                let mut odometry = Odometry::default();
                (odometry.odom_from_base.x_m, odometry.header.stamp) =
                    (*x_m, Stamp(process_clock().0 as i64));
                endpoint.publish(FleetMessage::Odometry(robot(), &odometry));
            }
            tokio::time::sleep(PERIOD).await;
        };
        let (one, two) = (open(), open());
        while taken_x_m.borrow().is_empty() {
            send(&[(&one, 1.0)]).await;
        }
        let is_reported =
            || bridge.take_events().iter().any(|event| event.contains("from two publishers at once"));
        while !is_reported() {
            send(&[(&one, 1.0), (&two, 9.0)]).await;
        }
        assert!(!taken_x_m.borrow().contains(&9.0));
        taken_x_m.borrow_mut().clear();
        while taken_x_m.borrow().is_empty() {
            send(&[(&two, 9.0)]).await;
        }
        assert_eq!(taken_x_m.borrow()[0], 9.0, "the one that is left is taken");
    });
}

#[test]
fn an_endpoint_that_leaves_is_gone_from_the_graph_before_its_lease_ends() {
    run(async {
        let config = config(41);
        let observer = DomainParticipantBuilder::new(config.dds.domain())
            .with_only_networks([Ipv4Addr::LOCALHOST])
            .build()
            .unwrap();
        let qos = QosPolicyBuilder::new()
            .reliable(rustdds::Duration::ZERO)
            .durability(policy::Durability::TransientLocal)
            .history(policy::History::KeepLast { depth: 8 })
            .build();
        let (name, class) = (ros_discovery::TOPIC_NAME.into(), ros_discovery::TYPE_NAME.into());
        let topic = observer.create_topic(name, class, &qos, TopicKind::NoKey).unwrap();
        let subscriber = observer.create_subscriber(&qos).unwrap();
        let reader =
            subscriber.create_datareader_no_key_cdr::<ParticipantEntitiesInfo>(&topic, None).unwrap();
        let mut announcements = std::pin::pin!(reader.async_bare_sample_stream());
        let endpoint = Rc::new(DdsEndpoint::open(&config, 1, false, Arc::default()).unwrap());
        let served = spawn_local(endpoint.clone().serve());
        while announcements.next().await.unwrap().unwrap().nodes().is_empty() {}
        served.abort();
        let is_gone = async { while !announcements.next().await.unwrap().unwrap().nodes().is_empty() {} };
        tokio::join!(endpoint.leave(), is_gone);
    });
}
