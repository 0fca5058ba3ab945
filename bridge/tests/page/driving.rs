//! Robots driven from browsers: leases, permissions, the emergency stop, and what happens when a browser vanishes.

use crate::Served;
use crate::browser::Browser;
use bridge::ros::{Bool, Empty, Twist};
use bridge::{BridgeConfig, Permission};

const FORWARD: Twist = Twist { linear: [0.1, 0.0, 0.0], angular: [0.0, 0.0, 0.0] };

fn last_of(robot: usize, velocities: &[(usize, f64, f64)]) -> Option<f64> {
    velocities.iter().rev().find(|(of, ..)| *of == robot).map(|(_, linear, _)| *linear)
}

/// A configuration in which a velocity stays valid longer than a loaded machine pauses.
fn patient() -> BridgeConfig {
    let mut config = BridgeConfig { lease_s: 60.0, ..BridgeConfig::default() };
    config.velocity.timeout_s = 10.0;
    config
}

#[test]
fn a_robot_stands_when_its_browser_vanishes() {
    let served = Served::start(patient());
    let mut browser = Browser::connect(served.page);
    let channel = browser.advertise::<Twist>("/cmd_vel_2");
    browser.publish(channel, &FORWARD);
    served.wait_for(|velocities| last_of(2, velocities) == Some(0.1));
    // The socket is closed without a word, as when the browser is killed.
    drop(browser);
    served.wait_for(|velocities| last_of(2, velocities) == Some(0.0));
}

#[test]
fn a_silent_browser_loses_its_robot_after_the_dead_mans_time() {
    let served = Served::start(BridgeConfig::default());
    let mut browser = Browser::connect(served.page);
    let channel = browser.advertise::<Twist>("/cmd_vel_1");
    browser.publish(channel, &FORWARD);
    served.wait_for(|velocities| last_of(1, velocities) == Some(0.1));
    served.wait_for(|velocities| last_of(1, velocities) == Some(0.0));
    assert!(browser.socket.can_write(), "the browser is connected still");
}

#[test]
fn a_second_browser_is_told_who_drives() {
    let served = Served::start(patient());
    let (mut first, mut second) = (Browser::connect(served.page), Browser::connect(served.page));
    let channel = first.advertise::<Twist>("/cmd_vel_1");
    first.publish(channel, &FORWARD);
    served.wait_for(|velocities| last_of(1, velocities) == Some(0.1));
    let channel = second.advertise::<Twist>("/cmd_vel_1");
    second.publish(channel, &Twist { linear: [-0.1, 0.0, 0.0], ..FORWARD });
    second.wait_for_status("is driven by 127.0.0.1");
    second.send(&serde_json::json!({"op": "subscribeParameterUpdates", "parameterNames": []}));
    while second.fleet.is_null() {
        second.read();
    }
    let robot = &second.fleet["robots"][0];
    assert!(robot["driver"].as_str().unwrap().starts_with("127.0.0.1:"), "{robot}");
    assert_eq!((&robot["is_mine"], &robot["prefix"]), (&false.into(), &"/robot1/".into()));
    assert!(second.fleet["robots"][1]["driver"].is_null());
    assert!(
        !second.fleet.to_string().contains(":null"),
        "the protocol's values have no null: {}",
        second.fleet
    );
    served.wait_for(|velocities| last_of(1, velocities) == Some(0.1));
}

#[test]
fn the_emergency_stop_holds_until_it_is_released() {
    let served = Served::start(patient());
    let mut browser = Browser::connect(served.page);
    let state = browser.subscribe("/emergency_stop");
    assert_eq!(browser.data(state).payload[4..], [0]);
    let (drive, stop) =
        (browser.advertise::<Twist>("/cmd_vel_1"), browser.advertise::<Bool>("/emergency_stop"));
    let release = browser.advertise::<Empty>("/emergency_stop_release");
    browser.publish(drive, &FORWARD);
    served.wait_for(|velocities| last_of(1, velocities) == Some(0.1));
    browser.publish(stop, &Bool(true));
    assert_eq!(browser.data(state).payload[4..], [1]);
    browser.publish(drive, &FORWARD);
    browser.wait_for_status("the emergency stop is set");
    assert_eq!(last_of(1, &served.velocities.lock().unwrap()), Some(0.0));
    browser.publish(release, &Empty);
    assert_eq!(browser.data(state).payload[4..], [0]);
}

#[test]
fn an_address_without_permission_watches_but_does_not_drive() {
    let config = BridgeConfig { trust_loopback: false, drive: Permission::Allowed, ..patient() };
    let served = Served::start(config);
    let mut browser = Browser::connect(served.page);
    let channel = browser.advertise::<Twist>("/cmd_vel_1");
    browser.publish(channel, &FORWARD);
    browser.wait_for_status("may not drive yet");
    assert_ne!(last_of(1, &served.velocities.lock().unwrap()), Some(0.1));
    served.with(|bridge| bridge.allow([127, 0, 0, 1].into())).unwrap();
    browser.publish(channel, &FORWARD);
    served.wait_for(|velocities| last_of(1, velocities) == Some(0.1));
}

#[test]
fn a_malformed_message_is_refused_and_the_connection_stays() {
    let served = Served::start(patient());
    let mut browser = Browser::connect(served.page);
    for text in [
        "{",
        "{\"op\":\"getParameters\"}",
        "[[[[",
        "{\"op\":\"subscribe\",\"subscriptions\":[{\"id\":1,\"channelId\":9999}]}",
    ] {
        browser.socket.send(tungstenite::Message::text(text)).unwrap();
    }
    for bytes in [vec![], vec![1], vec![9, 0, 0, 0, 0], vec![1, 255, 255, 255, 255, 0]] {
        browser.socket.send(tungstenite::Message::binary(bytes)).unwrap();
    }
    browser.wait_for_status("there is no channel 4294967295");
    assert_eq!(browser.statuses.len(), 8, "{:?}", browser.statuses);
    let channel = browser.advertise::<Twist>("/cmd_vel_1");
    browser.publish(channel, &FORWARD);
    served.wait_for(|velocities| last_of(1, velocities) == Some(0.1));
}
