//! Tests of the player's services: long silence, requests that are too long, a lost connection.

use super::*;
use crate::config::FleetConfig;

/// Number of the caller's calls.
const CALL: Call = Call { srv_id: 7 };

/// A bridge with the services and a client that calls them, on a simulated clock.
struct Replay {
    bridge: Bridge,
    services: PlayerServices,
    caller: ClientId,
    now: Monotonic,
}

impl Replay {
    fn new() -> Self {
        let bridge = Bridge::new(FleetConfig::default().bridge_config(), 1, |_, _| {}).unwrap();
        let now = Monotonic(0);
        let services = PlayerServices::open(&bridge, now).unwrap();
        let caller = bridge.connect(SocketAddr::from((Ipv4Addr::LOCALHOST, 1))).unwrap();
        Self { bridge, services, caller, now }
    }

    fn register(&self, command: &str) {
        let (topic, message_name, _) = SERVICES[0];
        let (topic, message_name) = (topic.to_owned(), message_name.to_owned());
        let mut bytes = Vec::new();
        let registration = Registration { topic, message_name, ..Registration::default() };
        Side::Client.write_command(&mut bytes, command, &registration);
        send(&self.bridge, self.caller, &bytes, self.now);
    }

    /// Lets the services answer what has come; each request is answered with one byte.
    fn answer(&mut self) -> Vec<String> {
        self.services.answer(&self.bridge, self.now, |service, _, response| {
            response.push(1);
            Ok(Some(format!("{service:?}")))
        })
    }

    /// Returns the names and payloads of the frames that wait for the caller.
    fn frames(&self) -> Vec<(String, Vec<u8>)> {
        let (mut bytes, mut frames) = (Vec::new(), Vec::new());
        self.bridge.take_outgoing(self.caller, &mut bytes).unwrap();
        let mut parser = Parser::new(1 << 20);
        parser.push(&bytes);
        while let Some(frame) = parser.next_frame().unwrap() {
            frames.push((String::from_utf8_lossy(frame.name).into_owned(), frame.payload.to_owned()));
        }
        frames
    }

    /// Calls the first service; returns what was done, and the response.
    fn call(&mut self, request_bytes: usize) -> (Vec<String>, Vec<u8>) {
        self.frames();
        let mut bytes = Vec::new();
        Side::Client.write_command(&mut bytes, name::REQUEST, &CALL);
        Side::Client.write(&mut bytes, SERVICES[0].0, &vec![0; request_bytes]);
        send(&self.bridge, self.caller, &bytes, self.now);
        let done = self.answer();
        let frames = self.frames();
        let response = frames.iter().position(|(name, _)| name == name::RESPONSE);
        let response = response.unwrap_or_else(|| panic!("no response in {frames:?}"));
        (done, frames[response + 1].1.clone())
    }

    fn advance_s(&mut self, seconds: u64) {
        for _ in 0..seconds {
            self.now = Monotonic(self.now.0 + 1_000_000_000);
            self.bridge.tick(self.now);
            assert_eq!(self.answer(), [""; 0]);
            // The caller lives.
            send(&self.bridge, self.caller, &bridge::frame::KEEPALIVE, self.now);
        }
    }
}

#[test]
fn the_services_are_offered_however_long_nobody_calls_them() {
    let mut replay = Replay::new();
    replay.register(name::ROS_SERVICE);
    replay.advance_s(400);
    replay.register(name::UNITY_SERVICE);
    let refused = replay.frames();
    assert!(refused.iter().any(|(name, _)| name == name::ERROR), "the service is taken: {refused:?}");
    let (done, response) = replay.call(4);
    assert_eq!((done, response), (vec!["Pause".to_owned()], vec![1]));
}

#[test]
fn a_request_that_is_too_long_is_answered_and_the_next_is_served() {
    let mut replay = Replay::new();
    replay.register(name::ROS_SERVICE);
    for _ in 0..3 {
        let (done, response) = replay.call(REQUEST_BYTES_MAX + 1);
        assert!(done[0].contains("4097 bytes") && done[0].contains("/rosbag2_player/pause"), "{done:?}");
        assert_eq!(response, [0; 0], "nobody takes that for a success");
    }
    assert_eq!(replay.call(REQUEST_BYTES_MAX), (vec!["Pause".to_owned()], vec![1]));
}

#[test]
fn services_whose_connection_is_lost_are_offered_again() {
    let mut replay = Replay::new();
    replay.register(name::ROS_SERVICE);
    replay.bridge.disconnect(replay.services.id);
    let done = replay.answer();
    assert!(done.len() == 1 && done[0].contains("offered again"), "{done:?}");
    assert_eq!(replay.call(4), (vec!["Pause".to_owned()], vec![1]));
}
