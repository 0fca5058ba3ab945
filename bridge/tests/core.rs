//! The routing core without sockets and with a simulated clock: clients of this process drive robots.

mod in_memory;

use bridge::command::{Notice, Registration, name};
use bridge::frame::Side;
use bridge::ros::{Bool, Clock, Empty, Int32, Joy, Message, Twist, encode};
use bridge::{Bridge, BridgeConfig, ClientId, FleetMessage};
use msg::{Monotonic, VelocityCommand};
use std::cell::RefCell;
use std::rc::Rc;

/// A velocity that reached a robot: robot, m/s, rad/s.
type Velocity = (usize, f64, f64);

/// A bridge of two robots, its simulated clock and the velocities that it has sent.
struct Simulation {
    bridge: Bridge,
    now: Monotonic,
    velocities: Rc<RefCell<Vec<Velocity>>>,
}

impl Simulation {
    /// Creates a bridge whose robots have got the zeros of its start.
    fn new() -> Self {
        let mut simulation = Self::at_start();
        for _ in 0..30 {
            simulation.advance_ms(50);
        }
        simulation.take_velocities();
        simulation
    }

    fn at_start() -> Self {
        let velocities = Rc::new(RefCell::new(Vec::new()));
        let sink = velocities.clone();
        let on_command = move |robot: msg::RobotId, command: VelocityCommand| {
            sink.borrow_mut().push((robot.number(), command.linear_m_s, command.angular_rad_s));
        };
        let bridge = Bridge::new(BridgeConfig::default(), 2, on_command).unwrap();
        Self { bridge, now: Monotonic(0), velocities }
    }

    fn advance_ms(&mut self, ms: u64) {
        self.now = Monotonic(self.now.0 + ms * 1_000_000);
        self.bridge.tick(self.now);
    }

    /// Connects a client that may publish these topics.
    fn connect(&self, port: u16, topics: &[(&str, &str)]) -> ClientId {
        let client = self.bridge.connect(([127, 0, 0, 1], port).into()).unwrap();
        for (topic, message_type) in topics {
            self.register(client, name::PUBLISH, topic, message_type);
        }
        client
    }

    fn register(&self, client: ClientId, command: &str, topic: &str, message_type: &str) {
        let registration = Registration {
            topic: topic.to_owned(),
            message_name: message_type.to_owned(),
            ..Registration::default()
        };
        let mut bytes = Vec::new();
        Side::Client.write_command(&mut bytes, command, &registration);
        self.receive(client, &bytes);
    }

    fn send<M: Message>(&self, client: ClientId, topic: &str, message: &M) {
        let mut bytes = Vec::new();
        Side::Client.write_with(&mut bytes, topic, |out| encode(message, out));
        self.receive(client, &bytes);
    }

    fn receive(&self, client: ClientId, bytes: &[u8]) {
        in_memory::receive(&self.bridge, client, bytes, self.now);
    }

    /// Takes the frames that wait for a client: name and payload.
    fn take_frames(&self, client: ClientId) -> Vec<(String, Vec<u8>)> {
        in_memory::take_frames(&self.bridge, client)
    }

    fn errors(&self, client: ClientId) -> Vec<String> {
        let frames = self.take_frames(client);
        let errors = frames.iter().filter(|(name, _)| name == name::ERROR);
        errors.map(|(_, payload)| serde_json::from_slice::<Notice>(payload).unwrap().text).collect()
    }

    fn take_velocities(&self) -> Vec<Velocity> {
        std::mem::take(&mut self.velocities.borrow_mut())
    }
}

fn forward(linear_m_s: f64) -> Twist {
    Twist { linear: [linear_m_s, 0.0, 0.0], ..Twist::default() }
}

const DRIVE_1: [(&str, &str); 1] = [("/cmd_vel_1", Twist::TYPE)];

