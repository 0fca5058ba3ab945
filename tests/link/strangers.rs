//! Machines with keys, and machines that have none or another's.

use crate::fleets::{self, Fleet, LIMIT, TestFolder, base_args, caught_up, endpoint, robot_args, until};
use link_transport::keys::{KeyOwner, create_authority, create_key};
use mr_slam::control::{self, Request};
use std::path::Path;
use std::time::Duration;

/// Time in which a stranger would have been let in: connecting again takes at most 1 s.
const TIME_TO_JOIN: Duration = Duration::from_secs(6);

fn keys(folder: &Path, owner: &KeyOwner) -> String {
    create_key(folder, owner).unwrap().display().to_string()
}

fn robot(name: &str) -> KeyOwner {
    KeyOwner::Robot(name.into())
}

#[test]
fn machines_with_keys_join_over_quic_and_no_other_does() {
    machines_with_keys_join_and_no_other_does("quic");
}

#[test]
fn machines_with_keys_join_over_tls_and_no_other_does() {
    machines_with_keys_join_and_no_other_does("tls");
}

fn machines_with_keys_join_and_no_other_does(protocol: &str) {
    let folder = TestFolder::new();
    let (own, foreign) = (folder.path().join("own"), folder.path().join("foreign"));
    create_authority(&own).unwrap();
    create_authority(&foreign).unwrap();
    let (base_key, alice_key, bob_key) =
        (keys(&own, &KeyOwner::Base), keys(&own, &robot("alice")), keys(&own, &robot("bob")));
    let foreign_alice = keys(&foreign, &robot("alice"));
    let endpoint = endpoint(protocol);
    let with_key = |mut args: Vec<&str>, key: &str| {
        args.extend(["--keys"]);
        let mut args: Vec<String> = args.into_iter().map(str::to_owned).collect();
        args.push(key.to_owned());
        args
    };
    let start = |name: &str, args: Vec<String>| {
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        Fleet::start(folder.path(), name, &endpoint, &args)
    };
    let mut base = start("base", with_key(base_args("alice,bob", &endpoint), &base_key));

    // Of another authority, and with bob's key in the name of alice.
    let mut stranger = start("stranger", with_key(robot_args("alice", &endpoint), &foreign_alice));
    let mut thief = start("thief", with_key(robot_args("alice", &endpoint), &bob_key));
    until("they have a map", LIMIT, || (stranger.cells("robot1_map").len() > 100).then_some(()));
    until("they have a map", LIMIT, || (thief.cells("robot1_map").len() > 100).then_some(()));
    until("the base shows the stranger", LIMIT, || base.has_said("a stranger is refused").then_some(()));
    assert!(base.has_said("mr-slam keys robot"), "it says what to do");
    until("the base shows whose key the thief has", LIMIT, || {
        base.has_said("key of `robot bob`").then_some(())
    });
    let begun = std::time::Instant::now();
    until("time to join has passed", LIMIT, || {
        assert!(base.cells("robot1_map").is_empty(), "a map came from a machine without alice's key");
        (begun.elapsed() >= TIME_TO_JOIN).then_some(())
    });
    assert!(!base.has_said("alice has joined"));
    drop((stranger, thief));

    let mut alice = start("alice", with_key(robot_args("alice", &endpoint), &alice_key));
    until("the base has alice's map", LIMIT, || caught_up(&mut base, &mut alice));
    assert!(base.has_said("alice has joined"));
}

#[test]
fn robots_and_base_join_through_a_router_with_keys() {
    let folder = TestFolder::new();
    let own = folder.path().join("own");
    create_authority(&own).unwrap();
    let [base_key, router_key, alice_key, bob_key] =
        [KeyOwner::Base, KeyOwner::Router, robot("alice"), robot("bob")].map(|owner| keys(&own, &owner));
    let endpoint = endpoint("quic");
    let router_args = ["router", "--names", "alice", "--listen", &endpoint, "--keys", &router_key];
    let mut router = fleets::Ended::start(folder.path(), &router_args);
    let base_args = ["base", "--names", "alice", "--router", &endpoint, "--keys", &base_key];
    let mut base = Fleet::start(folder.path(), "base", &endpoint, &base_args);
    let with_key = |key: &str| -> Vec<String> {
        let args = robot_args("alice", &endpoint).into_iter().chain(["--keys", key]);
        args.map(str::to_owned).collect()
    };
    let start = |name: &str, key: &str| {
        let args = with_key(key);
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        Fleet::start(folder.path(), name, &endpoint, &args)
    };
    // The router does not let bob's key speak for alice.
    let mut thief = start("thief", &bob_key);
    until("the thief has a map", LIMIT, || (thief.cells("robot1_map").len() > 100).then_some(()));
    until("the router shows the thief", LIMIT, || router.has_said("of no robot in --names").then_some(()));
    assert!(router.has_said("key of `robot bob`"));
    assert!(!base.has_said("alice has joined"));
    drop(thief);
    // A network that lets no UDP through: by TLS at the port at which the router listens for QUIC.
    let by_tls = endpoint.replace("quic/", "tls/");
    let alice_args = [&robot_args("alice", &by_tls)[..], &["--keys", &alice_key]].concat();
    let mut alice = Fleet::start(folder.path(), "alice", &by_tls, &alice_args);
    until("the base has alice's map", LIMIT, || caught_up(&mut base, &mut alice));

    drop(router);
    alice.drive("alice", 3.0, 0.15, 0.4);
    router = fleets::Ended::start(folder.path(), &router_args);
    until("the base has what alice has mapped without a router", LIMIT, || caught_up(&mut base, &mut alice));
    control::ask(&base.run, Request::Stop, LIMIT).unwrap();
    until("the stop is on the robot", LIMIT, || alice.is_stopped().filter(|stopped| *stopped));
    drop(router);
}

#[test]
fn a_robots_key_is_not_a_bases() {
    let folder = TestFolder::new();
    let own = folder.path().join("own");
    create_authority(&own).unwrap();
    let (alice_key, bob_key) = (keys(&own, &robot("alice")), keys(&own, &robot("bob")));
    let endpoint = endpoint("quic");
    let mut base_args = base_args("alice", &endpoint);
    base_args.extend(["--keys", &bob_key]);
    let mut robot_args = robot_args("alice", &endpoint);
    robot_args.extend(["--keys", &alice_key]);
    let mut false_base = Fleet::start(folder.path(), "base", &endpoint, &base_args);
    let mut alice = Fleet::start(folder.path(), "alice", &endpoint, &robot_args);
    until("alice has a map", LIMIT, || (alice.cells("robot1_map").len() > 100).then_some(()));
    let begun = std::time::Instant::now();
    until("time to join has passed", LIMIT, || {
        assert!(false_base.cells("robot1_map").is_empty(), "alice gave its map to a robot");
        (begun.elapsed() >= TIME_TO_JOIN).then_some(())
    });
    assert!(!alice.has_said("a base leads"));
}
