//! Services between clients and ROS 2 nodes, and all the ways in which a call fails.

use super::{EMPTY, RESPONSE, Simulation, TRIGGER};
use bridge::Permission;
use bridge::command::name;
use bridge::relay::RosEvent;

#[test]
fn a_client_calls_a_service_of_a_ros_node() {
    let simulation = Simulation::new();
    let client = simulation.connect();
    simulation.register(client, name::ROS_SERVICE, "/spawn", TRIGGER);
    assert_eq!(simulation.asked(), [format!("use /spawn {TRIGGER}")]);
    simulation.offer_in_ros(&[("/spawn", TRIGGER)]);
    simulation.call(client, 101, "/spawn");
    assert_eq!(simulation.asked(), [r#"call /spawn 1001 b"\0\x01\0\0\0""#]);
    let response = |number| RosEvent::Response { service: "/spawn".into(), number, payload: RESPONSE.into() };
    simulation.on_ros_event(response(1001));
    simulation.on_ros_event(response(1001));
    assert_eq!(simulation.received(client), (vec![(101, RESPONSE.to_vec())], vec![]), "once");
    simulation.bridge.disconnect(client);
    assert_eq!(simulation.asked(), ["leave /spawn"]);
}

#[test]
fn a_ros_node_calls_a_service_of_a_client() {
    let simulation = Simulation::new();
    let client = simulation.connect();
    simulation.register(client, name::UNITY_SERVICE, "photo", TRIGGER);
    assert_eq!(simulation.asked(), [format!("serve /photo {TRIGGER}")]);
    simulation.request_from_ros("/photo", EMPTY);
    assert_eq!(simulation.received(client), (vec![(1001, EMPTY.to_vec())], vec![]));
    simulation.send(client, name::RESPONSE, 1001, "photo", RESPONSE);
    assert_eq!(simulation.responses_to_ros(), [RESPONSE]);
    simulation.send(client, name::RESPONSE, 1001, "photo", RESPONSE);
    assert_eq!(
        (simulation.asked().len(), simulation.received(client).1.len()),
        (0, 1),
        "a second response is refused"
    );
    simulation.request_from_ros("/photo", EMPTY);
    simulation.send(client, name::RESPONSE, 1002, "photo", &[]);
    assert!(simulation.asked().is_empty(), "no response could be read as success");
    simulation.register(client, name::REMOVE_UNITY_SERVICE, "photo", TRIGGER);
    assert_eq!(simulation.asked(), ["close /photo"]);
}

#[test]
fn a_response_that_dds_cannot_carry_is_refused_and_told() {
    let simulation = Simulation::new();
    let client = simulation.connect();
    simulation.register(client, name::UNITY_SERVICE, "/photo", TRIGGER);
    simulation.asked();
    for (length, responses) in [(1024, 1), (1025, 0)] {
        simulation.request_from_ros("/photo", EMPTY);
        let (calls, _) = simulation.received(client);
        let response = [&[0, 1, 0, 0][..], &vec![7; length - 4]].concat();
        simulation.send(client, name::RESPONSE, calls[0].0, "/photo", &response);
        assert_eq!(simulation.responses_to_ros().len(), responses, "{length} bytes");
    }
    let (_, texts) = simulation.received(client);
    assert!(texts.len() == 1 && texts[0].contains("1025 bytes are not sent to ROS 2"), "{texts:?}");
}

#[test]
fn a_call_of_a_ros_node_that_fails_never_reads_as_success() {
    let mut simulation = Simulation::new();
    let client = simulation.connect();
    simulation.register(client, name::ROS_SERVICE, "/clear", "std_srvs/Empty");
    simulation.register(client, name::ROS_SERVICE, "/spawn", TRIGGER);
    simulation.call(client, 1, "/clear");
    let (responses, texts) = simulation.received(client);
    assert!(responses.is_empty() && texts[0].contains("no client and no ROS 2 node does"), "{texts:?}");

    simulation.offer_in_ros(&[("/clear", "std_srvs/Empty"), ("/spawn", "std_srvs/SetBool")]);
    simulation.call(client, 2, "/spawn");
    let (responses, texts) = simulation.received(client);
    assert_eq!(responses, [(2, vec![0, 1, 0, 0])], "a response that no reader accepts");
    assert!(texts[0].contains("'/spawn' is std_srvs/SetBool, not std_srvs/Trigger"), "{texts:?}");

    simulation.call(client, 3, "/clear");
    simulation.asked();
    simulation.advance_s(11);
    let (responses, texts) = simulation.received(client);
    assert!(responses.is_empty() && texts[0].contains("no answer came in time"), "{texts:?}");
    // Otherwise a server that comes later would still get the request.
    assert_eq!(simulation.asked(), ["cancel /clear 1001"]);

    simulation.call(client, 4, "/clear");
    simulation.offer_in_ros(&[]);
    let (responses, texts) = simulation.received(client);
    assert!(
        responses.is_empty() && texts[0].contains("the ROS 2 node that offered it has left"),
        "{texts:?}"
    );

    simulation.offer_in_ros(&[("/clear", "std_srvs/Empty")]);
    simulation.call(client, 5, "/clear");
    let text = "no such reader".to_owned();
    simulation.on_ros_event(RosEvent::ServiceFailure { service: "/clear".into(), text });
    let (responses, texts) = simulation.received(client);
    assert!(responses.is_empty() && texts[0].contains("no such reader"), "{texts:?}");
    simulation.asked();
    simulation.call(client, 6, "/clear");
    simulation.bridge.disconnect(client);
    let asked = simulation.asked();
    assert!(
        asked.contains(&"cancel /clear 1004".to_owned()) && asked.contains(&"leave /clear".to_owned()),
        "{asked:?}"
    );
}

#[test]
fn a_ros_node_whose_call_fails_gets_no_response() {
    let mut simulation = Simulation::new();
    let client = simulation.connect();
    simulation.register(client, name::UNITY_SERVICE, "/photo", TRIGGER);
    simulation.asked();
    simulation.request_from_ros("/photo", EMPTY);
    simulation.advance_s(11);
    simulation.request_from_ros("/photo", EMPTY);
    simulation.bridge.disconnect(client);
    simulation.request_from_ros("/photo", EMPTY);
    assert_eq!(simulation.asked(), ["close /photo"]);
    assert_eq!(simulation.bridge.counters().refused, 3);
}

#[test]
fn only_who_may_drive_offers_and_calls_in_ros_but_open_names() {
    let simulation = Simulation::with(|config| {
        config.drive = Permission::Allowed;
        config.open_topics = vec!["photo".into(), "spawn".into()];
    });
    let guest = simulation.connect_from([192, 168, 1, 20]);
    for service in ["/photo", "/reboot"] {
        simulation.register(guest, name::UNITY_SERVICE, service, TRIGGER);
    }
    for service in ["/spawn", "/despawn"] {
        simulation.register(guest, name::ROS_SERVICE, service, TRIGGER);
    }
    assert_eq!(simulation.asked(), [format!("serve /photo {TRIGGER}"), format!("use /spawn {TRIGGER}")]);
    let (_, texts) = simulation.received(guest);
    assert_eq!(texts.len(), 1, "{texts:?}");
    assert!(texts[0].contains("'/reboot' is not offered") && texts[0].contains("open_topics"), "{texts:?}");
    simulation.request_from_ros("/reboot", EMPTY);
    simulation.offer_in_ros(&[("/spawn", TRIGGER), ("/despawn", TRIGGER)]);
    simulation.call(guest, 1, "/despawn");
    let (responses, texts) = simulation.received(guest);
    assert_eq!(responses, [(1, vec![0, 1, 0, 0])]);
    assert!(texts[0].contains("mr-slam allow 192.168.1.20"), "{texts:?}");
    assert!(simulation.asked().is_empty());
    simulation.call(guest, 2, "/spawn");
    assert_eq!(simulation.asked().len(), 1);

    simulation.bridge.allow([192, 168, 1, 20].into()).unwrap();
    assert_eq!(simulation.asked(), [format!("use /despawn {TRIGGER}"), format!("serve /reboot {TRIGGER}")]);
    simulation.bridge.deny([192, 168, 1, 20].into()).unwrap();
    assert_eq!(simulation.asked(), ["leave /despawn", "close /reboot"]);
}

#[test]
fn a_service_is_not_taken_over() {
    let simulation = Simulation::new();
    let client = simulation.connect();
    simulation.offer_in_ros(&[("/spawn", TRIGGER)]);
    for (service, expected) in
        [("/spawn", "offered by a ROS 2 node"), ("/robot1/reset", "offered by the fleet")]
    {
        simulation.register(client, name::UNITY_SERVICE, service, TRIGGER);
        let (_, texts) = simulation.received(client);
        assert!(texts[0].contains(expected), "{texts:?}");
    }
    assert!(simulation.asked().is_empty());
}

#[test]
fn the_number_of_exchanged_services_is_limited() {
    let simulation = Simulation::with(|config| config.dds.relayed_services_max = 2);
    let client = simulation.connect();
    for service in ["/a", "/b", "/c"] {
        simulation.register(client, name::UNITY_SERVICE, service, TRIGGER);
    }
    simulation.register(client, name::ROS_SERVICE, "/d", TRIGGER);
    assert_eq!(simulation.asked().len(), 2);
    simulation.offer_in_ros(&[("/d", TRIGGER)]);
    simulation.call(client, 1, "/d");
    let (_, texts) = simulation.received(client);
    assert_eq!(texts.iter().filter(|text| text.contains("relayed_services_max")).count(), 2, "{texts:?}");
    simulation.register(client, name::REMOVE_UNITY_SERVICE, "/a", TRIGGER);
    assert_eq!(simulation.asked(), ["close /a".to_owned(), format!("use /d {TRIGGER}")]);
}

#[test]
fn one_caller_cannot_use_up_all_calls() {
    let simulation = Simulation::new();
    let (client, other) = (simulation.connect(), simulation.connect());
    simulation.register(client, name::UNITY_SERVICE, "/photo", TRIGGER);
    for _ in 0..300 {
        simulation.request_from_ros("/photo", EMPTY);
    }
    assert_eq!(simulation.received(client).0.len(), 256);
    simulation.register(other, name::ROS_SERVICE, "/photo", TRIGGER);
    simulation.call(other, 1, "/photo");
    assert_eq!(simulation.received(client).0.len(), 1);
}

#[test]
fn unknown_packages_are_accepted_if_a_ros_node_offers_the_service() {
    let simulation = Simulation::new();
    let client = simulation.connect();
    simulation.register(client, name::ROS_SERVICE, "/odd", "odd_msgs/Odd");
    assert_eq!(simulation.received(client).1.len(), 1);
    simulation.offer_in_ros(&[("/odd", "odd_msgs/Odd")]);
    simulation.register(client, name::ROS_SERVICE, "/odd", "odd_msgs/Odd");
    assert_eq!(simulation.asked(), ["use /odd odd_msgs/Odd"]);
}
