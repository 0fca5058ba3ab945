//! Velocities from clients: they reach the right robot, from the right client, and only if they are valid.

use crate::client::Client;
use crate::{serve_bridge, with_bridge};
use bridge::command::name;
use bridge::frame::Side;
use bridge::ros::{Bool, Empty, HandInputs, Int32, Joy, Message, Twist, TwistStamped, encode};
use bridge::{Bridge, BridgeConfig, FleetMessage, Permission};
use std::net::{IpAddr, Ipv4Addr};

fn twist(forward: f64, turn: f64) -> Twist {
    Twist { linear: [forward, 0.0, 0.0], angular: [0.0, 0.0, turn] }
}

async fn driver(served: &crate::Served, topics: &[&str]) -> Client {
    let mut client = Client::connect(served.address).await;
    for topic in topics {
        client.publish(topic, Twist::TYPE).await;
    }
    client
}

#[test]
fn each_topic_drives_its_robot() {
    with_bridge(Default::default(), async |served| {
        let mut client = driver(served, &["/cmd_vel", "/cmd_vel_2", "/robot1/cmd_vel"]).await;
        client.subscribe("/selected_robot", Int32::TYPE).await;
        assert_eq!(client.message::<Int32>("/selected_robot").await, Int32(1));
        client.send("/cmd_vel", &twist(0.1, 0.0)).await;
        client.send("/cmd_vel_2", &twist(0.2, 0.0)).await;
        client.send("/robot1/cmd_vel", &twist(0.15, -1.0)).await;
        client.publish("/selected_robot", Int32::TYPE).await;
        client.send("/selected_robot", &Int32(2)).await;
        client.send("/cmd_vel", &twist(0.21, 0.0)).await;
        assert_eq!(client.message::<Int32>("/selected_robot").await, Int32(2));
        client.settle().await;
        let want = [(1, 0.1, 0.0), (2, 0.2, 0.0), (1, 0.15, -1.0), (2, 0.21, 0.0)];
        assert_eq!(*served.commands.borrow(), want);
        client.send("/selected_robot", &Int32(3)).await;
        assert!(client.error().await.contains("no robot 3: the fleet has 1 to 2"));
        assert_eq!(served.bridge.selected_robot().number(), 2);
    });
}

#[test]
fn a_stamped_twist_is_accepted_on_a_robots_topic() {
    with_bridge(Default::default(), async |served| {
        let mut client = Client::connect(served.address).await;
        client.publish("/robot2/cmd_vel", TwistStamped::TYPE).await;
        client.subscribe("/robot2/cmd_vel", Twist::TYPE).await;
        client.send("/robot2/cmd_vel", &TwistStamped { twist: twist(0.1, 0.5), ..Default::default() }).await;
        assert_eq!(client.message::<Twist>("/robot2/cmd_vel").await, twist(0.1, 0.5));
        assert_eq!(*served.commands.borrow(), [(2, 0.1, 0.5)]);
    });
}

#[test]
fn an_invalid_velocity_moves_nothing_and_gets_an_error() {
    with_bridge(Default::default(), async |served| {
        let mut client = driver(served, &["/cmd_vel", "/cmd_vel_2"]).await;
        client.send("/cmd_vel", &twist(0.1, f64::NAN)).await;
        let text = client.error().await;
        assert!(text.contains("'/cmd_vel'") && text.contains("angular.z is NaN"), "{text}");
        client.send_bytes("/cmd_vel_2", &[0, 1, 0, 0, 1, 2, 3]).await;
        let text = client.error().await;
        assert!(text.contains("linear.x needs 8 bytes"), "{text}");
        client.send("/robot1/cmd_vel", &twist(0.1, 0.0)).await;
        assert!(client.error().await.contains("'/robot1/cmd_vel' is not registered"));
        assert_eq!(*served.commands.borrow(), []);
        assert_eq!(served.bridge.counters().refused, 3);
    });
}

#[test]
fn the_same_refusal_is_counted_each_time_and_reported_once() {
    with_bridge(Default::default(), async |served| {
        let mut client = driver(served, &["/cmd_vel"]).await;
        for _ in 0..20 {
            client.send("/cmd_vel", &twist(f64::INFINITY, 0.0)).await;
        }
        let (received, _) = client.settle().await;
        assert!((1..=2).contains(&received.len()), "{}", received.len());
        assert_eq!(served.bridge.counters().refused, 20);
    });
}

/// Unity's connector makes one write for each field, with Nagle's algorithm on.
#[test]
fn a_twist_written_field_by_field_is_one_command() {
    with_bridge(Default::default(), async |served| {
        let mut client = driver(served, &["/cmd_vel"]).await;
        client.stream.set_nodelay(false).unwrap();
        let mut frame = Vec::new();
        Side::Client.write_with(&mut frame, "/cmd_vel", |out| encode(&twist(0.1, 0.2), out));
        for field in
            [&frame[..4], &frame[4..13], &frame[13..17], &frame[17..21], &frame[21..29], &frame[29..]]
        {
            client.raw(field).await;
        }
        client.settle().await;
        assert_eq!(*served.commands.borrow(), [(1, 0.1, 0.2)]);
    });
}

