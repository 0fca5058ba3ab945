//! Services between clients, ROS 2 nodes and robots' SLAM without sockets and DDS: the endpoint is a list of commands here.

use bridge::command::{Call, Notice, Registration, name};
use bridge::frame::{Parser, Side};
use bridge::relay::{RosCommand, RosEvent, RosGraph, RosRequestId};
use bridge::{Bridge, BridgeConfig, ClientId};
use msg::{Monotonic, RobotId, SlamOutcome, SlamRequest, SlamResponse};
use std::cell::RefCell;
use std::rc::Rc;

mod actions;
mod ros;
mod slam;

const TRIGGER: &str = "std_srvs/Trigger";
/// An empty request: its encapsulation header and ROS 2's byte in messages without fields.
const EMPTY: &[u8] = &[0, 1, 0, 0, 0];
const RESPONSE: &[u8] = &[0, 1, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0];
const ROS: RosRequestId = RosRequestId { requester: [7; 16], number: 3, is_in_payload: false };

/// A bridge of two robots with an endpoint, and what it has asked of ROS and of SLAM.
struct Simulation {
    bridge: Bridge,
    now: Monotonic,
    commands: Rc<RefCell<Vec<RosCommand>>>,
    requests: Rc<RefCell<Vec<(RobotId, SlamRequest)>>>,
}

impl Simulation {
    fn new() -> Self {
        Self::with(|_| {})
    }

    fn with(change: impl FnOnce(&mut BridgeConfig)) -> Self {
        let mut config = BridgeConfig::default();
        change(&mut config);
        let bridge = Bridge::new(config, 2, |_, _| {}).unwrap();
        let (commands, requests) = (Rc::new(RefCell::new(Vec::new())), Rc::new(RefCell::new(Vec::new())));
        let (to_ros, to_slam) = (commands.clone(), requests.clone());
        bridge.on_ros_command(move |command| to_ros.borrow_mut().push(command));
        bridge.on_slam_request(move |robot, request| to_slam.borrow_mut().push((robot, request)));
        let simulation = Self { bridge, now: Monotonic(0), commands, requests };
        assert!(simulation.asked().iter().any(|command| command == "serve /robot2/pause std_srvs/SetBool"));
        simulation
    }

    fn advance_s(&mut self, seconds: u64) {
        self.now = Monotonic(self.now.0 + seconds * 1_000_000_000);
        self.bridge.tick(self.now);
    }

    fn connect(&self) -> ClientId {
        self.connect_from([127, 0, 0, 1])
    }

    fn connect_from(&self, address: [u8; 4]) -> ClientId {
        let client = self.bridge.connect((address, 5000).into()).unwrap();
        self.frames(client);
        client
    }

    fn receive(&self, client: ClientId, bytes: &[u8]) {
        let mut parser = Parser::new(1 << 20);
        parser.push(bytes);
        while let Some(frame) = parser.next_frame().unwrap() {
            self.bridge.receive(client, frame, self.now);
        }
    }

    fn register(&self, client: ClientId, command: &str, service: &str, service_type: &str) {
        let (topic, message_name) = (service.to_owned(), service_type.to_owned());
        let registration = Registration { topic, message_name, ..Registration::default() };
        let mut bytes = Vec::new();
        Side::Client.write_command(&mut bytes, command, &registration);
        self.receive(client, &bytes);
    }

    /// Sends a call or a response of a client.
    fn send(&self, client: ClientId, command: &str, number: i64, service: &str, payload: &[u8]) {
        let mut bytes = Vec::new();
        Side::Client.write_command(&mut bytes, command, &Call { srv_id: number });
        Side::Client.write(&mut bytes, service, payload);
        self.receive(client, &bytes);
    }

    fn call(&self, client: ClientId, number: i64, service: &str) {
        self.send(client, name::REQUEST, number, service, EMPTY);
    }

    fn on_ros_event(&self, event: RosEvent) {
        self.bridge.receive_ros(event, self.now);
    }

    /// Tells the bridge which services ROS nodes offer.
    fn offer_in_ros(&self, services: &[(&str, &str)]) {
        let services =
            services.iter().map(|(name, of)| ((*name).to_owned(), vec![(*of).to_owned()])).collect();
        self.on_ros_event(RosEvent::Graph(RosGraph { services, ..RosGraph::default() }));
    }

    fn request_from_ros(&self, service: &str, payload: &[u8]) {
        let payload = payload.to_vec().into();
        self.on_ros_event(RosEvent::Request { service: service.into(), id: ROS, payload });
    }

    fn frames(&self, client: ClientId) -> Vec<(String, Vec<u8>)> {
        let mut bytes = Vec::new();
        self.bridge.take_outgoing(client, &mut bytes).unwrap();
        let mut parser = Parser::new(1 << 20);
        parser.push(&bytes);
        let mut frames = Vec::new();
        while let Some(frame) = parser.next_frame().unwrap() {
            frames.push((String::from_utf8(frame.name.to_vec()).unwrap(), frame.payload.to_vec()));
        }
        frames
    }

    /// Takes the frames that wait for a client: calls or responses with number and payload, and texts for a person.
    fn received(&self, client: ClientId) -> (Vec<(i64, Vec<u8>)>, Vec<String>) {
        let (mut calls, mut texts, mut number) = (Vec::new(), Vec::new(), None);
        for (of, payload) in self.frames(client) {
            match of.as_str() {
                name::REQUEST | name::RESPONSE => {
                    number = Some(serde_json::from_slice::<Call>(&payload).unwrap().srv_id);
                }
                name::WARN | name::ERROR => {
                    texts.push(serde_json::from_slice::<Notice>(&payload).unwrap().text);
                }
                _ => calls.extend(number.take().map(|number| (number, payload))),
            }
        }
        (calls, texts)
    }

    /// Takes what was asked of ROS about services.
    fn asked(&self) -> Vec<String> {
        let text = |command: RosCommand| match command {
            RosCommand::OpenClient { service, service_type } => Some(format!("use {service} {service_type}")),
            RosCommand::CloseClient { service } => Some(format!("leave {service}")),
            RosCommand::Call { service, number, payload } => {
                Some(format!("call {service} {number} {payload:?}"))
            }
            RosCommand::Cancel { service, number } => Some(format!("cancel {service} {number}")),
            RosCommand::OpenServer { service, service_type } => {
                Some(format!("serve {service} {service_type}"))
            }
            RosCommand::CloseServer { service } => Some(format!("close {service}")),
            RosCommand::Respond { service, request, payload } => {
                assert_eq!(request, ROS);
                Some(format!("respond {service} {:?}", &payload[..]))
            }
            _ => None,
        };
        self.commands.borrow_mut().drain(..).filter_map(text).collect()
    }

    /// Takes the payloads of responses to ROS nodes.
    fn responses_to_ros(&self) -> Vec<Vec<u8>> {
        let payload = |command| match command {
            RosCommand::Respond { payload, .. } => Some(payload.to_vec()),
            _ => None,
        };
        self.commands.borrow_mut().drain(..).filter_map(payload).collect()
    }

    /// Answers SLAM's oldest request.
    fn answer(&self, outcome: SlamOutcome, text: &str) -> SlamRequest {
        let (robot, request) = self.requests.borrow_mut().remove(0);
        let text = msg::Text::new(text).unwrap();
        let answer =
            SlamResponse { id: request.id, outcome: outcome as u32, text, ..SlamResponse::default() };
        self.bridge.receive_slam_response(robot, &answer, true);
        request
    }
}
