//! Topics between a client and ROS nodes through the bridge and its ROS 2 endpoint: ros2-client is the other side.

mod watched;

use bridge::command::{Call, Registration, name};
use bridge::dds::{DdsConfig, DdsEndpoint, DdsQueues};
use bridge::frame::{Parser, Side};
use bridge::{Bridge, BridgeConfig, ClientId, process_clock};
use ros2_client::dds::rustdds::DomainParticipantBuilder;
use ros2_client::dds::{Node, Publisher, Subscription};
use ros2_client::qos::{Durability, QosProfile, Reliability};
use ros2_client::{Message, MessageTypeName, Name, ServiceMapping, ServiceTypeName};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::net::Ipv4Addr;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::spawn_local;
use watched::{connect, node, run};

/// Whatever else is on its way arrives within this time.
const QUIET: Duration = Duration::from_millis(400);
const PAUSE: Duration = Duration::from_millis(20);

/// A bridge with its endpoint, and one client of it.
struct Ours {
    config: BridgeConfig,
    bridge: Rc<Bridge>,
    client: ClientId,
}

impl Ours {
    /// Opens the endpoint in a domain that no other test uses at the same time, in all probability.
    fn open(offset: u32) -> Self {
        let domain = (101 + (std::process::id() * 7 + offset) % 100) as u16;
        let dds = DdsConfig { enabled: true, domain: domain.into(), ..DdsConfig::default() };
        let config = BridgeConfig { dds, ..BridgeConfig::default() };
        let queues = Arc::new(DdsQueues::default());
        let endpoint = Rc::new(DdsEndpoint::open(&config, 1, false, queues.clone()).unwrap());
        let bridge = Rc::new(Bridge::new(config.clone(), 1, |_, _| {}).unwrap());
        connect(&bridge, endpoint, queues);
        let client = bridge.connect(([127, 0, 0, 1], 5000).into()).unwrap();
        Self { config, bridge, client }
    }

    fn receive(&self, bytes: &[u8]) {
        let mut parser = Parser::new(1 << 20);
        parser.push(bytes);
        while let Some(frame) = parser.next_frame().unwrap() {
            self.bridge.receive(self.client, frame, process_clock());
        }
    }

    fn register(&self, command: &str, topic: &str, message_type: &str) {
        let (topic, message_name) = (topic.to_owned(), message_type.to_owned());
        let registration = Registration { topic, message_name, ..Registration::default() };
        let mut bytes = Vec::new();
        Side::Client.write_command(&mut bytes, command, &registration);
        self.receive(&bytes);
    }

    /// Sends a call or a response of the client.
    fn send_call(&self, command: &str, number: i64, service: &str, payload: &[u8]) {
        let mut bytes = Vec::new();
        Side::Client.write_command(&mut bytes, command, &Call { srv_id: number });
        Side::Client.write(&mut bytes, service, payload);
        self.receive(&bytes);
    }

    fn send(&self, topic: &str, payload: &[u8]) {
        let mut bytes = Vec::new();
        Side::Client.write(&mut bytes, topic, payload);
        self.receive(&bytes);
    }

    /// Takes the payloads that wait for the client on a topic.
    fn received(&self, topic: &str) -> Vec<Vec<u8>> {
        let mut bytes = Vec::new();
        self.bridge.take_outgoing(self.client, &mut bytes).unwrap();
        let mut parser = Parser::new(1 << 20);
        parser.push(&bytes);
        let mut payloads = Vec::new();
        while let Some(frame) = parser.next_frame().unwrap() {
            if frame.name == topic.as_bytes() {
                payloads.push(frame.payload.to_vec());
            }
        }
        payloads
    }

    /// Waits for messages on a topic.
    async fn wait_for(&self, topic: &str) -> Vec<Vec<u8>> {
        loop {
            let payloads = self.received(topic);
            if !payloads.is_empty() {
                return payloads;
            }
            tokio::time::sleep(PAUSE).await;
        }
    }
}

fn publisher<M: Serialize>(
    node: &mut Node,
    name: &str,
    class: (&str, &str),
    qos: &QosProfile,
) -> Publisher<M> {
    let topic = node.create_topic(&Name::parse(name).unwrap(), MessageTypeName::new(class.0, class.1), qos);
    node.create_publisher(&topic.unwrap(), None).unwrap()
}

