//! The operator against the real bridge with a small world behind it, over TCP on loopback.

mod fleet;

use super::*;
use bridge::BridgeConfig;
use fleet::{spawn_fleet, spawn_fleet_with};
use nav::test_world::TestWorld;
use std::sync::Arc;

fn args(port: u16) -> OperatorArgs {
    OperatorArgs {
        mode: OperatorMode::Tour,
        host: "127.0.0.1".into(),
        port,
        robots: None,
        names: None,
        seconds: Some(60.0),
        turn_seconds: Some(0.5),
        all_at_once: false,
        seed: 1,
        json: false,
        launcher_pid: None,
    }
}

#[test]
fn the_robots_of_a_bridge_are_driven_one_after_the_other() {
    let stop = Arc::new(AtomicBool::new(false));
    let all_turned = |world: &TestWorld| (0..2).all(|i| world.turned_rad(i).abs() > 0.3);
    let fleet = spawn_fleet(2.into(), stop.clone(), all_turned);
    let report = run(&args(fleet.port), &stop).unwrap();
    fleet.thread.join().unwrap();
    assert!(report.seconds < 60.0, "not both robots moved: {report:?}");
    assert_eq!(report.robots.iter().map(|r| r.robot).collect::<Vec<_>>(), [1, 2]);
    assert!(report.robots.iter().all(|r| r.turns >= 1), "{report:?}");
    assert!(report.commands > 10);
    let link = &report.link;
    assert_eq!((link.connections, link.undecodable, link.tf.lost), (1, 0, 0));
    assert_eq!(link.scans.len(), 2);
    assert!(link.scans.iter().all(|s| s.scans.lost == 0 && s.scans.received > 5), "{:?}", link.scans);
    // odom -> base_footprint of each; map -> map_K -> odom_K of each.
    assert_eq!((link.tf.streams, link.slam_tf.streams), (2, 4));
    assert!(report.map.unwrap().free_m2 > 0.5);
    assert!(report.notices.is_empty(), "{:?}", report.notices);
    assert!(serde_json::to_string(&report).unwrap().contains("jitter_ms"));
    assert!(report.to_string().contains("merged map"));
}

#[test]
fn a_robot_that_another_client_selects_again_and_again_is_not_driven() {
    let (stop, has_moved) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
    let seen = has_moved.clone();
    let has_turned = move |world: &TestWorld| {
        seen.fetch_or(world.turned_rad(1) != 0.0, Ordering::Relaxed);
        world.turned_rad(0).abs() > 0.3
    };
    let fleet = spawn_fleet(2.into(), stop.clone(), has_turned);
    let (address, ended) = (format!("127.0.0.1:{}", fleet.port), stop.clone());
    let other = std::thread::spawn(move || {
        let mut client = Client::new(address);
        let handle = client.handle();
        handle.advertise::<bridge::ros::Int32>("/selected_robot");
        while !ended.load(Ordering::Relaxed) {
            handle.publish("/selected_robot", &bridge::ros::Int32(2));
            client.poll(Instant::now() + Duration::from_millis(10), &mut |_| {});
        }
    });
    let report = run(&OperatorArgs { robots: Some(1), ..args(fleet.port) }, &stop).unwrap();
    fleet.thread.join().unwrap();
    other.join().unwrap();
    assert!(report.seconds < 60.0, "the robot did not move: {report:?}");
    assert!(!has_moved.load(Ordering::Relaxed), "the other robot moved");
}

#[test]
fn all_robots_are_driven_at_once() {
    let stop = Arc::new(AtomicBool::new(false));
    let all_turned = |world: &TestWorld| (0..3).all(|i| world.turned_rad(i).abs() > 0.3);
    let fleet = spawn_fleet(3.into(), stop.clone(), all_turned);
    let report = run(&OperatorArgs { all_at_once: true, ..args(fleet.port) }, &stop).unwrap();
    fleet.thread.join().unwrap();
    assert!(report.seconds < 60.0, "not all robots moved: {report:?}");
    assert_eq!(report.robots.len(), 3);
    assert!(report.notices.is_empty(), "{:?}", report.notices);
}

#[test]
fn robots_with_any_names_are_driven() {
    let all_turned = |world: &TestWorld| (0..world.robot_count()).all(|i| world.turned_rad(i).abs() > 0.3);
    for names in [vec!["alice", "lab/bob"], vec![""]] {
        let names: Vec<String> = names.into_iter().map(str::to_owned).collect();
        let stop = Arc::new(AtomicBool::new(false));
        let fleet = spawn_fleet(RobotNames::new(names.clone()).unwrap(), stop.clone(), all_turned);
        let report = run(&OperatorArgs { names: Some(names.clone()), ..args(fleet.port) }, &stop).unwrap();
        fleet.thread.join().unwrap();
        assert!(report.seconds < 60.0, "not all robots moved: {report:?}");
        assert_eq!((report.robots.len(), report.link.scans.len()), (names.len(), names.len()));
        assert!(report.notices.is_empty(), "{:?}", report.notices);
    }
}

#[test]
fn an_operator_that_may_not_drive_has_failed_and_says_why() {
    /// Steps of the world, 1 s, in which the bridge's refusal arrives.
    const STEPS: u64 = 20;
    let stop = Arc::new(AtomicBool::new(false));
    let config = BridgeConfig { trust_loopback: false, ..BridgeConfig::default() };
    let steps = std::sync::atomic::AtomicU64::new(0);
    let is_refused = move |_: &TestWorld, bridge: &bridge::Bridge| {
        !bridge.waiting_addresses().is_empty() && steps.fetch_add(1, Ordering::Relaxed) > STEPS
    };
    let fleet = spawn_fleet_with(config, 1.into(), stop.clone(), is_refused);
    let report = run(&args(fleet.port), &stop).unwrap();
    fleet.thread.join().unwrap();
    let said = report.check().unwrap_err().to_string();
    assert!(said.contains("127.0.0.1 may not drive yet") && said.contains("mr-slam allow"), "{said}");
}

#[test]
fn an_operator_that_got_no_scans_has_failed() {
    let stop = Arc::new(AtomicBool::new(false));
    let fleet = spawn_fleet(1.into(), stop.clone(), |world| world.turned_rad(0).abs() > 0.1);
    let mut report = run(&args(fleet.port), &stop).unwrap();
    fleet.thread.join().unwrap();
    assert_eq!(report.check(), Ok(()));
    report.link.scans.clear();
    let said = report.check().unwrap_err().to_string();
    assert!(said.contains("no scan of any robot") && said.contains(&report.address), "{said}");
}

#[test]
fn errors_name_what_is_missing() {
    let stop = AtomicBool::new(false);
    let short = |port| OperatorArgs { seconds: Some(0.3), ..args(port) };
    let unused_port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let error = run(&short(unused_port), &stop).unwrap_err();
    assert!(matches!(error, OperatorError::NoConnection { port, .. } if port == unused_port), "{error}");
    assert!(error.to_string().contains("mr-slam up"), "{error}");
    let error = run(&OperatorArgs { seconds: Some(f64::NAN), ..args(unused_port) }, &stop).unwrap_err();
    assert!(error.to_string().contains("--seconds is NaN"), "{error}");
}
