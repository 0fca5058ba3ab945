//! Nav2's actions: goals of ROS 2 nodes, and that nothing is told of them but what the navigator says.

use super::Simulation;
use bridge::cdr::Writer;
use bridge::command::{Registration, name};
use bridge::frame::Side;
use bridge::relay::{RosCommand, RosEvent, RosGraph, RosRequestId};
use bridge::ros::actions::{GoalStatus, write_goal_id};
use bridge::ros::{Message, PoseStamped, encode};
use bridge::world::ExternalWorld;
use bridge::{Bridge, BridgeConfig, FleetMessage, RobotNames};
use msg::{
    Monotonic, NavigationAction, NavigationCommand, NavigationReport, NavigationStatus, Pose2, PoseEstimate,
    RobotId, Stamp, TrackingState,
};
use std::cell::RefCell;
use std::rc::Rc;

const POSE: &str = "/robot2/navigate_to_pose/_action/";
const WAYPOINTS: &str = "/robot2/follow_waypoints/_action/";
const ROBOT: RobotId = RobotId::new(2).unwrap();

/// A bridge with its endpoint, and the commands that the navigator gets.
struct Actions {
    simulation: Simulation,
    navigation: Rc<RefCell<Vec<(RobotId, NavigationCommand)>>>,
    requests: i64,
}

/// What ROS got: responses with the number of their request, and messages on topics.
#[derive(Debug, Default, PartialEq)]
struct Sent {
    responses: Vec<(i64, Vec<u8>)>,
    messages: Vec<(String, Vec<u8>)>,
}

impl Sent {
    fn statuses(&self, prefix: &str) -> Vec<u8> {
        let topic = format!("{prefix}status");
        let newest = self.messages.iter().rfind(|(of, _)| *of == topic);
        // Behind the count each goal has 24 bytes and its status, padded to 28.
        newest.map_or(Vec::new(), |(_, bytes)| bytes[8..].chunks(28).map(|goal| goal[24]).collect())
    }

    fn feedback(&self, prefix: &str) -> Vec<&[u8]> {
        let topic = format!("{prefix}feedback");
        self.messages.iter().filter(|(of, _)| *of == topic).map(|(_, bytes)| &bytes[4..]).collect()
    }
}

impl Actions {
    fn new() -> Self {
        let simulation = Simulation::new();
        let navigation = Rc::new(RefCell::new(Vec::new()));
        let commands = navigation.clone();
        simulation.bridge.on_navigation(move |robot, command| commands.borrow_mut().push((robot, command)));
        Self { simulation, navigation, requests: 0 }
    }

