//! An external world over TCP: which sensor data are accepted and refused, and what is sent back.

use crate::client::Client;
use crate::{Served, serve_bridge};
use bridge::ros::{self, LaserScan, Message, TfMessage, TransformStamped, Twist};
use bridge::world::{ExternalWorld, WorldMessage};
use bridge::{Bridge, BridgeConfig, process_clock};
use msg::{Monotonic, Stamp};
use std::cell::RefCell;
use std::rc::Rc;

type WorldMessages = Rc<RefCell<Vec<(String, Stamp)>>>;

/// Runs a test against a bridge of two robots in an external world.
fn with_world(config: BridgeConfig, test: impl AsyncFnOnce(&Served, &WorldMessages)) {
    let messages = WorldMessages::default();
    let sink = messages.clone();
    let world = ExternalWorld::new(2, move |message| {
        sink.borrow_mut().push(match message {
            WorldMessage::Scan(robot, scan) => (format!("{robot}/scan"), scan.header.stamp),
            WorldMessage::Odometry(robot, odometry) => (format!("{robot}/odometry"), odometry.header.stamp),
            WorldMessage::OdometryRestart(robot) => (format!("{robot}/odometry restart"), Stamp(0)),
            WorldMessage::Transforms(robot, transforms) => {
                (format!("{robot}/transforms"), transforms.header.stamp)
            }
            WorldMessage::Battery(robot, battery) => (format!("{robot}/battery"), battery.header.stamp),
            WorldMessage::Clock(clock) => ("clock".into(), clock.header.stamp),
        });
    });
    let stamp_at = |now: Monotonic| Stamp(now.0 as i64);
    serve_bridge(
        |on_command| Bridge::with_external_world(config, world, stamp_at, on_command).unwrap(),
        async |served: &Served| test(served, &messages).await,
    );
}

/// Stamp of the client's messages: its clock is further ahead than this process is old.
const AHEAD: Stamp = Stamp(3600 * 1_000_000_000);

fn scan() -> LaserScan {
    LaserScan {
        stamp: AHEAD,
        angle_increment: 0.1,
        range_min: 0.1,
        range_max: 3.0,
        ranges: vec![1.0; 8],
        ..LaserScan::default()
    }
}

fn edge(parent: &str, child: &str) -> TransformStamped {
    TransformStamped {
        stamp: AHEAD,
        frame_id: parent.into(),
        child_frame_id: child.into(),
        rotation: [0.0, 0.0, 0.0, 1.0],
        ..TransformStamped::default()
    }
}

#[test]
fn scans_transforms_and_clock_are_converted_to_the_runs_time() {
    with_world(BridgeConfig::default(), async |served, messages| {
        let mut client = Client::connect(served.address).await;
        client.publish("/robot2/scan", LaserScan::TYPE).await;
        client.publish("/tf", TfMessage::TYPE).await;
        client.publish("/clock", ros::Clock::TYPE).await;
        client.send("/clock", &ros::Clock { clock: AHEAD }).await;
        client.send("/tf", &TfMessage { transforms: vec![edge("odom_2", "base_footprint_2")] }).await;
        client.send("/robot2/scan", &scan()).await;
        client.settle().await;
        let messages = messages.borrow();
        let names = messages.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>();
        assert_eq!(names, ["clock", "robot2/odometry", "robot2/transforms", "robot2/scan"]);
        let clock = served.bridge.clients(process_clock())[0].clock.unwrap();
        assert!(
            (messages[3].1.seconds() - (AHEAD.seconds() - clock.offset_s)).abs() < 1e-6,
            "{messages:?} {clock:?}"
        );
        assert!(messages[3].1 < AHEAD && clock.messages == 3, "{clock:?}");
        assert_eq!(served.bridge.counters().refused, 0);
    });
}