fn subscription<M: DeserializeOwned + 'static>(
    node: &mut Node,
    name: &str,
    class: (&str, &str),
) -> Subscription<M> {
    let qos = QosProfile::subscription_default();
    let topic = node.create_topic(&Name::parse(name).unwrap(), MessageTypeName::new(class.0, class.1), &qos);
    node.create_subscription(&topic.unwrap(), None).unwrap()
}

/// std_msgs/String as ROS 2 encodes it: the text's length with its NUL, and the text.
fn text(text: &str) -> Vec<u8> {
    let length = text.len() as u32 + 1;
    [&[0, 1, 0, 0][..], &length.to_le_bytes(), text.as_bytes(), &[0]].concat()
}

/// Returns whether a payload is a std_msgs/String; RustDDS pads messages to a multiple of 4 bytes.
fn is_text(payload: &[u8], expected: &str) -> bool {
    let expected = text(expected);
    payload.starts_with(&expected) && payload.len() < expected.len() + 4
}

#[test]
fn a_message_passes_in_both_directions_and_does_not_come_back() {
    run(async {
        let ours = Ours::open(0);
        ours.register(name::SUBSCRIBE, "/chat", "std_msgs/String");
        ours.register(name::PUBLISH, "/chat", "std_msgs/String");
        let mut node = node(&ours.config);
        let there =
            publisher::<String>(&mut node, "/chat", ("std_msgs", "String"), &QosProfile::publisher_default());
        let heard = subscription::<String>(&mut node, "/chat", ("std_msgs", "String"));
        // Messages are lost until discovery is complete.
        loop {
            there.publish("from ROS".into()).unwrap();
            if let [first, ..] = &ours.received("/chat")[..] {
                assert!(is_text(first, "from ROS"), "{first:?}");
                break;
            }
            tokio::time::sleep(PAUSE).await;
        }
        ours.received("/chat");
        let mut sent = 0;
        loop {
            ours.send("/chat", &text("from a client"));
            sent += 1;
            tokio::time::sleep(PAUSE).await;
            if let Ok(Some((message, _))) = heard.take()
                && message == "from a client"
            {
                break;
            }
        }
        tokio::time::sleep(QUIET).await;
        // The client subscribed to its own topic: it gets each message once, from the bridge.
        let payloads = ours.received("/chat");
        let own = payloads.iter().filter(|payload| is_text(payload, "from a client")).count();
        assert_eq!(own, sent);
    });
}

#[test]
fn best_effort_and_latched_publishers_are_heard() {
    run(async {
        let ours = Ours::open(25);
        let mut node = node(&ours.config);
        let latched = QosProfile::publisher_default().durability(Durability::TransientLocal);
        let there = publisher::<String>(&mut node, "/description", ("std_msgs", "String"), &latched);
        there.publish("published before anybody subscribed".into()).unwrap();
        ours.register(name::SUBSCRIBE, "/description", "std_msgs/String");
        let payloads = ours.wait_for("/description").await;
        assert_eq!(payloads.len(), 1);
        assert!(is_text(&payloads[0], "published before anybody subscribed"), "{payloads:?}");

        ours.register(name::SUBSCRIBE, "/fast", "std_msgs/String");
        let hasty = QosProfile::publisher_default().reliability(Reliability::BestEffort);
        let there = publisher::<String>(&mut node, "/fast", ("std_msgs", "String"), &hasty);
        while ours.received("/fast").is_empty() {
            there.publish("now".into()).unwrap();
            tokio::time::sleep(PAUSE).await;
        }
    });
}

#[test]
fn messages_of_another_type_do_not_reach_the_client() {
    run(async {
        let ours = Ours::open(50);
        let mut node = node(&ours.config);
        let qos = QosProfile::publisher_default();
        let wrong = publisher::<u32>(&mut node, "/count", ("std_msgs", "UInt32"), &qos);
        ours.register(name::SUBSCRIBE, "/count", "std_msgs/String");
        let texts = ours.wait_for(name::ERROR).await;
        assert!(String::from_utf8_lossy(&texts[0]).contains("std_msgs/UInt32 in ROS"), "{texts:?}");
        let right = publisher::<String>(&mut node, "/count", ("std_msgs", "String"), &qos);
        let payloads = loop {
            wrong.publish(7).unwrap();
            right.publish("seven".into()).unwrap();
            tokio::time::sleep(PAUSE).await;
            let payloads = ours.received("/count");
            if !payloads.is_empty() {
                break payloads;
            }
        };
        assert!(payloads.iter().all(|payload| is_text(payload, "seven")), "{payloads:?}");
    });
}

