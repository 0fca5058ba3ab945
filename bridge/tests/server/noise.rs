//! Valid frames with random contents.

use crate::client::Client;
use crate::with_bridge;
use bridge::command::name;
use bridge::frame::Side;
use proptest::prelude::*;
use proptest::sample::select;

fn a_name() -> impl Strategy<Value = Vec<u8>> {
    let known = [
        name::SUBSCRIBE,
        name::PUBLISH,
        name::ROS_SERVICE,
        name::UNITY_SERVICE,
        name::REQUEST,
        name::RESPONSE,
        name::TOPIC_LIST,
        name::REMOVE_SUBSCRIBER,
        name::REMOVE_PUBLISHER,
        name::REMOVE_ROS_SERVICE,
        name::REMOVE_UNITY_SERVICE,
        "/cmd_vel",
        "/tf",
        "/a",
        "a",
        "/emergency_stop",
        "/selected_robot",
        "",
        "__",
    ];
    prop_oneof![
        9 => select(known.map(|name| name.as_bytes().to_vec()).to_vec()),
        1 => prop::collection::vec(any::<u8>(), 0..20),
    ]
}

fn a_payload() -> impl Strategy<Value = Vec<u8>> {
    let topics = ["/a", "a", "/cmd_vel", "/tf", "/clock", "/emergency_stop", "", "/robot1/cmd_vel", "//"];
    let classes = [
        "std_msgs/String",
        "geometry_msgs/Twist",
        "tf2_msgs/TFMessage",
        "std_srvs/Trigger",
        "rosgraph_msgs/Clock",
        "std_msgs/Bool",
        "x",
    ];
    let registration = (select(topics.to_vec()), select(classes.to_vec()), any::<i64>(), any::<bool>()).prop_map(
        |(topic, class, size, latch)| {
            let body = serde_json::json!({"topic": topic, "message_name": class, "queue_size": size, "latch": latch});
            body.to_string().into_bytes()
        },
    );
    let call = (990_i64..1010).prop_map(|number| format!("{{\"srv_id\":{number}}}").into_bytes());
    let cdr = prop::collection::vec(select(vec![0_u8, 1, 2, 255]), 0..100)
        .prop_map(|bytes| [&[0, 1, 0, 0], bytes.as_slice()].concat());
    prop_oneof![4 => registration, 2 => call, 2 => cdr, 1 => prop::collection::vec(any::<u8>(), 0..100)]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn the_connection_stays_open(frames in prop::collection::vec((a_name(), a_payload()), 1..60)) {
        let mut bytes = Vec::new();
        for (name, payload) in &frames {
            match core::str::from_utf8(name) {
                Ok(name) => Side::Client.write(&mut bytes, name, payload),
                Err(_) => {
                    bytes.extend_from_slice(&(name.len() as u32).to_le_bytes());
                    bytes.extend_from_slice(name);
                    bytes.extend_from_slice(&(payload.len() as u32).to_le_bytes());
                    bytes.extend_from_slice(payload);
                }
            }
        }
        with_bridge(Default::default(), async |served| {
            let mut client = Client::connect(served.address).await;
            client.raw(&bytes).await;
            client.settle().await;
            drop(client);
            Client::connect(served.address).await.settle().await;
            let finite = |(_, forward, turn): &(usize, f64, f64)| forward.is_finite() && turn.is_finite();
            assert!(served.commands.borrow().iter().all(finite));
        });
    }
}