#[test]
fn only_slams_transform_is_refused_and_the_error_names_it() {
    with_world(BridgeConfig::default(), async |served, messages| {
        let mut viewer = Client::connect(served.address).await;
        viewer.subscribe("/tf", TfMessage::TYPE).await;
        viewer.settle().await;
        let mut client = Client::connect(served.address).await;
        client.publish("/tf", TfMessage::TYPE).await;
        let transforms = vec![edge("map", "odom_1"), edge("odom_1", "base_link_1"), edge("world", "table")];
        client.send("/tf", &TfMessage { transforms }).await;
        let error = client.error().await;
        assert!(error.contains("map -> odom_1 is refused") && error.contains("SLAM owns"), "{error}");
        assert_eq!(messages.borrow().len(), 2, "its odometry is taken: {messages:?}");
        // The bridge itself forwards the transforms of other frames only.
        let passed: TfMessage = viewer.message("/tf").await;
        assert_eq!(passed.transforms.len(), 1);
        assert_eq!(passed.transforms[0].child_frame_id, "table");
        assert!(passed.transforms[0].stamp < AHEAD, "on our time");
    });
}

#[test]
fn a_client_without_permission_sends_no_sensor_data() {
    let config = BridgeConfig { trust_loopback: false, ..BridgeConfig::default() };
    with_world(config, async |served, messages| {
        let mut client = Client::connect(served.address).await;
        client.publish("/robot1/scan", LaserScan::TYPE).await;
        client.send("/robot1/scan", &scan()).await;
        assert!(client.error().await.contains("mr-slam allow 127.0.0.1"));
        assert!(messages.borrow().is_empty());
        assert_eq!(served.bridge.waiting_addresses(), [std::net::IpAddr::from([127, 0, 0, 1])]);
        served.bridge.allow(served.bridge.waiting_addresses()[0]).unwrap();
        client.send("/robot1/scan", &scan()).await;
        client.settle().await;
        assert_eq!(messages.borrow().len(), 1);
    });
}

#[test]
fn velocities_are_published_to_external_robots() {
    with_world(BridgeConfig::default(), async |served, _| {
        let mut robots = Client::connect(served.address).await;
        robots.subscribe("/robot1/cmd_vel", Twist::TYPE).await;
        assert_eq!(
            robots.message::<Twist>("/robot1/cmd_vel").await,
            Twist::default(),
            "before anything else"
        );
        let mut driver = Client::connect(served.address).await;
        driver.publish("/cmd_vel", Twist::TYPE).await;
        let twist = Twist { linear: [0.1, 0.0, 0.0], angular: [0.0, 0.0, 0.5] };
        driver.send("/cmd_vel", &twist).await;
        let received = async |robots: &mut Client| loop {
            let velocity = robots.message::<Twist>("/robot1/cmd_vel").await;
            if velocity != Twist::default() {
                return velocity;
            }
        };
        assert_eq!(received(&mut robots).await, twist);
        driver.send("/cmd_vel", &Twist { linear: [5.0, 1.0, 1.0], angular: [1.0, 1.0, 9.0] }).await;
        let clamped = Twist { linear: [0.22, 0.0, 0.0], angular: [0.0, 0.0, 2.84] };
        assert_eq!(received(&mut robots).await, clamped);
        driver.abort();
        assert_eq!(robots.message::<Twist>("/robot1/cmd_vel").await, Twist::default(), "its driver vanished");
    });
}

#[test]
fn another_client_sends_a_robots_data_only_when_its_source_has_left() {
    with_world(BridgeConfig::default(), async |served, messages| {
        let mut first = Client::connect(served.address).await;
        let mut second = Client::connect(served.address).await;
        for client in [&mut first, &mut second] {
            client.publish("/robot1/scan", LaserScan::TYPE).await;
            client.send("/robot1/scan", &scan()).await;
            client.settle().await;
        }
        assert_eq!(messages.borrow().len(), 1);
        drop(first);
        while served.bridge.counters().clients > 1 {
            tokio::task::yield_now().await;
        }
        let later = LaserScan { stamp: Stamp(AHEAD.0 + 1_000_000_000), ..scan() };
        second.send("/robot1/scan", &later).await;
        second.settle().await;
        assert_eq!(messages.borrow().len(), 2);
    });
}