#[test]
fn a_client_of_this_process_gets_the_handshake_and_its_topics() {
    let simulation = Simulation::new();
    let client = simulation.connect(1, &[]);
    simulation.register(client, name::SUBSCRIBE, "/clock", Clock::TYPE);
    simulation.bridge.publish(FleetMessage::Clock(&msg::Clock::default()));
    let frames = simulation.take_frames(client);
    let names: Vec<&str> = frames.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, [name::HANDSHAKE, "/clock"]);
    assert!(simulation.take_frames(client).is_empty());
}

#[test]
fn a_lease_ends_one_second_after_the_last_moving_velocity() {
    let mut simulation = Simulation::new();
    let (one, two) = (simulation.connect(1, &DRIVE_1), simulation.connect(2, &DRIVE_1));
    simulation.send(one, "/cmd_vel_1", &forward(0.1));
    simulation.advance_ms(999);
    simulation.send(two, "/cmd_vel_1", &forward(0.2));
    assert_eq!(simulation.take_velocities(), [(1, 0.1, 0.0), (1, 0.0, 0.0)]);
    assert!(simulation.errors(two)[0].contains("robot1 is driven by 127.0.0.1:1"));
    simulation.advance_ms(1);
    simulation.take_velocities();
    simulation.send(two, "/cmd_vel_1", &forward(0.2));
    assert_eq!(simulation.take_velocities(), [(1, 0.2, 0.0)]);
    assert_eq!(simulation.bridge.clients(simulation.now)[1].drives.len(), 1);
}

#[test]
fn releasing_the_grip_stops_the_robot_that_the_stick_moved() {
    let simulation = Simulation::new();
    let client = simulation.connect(1, &[("/quest/joystick", Joy::TYPE), ("/selected_robot", Int32::TYPE)]);
    let joy = |grip: f32| Joy { axes: vec![0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, grip], ..Joy::default() };
    simulation.send(client, "/quest/joystick", &joy(1.0));
    simulation.send(client, "/selected_robot", &Int32(2));
    simulation.send(client, "/quest/joystick", &joy(0.0));
    assert_eq!(simulation.take_velocities(), [(1, 0.15, 0.0), (1, 0.0, 0.0)]);
}

#[test]
fn a_stick_without_permission_sends_no_zero_and_its_client_stops_nothing() {
    let simulation = Simulation::new();
    let address = std::net::IpAddr::from([10, 0, 0, 9]);
    let client = simulation.bridge.connect((address, 1).into()).unwrap();
    simulation.register(client, name::PUBLISH, "/quest/joystick", Joy::TYPE);
    let joy = |grip: f32| Joy { axes: vec![0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, grip], ..Joy::default() };
    simulation.send(client, "/quest/joystick", &joy(1.0));
    assert!(simulation.errors(client)[0].contains("may not drive yet"));
    simulation.send(client, "/quest/joystick", &joy(0.0));
    simulation.bridge.disconnect(client);
    assert_eq!(simulation.take_velocities(), []);
    // A zero of a client that may drive passes, also the one of a released grip.
    let client = simulation.connect(2, &[DRIVE_1[0], ("/quest/joystick", Joy::TYPE)]);
    simulation.send(client, "/quest/joystick", &joy(1.0));
    simulation.send(client, "/quest/joystick", &joy(0.0));
    simulation.send(client, "/cmd_vel_1", &forward(0.0));
    assert_eq!(simulation.take_velocities(), [(1, 0.15, 0.0), (1, 0.0, 0.0), (1, 0.0, 0.0)]);
    simulation.send(client, "/quest/joystick", &joy(1.0));
    simulation.bridge.disconnect(client);
    assert_eq!(simulation.take_velocities(), [(1, 0.15, 0.0), (1, 0.0, 0.0)], "a driver that vanishes");
}

