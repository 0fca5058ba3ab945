//! Configurations of Zenoh, and messages through a router.

use super::*;

const ROLES: [SessionRole; 4] =
    [SessionRole::Robot, SessionRole::Base, SessionRole::BaseBehindRouter, SessionRole::Router];

fn config(endpoint: &str, role: SessionRole, keys: Option<KeyFiles>) -> SessionConfig {
    let robots = vec!["alice".to_owned(), "lab/bob".to_owned()];
    SessionConfig { endpoint: endpoint.parse().unwrap(), role, robots, keys }
}

#[test]
fn zenoh_knows_every_key_of_the_configuration() {
    let keys = || {
        let file = |name: &str| std::path::PathBuf::from("/tmp").join(name);
        KeyFiles { authority: file("a"), certificate: file("c"), private_key: file("k") }
    };
    for role in ROLES {
        config("tcp/127.0.0.1:7447", role, None).to_zenoh(WITHOUT_END).unwrap();
        config("tls/[::1]:7447", role, Some(keys())).to_zenoh(WITHOUT_END).unwrap();
        config("quic/[::1]:7447", role, Some(keys())).to_zenoh(WITHOUT_END).unwrap();
        // As `zenohd` reads it.
        let file = config("tls/127.0.0.1:7447", role, Some(keys())).to_json();
        zenoh::Config::from_json5(&file).unwrap();
    }
}

#[test]
fn the_access_list_lets_nobody_else_through() {
    let list = config("tls/127.0.0.1:7447", SessionRole::Base, None).access_control();
    assert_eq!(list["default_permission"], "deny");
    assert_eq!(list["subjects"][0]["cert_common_names"], json!(["robot alice"]));
    assert_eq!(list["rules"][0]["key_exprs"], json!(["mr-slam/alice/up/*"]));
    assert_eq!(list["policies"][0]["rules"].as_array().map(Vec::len), Some(4));
    let list = config("tls/127.0.0.1:7447", SessionRole::Router, None).access_control();
    assert_eq!(list["subjects"][1]["cert_common_names"], json!(["base"]));
    assert_eq!(list["rules"][4]["key_exprs"], json!(["mr-slam/alice/down/*"]));
}

/// Messages cross a router both ways, also one that was started again.
#[test]
fn robot_and_base_reach_each_other_through_a_router() {
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let at_router = |role| config(&format!("tcp/127.0.0.1:{port}"), role, None);
    let mut router = Router::open(&at_router(SessionRole::Router)).unwrap();
    let mut base = ZenohTransport::open(&at_router(SessionRole::BaseBehindRouter)).unwrap();
    let mut robot = ZenohTransport::open(&at_router(SessionRole::Robot)).unwrap();
    cross(&mut base, &mut robot, Kind::BaseState);
    cross(&mut robot, &mut base, Kind::Chunk);
    drop(router);
    router = Router::open(&at_router(SessionRole::Router)).unwrap();
    cross(&mut base, &mut robot, Kind::Velocity);
    cross(&mut robot, &mut base, Kind::RobotState);
    drop(router);
}

#[test]
fn what_is_said_of_a_failed_connection_names_no_source_file() {
    let why = "Unable to connect to any of [tcp/127.0.0.1:17999]! at /root/.cargo/registry/src/zenoh/orchestrator.rs:388.";
    assert_eq!(plain_reason(why), "Unable to connect to any of [tcp/127.0.0.1:17999]!");
}

#[test]
fn a_base_hears_the_name_of_a_robot_that_it_does_not_have() {
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let mut base = ZenohTransport::open(&config(&endpoint, SessionRole::Base, None)).unwrap();
    let robots = vec!["carl".to_owned()];
    let carl = SessionConfig { robots, ..config(&endpoint, SessionRole::Robot, None) };
    let mut robot = ZenohTransport::open(&carl).unwrap();
    let begun = std::time::Instant::now();
    let name = loop {
        robot.send(0, Kind::RobotState, b"state");
        if let Some(name) = base.receive_unknown_name() {
            break name;
        }
        assert!(begun.elapsed() < Duration::from_secs(60), "nothing arrives");
        std::thread::sleep(Duration::from_millis(10));
    };
    assert_eq!(name, "carl");
    assert_eq!(base.receive(), None, "it is no robot of this base");
}

/// Sends a message until it arrives.
fn cross(from: &mut ZenohTransport, to: &mut ZenohTransport, kind: Kind) {
    let begun = std::time::Instant::now();
    let bytes = [kind as u8];
    while !std::iter::from_fn(|| to.receive()).any(|(robot, found)| robot == 1 && found == bytes) {
        assert!(begun.elapsed() < std::time::Duration::from_secs(20), "{kind:?} does not arrive");
        from.send(1, kind, &bytes);
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
}
