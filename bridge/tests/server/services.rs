//! Service calls between clients, and all the ways in which a call fails.

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

/// Returns the next `command` and the frame behind it, which must be adjacent.
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
fn a_call_reaches_its_provider_and_the_response_its_caller() {
    with_bridge(Default::default(), async |served| {
        let (mut caller, mut provider) =
            (Client::connect(served.address).await, Client::connect(served.address).await);
        provider.register(name::UNITY_SERVICE, "/save", TRIGGER).await;
        provider.settle().await;
        for _ in 0..2 {
            caller.register(name::ROS_SERVICE, "/save", TRIGGER).await;
        }
        pair(&mut caller, name::REQUEST, 101, "/save", b"\0\x01\0\0").await;
        let (number, (service, payload)) = expect(&mut provider, name::REQUEST).await;
        assert!(number >= 1001);
        // ROS 2 has a byte in an empty request, which Unity's connector leaves out.
        assert_eq!((service.as_str(), payload.as_slice()), ("/save", &b"\0\x01\0\0\0"[..]));
        pair(&mut provider, name::RESPONSE, number, "/save", b"\0\x01\0\0\x01").await;
        let (number, (_, payload)) = expect(&mut caller, name::RESPONSE).await;
        assert_eq!((number, payload.as_slice()), (101, &b"\0\x01\0\0\x01"[..]));
    });
}

#[test]
fn a_response_as_long_as_a_map_arrives() {
    with_bridge(Default::default(), async |served| {
        let (mut caller, mut provider) =
            (Client::connect(served.address).await, Client::connect(served.address).await);
        provider.register(name::UNITY_SERVICE, "/map", "nav_msgs/GetMap").await;
        provider.settle().await;
        caller.register(name::ROS_SERVICE, "/map", "nav_msgs/GetMap").await;
        pair(&mut caller, name::REQUEST, 101, "/map", b"\0\x01\0\0").await;
        let (number, _) = expect(&mut provider, name::REQUEST).await;
        let map = [&b"\0\x01\0\0"[..], &vec![7; 9 << 20]].concat();
        let (_, (answered, (_, payload))) = tokio::join!(
            pair(&mut provider, name::RESPONSE, number, "/map", &map),
            expect(&mut caller, name::RESPONSE)
        );
        assert!(answered == 101 && payload == map);
    });
}

/// Expects the next call to fail: with an error, and an empty response that no reader accepts.
async fn failed(caller: &mut Client, number: i64, why: &str) {
    let text = caller.error().await;
    assert!(text.contains(why), "{text}");
    let (answered, (_, payload)) = expect(caller, name::RESPONSE).await;
    assert_eq!((answered, payload.as_slice()), (number, &b"\0\x01\0\0"[..]));
}

#[test]
fn every_call_ends() {
    with_bridge(BridgeConfig { service_timeout_s: 0.1, ..Default::default() }, async |served| {
        let mut caller = Client::connect(served.address).await;
        pair(&mut caller, name::REQUEST, 1, "/save", b"\0\x01\0\0").await;
        // Its type is not known: an empty response might read as a success.
        let text = caller.error().await;
        assert!(text.contains("'/save' is not registered"), "{text}");
        caller.register(name::ROS_SERVICE, "/save", TRIGGER).await;
        pair(&mut caller, name::REQUEST, 2, "/save", b"\0\x01\0\0").await;
        failed(&mut caller, 2, "nobody offers").await;

        let mut provider = Client::connect(served.address).await;
        provider.register(name::UNITY_SERVICE, "/save", TRIGGER).await;
        provider.settle().await;
        pair(&mut caller, name::REQUEST, 3, "/save", b"\0\x01\0\0").await;
        failed(&mut caller, 3, "no answer came in time").await;
        let (late, _) = expect(&mut provider, name::REQUEST).await;
        pair(&mut provider, name::RESPONSE, late, "/save", b"\0\x01\0\0\x01").await;
        assert!(provider.error().await.contains("no such call"));
    });
}

#[test]
fn a_call_fails_when_its_provider_leaves() {
    with_bridge(BridgeConfig { service_timeout_s: 3600.0, ..Default::default() }, async |served| {
        let (mut caller, mut provider) =
            (Client::connect(served.address).await, Client::connect(served.address).await);
        caller.register(name::ROS_SERVICE, "/save", TRIGGER).await;
        for command in [name::UNITY_SERVICE, name::REMOVE_UNITY_SERVICE, name::UNITY_SERVICE] {
            provider.register(command, "/save", TRIGGER).await;
        }
        provider.settle().await;
        pair(&mut caller, name::REQUEST, 1, "/save", b"\0\x01\0\0").await;
        expect(&mut provider, name::REQUEST).await;
        provider.register(name::REMOVE_UNITY_SERVICE, "/save", "").await;
        failed(&mut caller, 1, "no longer offers").await;
        provider.register(name::UNITY_SERVICE, "/save", TRIGGER).await;
        provider.settle().await;
        pair(&mut caller, name::REQUEST, 2, "/save", b"\0\x01\0\0").await;
        expect(&mut provider, name::REQUEST).await;
        provider.abort();
        failed(&mut caller, 2, "has left").await;
    });
}

#[test]
fn an_unknown_response_affects_no_other_client() {
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
fn a_services_type_is_checked() {
    with_bridge(Default::default(), async |served| {
        let mut client = Client::connect(served.address).await;
        client.register(name::ROS_SERVICE, "/save", "geometry_msgs/Twist").await;
        assert!(client.error().await.contains("unknown service class"));
        client.register(name::UNITY_SERVICE, "/save", TRIGGER).await;
        client.register(name::ROS_SERVICE, "/save", "std_srvs/SetBool").await;
        assert!(client.error().await.contains("is std_srvs/Trigger, not std_srvs/SetBool"));
    });
}