#[test]
fn a_part_of_the_process_keeps_its_place_and_its_services_however_long_it_is_silent() {
    let mut simulation = Simulation::new();
    let permanent = simulation.bridge.connect_permanent(([127, 0, 0, 1], 1).into()).unwrap();
    simulation.connect(2, &[]);
    simulation.register(permanent, name::UNITY_SERVICE, "/pause", "std_srvs/Empty");
    for _ in 0..301 {
        simulation.advance_ms(1000);
    }
    let clients: Vec<_> =
        simulation.bridge.clients(simulation.now).iter().map(|client| client.address).collect();
    assert_eq!(
        clients,
        [std::net::SocketAddr::from(([127, 0, 0, 1], 1))],
        "the remote one is dropped after 300 s"
    );
    let other = simulation.connect(3, &[]);
    simulation.register(other, name::UNITY_SERVICE, "/pause", "std_srvs/Empty");
    assert!(simulation.errors(other)[0].contains("/pause"), "the service is taken");
    simulation.take_frames(permanent);
    // Of the clients that are silent, one makes room for a new one; the silence of the part of the process does not count.
    simulation.advance_ms(6000);
    let places = BridgeConfig::default().clients_max - 2;
    for index in 0..places {
        simulation.connect(100 + index as u16, &[]);
    }
    simulation.connect(4, &[]);
    let clients = simulation.bridge.clients(simulation.now);
    let ports: Vec<u16> = clients.iter().map(|client| client.address.port()).collect();
    assert!(ports.contains(&1) && ports.contains(&4) && !ports.contains(&3), "{ports:?}");
}

#[test]
fn the_emergency_stop_stops_all_robots_until_it_is_released() {
    let simulation = Simulation::new();
    let topics = [DRIVE_1[0], ("/emergency_stop", Bool::TYPE), ("/emergency_stop_release", Empty::TYPE)];
    let client = simulation.connect(1, &topics);
    simulation.send(client, "/cmd_vel_1", &forward(0.1));
    simulation.send(client, "/emergency_stop", &Bool(true));
    simulation.send(client, "/cmd_vel_1", &forward(0.1));
    assert_eq!(simulation.take_velocities(), [(1, 0.1, 0.0), (1, 0.0, 0.0), (2, 0.0, 0.0)]);
    assert!(simulation.bridge.is_stopped());
    assert!(simulation.errors(client)[0].contains("emergency stop is set"));
    simulation.send(client, "/emergency_stop_release", &Empty);
    simulation.send(client, "/cmd_vel_1", &forward(0.1));
    assert_eq!(simulation.take_velocities(), [(1, 0.1, 0.0)]);
}

#[test]
fn a_robot_stops_when_its_client_leaves() {
    let simulation = Simulation::new();
    let client = simulation.connect(1, &DRIVE_1);
    simulation.send(client, "/cmd_vel_1", &forward(0.1));
    simulation.bridge.disconnect(client);
    assert_eq!(simulation.take_velocities(), [(1, 0.1, 0.0), (1, 0.0, 0.0)]);
    assert!(simulation.bridge.take_outgoing(client, &mut Vec::new()).is_err());
}

#[test]
fn every_robot_is_sent_a_zero_before_a_clients_first_velocity() {
    let simulation = Simulation::at_start();
    let client = simulation.connect(1, &DRIVE_1);
    simulation.send(client, "/cmd_vel_1", &forward(5.0));
    assert_eq!(simulation.take_velocities(), [(1, 0.0, 0.0), (2, 0.0, 0.0), (1, 0.22, 0.0)]);
}

#[test]
fn the_robot_of_a_silent_client_is_sent_zeros_for_a_second() {
    let mut simulation = Simulation::new();
    let client = simulation.connect(1, &DRIVE_1);
    simulation.send(client, "/cmd_vel_1", &forward(0.1));
    let sent_at = simulation.now;
    assert_eq!(simulation.take_velocities(), [(1, 0.1, 0.0)]);
    let mut zeros = Vec::new();
    while simulation.now.since(sent_at) < 5_000_000_000 {
        // As the server does: it sleeps until the bridge names the time.
        simulation.now = simulation.bridge.next_tick(simulation.now);
        simulation.bridge.tick(simulation.now);
        let velocities = simulation.take_velocities();
        assert!(velocities.iter().all(|velocity| *velocity == (1, 0.0, 0.0)), "{velocities:?}");
        zeros.extend(velocities.iter().map(|_| simulation.now.since(sent_at) / 1_000_000));
    }
    assert_eq!((zeros[0], zeros.len(), zeros.last()), (300, 21, Some(&1_300)));
}

