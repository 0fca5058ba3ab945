//! Messages of the fleet at browsers: the bytes of the other transports, the newest first.

use crate::Served;
use crate::browser::{Browser, WAIT_MAX};
use bridge::command::{Registration, name};
use bridge::frame::{Parser, RosTcpFrame};
use bridge::ros::{Text, Twist};
use bridge::{Bridge, BridgeConfig, FleetMessage};
use bytemuck::Zeroable;
use msg::{GridHeader, GridView, Header, Monotonic, RobotId, Stamp};
use serde_json::json;
use std::io::{Read, Write};

const ROBOT: RobotId = RobotId::new(1).unwrap();

fn publish_scan(bridge: &Bridge, stamp: i64) {
    let mut scan = msg::Scan::zeroed();
    (scan.header, scan.len) = (Header { stamp: Stamp(stamp), ..Header::default() }, 3);
    bridge.publish(FleetMessage::Scan(ROBOT, &scan));
}

/// Publishes a merged map of 1000 x 1000 cells.
fn publish_map(bridge: &Bridge, stamp: i64) {
    let cells = vec![0; 1_000_000];
    let header = GridHeader {
        header: Header { stamp: Stamp(stamp), ..Header::default() },
        width: 1000,
        height: 1000,
        resolution_m: 0.05,
        ..GridHeader::default()
    };
    bridge.publish(FleetMessage::MergedMap(GridView::new(&header, &cells).unwrap()));
}

#[test]
fn the_server_says_who_it_is_and_what_it_has() {
    let served = Served::start(BridgeConfig::default());
    let browser = Browser::connect(served.page);
    assert_eq!(
        browser.info["capabilities"],
        serde_json::json!(["clientPublish", "parameters", "parametersSubscribe", "services"])
    );
    assert_eq!(browser.info["metadata"], serde_json::json!({ "run": "7-42" }));
    assert_eq!(browser.channels["/robot1/scan"].1, "sensor_msgs/msg/LaserScan");
    assert_eq!(browser.channels["/merged_map"].1, "nav_msgs/msg/OccupancyGrid");
    assert!(browser.channels.contains_key("/tf") && browser.channels.contains_key("/cmd_vel_2"));
    assert!(!browser.channels.contains_key("/robot3/scan"), "the fleet has two robots");
}

#[test]
fn a_browser_that_asks_for_the_time_of_the_run_gets_it_with_its_own_words() {
    let served = Served::start(BridgeConfig::default());
    let mut browser = Browser::connect(served.page);
    let header = Header { stamp: Stamp(12_500_000_000), ..Header::default() };
    served.with(move |bridge| bridge.publish(FleetMessage::Clock(&msg::Clock { header })));
    let ask = |names: &[&str], id: &str| json!({"op": "getParameters", "parameterNames": names, "id": id});
    browser.send(&ask(&["/mr_slam/time", "/mine"], "t1"));
    let mut answer = || loop {
        browser.read();
        if let Some(answer) = browser.answers.pop() {
            return answer;
        }
    };
    let time = answer();
    assert_eq!(time["parameters"], json!([{"name": "/mr_slam/time", "value": 12.5}]));
    assert_eq!(time["id"], "t1");
    let mut browser = Browser::connect(served.page);
    browser.send(&ask(&[], "all"));
    while browser.answers.is_empty() {
        browser.read();
    }
    let all: Vec<_> =
        browser.answers[0]["parameters"].as_array().unwrap().iter().map(|one| &one["name"]).collect();
    assert_eq!(all, ["/mr_slam/fleet", "/mr_slam/time", "/mr_slam/clock"]);
    browser.send(&ask(&[], &"x".repeat(65)));
    browser.wait_for_status("65 bytes");
}

#[test]
fn a_browser_gets_the_bytes_that_a_client_on_tcp_gets() {
    let served = Served::start(BridgeConfig::default());
    let mut browser = Browser::connect(served.page);
    let subscription = browser.subscribe("/robot1/scan");
    // The topic's latched state shows that the subscriptions before it are made.
    let stop = browser.subscribe("/emergency_stop");
    browser.data(stop);
    let on_tcp = served.with(|bridge| {
        let client = bridge.connect(([127, 0, 0, 1], 5000).into()).unwrap();
        let (topic, message_name) = ("/robot1/scan".to_owned(), "sensor_msgs/LaserScan".to_owned());
        let registration = Registration { topic, message_name, ..Registration::default() };
        let payload = serde_json::to_vec(&registration).unwrap();
        bridge.receive(
            client,
            RosTcpFrame { name: name::SUBSCRIBE.as_bytes(), payload: &payload },
            Monotonic(0),
        );
        publish_scan(bridge, 7_000_000_001);
        let mut bytes = Vec::new();
        bridge.take_outgoing(client, &mut bytes).unwrap();
        let mut parser = Parser::new(1 << 20);
        parser.push(&bytes);
        let mut payload = Vec::new();
        while let Some(frame) = parser.next_frame().unwrap() {
            payload = frame.payload.to_vec();
        }
        payload
    });
    let data = browser.data(subscription);
    assert_eq!(data.time_ns, 7_000_000_001);
    assert_eq!(data.payload, on_tcp);
}

