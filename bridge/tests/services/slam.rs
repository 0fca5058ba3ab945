//! SLAM's services for clients and ROS 2 nodes.

use super::{Simulation, TRIGGER};
use bridge::Permission;
use bridge::command::name;
use msg::{SlamOutcome, SlamRequestKind};

#[test]
fn slams_services_are_served_to_clients() {
    let mut simulation = Simulation::new();
    let client = simulation.connect();
    simulation.register(client, name::ROS_SERVICE, "/robot2/relocalize", TRIGGER);
    simulation.register(client, name::ROS_SERVICE, "/robot2/slam_toolbox/reset", "slam_toolbox/Reset");
    assert!(simulation.asked().is_empty(), "the fleet's services are not called in ROS");
    simulation.call(client, 101, "/robot2/relocalize");
    assert_eq!(simulation.requests.borrow()[0].0.number(), 2);
    assert_eq!(simulation.answer(SlamOutcome::Done, "looking").kind, SlamRequestKind::Relocalize as u32);
    let expected = [&[0, 1, 0, 0, 1, 0, 0, 0, 8, 0, 0, 0][..], b"looking\0"].concat();
    assert_eq!(simulation.received(client), (vec![(101, expected)], vec![]));

    // A reset that pauses is two requests.
    simulation.send(client, name::REQUEST, 102, "/robot2/slam_toolbox/reset", &[0, 1, 0, 0, 1]);
    assert_eq!(simulation.answer(SlamOutcome::Done, "").kind, SlamRequestKind::Reset as u32);
    assert!(simulation.received(client).0.is_empty());
    assert_eq!(simulation.answer(SlamOutcome::Done, "").kind, SlamRequestKind::Pause as u32);
    assert_eq!(simulation.received(client).0, [(102, vec![0, 1, 0, 0, 0])]);

    // What is done and not saved has failed, but what follows is done, too.
    simulation.send(client, name::REQUEST, 102, "/robot2/slam_toolbox/reset", &[0, 1, 0, 0, 1]);
    assert_eq!(
        simulation.answer(SlamOutcome::NotSaved, "the disk is full").kind,
        SlamRequestKind::Reset as u32
    );
    assert_eq!(simulation.answer(SlamOutcome::NotSaved, "").kind, SlamRequestKind::Pause as u32);
    assert_eq!(simulation.received(client).0, [(102, vec![0, 1, 0, 0, 255])]);

    simulation.send(client, name::REQUEST, 103, "/robot2/slam_toolbox/reset", &[0, 1, 0, 0, 0]);
    simulation.answer(SlamOutcome::Refused, "not now");
    let (responses, texts) = simulation.received(client);
    assert_eq!(responses, [(103, vec![0, 1, 0, 0, 255])]);
    assert!(texts[0].contains("not now"), "{texts:?}");
    simulation.call(client, 104, "/robot2/relocalize");
    simulation.advance_s(21);
    let (responses, texts) = simulation.received(client);
    assert_eq!((responses.len(), responses[0].1[4], texts.len()), (1, 0, 1), "success is false");
    simulation.register(client, name::ROS_SERVICE, "/robot1/reset", "std_srvs/SetBool");
    assert!(simulation.received(client).1[0].contains("is std_srvs/Trigger, not std_srvs/SetBool"));
}

#[test]
fn only_who_may_drive_calls_slams_services() {
    let simulation = Simulation::with(|config| config.drive = Permission::Allowed);
    let guest = simulation.connect_from([192, 168, 1, 20]);
    simulation.register(guest, name::ROS_SERVICE, "/robot1/reset", TRIGGER);
    simulation.call(guest, 1, "/robot1/reset");
    let (responses, texts) = simulation.received(guest);
    assert_eq!((responses.len(), responses[0].1[4]), (1, 0), "success is false");
    assert!(texts[0].contains("mr-slam allow 192.168.1.20"), "{texts:?}");
    assert!(simulation.requests.borrow().is_empty());
}

#[test]
fn a_session_that_is_not_loaded_is_not_answered_as_if_it_were() {
    let simulation = Simulation::new();
    let client = simulation.connect();
    let service = "/robot1/slam_toolbox/deserialize_map";
    simulation.register(client, name::ROS_SERVICE, service, "slam_toolbox/DeserializePoseGraph");
    // filename "a", match_type 1, initial_pose; the doubles are aligned to 8 bytes.
    let request = [&[0, 1, 0, 0, 2, 0, 0, 0, b'a', 0, 1, 0][..], &[0; 24]].concat();
    for is_ros in [false, true] {
        match is_ros {
            false => simulation.send(client, name::REQUEST, 1, service, &request),
            true => simulation.request_from_ros(service, &request),
        }
        simulation.answer(SlamOutcome::Refused, "no such file");
        assert!(
            simulation.received(client).0.is_empty() && simulation.asked().is_empty(),
            "the response has no fields"
        );
        match is_ros {
            false => simulation.send(client, name::REQUEST, 2, service, &request),
            true => simulation.request_from_ros(service, &request),
        }
        simulation.answer(SlamOutcome::NotSaved, "");
        let responses = simulation.received(client).0.len() + simulation.asked().len();
        assert_eq!(responses, 1);
    }
}