#[test]
fn a_service_call_fails_after_its_timeout() {
    let mut simulation = Simulation::new();
    let (caller, provider) = (simulation.connect(1, &[]), simulation.connect(2, &[]));
    simulation.register(provider, name::UNITY_SERVICE, "/save", "std_srvs/Trigger");
    simulation.register(caller, name::ROS_SERVICE, "/save", "std_srvs/Trigger");
    let mut bytes = Vec::new();
    Side::Client.write_command(&mut bytes, name::REQUEST, &bridge::command::Call { srv_id: 101 });
    Side::Client.write(&mut bytes, "/save", &[0, 1, 0, 0]);
    simulation.receive(caller, &bytes);
    simulation.advance_ms(9_999);
    assert!(simulation.errors(caller).is_empty());
    simulation.advance_ms(1);
    assert!(simulation.errors(caller)[0].contains("no answer came in time"));
}

#[test]
fn a_client_that_takes_no_replies_must_be_disconnected() {
    let simulation = Simulation::new();
    let client = simulation.connect(1, &[]);
    let mut bytes = Vec::new();
    Side::Client.write_command(&mut bytes, name::TOPIC_LIST, &serde_json::json!({}));
    for _ in 0..10_000 {
        simulation.receive(client, &bytes);
    }
    assert!(simulation.bridge.take_outgoing(client, &mut Vec::new()).is_err());
}

/// Connects clients at different addresses until the bridge has as many as it may.
fn fill(simulation: &Simulation) -> Vec<ClientId> {
    let limit = BridgeConfig::default().clients_max;
    let address = |index: usize| ([10, 0, 0, index as u8], 1).into();
    (0..limit).map(|index| simulation.bridge.connect(address(index)).unwrap()).collect()
}

#[test]
fn a_silent_connection_makes_room_and_a_living_one_does_not() {
    let mut simulation = Simulation::new();
    let clients = fill(&simulation);
    simulation.advance_ms(4_900);
    let (silent, living) = clients.split_first().unwrap();
    living.iter().for_each(|client| simulation.receive(*client, &bridge::frame::KEEPALIVE));
    let newcomer = ([10, 0, 1, 1], 1).into();
    assert!(simulation.bridge.connect(newcomer).unwrap_err().to_string().contains("clients_max"));
    simulation.advance_ms(200);
    let newcomer = simulation.bridge.connect(newcomer).unwrap();
    assert!(simulation.bridge.connect(([10, 0, 1, 2], 1).into()).is_err(), "the others are not silent");
    let reason = simulation.errors(*silent).remove(0);
    assert!(reason.contains("sent nothing for 5 s, and its place was needed"), "{reason}");
    assert!(simulation.bridge.take_outgoing(*silent, &mut Vec::new()).is_err());
    assert_eq!(simulation.take_frames(newcomer)[0].0, name::HANDSHAKE);
}

#[test]
fn a_connection_that_is_silent_for_minutes_is_closed() {
    let mut simulation = Simulation::new();
    let client = simulation.connect(1, &[]);
    simulation.advance_ms(299_000);
    assert_eq!(simulation.bridge.counters().clients, 1);
    simulation.advance_ms(1_000);
    assert_eq!(simulation.bridge.counters().clients, 0);
    assert!(simulation.errors(client)[0].contains("silence_max_s"));
}

