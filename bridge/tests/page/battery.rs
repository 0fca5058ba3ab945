//! The state of a battery on its way from a client on TCP to a browser, as the fleet's channel carries it.

use crate::Served;
use crate::browser::Browser;
use bridge::command::{Registration, name};
use bridge::frame::{Parser, RosTcpFrame, Side};
use bridge::ros::{BatteryState, Message, encode};
use bridge::world::{ExternalWorld, WorldMessage};
use bridge::{Bridge, BridgeConfig, FleetMessage, PageConfig, process_clock};
use msg::{Battery, Monotonic, RobotId, Stamp};
use serde_json::{Value, json};
use std::sync::{Arc, Mutex};
use std::time::Duration;

const TOPIC: &str = "/robot2/battery_state";

/// What the external world has passed on, as the channels `robotK/battery` carry it.
type Passed = Arc<Mutex<Vec<(RobotId, Battery)>>>;

fn start() -> (Served, Passed) {
    let passed = Passed::default();
    let sink = passed.clone();
    let served = Served::start_bridge(PageConfig::default(), move |on_command| {
        let world = ExternalWorld::new(2, move |message| {
            if let WorldMessage::Battery(robot, battery) = message {
                sink.lock().unwrap().push((robot, *battery));
            }
        });
        let stamp_at = |now: Monotonic| Stamp(now.0 as i64);
        Bridge::with_external_world(BridgeConfig::default(), world, stamp_at, on_command).unwrap()
    });
    (served, passed)
}

/// Frames of a client on TCP that registers the topic and publishes this payload.
fn frames(write_payload: impl FnOnce(&mut Vec<u8>)) -> Parser {
    let mut bytes = Vec::new();
    let registration = Registration {
        topic: TOPIC.into(),
        message_name: BatteryState::TYPE.into(),
        ..Registration::default()
    };
    Side::Client.write_command(&mut bytes, name::PUBLISH, &registration);
    Side::Client.write_with(&mut bytes, TOPIC, write_payload);
    let mut parser = Parser::new(1 << 20);
    parser.push(&bytes);
    parser
}

/// Lets a client that comes and leaves send these frames.
fn receive_frames(bridge: &Bridge, mut parser: Parser, now: Monotonic) {
    let client = bridge.connect(([127, 0, 0, 1], 5000).into()).unwrap();
    while let Some(RosTcpFrame { name, payload }) = parser.next_frame().unwrap() {
        bridge.receive(client, RosTcpFrame { name, payload }, now);
    }
    bridge.disconnect(client);
}

/// Lets a client on TCP send a state, and brings what the world passes on back, as the channel does.
fn send(served: &Served, passed: &Passed, battery: Battery, now: Monotonic) {
    let message = BatteryState { battery, cell_voltage: vec![3.9; 3], ..BatteryState::default() };
    let parser = frames(|out| encode(&message, out));
    let passed = passed.clone();
    served.with(move |bridge| {
        receive_frames(bridge, parser, now);
        for (robot, battery) in passed.lock().unwrap().drain(..) {
            bridge.publish(FleetMessage::Battery(robot, &battery));
        }
    });
}

/// Waits until the page is told something of a robot's battery that is as wanted.
fn wait_for_battery(browser: &mut Browser, robot: usize, is_wanted: impl Fn(&Value) -> bool) -> Value {
    while !is_wanted(&browser.fleet["robots"][robot - 1]["battery"]) {
        browser.read();
    }
    browser.fleet["robots"][robot - 1]["battery"].clone()
}

#[test]
fn a_browser_is_told_of_the_battery_that_a_client_on_tcp_reports() {
    let (served, passed) = start();
    let mut browser = Browser::connect(served.page);
    assert_eq!(browser.channels[TOPIC].1, "sensor_msgs/msg/BatteryState");
    let subscription = browser.subscribe(TOPIC);
    browser.send(&json!({"op": "subscribeParameterUpdates", "parameterNames": ["/mr_slam/fleet"]}));
    while browser.fleet.is_null() {
        browser.read();
    }
    assert!(browser.fleet["robots"][1]["battery"].is_null(), "none was sent yet: {}", browser.fleet);

    // A driver that counts in percent, as the TurtleBot3's.
    let battery = Battery { percentage: 42.0, voltage_v: 11.26, is_present: 1, ..Battery::default() };
    let now = process_clock();
    send(&served, &passed, battery, now);
    let reported = browser.data(subscription);
    let read: BatteryState = bridge::ros::decode(&reported.payload).unwrap();
    assert_eq!((read.battery.percentage, read.battery.voltage_v), (42.0, 11.26), "as it was sent");
    let mut known = wait_for_battery(&mut browser, 2, |battery| !battery.is_null());
    assert!(known["age_s"].take().as_f64().unwrap() >= 0.0);
    assert_eq!(known, json!({"charge": 0.42, "voltage_v": 11.26, "last_charge": 0.42, "age_s": null}));
    assert!(browser.fleet["robots"][0]["battery"].is_null(), "the other robot sent none");

    let low = Battery { percentage: 8.0, power_supply_status: 2, ..battery };
    send(&served, &passed, low, now + Duration::from_secs(1));
    let known = wait_for_battery(&mut browser, 2, |battery| battery["charge"] == 0.08);
    assert_eq!((&known["level"], &known["is_charging"]), (&"critical".into(), &false.into()));

    // It is unknown when it is too old; what it was, and how long ago, is known.
    served.with(|bridge| {
        let seen = process_clock();
        bridge.tick(seen);
        let old = bridge.batteries(seen + Duration::from_secs(31))[1].unwrap();
        assert_eq!((old.charge, old.voltage_v, old.level), (None, None, None));
        assert!(old.last_charge == Some(0.08) && old.age_s >= 31.0, "{old:?}");
    });
}

#[test]
fn a_state_that_nobody_measured_is_not_shown_and_one_that_is_none_is_refused() {
    let (served, passed) = start();
    let mut browser = Browser::connect(served.page);
    browser.send(&json!({"op": "subscribeParameterUpdates", "parameterNames": ["/mr_slam/fleet"]}));
    let unknown = Battery { percentage: f32::NAN, voltage_v: f32::NAN, is_present: 1, ..Battery::default() };
    send(&served, &passed, unknown, process_clock());
    let known = wait_for_battery(&mut browser, 2, |battery| !battery.is_null());
    assert_eq!(known.as_object().unwrap().keys().collect::<Vec<_>>(), ["age_s"]);
    let cut = frames(|out| out.extend_from_slice(&[0, 1, 0, 0, 7]));
    let refused = served.with(|bridge| {
        receive_frames(bridge, cut, process_clock());
        bridge.counters().refused
    });
    assert_eq!(refused, 1);
}
