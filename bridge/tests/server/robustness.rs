//! Clients that send invalid or incomplete frames, or disconnect abruptly.

use crate::client::Client;
use crate::with_bridge;
use bridge::command::name;
use bridge::ros::{Clock, Message, Text, Twist};
use bridge::{Bridge, BridgeConfig, FleetMessage, process_clock, serve};

#[test]
fn a_stream_that_is_not_ros_tcp_gets_an_error_and_is_closed() {
    with_bridge(Default::default(), async |served| {
        let mut client = Client::connect(served.address).await;
        client.raw(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n").await;
        assert!(client.error().await.contains("speaks ros_tcp"));
        assert_eq!(client.next().await, None);
        Client::connect(served.address).await.settle().await;
    });
}

#[test]
fn a_frame_over_the_limit_gets_an_error_and_is_closed() {
    with_bridge(Default::default(), async |served| {
        let mut client = Client::connect(served.address).await;
        client.raw(b"\x03\0\0\0/x\0\0\0\0\x20abcd").await;
        let text = client.error().await;
        assert!(text.contains("'/x' announces 536870912 bytes, the limit is 33554432"), "{text}");
        assert_eq!(client.next().await, None);
        assert_eq!(served.bridge.counters().clients, 0);
    });
}

#[test]
fn an_incomplete_frame_delays_no_other_client() {
    with_bridge(Default::default(), async |served| {
        let mut half = Client::connect(served.address).await;
        half.raw(b"\xc8\0\0\0/half").await;
        let mut other = Client::connect(served.address).await;
        other.subscribe("/clock", Clock::TYPE).await;
        other.settle().await;
        served.bridge.publish(FleetMessage::Clock(&msg::Clock::default()));
        other.message::<Clock>("/clock").await;
        drop(half);
        while served.bridge.counters().clients > 1 {
            other.settle().await;
        }
    });
}

#[test]
fn frames_arrive_byte_by_byte_or_several_at_once() {
    with_bridge(Default::default(), async |served| {
        let mut client = Client::connect(served.address).await;
        let list = b"\x0d\0\0\0__topic_list\0\x03\0\0\0{}\0";
        for byte in list {
            client.raw(&[*byte]).await;
        }
        assert_eq!(client.next().await.unwrap().0, name::TOPIC_LIST);
        // Keepalives between, and no NUL at all.
        client.raw(&[&[0; 8][..], list, &[0; 8], b"\x0c\0\0\0__topic_list\x02\0\0\0{}", list].concat()).await;
        for _ in 0..3 {
            assert_eq!(client.next().await.unwrap().0, name::TOPIC_LIST);
        }
    });
}

#[test]
fn abrupt_reconnects_leave_no_topics_and_clients() {
    with_bridge(BridgeConfig { clients_max: 8, ..Default::default() }, async |served| {
        let mut witness = Client::connect(served.address).await;
        let (_, before) = witness.settle().await;
        for i in 0..200 {
            let mut client = Client::connect(served.address).await;
            for topic in ["/a", "/b", "/c", "/tf"] {
                client.subscribe(topic, if topic == "/tf" { "tf2_msgs/TFMessage" } else { Text::TYPE }).await;
            }
            client.publish("/cmd_vel", Twist::TYPE).await;
            if i % 2 == 0 {
                client.settle().await;
            }
            client.abort();
            while served.bridge.counters().clients > 4 {
                witness.settle().await;
            }
        }
        while served.bridge.counters().clients > 1 {
            witness.settle().await;
        }
        assert_eq!(witness.settle().await.1, before, "topics of clients that are gone are gone");
        assert_eq!(served.bridge.counters().accepted, 201);
    });
}

#[test]
fn one_client_too_many_gets_an_error() {
    with_bridge(BridgeConfig { clients_max: 1, ..Default::default() }, async |served| {
        let mut first = Client::connect(served.address).await;
        let mut second = Client::connect(served.address).await;
        assert!(second.error().await.contains("clients_max"));
        assert_eq!(second.next().await, None);
        first.settle().await;
        drop(first);
        while served.bridge.counters().clients > 0 {
            tokio::task::yield_now().await;
        }
        Client::connect(served.address).await.settle().await;
    });
}

#[test]
fn stopping_the_server_closes_every_connection() {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    tokio::task::LocalSet::new().block_on(&runtime, async {
        let bridge = std::rc::Rc::new(Bridge::new(BridgeConfig::default(), 1, |_, _| {}).unwrap());
        let listener = tokio::net::TcpListener::bind((std::net::Ipv4Addr::LOCALHOST, 0)).await.unwrap();
        let address = listener.local_addr().unwrap();
        let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
        let server = tokio::task::spawn_local(serve(bridge.clone(), listener, process_clock, async {
            drop(stopped.await)
        }));
        let mut client = Client::connect(address).await;
        client.settle().await;
        drop(stop);
        server.await.unwrap();
        assert_eq!(client.next().await, None);
        assert_eq!(bridge.counters().clients, 0);
    });
}

#[test]
fn the_number_of_clients_topics_is_limited() {
    with_bridge(BridgeConfig { client_topics_max: 2, ..Default::default() }, async |served| {
        let mut client = Client::connect(served.address).await;
        for topic in ["/a", "/b", "/c"] {
            client.subscribe(topic, Text::TYPE).await;
        }
        assert!(client.error().await.contains("'/c' would be one topic too many"));
        client.register(name::REMOVE_SUBSCRIBER, "/a", "").await;
        client.subscribe("/c", Text::TYPE).await;
        assert!(client.settle().await.0.is_empty());
    });
}

#[test]
fn a_large_frame_needs_a_registered_topic_and_is_skipped_without_one() {
    with_bridge(Default::default(), async |served| {
        let mut client = Client::connect(served.address).await;
        client.publish("/cmd_vel", Twist::TYPE).await;
        client.send_bytes("/unknown", &vec![0; 1 << 20]).await;
        let text = client.error().await;
        assert!(text.contains("1048576 bytes for '/unknown' is skipped") && text.contains("65536"), "{text}");
        client.send_bytes("/cmd_vel", &vec![0; 2 << 20]).await;
        let text = client.error().await;
        assert!(text.contains("no message of this topic is over 1048576 bytes"), "{text}");
        client.send_bytes("__subscribe", &vec![b'x'; 100_000]).await;
        let text = client.error().await;
        assert!(text.contains("a command of 100000 bytes"), "{text}");
        // The stream is in step still, and the parts that were skipped are not held.
        assert!(client.settle().await.0.is_empty());
        assert!(served.bridge.held_bytes() <= 64 << 10, "{} bytes", served.bridge.held_bytes());
    });
}

#[test]
fn a_large_frame_that_stops_ends_its_connection_and_frees_its_memory() {
    let mut config = BridgeConfig::default();
    config.limits.frame_timeout_s = 2.0;
    with_bridge(config, async |served| {
        let mut witness = Client::connect(served.address).await;
        let mut client = Client::connect(served.address).await;
        client.publish("/log", Text::TYPE).await;
        client.settle().await;
        client.raw(&[b"\x05\0\0\0/log\0\0\0\x80\0", &vec![0; 3 << 20][..]].concat()).await;
        while served.bridge.held_bytes() < 3 << 20 {
            witness.settle().await;
        }
        // A keepalive cannot come in the middle of a frame: these bytes are part of it.
        client.raw(&[0; 8]).await;
        let text = client.error().await;
        assert!(text.contains("stopped in its middle for 2 s"), "{text}");
        assert_eq!(client.next().await, None);
        assert_eq!(served.bridge.counters().clients, 1);
        assert!(served.bridge.held_bytes() <= 64 << 10, "{} bytes", served.bridge.held_bytes());
    });
}

#[test]
fn one_client_cannot_take_all_topics_and_services() {
    let mut config = BridgeConfig::default();
    (config.limits.topics_per_client, config.limits.services_per_client) = (2, 1);
    with_bridge(config, async |served| {
        let mut client = Client::connect(served.address).await;
        client.subscribe("/clock", Clock::TYPE).await;
        for topic in ["/a", "/b", "/a"] {
            client.subscribe(topic, Text::TYPE).await;
            client.publish(topic, Text::TYPE).await;
        }
        client.publish("/cmd_vel", Twist::TYPE).await;
        client.publish("/c", Text::TYPE).await;
        let text = client.error().await;
        assert!(text.contains("'/c' would be one topic too many for one client: the limit is 2"), "{text}");
        client.register(name::UNITY_SERVICE, "/one", "std_srvs/Trigger").await;
        client.register(name::ROS_SERVICE, "/one", "std_srvs/Trigger").await;
        client.register(name::ROS_SERVICE, "/two", "std_srvs/Trigger").await;
        assert!(client.error().await.contains("'/two' would be one service too many"));
        assert!(client.settle().await.0.is_empty());
        Client::connect(served.address).await.subscribe("/c", Text::TYPE).await;
    });
}

#[test]
fn a_dropped_client_is_told_why() {
    with_bridge(Default::default(), async |served| {
        let mut client = Client::connect(served.address).await;
        let number = served.bridge.clients(process_clock())[0].number;
        assert_eq!(served.bridge.drop_clients("10.1.2.3".parse().unwrap()), 0);
        assert_eq!(served.bridge.drop_clients(number.to_string().parse().unwrap()), 1);
        assert!(client.error().await.contains("the operator has closed"));
        assert_eq!(client.next().await, None);
        assert!("robot1".parse::<bridge::ClientSelector>().is_err());
    });
}