#[test]
fn one_address_cannot_take_all_places() {
    let mut simulation = Simulation::new();
    let connect = |simulation: &Simulation, port| simulation.bridge.connect(([10, 0, 0, 9], port).into());
    let ids: Vec<ClientId> = (1..=16).map(|port| connect(&simulation, port).unwrap()).collect();
    let error = connect(&simulation, 17).unwrap_err().to_string();
    assert!(error.contains("10.0.0.9 has 16 connections"), "{error}");
    assert!(simulation.bridge.connect(([10, 0, 0, 8], 1).into()).is_ok());
    simulation.advance_ms(5_000);
    ids[1..].iter().for_each(|client| simulation.receive(*client, &bridge::frame::KEEPALIVE));
    assert!(connect(&simulation, 17).is_ok(), "the silent one has made room");
    assert_eq!(simulation.bridge.drop_clients("10.0.0.9".parse().unwrap()), 16);
    assert_eq!(simulation.bridge.counters().clients, 1);
}

#[test]
fn a_service_is_not_taken_over_while_its_owner_lives() {
    let mut simulation = Simulation::new();
    let (caller, owner, thief) =
        (simulation.connect(1, &[]), simulation.connect(2, &[]), simulation.connect(3, &[]));
    simulation.register(owner, name::UNITY_SERVICE, "/save", "std_srvs/Trigger");
    simulation.register(thief, name::UNITY_SERVICE, "/save", "std_srvs/Trigger");
    simulation.register(caller, name::ROS_SERVICE, "/save", "std_srvs/Trigger");
    assert!(simulation.errors(thief)[0].contains("offered by another client"));
    let call = |simulation: &Simulation, number| {
        let mut bytes = Vec::new();
        Side::Client.write_command(&mut bytes, name::REQUEST, &bridge::command::Call { srv_id: number });
        Side::Client.write(&mut bytes, "/save", &[0, 1, 0, 0]);
        simulation.receive(caller, &bytes);
    };
    let requests = |simulation: &Simulation, client| {
        simulation.take_frames(client).iter().filter(|(name, _)| name == name::REQUEST).count()
    };
    call(&simulation, 101);
    assert_eq!((requests(&simulation, owner), requests(&simulation, thief)), (1, 0));
    simulation.bridge.disconnect(owner);
    call(&simulation, 102);
    assert_eq!(requests(&simulation, thief), 1, "the next in line answers");
    // An owner that has been silent for long is replaced by who registers then.
    simulation.advance_ms(5_000);
    let heir = simulation.connect(4, &[]);
    simulation.register(heir, name::UNITY_SERVICE, "/save", "std_srvs/Trigger");
    call(&simulation, 103);
    assert_eq!((requests(&simulation, heir), requests(&simulation, thief)), (1, 0));
}

/// Every frame counts: at a client that keeps up none is lost, repeated or out of order.
#[test]
fn a_client_that_keeps_up_gets_every_transform_in_order() {
    let simulation = Simulation::new();
    let client = simulation.connect(1, &[]);
    simulation.register(client, name::SUBSCRIBE, "/tf", bridge::ros::TfMessage::TYPE);
    simulation.register(client, name::SUBSCRIBE, "/clock", Clock::TYPE);
    simulation.take_frames(client);
    let robot = msg::RobotId::new(1).unwrap();
    for sent in 1..=2_000 {
        let mut transforms = msg::Transforms { len: 1, ..Default::default() };
        transforms.transforms[0].parent_frame = msg::RobotFrame::Odom as u32;
        transforms.transforms[0].child_frame = msg::RobotFrame::BaseFootprint as u32;
        transforms.header.stamp = msg::Stamp(sent * 50_000_000);
        let mut clock = msg::Clock::default();
        clock.header.stamp = msg::Stamp(sent * 50_000_000 + 1);
        simulation.bridge.publish(FleetMessage::Transforms(robot, &transforms));
        simulation.bridge.publish(FleetMessage::Clock(&clock));
        let frames = simulation.take_frames(client);
        let names: Vec<&str> = frames.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["/tf", "/clock"], "after {sent} of each");
        let tf: bridge::ros::TfMessage = bridge::ros::decode(&frames[0].1).unwrap();
        assert_eq!(tf.transforms[0].stamp, transforms.header.stamp);
        let received: Clock = bridge::ros::decode(&frames[1].1).unwrap();
        assert_eq!(received.clock, clock.header.stamp);
    }
    assert_eq!(simulation.bridge.counters().dropped, 0);
}