#[test]
fn the_reader_goes_with_its_last_client() {
    run(async {
        let ours = Ours::open(75);
        let builder =
            DomainParticipantBuilder::new(ours.config.dds.domain()).with_only_networks([Ipv4Addr::LOCALHOST]);
        let other = builder.build().unwrap();
        let readers = || {
            let readers = other.discovered_readers();
            readers.iter().filter(|reader| reader.subscription_topic_data.topic_name() == "rt/chat").count()
        };
        for (command, wanted) in [(name::SUBSCRIBE, 1), (name::REMOVE_SUBSCRIBER, 0)] {
            ours.register(command, "/chat", "std_msgs/String");
            while readers() != wanted {
                tokio::time::sleep(PAUSE).await;
            }
        }
    });
}

#[test]
fn a_late_node_reads_the_emergency_stop() {
    run(async {
        let ours = Ours::open(90);
        ours.bridge.stop_robots();
        let mut node = node(&ours.config);
        let name = Name::parse("/emergency_stop").unwrap();
        let latched = QosProfile::publisher_default().durability(Durability::TransientLocal);
        let topic = node.create_topic(&name, MessageTypeName::new("std_msgs", "Bool"), &latched).unwrap();
        let states = node.create_subscription::<bool>(&topic, None).unwrap();
        loop {
            if let Ok(Some((true, _))) = states.take() {
                return;
            }
            tokio::time::sleep(PAUSE).await;
        }
    });
}

/// A request and a response with one field, of any length.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Field(String);
impl Message for Field {}

#[test]
fn a_client_calls_a_ros_nodes_service_also_with_a_long_request() {
    run(async {
        let ours = Ours::open(60);
        let mut node = node(&ours.config);
        let (name, of) = (Name::parse("/echo").unwrap(), ServiceTypeName::new("odd_msgs", "Echo"));
        let (qos, mapping) = (QosProfile::publisher_default(), ServiceMapping::Enhanced);
        let server = node.create_server::<Field, Field>(mapping, &name, &of, qos.clone(), qos).unwrap();
        spawn_local(async move {
            loop {
                let (id, Field(text)) = server.async_receive_request().await.unwrap();
                server.async_send_response(id, Field(text.chars().take(9).collect())).await.unwrap();
            }
        });
        for length in [3, 5000, 200_000] {
            let payload = loop {
                ours.register(name::ROS_SERVICE, "/echo", "odd_msgs/Echo");
                ours.send_call(name::REQUEST, 101, "/echo", &text(&"a".repeat(length)));
                tokio::time::sleep(QUIET).await;
                if let Some(payload) = ours.received("/echo").pop() {
                    break payload;
                }
            };
            assert!(is_text(&payload, &"a".repeat(length.min(9))), "{length}: {payload:?}");
        }
    });
}

#[test]
fn a_ros_nodes_call_is_answered_by_a_client_once() {
    run(async {
        let ours = Ours::open(65);
        ours.register(name::UNITY_SERVICE, "/trigger", "std_srvs/Trigger");
        let mut node = node(&ours.config);
        let (name, of) = (Name::parse("/trigger").unwrap(), ServiceTypeName::new("std_srvs", "Trigger"));
        let (qos, mapping) = (QosProfile::publisher_default(), ServiceMapping::Enhanced);
        let client = node.create_client::<Field, Field>(mapping, &name, &of, qos.clone(), qos).unwrap();
        let mut sent = 0;
        let id = loop {
            // Requests are lost until discovery is complete.
            let id = client.send_request(Field("first".into())).unwrap();
            sent += 1;
            tokio::time::sleep(QUIET).await;
            let calls = ours.received(name::REQUEST);
            for call in &calls {
                let Call { srv_id } = serde_json::from_slice(call).unwrap();
                ours.send_call(name::RESPONSE, srv_id, "/trigger", &text("done"));
            }
            if !calls.is_empty() {
                break id;
            }
        };
        let mut answered = Vec::new();
        while !answered.contains(&id) {
            tokio::time::sleep(PAUSE).await;
            if let Ok(Some((of, response))) = client.receive_response() {
                assert_eq!(response, Field("done".into()));
                answered.push(of);
            }
        }
        assert!(answered.len() <= sent);
        // A service that is offered anew does not get its old requests again.
        for command in [name::REMOVE_UNITY_SERVICE, name::UNITY_SERVICE] {
            ours.register(command, "/trigger", "std_srvs/Trigger");
        }
        tokio::time::sleep(QUIET).await;
        assert!(ours.received(name::REQUEST).is_empty());
    });
}
