//! A bridge's clients in memory: frames in and out, without sockets.

use bridge::frame::Parser;
use bridge::{Bridge, ClientId};
use msg::Monotonic;

/// Hands the frames in `bytes` to the bridge, as a client's.
pub fn receive(bridge: &Bridge, client: ClientId, bytes: &[u8], now: Monotonic) {
    let mut parser = Parser::new(1 << 20);
    parser.push(bytes);
    while let Some(frame) = parser.next_frame().unwrap() {
        bridge.receive(client, frame, now);
    }
}

/// Takes the frames that wait for a client: name and payload.
pub fn take_frames(bridge: &Bridge, client: ClientId) -> Vec<(String, Vec<u8>)> {
    let mut bytes = Vec::new();
    bridge.take_outgoing(client, &mut bytes).unwrap();
    let mut parser = Parser::new(1 << 20);
    parser.push(&bytes);
    let mut frames = Vec::new();
    while let Some(frame) = parser.next_frame().unwrap() {
        frames.push((String::from_utf8(frame.name.to_vec()).unwrap(), frame.payload.to_vec()));
    }
    assert_eq!(parser.pending(), 0, "whole frames only");
    frames
}
