//! A console that does not draw: it reads from the bridge what the operator's page reads.

use mr_slam::run::Run;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::error::Error;
use std::net::TcpStream;
use std::process::{Child, Command};
use tungstenite::WebSocket;
use tungstenite::client::IntoClientRequest;
use tungstenite::http::HeaderValue;
use tungstenite::protocol::Message;

/// First word of the command line that runs [`read`].
pub const WORD: &str = "page-client";
/// Topics of the fleet and of each robot that `page/main.js` subscribes to.
const FLEET_TOPICS: [&str; 7] = [
    "/tf",
    "/tf_static",
    "/emergency_stop",
    "/merge_edges",
    "/explore/state",
    "/exclusion_zones",
    "/merged_map_tiles",
];
const ROBOT_TOPICS: [&str; 5] = ["odom", "scan", "pose", "plan", "navigation_state"];

/// A process that reads, which is killed when this is dropped.
pub struct Console(Child);

impl Console {
    /// Starts it at the lowest priority (`SCHED_IDLE`), as an operator's console runs on another machine.
    pub fn start(run: &Run) -> Result<Self, Box<dyn Error>> {
        let child = Command::new("chrt")
            .args(["--idle", "0"])
            .arg(std::env::current_exe()?)
            .args([WORD, &run.config.bridge.page.port.to_string()])
            .spawn()?;
        Ok(Self(child))
    }
}

impl Drop for Console {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Connects to the page's port on loopback, subscribes, and reads until the connection ends.
pub fn read(port: u16) -> Result<(), Box<dyn Error>> {
    let stream = TcpStream::connect(("127.0.0.1", port))?;
    stream.set_nodelay(true)?;
    let mut request = format!("ws://127.0.0.1:{port}/").into_client_request()?;
    let headers = request.headers_mut();
    headers.insert("Sec-WebSocket-Protocol", HeaderValue::from_static("foxglove.sdk.v1"));
    headers.insert("Origin", HeaderValue::from_str(&format!("http://127.0.0.1:{port}"))?);
    let (mut socket, _) = tungstenite::client::client(request, stream)?;
    send(&mut socket, &json!({"op": "subscribeParameterUpdates", "parameterNames": []}))?;
    let mut subscribed = BTreeSet::new();
    loop {
        let Message::Text(text) = socket.read()? else { continue };
        let message: Value = serde_json::from_str(&text)?;
        for channel in message["channels"].as_array().into_iter().flatten() {
            let (Some(id), Some(topic)) = (channel["id"].as_u64(), channel["topic"].as_str()) else {
                continue;
            };
            if is_of_page(topic) && subscribed.insert(id) {
                let subscription = json!({"id": subscribed.len(), "channelId": id});
                send(&mut socket, &json!({"op": "subscribe", "subscriptions": [subscription]}))?;
            }
        }
    }
}

fn is_of_page(topic: &str) -> bool {
    let of_robot = topic.strip_prefix("/robot").and_then(|rest| rest.split_once('/'));
    FLEET_TOPICS.contains(&topic) || of_robot.is_some_and(|(_, name)| ROBOT_TOPICS.contains(&name))
}

fn send(socket: &mut WebSocket<TcpStream>, command: &Value) -> Result<(), tungstenite::Error> {
    socket.send(Message::text(command.to_string()))
}
