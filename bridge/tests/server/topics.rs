//! Messages from the fleet to clients, and between clients.

use crate::client::Client;
use crate::{header, robot, with_bridge};
use bridge::command::{HANDSHAKE, Registration, name};
use bridge::frame::Side;
use bridge::ros::{
    Clock, Dialect, Empty, Float32MultiArray, LaserScan, Message, OccupancyGrid, Odometry, Text, TfMessage,
    TransformStamped, Twist, decode_as, encode_as,
};
use bridge::{BridgeConfig, FleetMessage};
use bytemuck::Zeroable;
use msg::{
    FleetStats, GridHeader, GridView, MapTransform, MapTransforms, Pose2, PoseEstimate, Stamp, Transforms,
};

#[test]
fn the_handshake_is_the_first_frame_byte_for_byte() {
    with_bridge(Default::default(), async |served| {
        let mut client = Client::connect_raw(served.address).await;
        let (name, payload) = client.next().await.unwrap();
        assert_eq!((name.as_str(), payload.as_slice()), (name::HANDSHAKE, HANDSHAKE));
        assert_eq!(HANDSHAKE.len(), 61);
    });
}

#[test]
fn the_fleets_topics_are_listed_without_subscribers() {
    with_bridge(Default::default(), async |served| {
        let (_, list) = Client::connect(served.address).await.settle().await;
        assert_eq!(list.topics.len(), list.types.len());
        let class_of = |topic: &str| {
            let place = list.topics.iter().position(|name| name == topic)?;
            Some(list.types[place].as_str())
        };
        for topic in ["/robot1/scan", "/robot2/scan"] {
            assert_eq!(class_of(topic), Some("sensor_msgs/LaserScan"));
        }
        assert_eq!(class_of("/robot2/map"), Some("nav_msgs/OccupancyGrid"));
        assert_eq!(class_of("/tf"), Some("tf2_msgs/TFMessage"));
        assert_eq!(class_of("/clock"), Some("rosgraph_msgs/Clock"));
        assert_eq!(class_of("/cmd_vel_2"), Some("geometry_msgs/Twist"));
        assert_eq!(class_of("/robot3/scan"), None, "the fleet has two robots");
    });
}

#[test]
fn each_type_of_message_reaches_its_subscriber() {
    with_bridge(Default::default(), async |served| {
        let mut client = Client::connect(served.address).await;
        client.subscribe("/robot2/scan", LaserScan::TYPE).await;
        client.subscribe("/robot2/odom", Odometry::TYPE).await;
        client.subscribe("/robot2/slam_stats", Float32MultiArray::TYPE).await;
        client.subscribe("/clock", Clock::TYPE).await;
        client.subscribe("/tf", TfMessage::TYPE).await;
        client.settle().await;

        let mut scan = msg::Scan::zeroed();
        (scan.header, scan.len) = (header(5), 2);
        served.bridge.publish(FleetMessage::Scan(robot(1), &scan));
        served.bridge.publish(FleetMessage::Scan(robot(2), &scan));
        let got: LaserScan = client.message("/robot2/scan").await;
        assert_eq!((got.frame_id.as_str(), got.ranges.len()), ("base_scan_2", 2));

        served.bridge.publish(FleetMessage::Odometry(
            robot(2),
            &msg::Odometry { header: header(6), ..Default::default() },
        ));
        assert_eq!(client.message::<Odometry>("/robot2/odom").await.child_frame_id, "base_footprint_2");
        served.bridge.publish(FleetMessage::Clock(&msg::Clock { header: header(1_500_000_000) }));
        assert_eq!(client.message::<Clock>("/clock").await.clock, Stamp(1_500_000_000));

        let mut stats = FleetStats::default();
        (stats.robots[1].free_cells, stats.robots[1].resolution_m) = (70, 0.05);
        served.bridge.publish(FleetMessage::Stats(&stats));
        let got: Float32MultiArray = client.message("/robot2/slam_stats").await;
        assert_eq!(got.data, [70.0, 0.0, 0.0, 70.0, 0.0, 0.0, 0.05]);

        served.bridge.publish(FleetMessage::Transforms(
            robot(2),
            &Transforms { header: header(8), ..Default::default() },
        ));
        assert_eq!(client.message::<TfMessage>("/tf").await.transforms, []);
        // While `odom` lies nowhere, no transform of it is published.
        served.bridge.publish(FleetMessage::PoseEstimate(
            robot(1),
            &PoseEstimate { header: header(9), map_from_odom_unknown: 1, ..Default::default() },
        ));
        let map_from_odom = Pose2::new(1.0, 0.0, 0.0);
        served.bridge.publish(FleetMessage::PoseEstimate(
            robot(2),
            &PoseEstimate { header: header(9), map_from_odom, ..Default::default() },
        ));
        let tf: TfMessage = client.message("/tf").await;
        assert_eq!(tf.transforms[0].child_frame_id, "odom_2");
    });
}

