//! A browser for the tests: the WebSocket side of one, as a blocking client.

use bridge::ros::{Message, encode};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;
use tungstenite::client::IntoClientRequest;
use tungstenite::http::HeaderValue;
use tungstenite::protocol::Message as Frame;
use tungstenite::{Error, HandshakeError, WebSocket};

/// What has not come by then never comes: a test fails, and does not hang.
pub(crate) const WAIT_MAX: Duration = Duration::from_secs(30);

/// A connected browser.
pub(crate) struct Browser {
    pub(crate) socket: WebSocket<TcpStream>,
    /// Channels by topic: number and schema name.
    pub(crate) channels: BTreeMap<String, (u64, String)>,
    /// Services by name: number and type.
    pub(crate) services: BTreeMap<String, (u64, String)>,
    /// Calls that failed: number of the call, and why.
    pub(crate) failures: Vec<(u64, String)>,
    /// Responses of services.
    pub(crate) responses: Vec<Response>,
    pub(crate) statuses: Vec<(u64, String)>,
    pub(crate) info: Value,
    /// The newest state of the fleet.
    pub(crate) fleet: Value,
    /// Answers to requests for parameters.
    pub(crate) answers: Vec<Value>,
    next_id: u32,
}

/// A message on a subscription.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Data {
    pub(crate) subscription: u32,
    pub(crate) time_ns: u64,
    pub(crate) payload: Vec<u8>,
}

/// The response of a service.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Response {
    pub(crate) service: u32,
    pub(crate) call: u32,
    pub(crate) payload: Vec<u8>,
}

