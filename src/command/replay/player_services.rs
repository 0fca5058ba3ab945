//! Services of a replay, with names and types of rosbag2's player: pause, resume, rate, seek.
//!
//! A client of the bridge in this process offers them, so that ros_tcp clients, browsers and ROS 2 nodes can call them.

use super::player::Player;
use bridge::cdr::{DecodeError, Reader, Writer};
use bridge::command::{Call, Registration, name};
use bridge::frame::{FrameError, Parser, Side};
use bridge::{Bridge, ClientId};
use msg::Monotonic;
use recording::playback::Speed;
use std::net::{Ipv4Addr, SocketAddr};

/// Longest request, bytes; all of the player's are a number at most.
const REQUEST_BYTES_MAX: usize = 4 << 10;

/// What a service does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Service {
    Pause,
    Resume,
    TogglePaused,
    IsPaused,
    SetRate,
    GetRate,
    Seek,
}

/// Name, type and meaning of each service.
const SERVICES: [(&str, &str, Service); 7] = [
    ("/rosbag2_player/pause", "rosbag2_interfaces/Pause", Service::Pause),
    ("/rosbag2_player/resume", "rosbag2_interfaces/Resume", Service::Resume),
    ("/rosbag2_player/toggle_paused", "rosbag2_interfaces/TogglePaused", Service::TogglePaused),
    ("/rosbag2_player/is_paused", "rosbag2_interfaces/IsPaused", Service::IsPaused),
    ("/rosbag2_player/set_rate", "rosbag2_interfaces/SetRate", Service::SetRate),
    ("/rosbag2_player/get_rate", "rosbag2_interfaces/GetRate", Service::GetRate),
    ("/rosbag2_player/seek", "rosbag2_interfaces/Seek", Service::Seek),
];

/// Client of the bridge that offers the services.
pub struct PlayerServices {
    id: ClientId,
    parser: Parser,
    /// Call that the last `__request` frame announced; `None` between calls.
    call: Option<Call>,
    /// Whether people were told that the services are not offered.
    is_lost: bool,
}

impl PlayerServices {
    /// Connects and registers the services.
    ///
    /// # Errors
    /// The bridge refuses the connection.
    pub fn open(bridge: &Bridge, now: Monotonic) -> Result<Self, bridge::ConnectError> {
        let id = bridge.connect_permanent(SocketAddr::from((Ipv4Addr::LOCALHOST, 0)))?;
        let mut sent = Vec::new();
        for (topic, message_name, _) in SERVICES {
            let (topic, message_name) = (topic.to_owned(), message_name.to_owned());
            let registration = Registration { topic, message_name, ..Registration::default() };
            Side::Client.write_command(&mut sent, name::UNITY_SERVICE, &registration);
        }
        send(bridge, id, &sent, now);
        Ok(Self { id, parser: Parser::new(REQUEST_BYTES_MAX), call: None, is_lost: false })
    }

