//! Services: both directions, and every way of getting no answer.

use crate::client::{Client, Received};
use crate::with_bridge;
use bridge::BridgeConfig;
use bridge::command::{Call, name};
use bridge::frame::Side;

const TRIGGER: &str = "std_srvs/Trigger";

async fn pair(client: &mut Client, command: &str, number: i64, service: &str, payload: &[u8]) {
    let mut out = Vec::new();
    Side::Client.write_command(&mut out, command, &Call { srv_id: number });
    Side::Client.write(&mut out, service, payload);
    client.raw(&out).await;
}

/// The next `command` and the frame behind it, which must be adjacent.
async fn expect(client: &mut Client, command: &str) -> (i64, Received) {
    loop {
        let (name, payload) = client.next().await.unwrap();
        if name == command {
            let Call { srv_id } = serde_json::from_slice(&payload).unwrap();
            return (srv_id, client.next().await.unwrap());
        }
    }
}

#[test]
fn a_call_goes_to_the_one_who_offers_and_its_answer_back() {
    with_bridge(Default::default(), async |served| {
        let (mut asks, mut offers) =
            (Client::connect(served.address).await, Client::connect(served.address).await);
        offers.register(name::UNITY_SERVICE, "/save", TRIGGER).await;
        offers.settle().await;
        for _ in 0..2 {
            asks.register(name::ROS_SERVICE, "/save", TRIGGER).await;
        }
        pair(&mut asks, name::REQUEST, 101, "/save", b"\0\x01\0\0").await;
        let (number, (service, payload)) = expect(&mut offers, name::REQUEST).await;
        assert!(number >= 1001);
        // An empty request has a dummy byte in ROS 2, which Unity's connector leaves out.
        assert_eq!((service.as_str(), payload.as_slice()), ("/save", &b"\0\x01\0\0\0"[..]));
        pair(&mut offers, name::RESPONSE, number, "/save", b"\0\x01\0\0\x01").await;
        let (number, (_, payload)) = expect(&mut asks, name::RESPONSE).await;
        assert_eq!((number, payload.as_slice()), (101, &b"\0\x01\0\0\x01"[..]));
    });
}

#[test]
fn a_response_as_long_as_a_map_arrives() {
    with_bridge(Default::default(), async |served| {
        let (mut asks, mut offers) =
            (Client::connect(served.address).await, Client::connect(served.address).await);
        offers.register(name::UNITY_SERVICE, "/map", "nav_msgs/GetMap").await;
        offers.settle().await;
        asks.register(name::ROS_SERVICE, "/map", "nav_msgs/GetMap").await;
        pair(&mut asks, name::REQUEST, 101, "/map", b"\0\x01\0\0").await;
        let (number, _) = expect(&mut offers, name::REQUEST).await;
        let map = [&b"\0\x01\0\0"[..], &vec![7; 9 << 20]].concat();
        let (_, (answered, (_, payload))) = tokio::join!(
            pair(&mut offers, name::RESPONSE, number, "/map", &map),
            expect(&mut asks, name::RESPONSE)
        );
        assert!(answered == 101 && payload == map);
    });
}

/// The next call fails: why is told, and an answer comes that no reader takes for a response.
async fn failed(asks: &mut Client, number: i64, why: &str) {
    let text = asks.error().await;
    assert!(text.contains(why), "{text}");
    let (answered, (_, payload)) = expect(asks, name::RESPONSE).await;
    assert_eq!((answered, payload.as_slice()), (number, &b"\0\x01\0\0"[..]));
}

#[test]
fn nobody_waits_for_ever() {
    with_bridge(BridgeConfig { service_timeout_s: 0.1, ..Default::default() }, async |served| {
        let mut asks = Client::connect(served.address).await;
        pair(&mut asks, name::REQUEST, 1, "/save", b"\0\x01\0\0").await;
        failed(&mut asks, 1, "'/save' is not registered").await;
        asks.register(name::ROS_SERVICE, "/save", TRIGGER).await;
        pair(&mut asks, name::REQUEST, 2, "/save", b"\0\x01\0\0").await;
        failed(&mut asks, 2, "nobody offers").await;

        let mut offers = Client::connect(served.address).await;
        offers.register(name::UNITY_SERVICE, "/save", TRIGGER).await;
        offers.settle().await;
        pair(&mut asks, name::REQUEST, 3, "/save", b"\0\x01\0\0").await;
        failed(&mut asks, 3, "no answer came in time").await;
        let (late, _) = expect(&mut offers, name::REQUEST).await;
        pair(&mut offers, name::RESPONSE, late, "/save", b"\0\x01\0\0\x01").await;
        assert!(offers.error().await.contains("no such call"));
    });
}

#[test]
fn calls_end_with_the_one_who_should_answer() {
    with_bridge(BridgeConfig { service_timeout_s: 3600.0, ..Default::default() }, async |served| {
        let (mut asks, mut offers) =
            (Client::connect(served.address).await, Client::connect(served.address).await);
        asks.register(name::ROS_SERVICE, "/save", TRIGGER).await;
        for command in [name::UNITY_SERVICE, name::REMOVE_UNITY_SERVICE, name::UNITY_SERVICE] {
            offers.register(command, "/save", TRIGGER).await;
        }
        offers.settle().await;
        pair(&mut asks, name::REQUEST, 1, "/save", b"\0\x01\0\0").await;
        expect(&mut offers, name::REQUEST).await;
        offers.register(name::REMOVE_UNITY_SERVICE, "/save", "").await;
        failed(&mut asks, 1, "no longer offers").await;
        offers.register(name::UNITY_SERVICE, "/save", TRIGGER).await;
        offers.settle().await;
        pair(&mut asks, name::REQUEST, 2, "/save", b"\0\x01\0\0").await;
        expect(&mut offers, name::REQUEST).await;
        offers.abort();
        failed(&mut asks, 2, "has left").await;
    });
}

#[test]
fn an_unknown_answer_harms_nobody() {
    with_bridge(Default::default(), async |served| {
        let mut client = Client::connect(served.address).await;
        pair(&mut client, name::RESPONSE, 999_999, "/x", b"\0\x01\0\0").await;
        assert!(client.error().await.contains("999999"));
        client.command(name::REQUEST, &Call { srv_id: 5 }).await;
        client.command(name::TOPIC_LIST, &serde_json::json!({})).await;
        assert!(client.error().await.contains("__topic_list came between"));
        Client::connect(served.address).await.settle().await;
        assert!(client.settle().await.0.len() <= 1);
    });
}

#[test]
fn types_of_services_are_checked() {
    with_bridge(Default::default(), async |served| {
        let mut client = Client::connect(served.address).await;
        client.register(name::ROS_SERVICE, "/save", "geometry_msgs/Twist").await;
        assert!(client.error().await.contains("unknown service class"));
        client.register(name::UNITY_SERVICE, "/save", TRIGGER).await;
        client.register(name::ROS_SERVICE, "/save", "std_srvs/SetBool").await;
        assert!(client.error().await.contains("is std_srvs/Trigger, not std_srvs/SetBool"));
    });
}