#[test]
fn messages_of_robots_beyond_the_fleet_are_dropped() {
    with_bridge(Default::default(), async |served| {
        served.bridge.publish(FleetMessage::Scan(robot(3), &msg::Scan::zeroed()));
        served.bridge.publish(FleetMessage::PoseEstimate(robot(16), &PoseEstimate::default()));
        assert_eq!(served.bridge.counters().sent, 0);
    });
}

fn publish_map(served: &crate::Served, stamp: i64, width: u32) {
    let shape =
        GridHeader { header: header(stamp), width, height: 1, resolution_m: 0.05, ..Default::default() };
    served
        .bridge
        .publish(FleetMessage::Map(robot(1), GridView::new(&shape, &vec![100; width as usize]).unwrap()));
}

#[test]
fn a_late_subscriber_gets_the_newest_map_once() {
    with_bridge(Default::default(), async |served| {
        publish_map(served, 1, 3);
        publish_map(served, 2, 5);
        let mut client = Client::connect(served.address).await;
        for _ in 0..3 {
            client.subscribe("/robot1/map", OccupancyGrid::TYPE).await;
        }
        client.subscribe("/merged_map", OccupancyGrid::TYPE).await;
        let (before, _) = client.settle().await;
        assert_eq!(before.len(), 1, "one map, whatever was registered twice");
        let map: OccupancyGrid = bridge::ros::decode(&before[0].1).unwrap();
        assert_eq!((map.stamp, map.width, map.frame_id.as_str()), (Stamp(2), 5, "map_1"));
        publish_map(served, 3, 7);
        assert_eq!(client.message::<OccupancyGrid>("/robot1/map").await.width, 7);
    });
}

#[test]
fn a_late_subscriber_gets_the_map_transforms() {
    with_bridge(Default::default(), async |served| {
        let mut map_transforms = MapTransforms::default();
        map_transforms.robots[0] =
            MapTransform { map_from_robot_map: Pose2::new(2.0, 0.0, 0.0), known: 1, map_frame: 0 };
        served.bridge.publish(FleetMessage::MapTransforms(&map_transforms));
        served.bridge.publish(FleetMessage::Clock(&msg::Clock { header: header(77) }));
        let mut client = Client::connect(served.address).await;
        client.subscribe("/tf", TfMessage::TYPE).await;
        for _ in 0..2 {
            // Once at the subscription, and again after a second.
            let tf: TfMessage = client.message("/tf").await;
            let names = (tf.transforms[0].frame_id.as_str(), tf.transforms[0].child_frame_id.as_str());
            assert_eq!((names, tf.transforms[0].stamp), (("map", "map_1"), Stamp(77)));
        }
    });
}

#[test]
fn clients_receive_each_others_messages_and_their_own() {
    with_bridge(Default::default(), async |served| {
        let (mut one, mut two) =
            (Client::connect(served.address).await, Client::connect(served.address).await);
        for client in [&mut one, &mut two] {
            client.subscribe("/chat", Text::TYPE).await;
            client.publish("/chat", Text::TYPE).await;
            client.publish("/chat", Text::TYPE).await;
            client.settle().await;
        }
        one.send("/chat", &Text("hello".into())).await;
        two.send("/chat", &Text("you".into())).await;
        for client in [&mut one, &mut two] {
            let mut texts =
                [client.message::<Text>("/chat").await.0, client.message::<Text>("/chat").await.0];
            texts.sort();
            assert_eq!(texts, ["hello", "you"]);
        }
        two.abort();
        one.send("/chat", &Text("still here".into())).await;
        assert_eq!(one.message::<Text>("/chat").await.0, "still here");
        let (after, list) = one.settle().await;
        assert!(after.is_empty() && list.topics.contains(&"/chat".to_owned()));
    });
}