    /// Sends a request; returns its number.
    fn request(&mut self, service: &str, fill: impl FnOnce(&mut Writer<'_>)) -> i64 {
        let mut payload = Vec::new();
        fill(&mut Writer::new(&mut payload));
        self.requests += 1;
        let id = RosRequestId { requester: [7; 16], number: self.requests, is_in_payload: false };
        let (service, payload) = (service.into(), payload.into());
        self.simulation.on_ros_event(RosEvent::Request { service, id, payload });
        self.requests
    }

    fn sent(&self) -> Sent {
        let mut sent = Sent::default();
        for command in self.simulation.commands.borrow_mut().drain(..) {
            match command {
                RosCommand::Respond { request, payload, .. } => {
                    sent.responses.push((request.number, payload[4..].to_vec()));
                }
                RosCommand::Publish { topic, payload } => {
                    sent.messages.push((topic.to_string(), payload.to_vec()));
                }
                _ => {}
            }
        }
        sent
    }

    fn commands(&self) -> Vec<(RobotId, NavigationCommand)> {
        self.navigation.borrow_mut().drain(..).collect()
    }

    /// Offers a goal; returns whether it was accepted, and the number of its command.
    fn navigate(&mut self, id: u8, frame: &str) -> Option<u64> {
        self.request(&format!("{POSE}send_goal"), |to| {
            write_goal_id(to, &[id; 16]);
            pose(frame, 1.0).write(to);
            to.string("");
        });
        self.accepted()
    }

    fn follow(&mut self, id: u8, loops: u32, first: u32, poses: &[PoseStamped]) -> Option<u64> {
        self.request(&format!("{WAYPOINTS}send_goal"), |to| {
            write_goal_id(to, &[id; 16]);
            to.u32(loops);
            to.u32(first);
            to.count(poses.len());
            poses.iter().for_each(|pose| pose.write(to));
        });
        self.accepted()
    }

    fn accepted(&self) -> Option<u64> {
        let responses = self.sent().responses;
        let [(_, response)] = &responses[..] else { panic!("{responses:?}") };
        assert_eq!(response.len(), 12, "a bool and a time");
        let commands = self.commands();
        match response[0] {
            0 => {
                assert!(commands.is_empty(), "the navigator gets no refused goal");
                None
            }
            _ => Some(commands.last().unwrap().1.number),
        }
    }

    fn report(&self, number: u64, status: NavigationStatus, next_pose: u32, reason: &str) -> Sent {
        let mut report =
            NavigationReport { number, status: status as u32, remaining_m: 1.5, ..Default::default() };
        report.next_pose = next_pose;
        report.set_reason(reason);
        self.simulation.bridge.publish(FleetMessage::NavigationState(ROBOT, &report));
        self.sent()
    }

    fn ask_result(&mut self, prefix: &str, id: u8) -> i64 {
        self.request(&format!("{prefix}get_result"), |to| write_goal_id(to, &[id; 16]))
    }

    fn cancel(&mut self, prefix: &str, id: u8) -> Vec<u8> {
        self.request(&format!("{prefix}cancel_goal"), |to| {
            write_goal_id(to, &[id; 16]);
            to.i32(0);
            to.u32(0);
        });
        self.sent().responses.remove(0).1
    }
}

fn pose(frame: &str, x_m: f64) -> PoseStamped {
    let (position, orientation) = ([x_m, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]);
    PoseStamped { frame_id: frame.into(), position, orientation, ..PoseStamped::default() }
}

#[test]
fn a_goal_is_executed_reported_and_its_result_waits_for_the_end() {
    let mut actions = Actions::new();
    let number = actions.navigate(1, "map_2").unwrap();
    let asked = actions.ask_result(POSE, 1);
    assert_eq!(actions.sent(), Sent::default(), "no result before the end");

    let driving = actions.report(number, NavigationStatus::Driving, 0, "");
    assert_eq!(driving.statuses(POSE), [GoalStatus::Executing as u8]);
    assert!(driving.feedback(POSE).is_empty(), "where the robot is is not known");
    let pose_estimate = PoseEstimate {
        map_from_base: Pose2::new(0.25, 0.5, 0.0),
        state: TrackingState::Tracking as u32,
        nodes: 1,
        ..PoseEstimate::default()
    };
    actions.simulation.bridge.publish(FleetMessage::PoseEstimate(ROBOT, &pose_estimate));
    let driving = actions.report(number, NavigationStatus::Recovering, 0, "");
    let [feedback] = driving.feedback(POSE)[..] else { panic!("{driving:?}") };
    // Identifier, stamp, frame `map_2`, pose, two durations, recoveries and distance.
    assert_eq!((&feedback[..16], &feedback[28..34]), (&[1; 16][..], &b"map_2\0"[..]));
    assert_eq!(f64::from_le_bytes(*feedback[40..].first_chunk().unwrap()), 0.25);
    assert_eq!(i16::from_le_bytes(*feedback[112..].first_chunk().unwrap()), 1);
    assert_eq!(f32::from_le_bytes(*feedback[116..].first_chunk().unwrap()), 1.5);
    assert_eq!(feedback.len(), 120);

    let mut reached = actions.report(number, NavigationStatus::Reached, 0, "");
    assert_eq!(reached.statuses(POSE), [GoalStatus::Succeeded as u8]);
    let (answered, result) = reached.responses.remove(0);
    assert_eq!((answered, result), (asked, vec![4, 0, 0, 0, 1, 0, 0, 0, 0]));
    let again = actions.ask_result(POSE, 1);
    assert_eq!(actions.sent().responses, [(again, vec![4, 0, 0, 0, 1, 0, 0, 0, 0])]);
    let unknown = actions.ask_result(POSE, 9);
    assert_eq!(actions.sent().responses, [(unknown, vec![0, 0, 0, 0, 1, 0, 0, 0, 0])]);
}

#[test]
fn goals_that_cannot_be_driven_are_refused() {
    let mut actions = Actions::new();
    for frame in ["", "kitchen", "map_3"] {
        assert_eq!(actions.navigate(1, frame), None, "{frame}");
    }
    assert_eq!(actions.navigate(0, "map"), None, "no identifier");
    assert!(actions.navigate(1, "map").is_some());
    assert_eq!(actions.navigate(1, "map"), None, "the identifier is known");
    let waypoints = [pose("map", 0.0), pose("map", 1.0)];
    assert_eq!(actions.follow(2, 1, 0, &waypoints), None, "twice");
    assert_eq!(actions.follow(2, 0, 2, &waypoints), None, "beyond the last");
    assert_eq!(actions.follow(2, 0, 0, &[]), None);
    assert_eq!(actions.follow(2, 0, 0, &vec![pose("map", 0.0); 65]), None);
    assert_eq!(actions.follow(2, 0, 0, &[pose("map", 0.0), pose("odom_2", 0.0)]), None);
    actions.request(&format!("{POSE}send_goal"), |to| {
        write_goal_id(to, &[3; 16]);
        pose("map", 0.0).write(to);
        to.string("my_tree.xml");
    });
    assert_eq!(actions.accepted(), None, "there are no behaviour trees");
    actions.request(&format!("{POSE}send_goal"), |to| to.u8(1));
    assert_eq!(actions.accepted(), None, "too short");
    actions.simulation.bridge.stop_robots();
    actions.commands();
    assert_eq!(actions.navigate(4, "map"), None, "the emergency stop is set");
    assert_eq!(actions.simulation.bridge.counters().refused, 13);
}

#[test]
fn another_goal_takes_the_place_of_the_present_one() {
    let mut actions = Actions::new();
    actions.navigate(1, "map").unwrap();
    let number = actions.follow(2, 0, 0, &[pose("map", 0.0)]).unwrap();
    actions.navigate(3, "map").unwrap();
    for (prefix, id) in [(POSE, 1), (WAYPOINTS, 2)] {
        actions.ask_result(prefix, id);
        assert_eq!(actions.sent().responses[0].1[0], GoalStatus::Aborted as u8, "{prefix}{id}");
    }
    // The navigator's late report about it changes nothing.
    let late = actions.report(number, NavigationStatus::Reached, 0, "");
    assert!(late.statuses(WAYPOINTS).is_empty() && late.statuses(POSE).is_empty(), "{late:?}");

    // A topic of TCP, and a program that sends to the navigator itself.
    let client = actions.simulation.connect();
    let (topic, message_name) = ("/robot2/goal_pose".to_owned(), PoseStamped::TYPE.to_owned());
    let mut bytes = Vec::new();
    let registration = Registration { topic: topic.clone(), message_name, ..Registration::default() };
    Side::Client.write_command(&mut bytes, name::PUBLISH, &registration);
    let mut payload = Vec::new();
    encode(&pose("map", 2.0), &mut payload);
    Side::Client.write(&mut bytes, &topic, &payload);
    actions.simulation.receive(client, &bytes);
    actions.simulation.bridge.tick(actions.simulation.now);
    assert_eq!(actions.sent().statuses(POSE).last(), Some(&(GoalStatus::Aborted as u8)));
    let number = actions.navigate(4, "map").unwrap();
    let replaced = actions.report(number + 1_000_000, NavigationStatus::Driving, 0, "");
    assert_eq!(replaced.statuses(POSE).last(), Some(&(GoalStatus::Aborted as u8)));
}

#[test]
fn a_cancelled_goal_is_cancelled_when_the_navigator_says_so() {
    let mut actions = Actions::new();
    let number = actions.navigate(1, "map").unwrap();
    assert_eq!(actions.cancel(POSE, 9)[0], 2, "unknown");
    let response = actions.cancel(POSE, 1);
    assert_eq!((response[0], response[4], &response[8..24]), (0, 1, &[1; 16][..]));
    let [(robot, command)] = actions.commands()[..] else { panic!("one command") };
    assert_eq!((robot, command.action()), (ROBOT, Some(NavigationAction::Cancel)));
    let canceling = actions.report(number, NavigationStatus::Driving, 0, "");
    assert_eq!(canceling.statuses(POSE), [GoalStatus::Canceling as u8], "it drives still");
    let cancelled = actions.report(number, NavigationStatus::Cancelled, 0, "");
    assert_eq!(cancelled.statuses(POSE), [GoalStatus::Canceled as u8]);
    assert_eq!(actions.cancel(POSE, 1)[0], 3, "it is over");
    assert!(actions.commands().is_empty(), "nobody else's goal is cancelled");

    let number = actions.navigate(2, "map").unwrap();
    let cancelled = actions.report(number, NavigationStatus::Cancelled, 0, "");
    assert_eq!(cancelled.statuses(POSE).last(), Some(&(GoalStatus::Aborted as u8)), "by somebody else");
}

#[test]
fn a_failure_names_the_waypoint_that_was_missed() {
    let mut actions = Actions::new();
    let waypoints = [pose("map", 0.0), pose("map", 1.0), pose("map", 2.0)];
    let number = actions.follow(1, 0, 1, &waypoints).unwrap();
    let driving = actions.report(number, NavigationStatus::Driving, 1, "");
    assert_eq!(driving.feedback(WAYPOINTS), [[[1; 16].as_slice(), &[2, 0, 0, 0]].concat()]);
    actions.report(number, NavigationStatus::Failed, 0, "a chair");
    actions.ask_result(WAYPOINTS, 1);
    let result = actions.sent().responses.remove(0).1;
    assert_eq!((result[0], result[4], result[8]), (GoalStatus::Aborted as u8, 1, 2), "one, the last");
    assert!(result.windows(7).any(|text| text == b"a chair"));
}

#[test]
fn a_goal_that_the_navigator_does_not_take_up_ends_and_is_withdrawn() {
    let mut actions = Actions::new();
    actions.navigate(1, "map").unwrap();
    let asked = actions.ask_result(POSE, 1);
    actions.simulation.advance_s(4);
    assert!(actions.sent().responses.is_empty());
    actions.simulation.advance_s(1);
    let sent = actions.sent();
    assert_eq!(sent.statuses(POSE), [GoalStatus::Aborted as u8]);
    assert_eq!((sent.responses[0].0, sent.responses[0].1[0]), (asked, GoalStatus::Aborted as u8));
    assert_eq!(actions.commands()[0].1.action(), Some(NavigationAction::Cancel));
    actions.simulation.advance_s(60);
    assert_eq!(actions.sent().messages.len(), 1, "the result is forgotten, and the status says so");
    actions.ask_result(POSE, 1);
    assert_eq!(actions.sent().responses[0].1[0], GoalStatus::Unknown as u8);
}

#[test]
fn the_names_are_the_robots_own_and_nobody_elses() {
    let offered = |config: BridgeConfig, names: &[&str]| {
        let names = RobotNames::new(names.iter().map(|name| (*name).to_owned()).collect()).unwrap();
        let bridge = Bridge::new(config, names, |_, _| {}).unwrap();
        let offered = Rc::new(RefCell::new(Vec::new()));
        let commands = offered.clone();
        bridge.on_ros_command(move |command| commands.borrow_mut().push(command.name().to_string()));
        bridge.tick(Monotonic(0));
        offered.take()
    };
    for (names, expected) in [
        (&["alice", "lab/bob"][..], "/lab/bob/follow_waypoints/_action/get_result"),
        (&[""][..], "/navigate_to_pose/_action/send_goal"),
    ] {
        let offered = offered(BridgeConfig::default(), names);
        assert!(offered.iter().any(|name| name == expected), "{offered:?}");
        // Each action has three services, two topics, and its empty status.
        assert_eq!(offered.iter().filter(|name| name.contains("/_action/")).count(), 12 * names.len());
    }
    let actions = Actions::new();
    let client = actions.simulation.connect();
    let service = format!("{POSE}cancel_goal");
    actions.simulation.register(client, name::UNITY_SERVICE, &service, "action_msgs/CancelGoal");
    let (_, texts) = actions.simulation.received(client);
    assert!(texts.iter().any(|text| text.contains("offered by the fleet")), "{texts:?}");
}

#[test]
fn an_action_that_a_robots_own_nav2_offers_is_left_to_it() {
    let bridge = Bridge::with_external_world(
        BridgeConfig::default(),
        ExternalWorld::new(1, |_| {}),
        |now| Stamp(now.0 as i64),
        |_, _| {},
    )
    .unwrap();
    let commands = Rc::new(RefCell::new(Vec::new()));
    let asked = commands.clone();
    bridge.on_ros_command(move |command| asked.borrow_mut().push(command));
    bridge.tick(Monotonic(0));
    commands.borrow_mut().clear();
    let graph = |service: &str| {
        let services = [(service.to_owned(), vec!["action_msgs/CancelGoal".to_owned()])].into();
        RosEvent::Graph(RosGraph { services, ..RosGraph::default() })
    };
    bridge.receive_ros(graph("/robot1/navigate_to_pose/_action/cancel_goal"), Monotonic(0));
    let closed: Vec<String> =
        commands.borrow_mut().drain(..).map(|command| command.name().to_string()).collect();
    assert_eq!(closed.len(), 5, "{closed:?}");
    assert!(closed.iter().all(|name| name.starts_with("/robot1/navigate_to_pose/_action/")), "{closed:?}");
    bridge.receive_ros(graph("/other"), Monotonic(0));
    assert_eq!(commands.borrow().len(), 6, "it is offered again, with its status");
}
