//! The bridge as the foxglove crate reads it: each message of the server is parsed by the crate's own types, strictly, and
//! each of the client is written by them.
//!
//! usage: foxglove-oracle URL

use foxglove::ws_protocol::client::{GetParameters, ServiceCallRequest, Subscribe, SubscribeParameterUpdates, Subscription};
use foxglove::ws_protocol::server::ServerMessage;
use foxglove::ws_protocol::server::server_info::Capability;
use foxglove::ws_protocol::server::status::Level;
use foxglove::ws_protocol::{BinaryMessage, JsonMessage};
use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;
use std::net::TcpStream;
use std::time::{Duration, Instant};
use tungstenite::client::IntoClientRequest;
use tungstenite::http::HeaderValue;
use tungstenite::{Message, WebSocket};

/// What has not come by then never comes.
const PATIENCE: Duration = Duration::from_secs(30);
/// A request without fields in CDR: the header, and the byte of an empty structure.
const EMPTY: &[u8] = &[0, 1, 0, 0, 0];
/// Topics on which a fleet at rest publishes, or has published.
const EXPECTED: [&str; 5] = ["/robot1/scan", "/robot2/odom", "/tf", "/merged_map", "/clock"];

/// What the server has sent.
#[derive(Default)]
struct Seen {
    capabilities: Vec<Capability>,
    channels: BTreeMap<String, u64>,
    services: BTreeMap<String, u32>,
    topics: BTreeMap<u32, String>,
    received: BTreeSet<String>,
    parameters: BTreeSet<String>,
    responses: BTreeMap<u32, Vec<u8>>,
    failures: BTreeMap<u32, String>,
}

impl Seen {
    fn take(&mut self, message: ServerMessage<'_>) -> Result<(), Box<dyn Error>> {
        match message {
            ServerMessage::ServerInfo(info) => self.capabilities = info.capabilities,
            ServerMessage::Advertise(advertise) => {
                for channel in &advertise.channels {
                    channel.decode_schema()?;
                    self.channels.insert(channel.topic.to_string(), channel.id);
                }
            }
            ServerMessage::AdvertiseServices(advertise) => {
                for service in &advertise.services {
                    for part in [&service.request, &service.response] {
                        part.as_ref().ok_or("a service without a schema")?.schema()?;
                    }
                    self.services.insert(service.name.to_string(), service.id);
                }
            }
            ServerMessage::MessageData(data) => {
                let topic = self.topics.get(&data.subscription_id).ok_or("a message of no subscription")?;
                self.received.insert(topic.clone());
            }
            ServerMessage::ParameterValues(values) => {
                self.parameters.extend(values.parameters.into_iter().map(|parameter| parameter.name));
            }
            ServerMessage::ServiceCallResponse(response) => {
                self.responses.insert(response.call_id, response.payload.into_owned());
            }
            ServerMessage::ServiceCallFailure(failure) => {
                self.failures.insert(failure.call_id, failure.message);
            }
            ServerMessage::Status(status) if status.level == Level::Error => {
                return Err(format!("the server says: {status:?}").into());
            }
            ServerMessage::Status(_)
            | ServerMessage::Unadvertise(_) | ServerMessage::UnadvertiseServices(_) => {}
            other => return Err(format!("not expected: {other:?}").into()),
        }
        Ok(())
    }
}

/// A connection, and what has come on it.
struct Client {
    socket: WebSocket<TcpStream>,
    seen: Seen,
}

impl Client {
    fn connect(url: &str) -> Result<Self, Box<dyn Error>> {
        let address = url.trim_start_matches("http://");
        let stream = TcpStream::connect(address)?;
        stream.set_read_timeout(Some(PATIENCE))?;
        let mut request = format!("ws://{address}/").into_client_request()?;
        let protocol = HeaderValue::from_static("foxglove.sdk.v1");
        request.headers_mut().insert("Sec-WebSocket-Protocol", protocol);
        let (socket, _) = tungstenite::client(request, stream)?;
        Ok(Self { socket, seen: Seen::default() })
    }

    fn send_text(&mut self, message: &impl JsonMessage) -> Result<(), Box<dyn Error>> {
        Ok(self.socket.send(Message::text(message.to_string()))?)
    }

    fn call(&mut self, service: &str, call_id: u32, payload: &[u8]) -> Result<(), Box<dyn Error>> {
        let service_id = self.seen.services[service];
        let request = ServiceCallRequest { service_id, call_id, encoding: "cdr".into(), payload: payload.into() };
        Ok(self.socket.send(Message::binary(request.to_bytes()))?)
    }

    /// Reads until something is so.
    fn wait_for(&mut self, what: &str, is_so: impl Fn(&Seen) -> bool) -> Result<(), Box<dyn Error>> {
        let begun = Instant::now();
        while !is_so(&self.seen) {
            if begun.elapsed() > PATIENCE {
                return Err(format!("waited in vain: {what}").into());
            }
            match self.socket.read()? {
                Message::Text(text) => self.seen.take(ServerMessage::parse_json(&text)?)?,
                Message::Binary(bytes) => self.seen.take(ServerMessage::parse_binary(&bytes)?)?,
                _ => {}
            }
        }
        Ok(())
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let url = std::env::args().nth(1).ok_or("usage: foxglove-oracle URL")?;
    let mut client = Client::connect(&url)?;
    client.wait_for("topics and services", |seen| {
        EXPECTED.iter().all(|topic| seen.channels.contains_key(*topic)) && !seen.services.is_empty()
    })?;
    let wanted = [Capability::ClientPublish, Capability::Parameters, Capability::Services];
    assert!(wanted.iter().all(|capability| client.seen.capabilities.contains(capability)));

    let mut subscriptions = Vec::new();
    for (id, topic) in (1..).zip(EXPECTED) {
        client.seen.topics.insert(id, topic.to_owned());
        subscriptions.push(Subscription::new(id, client.seen.channels[topic]));
    }
    client.send_text(&Subscribe::new(subscriptions))?;
    client.wait_for("messages", |seen| EXPECTED.iter().all(|topic| seen.received.contains(*topic)))?;

    client.send_text(&SubscribeParameterUpdates::new(["/mr_slam/fleet"]))?;
    client.send_text(&GetParameters::new(["/mr_slam/time"]).with_id("time"))?;
    client.wait_for("parameters", |seen| seen.parameters.len() == 2)?;

    client.call("/robot2/clear_closures", 1, EMPTY)?;
    client.call("/robot2/slam_toolbox/save_map", 2, &[0, 1, 0, 0, 5, 0, 0, 0, b'.', b'.', b'/', b'x', 0])?;
    client.wait_for("a response and a failure", |seen| seen.responses.len() == 1 && seen.failures.len() == 1)?;
    assert_eq!(client.seen.responses[&1][4], 1, "it is done");
    assert!(client.seen.failures[&2].contains("leads out of the folder for saved files"), "{:?}", client.seen.failures);
    println!("foxglove crate: every message is one of the protocol; services answer and fail as it says");
    Ok(())
}