#[test]
fn the_robots_of_a_client_that_vanishes_are_stopped() {
    with_bridge(Default::default(), async |served| {
        let mut witness = Client::connect(served.address).await;
        let mut client = driver(served, &["/cmd_vel_2"]).await;
        client.send("/cmd_vel_2", &twist(0.1, 0.0)).await;
        client.settle().await;
        client.abort();
        while served.bridge.counters().clients > 1 {
            witness.settle().await;
        }
        assert_eq!(*served.commands.borrow(), [(2, 0.1, 0.0), (2, 0.0, 0.0)]);
    });
}

#[test]
fn a_robot_has_one_driver_until_another_takes_over() {
    with_bridge(BridgeConfig { lease_s: 3600.0, ..Default::default() }, async |served| {
        let mut one = driver(served, &["/cmd_vel_1"]).await;
        let mut two = driver(served, &["/cmd_vel_1", "/cmd_vel_2"]).await;
        two.publish("/take_control", Int32::TYPE).await;
        one.send("/cmd_vel_1", &twist(0.1, 0.0)).await;
        one.settle().await;
        two.send("/cmd_vel_1", &twist(0.2, 0.0)).await;
        let text = two.error().await;
        assert!(text.contains("robot1 is driven by 127.0.0.1") && text.contains("/take_control"), "{text}");
        two.send("/cmd_vel_1", &twist(0.0, 0.0)).await;
        two.send("/cmd_vel_2", &twist(0.2, 0.0)).await;
        two.settle().await;
        assert_eq!(*served.commands.borrow(), [(1, 0.1, 0.0), (2, 0.2, 0.0)]);
        two.send("/take_control", &Int32(1)).await;
        assert!(one.notice(name::WARN).await.contains("taken over robot1"));
        two.send("/cmd_vel_1", &twist(0.15, 0.0)).await;
        two.settle().await;
        one.send("/cmd_vel_1", &twist(0.1, 0.0)).await;
        assert!(one.error().await.contains("driven by"));
        assert_eq!(served.commands.borrow()[2..], [(1, 0.0, 0.0), (1, 0.15, 0.0)]);
    });
}

#[test]
fn the_emergency_stop_holds_until_it_is_released() {
    with_bridge(Default::default(), async |served| {
        let mut client = driver(served, &["/cmd_vel"]).await;
        client.publish("/emergency_stop", Bool::TYPE).await;
        client.publish("/emergency_stop_release", Empty::TYPE).await;
        client.send("/cmd_vel", &twist(0.1, 0.0)).await;
        client.send("/emergency_stop", &Bool(true)).await;
        client.send("/emergency_stop", &Bool(false)).await;
        client.send("/cmd_vel", &twist(0.1, 0.0)).await;
        let text = client.error().await;
        assert!(text.contains("emergency stop is set"), "{text}");
        assert_eq!(*served.commands.borrow(), [(1, 0.1, 0.0), (1, 0.0, 0.0)]);
        let mut late = Client::connect(served.address).await;
        late.subscribe("/emergency_stop", Bool::TYPE).await;
        assert_eq!(late.message::<Bool>("/emergency_stop").await, Bool(true));
        // Unity's Empty is the encapsulation header alone.
        client.send_bytes("/emergency_stop_release", &[0, 1, 0, 0]).await;
        assert_eq!(late.message::<Bool>("/emergency_stop").await, Bool(false));
        client.send("/cmd_vel", &twist(0.1, 0.0)).await;
        client.settle().await;
        assert_eq!(served.commands.borrow().last(), Some(&(1, 0.1, 0.0)));
    });
}

#[test]
fn an_unknown_client_needs_permission_to_drive_but_may_stop_the_robots() {
    let config = BridgeConfig { trust_loopback: false, ..Default::default() };
    with_bridge(config, async |served| {
        let here = IpAddr::V4(Ipv4Addr::LOCALHOST);
        let mut client = driver(served, &["/cmd_vel"]).await;
        client.subscribe("/clock", "rosgraph_msgs/Clock").await;
        client.publish("/emergency_stop", Bool::TYPE).await;
        client.send("/cmd_vel", &twist(0.1, 0.0)).await;
        let text = client.error().await;
        assert!(text.contains("mr-slam allow 127.0.0.1"), "{text}");
        assert_eq!(served.bridge.waiting_addresses(), [here]);
        client.send("/emergency_stop", &Bool(true)).await;
        client.settle().await;
        assert!(served.bridge.is_stopped());
        served.bridge.release_stop();
        served.bridge.allow(here).unwrap();
        assert!(client.notice(name::LOG).await.contains("may drive"));
        assert!(served.bridge.waiting_addresses().is_empty());
        client.send("/cmd_vel", &twist(0.2, 0.0)).await;
        client.settle().await;
        assert_eq!(served.commands.borrow().last(), Some(&(1, 0.2, 0.0)));
        served.bridge.deny(here).unwrap();
        assert_eq!(served.commands.borrow().last(), Some(&(1, 0.0, 0.0)), "what it drove stops");
        client.send("/emergency_stop", &Bool(true)).await;
        assert!(client.error().await.contains("denied"));
        assert!(!served.bridge.is_stopped(), "a denied address cannot keep the fleet stopped");
    });
}

