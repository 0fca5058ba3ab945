//! Topics that the endpoint both writes and reads, on loopback: RustDDS does not bring them to its own readers there, so that
//! these never acknowledge.

mod watched;

use bridge::command::{Registration, name};
use bridge::dds::{DdsConfig, DdsEndpoint, DdsQueues};
use bridge::frame::{Parser, Side};
use bridge::{Bridge, BridgeConfig, FleetMessage, Transport, process_clock};
use msg::{Header, Odometry, PoseEstimate, RobotId, Stamp, TrackingState};
use ros2_client::dds::{Node, Subscription};
use ros2_client::qos::{Durability, QosProfile};
use ros2_client::{MessageTypeName, Name};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::spawn_local;
use watched::{connect, node, run};

const ROBOT: RobotId = RobotId::new(1).unwrap();
/// Period at which a test looks for messages.
const PERIOD: Duration = Duration::from_millis(2);

/// A domain that no other test uses at the same time, in all probability.
fn config(offset: u32) -> BridgeConfig {
    let domain = (1 + (std::process::id() * 7 + offset) % 200) as u16;
    BridgeConfig {
        dds: DdsConfig { enabled: true, domain: domain.into(), ..DdsConfig::default() },
        ..BridgeConfig::default()
    }
}

/// Creates a node while the endpoint goes on.
async fn node_elsewhere(config: &BridgeConfig) -> Node {
    let config = config.clone();
    tokio::task::spawn_blocking(move || node(&config)).await.unwrap()
}

fn subscription<M: DeserializeOwned + 'static>(
    node: &mut Node,
    name: &str,
    class: (&str, &str),
    durability: Durability,
) -> Subscription<M> {
    let qos = QosProfile::publisher_default().durability(durability);
    let topic = node.create_topic(&Name::parse(name).unwrap(), MessageTypeName::new(class.0, class.1), &qos);
    node.create_subscription(&topic.unwrap(), None).unwrap()
}

/// Waits for a message.
async fn next<M: DeserializeOwned + 'static>(subscription: &Subscription<M>) -> M {
    loop {
        if let Ok(Some((message, _))) = subscription.take() {
            return message;
        }
        tokio::time::sleep(PERIOD).await;
    }
}

#[test]
fn each_change_of_a_state_that_is_also_a_command_reaches_ros_nodes() {
    run(async {
        let config = config(0);
        let queues = Arc::new(DdsQueues::default());
        let endpoint = Rc::new(DdsEndpoint::open(&config, 1, false, queues.clone()).unwrap());
        let bridge = Rc::new(Bridge::new(config.clone(), 1, |_, _| {}).unwrap());
        connect(&bridge, endpoint, queues);
        bridge.stop_robots();
        let mut other = node_elsewhere(&config).await;
        let states = subscription::<bool>(
            &mut other,
            "/emergency_stop",
            ("std_msgs", "Bool"),
            Durability::TransientLocal,
        );
        assert!(next(&states).await);
        for _ in 0..100 {
            bridge.release_stop();
            while next(&states).await {}
            bridge.stop_robots();
            while !next(&states).await {}
        }
    });
}

#[test]
fn what_a_client_sends_on_a_topic_that_it_reads_reaches_ros_nodes() {
    run(async {
        let config = config(60);
        let queues = Arc::new(DdsQueues::default());
        let endpoint = Rc::new(DdsEndpoint::open(&config, 1, false, queues.clone()).unwrap());
        let bridge = Rc::new(Bridge::new(config.clone(), 1, |_, _| {}).unwrap());
        connect(&bridge, endpoint, queues);
        let client = bridge.connect(([127, 0, 0, 1], 5000).into()).unwrap();
        let receive = |bytes: &[u8]| {
            let mut parser = Parser::new(1 << 20);
            parser.push(bytes);
            while let Some(frame) = parser.next_frame().unwrap() {
                bridge.receive(client, frame, process_clock());
            }
        };
        for command in [name::SUBSCRIBE, name::PUBLISH] {
            let registration = Registration {
                topic: "/count".into(),
                message_name: "std_msgs/Int32".into(),
                ..Registration::default()
            };
            let mut bytes = Vec::new();
            Side::Client.write_command(&mut bytes, command, &registration);
            receive(&bytes);
        }
        let mut other = node_elsewhere(&config).await;
        let counts = subscription::<i32>(&mut other, "/count", ("std_msgs", "Int32"), Durability::Volatile);
        let send = |count: i32| {
            let mut bytes = Vec::new();
            Side::Client.write(&mut bytes, "/count", &[&[0, 1, 0, 0][..], &count.to_le_bytes()].concat());
            receive(&bytes);
        };
        // Messages are lost until discovery is complete.
        while !matches!(counts.take(), Ok(Some(_))) {
            send(0);
            tokio::time::sleep(PERIOD).await;
        }
        for count in 1..=300 {
            send(count);
            while next(&counts).await != count {}
        }
    });
}

/// geometry_msgs/TransformStamped.
#[derive(Deserialize)]
struct TransformStamped {
    stamp: (i32, u32),
    frame: String,
    _child: String,
    _transform: [f64; 7],
}

#[test]
fn transforms_reach_ros_nodes_while_those_of_external_robots_are_read() {
    run(async {
        let config = config(120);
        let queues = Arc::new(DdsQueues::default());
        let endpoint = Rc::new(DdsEndpoint::open(&config, 1, true, queues.clone()).unwrap());
        spawn_local(endpoint.clone().serve());
        let mut other = node_elsewhere(&config).await;
        let transforms = subscription::<Vec<TransformStamped>>(
            &mut other,
            "/tf",
            ("tf2_msgs", "TFMessage"),
            Durability::Volatile,
        );
        // Its odometry names the frame in which the transforms go out.
        let robot = Rc::new(DdsEndpoint::open(&config, 1, false, Arc::default()).unwrap());
        spawn_local(robot.clone().serve());
        let send = |stamp: Stamp| {
            let header = Header { stamp, ..Header::default() };
            let state = TrackingState::Tracking as u32;
            let pose_estimate = PoseEstimate { header, state, ..PoseEstimate::default() };
            endpoint.publish(FleetMessage::PoseEstimate(ROBOT, &pose_estimate));
        };
        // Messages are lost until discovery is complete.
        let is_from_map = |transform: &TransformStamped| transform.frame == "map_1";
        let mut stamp = Stamp(0);
        while !matches!(transforms.take(), Ok(Some((sent, _))) if sent.iter().any(is_from_map)) {
            robot.publish(FleetMessage::Odometry(ROBOT, &Odometry::default()));
            // A transform is sent again with a newer stamp alone.
            stamp = stamp + PERIOD;
            send(stamp);
            tokio::time::sleep(PERIOD).await;
        }
        // More than a writer keeps for a reader that does not acknowledge.
        for last in (100..=10_000_i32).step_by(100) {
            (last - 99..=last).for_each(|second| send(Stamp::from_seconds(second.into())));
            while next(&transforms).await.iter().all(|transform| transform.stamp.0 != last) {}
        }
        // Nobody takes the odometry: its queue may have dropped some.
        assert_eq!(endpoint.counters().dropped - queues.dropped(), 0);
    });
}