#[test]
fn a_message_without_fields_gets_its_dummy_byte() {
    with_bridge(Default::default(), async |served| {
        let mut client = Client::connect(served.address).await;
        client.publish("/bell", Empty::TYPE).await;
        client.subscribe("/bell", Empty::TYPE).await;
        // As Unity's connector writes it: the encapsulation header alone.
        client.send_bytes("/bell", &[0, 1, 0, 0]).await;
        let (name, payload) = client.next().await.unwrap();
        assert_eq!((name.as_str(), payload.as_slice()), ("/bell", &[0, 1, 0, 0, 0][..]));
    });
}

#[test]
fn a_topic_is_removed_with_its_last_subscriber_and_publisher() {
    with_bridge(Default::default(), async |served| {
        let mut client = Client::connect(served.address).await;
        client.subscribe("/chat", Text::TYPE).await;
        client.publish("/chat", Text::TYPE).await;
        client.register(name::REMOVE_SUBSCRIBER, "/chat", "").await;
        client.send("/chat", &Text("no subscriber".into())).await;
        let (received, list) = client.settle().await;
        assert!(received.is_empty() && list.topics.contains(&"/chat".to_owned()));
        client.register(name::REMOVE_PUBLISHER, "/chat", "").await;
        let (_, list) = client.settle().await;
        assert!(!list.topics.contains(&"/chat".to_owned()));
        client.send("/chat", &Text("unregistered".into())).await;
        assert!(client.error().await.contains("'/chat' is not registered"));
        // The name is free for another type.
        client.subscribe("/chat", Twist::TYPE).await;
        assert!(client.settle().await.0.is_empty());
    });
}

#[test]
fn a_name_without_slash_is_the_same_topic_and_is_sent_as_written() {
    with_bridge(Default::default(), async |served| {
        let (mut one, mut two) =
            (Client::connect(served.address).await, Client::connect(served.address).await);
        one.subscribe("pos_rot", Text::TYPE).await;
        one.settle().await;
        two.publish("/pos_rot", Text::TYPE).await;
        two.subscribe("/pos_rot", Text::TYPE).await;
        two.send("/pos_rot", &Text("x".into())).await;
        assert_eq!(one.message::<Text>("pos_rot").await.0, "x");
        assert_eq!(two.message::<Text>("/pos_rot").await.0, "x");
        one.publish("pos_rot", Text::TYPE).await;
        one.send("pos_rot", &Text("y".into())).await;
        assert_eq!(two.message::<Text>("/pos_rot").await.0, "y");
    });
}

#[test]
fn a_clients_latched_message_reaches_late_subscribers() {
    with_bridge(Default::default(), async |served| {
        let mut one = Client::connect(served.address).await;
        let about = Registration {
            topic: "/note".into(),
            message_name: Text::TYPE.into(),
            queue_size: 1,
            latch: true,
        };
        one.command(name::PUBLISH, &about).await;
        one.send("/note", &Text("old".into())).await;
        one.send("/note", &Text("new".into())).await;
        one.settle().await;
        let mut two = Client::connect(served.address).await;
        two.subscribe("/note", Text::TYPE).await;
        assert_eq!(two.message::<Text>("/note").await.0, "new");
    });
}