#[test]
fn a_late_browser_gets_the_newest_map() {
    let served = Served::start(BridgeConfig::default());
    served.with(|bridge| (1..4).for_each(|stamp| publish_map(bridge, stamp)));
    let mut browser = Browser::connect(served.page);
    let map = browser.subscribe("/merged_map");
    let data = browser.data(map);
    assert_eq!((data.time_ns, data.payload.len() > 1_000_000), (3, true));
}

#[test]
fn a_browser_that_does_not_read_costs_one_map_and_gets_the_newest() {
    let served = Served::start(BridgeConfig::default());
    let mut browser = Browser::connect(served.page);
    let map = browser.subscribe("/merged_map");
    let stop = browser.subscribe("/emergency_stop");
    browser.data(stop);
    // More than the kernel takes: the browser is behind.
    const MAPS: i64 = 40;
    served.with(|bridge| (1..=MAPS).for_each(|stamp| publish_map(bridge, stamp)));
    let held = served.with(|bridge| bridge.held_bytes());
    assert!(held < 4 << 20, "{held} bytes are held for a browser that does not read");
    let mut received = 0;
    while browser.data(map).time_ns < MAPS as u64 {
        received += 1;
    }
    assert!(received < MAPS, "the newest map replaces older ones");
}

#[test]
fn a_topic_that_a_client_creates_reaches_the_browser_and_leaves_it() {
    let served = Served::start(BridgeConfig::default());
    let (mut first, mut second) = (Browser::connect(served.page), Browser::connect(served.page));
    let channel = first.advertise::<Twist>("/mine");
    let begun = std::time::Instant::now();
    while !second.channels.contains_key("/mine") {
        second.read();
        assert!(begun.elapsed() < WAIT_MAX);
    }
    let subscription = second.subscribe("/mine");
    let stop = second.subscribe("/emergency_stop");
    second.data(stop);
    let twist = Twist { linear: [1.0, 2.0, 3.0], angular: [4.0, 5.0, 6.0] };
    first.publish(channel, &twist);
    let payload = second.data(subscription).payload;
    assert_eq!(payload.len(), 4 + 6 * 8);
    assert_eq!(payload[4..12], 1.0_f64.to_le_bytes());
}

#[test]
fn a_dropped_browser_is_told_why() {
    let served = Served::start(BridgeConfig::default());
    let mut browser = Browser::connect(served.page);
    served.with(|bridge| {
        let number = bridge.clients(Monotonic(0))[0].number;
        assert_eq!(bridge.drop_clients(bridge::ClientSelector::Number(number)), 1);
    });
    browser.wait_for_status("the operator has closed this connection");
    loop {
        match browser.socket.read() {
            Ok(message) => assert!(!message.is_binary()),
            Err(error) => break assert!(matches!(error, tungstenite::Error::ConnectionClosed), "{error}"),
        }
    }
}

#[test]
fn a_self_check_goes_to_the_log_shortened_and_not_for_ever() {
    let served = Served::start(BridgeConfig::default());
    let mut browser = Browser::connect(served.page);
    let channel = browser.advertise::<Text>("/mr_slam/selfcheck");
    let begun = std::time::Instant::now();
    for i in 0..20 {
        browser.publish(channel, &Text(format!("check {i}: yes\n{}", "x".repeat(10_000))));
    }
    let mut events = Vec::new();
    while events.len() < 4 {
        assert!(begun.elapsed() < crate::browser::WAIT_MAX, "{events:?}");
        events.extend(served.with(|bridge| bridge.take_events()));
    }
    // A command that is answered shows that the bridge has read all that came before it.
    browser.send(&serde_json::json!({"op": "subscribe", "subscriptions": [{"id": 9, "channelId": 9999}]}));
    browser.wait_for_status("9999");
    events.extend(served.with(|bridge| bridge.take_events()));
    assert_eq!(events.len(), 4, "{events:?}");
    assert!(events[0].starts_with("self-check of 127.0.0.1: check 0: yesx"), "{events:?}");
    assert!(events.iter().all(|event| event.len() < 2100 && !event.contains('\n')));
}

/// Returns the kinds (first byte) of the WebSocket frames in what a server sent.
fn frame_kinds(mut bytes: &[u8]) -> Vec<u8> {
    let mut kinds = Vec::new();
    while let [kind, length, rest @ ..] = bytes {
        kinds.push(*kind);
        let (header, length) = match length {
            126 => (2, usize::from(u16::from_be_bytes([rest[0], rest[1]]))),
            127 => (8, u64::from_be_bytes(rest[..8].try_into().unwrap()) as usize),
            short => (0, usize::from(*short)),
        };
        bytes = &rest[header + length..];
    }
    kinds
}

#[test]
fn a_browser_that_closes_gets_one_close_as_the_last_frame() {
    const CLOSE: u8 = 0x88;
    let served = Served::start(BridgeConfig::default());
    let mut browser = Browser::connect(served.page);
    let stop = browser.subscribe("/emergency_stop");
    browser.data(stop);
    let stream = browser.socket.get_mut();
    // A masked close without a reason (RFC 6455, 5.5.1).
    stream.write_all(&[CLOSE, 0x80, 0, 0, 0, 0]).unwrap();
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).unwrap();
    let kinds = frame_kinds(&bytes);
    assert_eq!(kinds.last(), Some(&CLOSE));
    assert_eq!(kinds.iter().filter(|kind| **kind == CLOSE).count(), 1, "{kinds:x?}");
}
