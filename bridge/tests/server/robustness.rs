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
        assert!(text.contains("'/x' announces 536870912 bytes, the limit is 67108864"), "{text}");
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