#[test]
fn the_first_user_sets_a_topics_type_and_errors_name_the_mistake() {
    with_bridge(Default::default(), async |served| {
        let mut client = Client::connect(served.address).await;
        let mut refused = async |command: &str, topic: &str, class: &str| {
            client.register(command, topic, class).await;
            client.error().await
        };
        let text = refused(name::SUBSCRIBE, "/tf", Text::TYPE).await;
        assert!(text.contains("'/tf' is tf2_msgs/TFMessage, not std_msgs/String"), "{text}");
        let text = refused(name::SUBSCRIBE, "/x", "no_such_pkg/Nope").await;
        assert!(text.contains("'no_such_pkg/Nope'") && text.contains("'/x'"), "{text}");
        let text = refused(name::PUBLISH, "/clock", Clock::TYPE).await;
        assert!(text.contains("published by the fleet"), "{text}");
        let text = refused(name::SUBSCRIBE, "", Text::TYPE).await;
        assert!(text.contains("empty"), "{text}");
        let text = refused("__no_such_command", "/x", Text::TYPE).await;
        assert!(text.contains("__no_such_command: unknown command"), "{text}");
        let text = refused(name::REMOVE_SUBSCRIBER, "/never", "").await;
        assert!(text.contains("no topic '/never'"), "{text}");
        client.raw(b"\x0c\0\0\0__subscribe\0\0\0\0\0").await;
        let text = client.error().await;
        assert!(text.contains("JSON is not valid"), "{text}");
        assert_eq!(served.bridge.counters().clients, 1, "the link stays");
    });
}

#[test]
fn slams_transforms_are_slams() {
    with_bridge(Default::default(), async |served| {
        let mut client = Client::connect(served.address).await;
        client.subscribe("/tf", TfMessage::TYPE).await;
        client.publish("/tf", TfMessage::TYPE).await;
        let edge = |parent: &str, child: &str| TransformStamped {
            frame_id: parent.into(),
            child_frame_id: child.into(),
            ..Default::default()
        };
        let tree = |transform| TfMessage { transforms: vec![transform] };
        client.send("/tf", &tree(edge("map", "odom_1"))).await;
        let text = client.error().await;
        assert!(text.contains("map -> odom_1") && text.contains("SLAM owns"), "{text}");
        client.send("/tf", &tree(edge("map", "headset"))).await;
        let tf: TfMessage = client.message("/tf").await;
        assert_eq!(tf.transforms[0].child_frame_id, "headset");
    });
}

#[test]
fn clients_built_for_ros_1_get_and_send_its_encoding() {
    let config = BridgeConfig { payloads: Dialect::Ros1, ..Default::default() };
    with_bridge(config, async |served| {
        let mut client = Client::connect_raw(served.address).await;
        let (_, payload) = client.next().await.unwrap();
        assert!(String::from_utf8(payload).unwrap().contains("ROS1"));
        client.subscribe("/robot1/scan", LaserScan::TYPE).await;
        client.publish("/cmd_vel", Twist::TYPE).await;
        client.settle().await;
        let mut scan = msg::Scan::zeroed();
        (scan.header, scan.len, scan.ranges_m[0]) = (header(3_000_000_007), 1, 2.5);
        served.bridge.publish(FleetMessage::Scan(robot(1), &scan));
        let (_, payload) = client.next().await.unwrap();
        // seq, secs, nsecs, frame, 7 floats, one range, no intensities.
        assert_eq!(payload.len(), 4 + 8 + 4 + "base_scan_1".len() + 28 + 8 + 4);
        assert_eq!(payload[..16], [0, 0, 0, 0, 3, 0, 0, 0, 7, 0, 0, 0, 11, 0, 0, 0]);
        let scan: LaserScan = decode_as(Dialect::Ros1, &payload).unwrap();
        assert_eq!((scan.frame_id.as_str(), scan.ranges.as_slice()), ("base_scan_1", &[2.5][..]));

        let mut twist = Vec::new();
        encode_as(Dialect::Ros1, &Twist { linear: [0.1, 0.0, 0.0], ..Default::default() }, &mut twist);
        assert_eq!(twist.len(), 48);
        let mut frame = Vec::new();
        // The ROS 1 connector ends nothing in NUL.
        Side::Server.write(&mut frame, "/cmd_vel", &twist);
        client.raw(&frame).await;
        client.settle().await;
        assert_eq!(*served.commands.borrow(), [(1, 0.1, 0.0)]);
    });
}