#[test]
fn watching_can_need_permission() {
    let config = BridgeConfig { trust_loopback: false, watch: Permission::Allowed, ..Default::default() };
    with_bridge(config, async |served| {
        let mut client = Client::connect(served.address).await;
        client.subscribe("/clock", "rosgraph_msgs/Clock").await;
        assert!(client.error().await.contains("may not watch"));
        served.bridge.allow(IpAddr::V4(Ipv4Addr::LOCALHOST)).unwrap();
        client.subscribe("/clock", "rosgraph_msgs/Clock").await;
        client.settle().await;
        served.bridge.publish(FleetMessage::Clock(&msg::Clock::default()));
        client.message::<bridge::ros::Clock>("/clock").await;
    });
}

#[test]
fn a_thumb_stick_drives_while_its_grip_is_held() {
    with_bridge(Default::default(), async |served| {
        let mut client = Client::connect(served.address).await;
        client.publish("/quest/joystick", Joy::TYPE).await;
        client.subscribe("/quest/joystick", Joy::TYPE).await;
        client.publish("/selected_robot", Int32::TYPE).await;
        let joy = |y: f32, grip: f32| Joy {
            axes: vec![0.0, y, 0.0, 0.0, 0.0, 0.0, 0.0, grip],
            ..Default::default()
        };
        client.send("/quest/joystick", &joy(1.0, 0.0)).await;
        client.settle().await;
        assert_eq!(*served.commands.borrow(), [], "an idle joystick says nothing");
        client.send("/quest/joystick", &joy(1.0, 1.0)).await;
        client.send("/selected_robot", &Int32(2)).await;
        client.send("/quest/joystick", &joy(-1.0, 1.0)).await;
        client.send("/quest/joystick", &joy(-1.0, 0.0)).await;
        client.send("/quest/joystick", &joy(-1.0, 0.0)).await;
        client.settle().await;
        let want = [(1, 0.15, 0.0), (1, 0.0, 0.0), (2, -0.15, 0.0), (2, 0.0, 0.0)];
        assert_eq!(*served.commands.borrow(), want);
        client.send("/quest/joystick", &joy(f32::NAN, 1.0)).await;
        assert!(client.error().await.contains("axis"));
    });
}

#[test]
fn a_quest2ros_hand_controller_drives() {
    with_bridge(Default::default(), async |served| {
        let mut client = Client::connect(served.address).await;
        // That application leaves out the slash.
        client.publish("q2r_right_hand_inputs", HandInputs::TYPE).await;
        let hand = HandInputs { thumb_stick_horizontal: -1.0, press_middle: 1.0, ..Default::default() };
        client.send("q2r_right_hand_inputs", &hand).await;
        client.settle().await;
        assert_eq!(*served.commands.borrow(), [(1, 0.0, 1.5)]);
    });
}

#[test]
fn an_idle_stick_needs_no_permission() {
    with_bridge(BridgeConfig { trust_loopback: false, ..Default::default() }, async |served| {
        let mut client = Client::connect(served.address).await;
        client.publish("q2r_right_hand_inputs", HandInputs::TYPE).await;
        client.send("q2r_right_hand_inputs", &HandInputs::default()).await;
        client.settle().await;
        assert!(served.bridge.waiting_addresses().is_empty());
        let hand = HandInputs { thumb_stick_vertical: 1.0, press_middle: 1.0, ..Default::default() };
        client.send("q2r_right_hand_inputs", &hand).await;
        assert!(client.error().await.contains("may not drive yet"));
        assert_eq!(*served.commands.borrow(), []);
    });
}

/// The server's own timer stops the robot: its driver stays connected and says nothing more.
#[test]
fn the_robot_of_a_silent_driver_is_stopped() {
    let make = |on_command| Bridge::new(BridgeConfig::default(), 2, on_command).unwrap();
    serve_bridge(make, async |served| {
        let mut client = driver(served, &["/cmd_vel_2"]).await;
        client.subscribe("/robot2/cmd_vel", Twist::TYPE).await;
        client.send("/cmd_vel_2", &twist(5.0, 9.0)).await;
        while client.message::<Twist>("/robot2/cmd_vel").await == Twist::default() {}
        assert_eq!(client.message::<Twist>("/robot2/cmd_vel").await, Twist::default());
        assert_eq!(*served.commands.borrow(), [(2, 0.22, 2.84), (2, 0.0, 0.0)]);
    });
}