    /// Answers the calls that have come: `apply` does what a request asks for. Returns what was done, for people.
    pub fn answer(
        &mut self,
        bridge: &Bridge,
        now: Monotonic,
        mut apply: impl FnMut(Service, &[u8], &mut Vec<u8>) -> Result<Option<String>, DecodeError>,
    ) -> Vec<String> {
        let (mut received, mut answers, mut done) = (Vec::new(), Vec::new(), Vec::new());
        if bridge.take_outgoing(self.id, &mut received).is_err() {
            return self.open_again(bridge, now).into_iter().collect();
        }
        self.parser.push(&received);
        loop {
            let (name, request) = match self.parser.next_frame() {
                Ok(Some(frame)) if frame.name == name::REQUEST.as_bytes() => {
                    self.call = serde_json::from_slice(frame.json()).ok();
                    continue;
                }
                Ok(Some(frame)) => {
                    (String::from_utf8_lossy(frame.name).into_owned(), Ok(frame.payload.to_owned()))
                }
                Ok(None) => break,
                Err(FrameError::Payload { name, announced, limit }) => {
                    self.parser.skip_frame();
                    (name, Err(format!("a request of {announced} bytes is refused, the limit is {limit}")))
                }
                Err(why @ FrameError::Name { .. }) => {
                    // Where the next frame begins is not known.
                    done.push(format!("the services of the replay: {why}"));
                    done.extend(self.open_again(bridge, now));
                    return done;
                }
            };
            let service = SERVICES.iter().find(|(of, ..)| *of == name);
            let (Some((service, _, what)), Some(call)) = (service, self.call.take()) else { continue };
            let mut response = Vec::new();
            let apply = |request: Vec<u8>| {
                apply(*what, &request, &mut response).map_err(|why: DecodeError| why.to_string())
            };
            match request.and_then(apply) {
                Ok(text) => done.extend(text),
                // A response without fields is one that no caller takes for a success.
                Err(why) => done.push(format!("{service}: {why}")),
            }
            Side::Client.write_command(&mut answers, name::RESPONSE, &call);
            Side::Client.write(&mut answers, service, &response);
        }
        send(bridge, self.id, &answers, now);
        done
    }

    /// Connects and registers anew, and says so once; a bridge that refuses is asked again at the next call.
    fn open_again(&mut self, bridge: &Bridge, now: Monotonic) -> Option<String> {
        bridge.disconnect(self.id);
        match Self::open(bridge, now) {
            Ok(opened) => {
                *self = opened;
                Some("the bridge had dropped the services of the replay: they are offered again".into())
            }
            Err(_) if self.is_lost => None,
            Err(why) => {
                self.is_lost = true;
                Some(format!("the services of the replay are not offered: {why}"))
            }
        }
    }
}

/// Passes a client's bytes to the bridge.
fn send(bridge: &Bridge, id: ClientId, bytes: &[u8], now: Monotonic) {
    // Whole frames that were written here: none is longer than all of them.
    let mut parser = Parser::new(bytes.len());
    parser.push(bytes);
    while let Ok(Some(frame)) = parser.next_frame() {
        bridge.receive(id, frame, now);
    }
}

/// Does what a request asks for, and writes the response. Returns what changed, for people.
pub fn apply(
    service: Service,
    request: &[u8],
    player: &mut Player,
    response: &mut Vec<u8>,
) -> Result<Option<String>, DecodeError> {
    let mut from = Reader::new(request)?;
    let (is_paused, speed) = (player.playback().is_paused(), player.playback().speed());
    let mut pause = |is_paused| Some(player.set_paused(is_paused));
    let done = match service {
        Service::Pause => pause(true),
        Service::Resume => pause(false),
        Service::TogglePaused => pause(!is_paused),
        Service::IsPaused => {
            Writer::new(response).bool(is_paused);
            return Ok(None);
        }
        Service::GetRate => {
            Writer::new(response).f64(speed.number());
            return Ok(None);
        }
        Service::SetRate => {
            let result = Speed::times(from.finite("rate")?).map(|speed| player.set_speed(speed));
            return Ok(answer_success(response, result));
        }
        Service::Seek => {
            let (seconds, nanoseconds) = (from.i32("time.sec")?, from.u32("time.nanosec")?);
            let result = player.seek(f64::from(seconds) + f64::from(nanoseconds) * 1e-9);
            return Ok(answer_success(response, result));
        }
    };
    // An empty response is one byte in ROS 2.
    Writer::new(response).u8(0);
    Ok(done)
}

/// Writes whether a request was done, and returns what was done or why it was not.
fn answer_success(response: &mut Vec<u8>, result: Result<String, impl std::fmt::Display>) -> Option<String> {
    Writer::new(response).bool(result.is_ok());
    Some(result.unwrap_or_else(|why| why.to_string()))
}

#[cfg(test)]
mod tests;