impl Browser {
    /// Connects with these headers; fails with the status of the response.
    pub(crate) fn try_connect(address: SocketAddr, headers: &[(&'static str, &str)]) -> Result<Self, u16> {
        let stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(WAIT_MAX)).unwrap();
        let mut request = format!("ws://{address}/").into_client_request().unwrap();
        let protocols = HeaderValue::from_static("foxglove.sdk.v1");
        request.headers_mut().insert("Sec-WebSocket-Protocol", protocols);
        for (name, value) in headers {
            request.headers_mut().insert(*name, HeaderValue::from_str(value).unwrap());
        }
        let socket = match tungstenite::client::client(request, stream) {
            Ok((socket, _)) => socket,
            Err(HandshakeError::Failure(Error::Http(response))) => return Err(response.status().as_u16()),
            Err(error) => panic!("{error}"),
        };
        let mut browser = Self {
            socket,
            channels: BTreeMap::new(),
            services: BTreeMap::new(),
            failures: Vec::new(),
            responses: Vec::new(),
            statuses: Vec::new(),
            info: Value::Null,
            fleet: Value::Null,
            answers: Vec::new(),
            next_id: 0,
        };
        while browser.channels.is_empty() {
            assert_eq!(browser.read(), None);
        }
        Ok(browser)
    }

    pub(crate) fn connect(address: SocketAddr) -> Self {
        let origin = format!("http://{address}");
        Self::try_connect(address, &[("Origin", &origin)]).unwrap()
    }

    /// Reads one message; returns it if it is of a subscription.
    pub(crate) fn read(&mut self) -> Option<Data> {
        match self.socket.read().expect("the bridge keeps the connection") {
            Frame::Text(text) => {
                self.read_text(&text);
                None
            }
            Frame::Binary(bytes) if bytes[0] == 3 => {
                let number = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
                assert_eq!((number(9), &bytes[13..16]), (3, &b"cdr"[..]));
                let response =
                    Response { service: number(1), call: number(5), payload: bytes[16..].to_vec() };
                self.responses.push(response);
                None
            }
            Frame::Binary(bytes) => {
                assert_eq!(bytes[0], 1);
                Some(Data {
                    subscription: u32::from_le_bytes(bytes[1..5].try_into().unwrap()),
                    time_ns: u64::from_le_bytes(bytes[5..13].try_into().unwrap()),
                    payload: bytes[13..].to_vec(),
                })
            }
            _ => None,
        }
    }

    fn read_text(&mut self, text: &str) {
        let value: Value = serde_json::from_str(text).unwrap();
        match value["op"].as_str().unwrap() {
            "serverInfo" => self.info = value,
            "advertise" => {
                for channel in value["channels"].as_array().unwrap() {
                    assert_eq!(
                        (&channel["encoding"], &channel["schemaEncoding"]),
                        (&json!("cdr"), &json!("ros2msg"))
                    );
                    let known =
                        (channel["id"].as_u64().unwrap(), channel["schemaName"].as_str().unwrap().to_owned());
                    self.channels.insert(channel["topic"].as_str().unwrap().to_owned(), known);
                }
            }
            "advertiseServices" => {
                for service in value["services"].as_array().unwrap() {
                    let known =
                        (service["id"].as_u64().unwrap(), service["type"].as_str().unwrap().to_owned());
                    self.services.insert(service["name"].as_str().unwrap().to_owned(), known);
                }
            }
            "unadvertiseServices" => {
                let gone = value["serviceIds"].as_array().unwrap();
                self.services.retain(|_, (id, _)| !gone.contains(&json!(id)));
            }
            "serviceCallFailure" => {
                let text = value["message"].as_str().unwrap().to_owned();
                self.failures.push((value["callId"].as_u64().unwrap(), text));
            }
            "status" => {
                let level = value["level"].as_u64().unwrap();
                self.statuses.push((level, value["message"].as_str().unwrap().to_owned()));
            }
            "parameterValues" if !value["id"].is_null() => self.answers.push(value),
            "parameterValues" => self.fleet = value["parameters"][0]["value"].clone(),
            "unadvertise" => {}
            other => panic!("{other}"),
        }
    }

    /// Reads until a message of this subscription arrives.
    pub(crate) fn data(&mut self, subscription: u32) -> Data {
        loop {
            if let Some(data) = self.read().filter(|data| data.subscription == subscription) {
                return data;
            }
        }
    }

    /// Reads until a status contains this text.
    pub(crate) fn wait_for_status(&mut self, text: &str) {
        while !self.statuses.iter().any(|(_, message)| message.contains(text)) {
            self.read();
        }
    }

    pub(crate) fn send(&mut self, command: &Value) {
        self.socket.send(Frame::text(command.to_string())).unwrap();
    }

    /// Reads until the browser has what is wanted.
    pub(crate) fn read_until(&mut self, is_done: impl Fn(&Self) -> bool) {
        while !is_done(self) {
            self.read();
        }
    }

    /// Calls a service.
    pub(crate) fn call(&mut self, service: u32, call: u32, encoding: &str, payload: &[u8]) {
        let mut bytes = vec![2];
        for number in [service, call, encoding.len() as u32] {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
        bytes.extend_from_slice(encoding.as_bytes());
        bytes.extend_from_slice(payload);
        self.socket.send(Frame::binary(bytes)).unwrap();
    }

    /// Subscribes to a topic; returns the subscription's number.
    pub(crate) fn subscribe(&mut self, topic: &str) -> u32 {
        self.next_id += 1;
        let (id, channel) = (self.next_id, self.channels[topic].0);
        self.send(&json!({"op": "subscribe", "subscriptions": [{"id": id, "channelId": channel}]}));
        id
    }

    /// Registers a topic for publication; returns its number.
    pub(crate) fn advertise<M: Message>(&mut self, topic: &str) -> u32 {
        self.next_id += 1;
        let schema = M::TYPE.replace('/', "/msg/");
        let channel = json!({"id": self.next_id, "topic": topic, "encoding": "cdr", "schemaName": schema});
        self.send(&json!({"op": "advertise", "channels": [channel]}));
        self.next_id
    }

    pub(crate) fn publish<M: Message>(&mut self, channel: u32, message: &M) {
        let mut bytes = vec![1];
        bytes.extend_from_slice(&channel.to_le_bytes());
        encode(message, &mut bytes);
        self.socket.send(Frame::binary(bytes)).unwrap();
    }
}
