//! Goals of clients in lockstep: robots drive there, and give way to people.

use bridge::ros::{self, Message};
use mr_slam::config::FleetConfig;
use mr_slam::lockstep::Lockstep;
use mr_slam::lockstep::client::Client;
use mr_slam::lockstep::faults::{Fault, FaultPlan};
use msg::{GroundTruth, Monotonic, NavigationReport, Pose2, PoseEstimate, TrackingState, VelocityCommand};
use std::collections::BTreeMap;
use std::time::Duration;

/// A fleet with a client that sends goals.
struct Scene {
    fleet: Lockstep,
    client: Client,
    messages: BTreeMap<String, Vec<u8>>,
    /// Newest state of the first robot.
    state: serde_json::Value,
    /// Newest exclusion zones.
    zones: serde_json::Value,
}

const GOAL: &str = "/robot1/goal_pose";
const STATE: &str = "/robot1/navigation_state";
const ZONES: &str = "/exclusion_zones";

impl Scene {
    fn new(robots: usize, faults: FaultPlan) -> Self {
        let mut config = FleetConfig::default();
        (config.fleet.robots, config.fleet.seed) = (robots, 1);
        Self::of(&config, faults)
    }

    fn of(config: &FleetConfig, faults: FaultPlan) -> Self {
        let fleet = Lockstep::with_navigation(config, faults).unwrap();
        let mut client = fleet.client(([127, 0, 0, 1], 7).into());
        client.subscribe(STATE, ros::Text::TYPE);
        client.subscribe(ZONES, ros::Text::TYPE);
        client.advertise::<ros::PolygonStamped>("/exclusion_zones/add");
        client.advertise::<ros::Int32>("/exclusion_zones/remove");
        client.advertise::<ros::PoseStamped>(GOAL);
        client.advertise::<ros::Empty>("/robot1/cancel_navigation");
        client.advertise::<ros::Empty>("/robot1/resume_navigation");
        client.advertise::<ros::Twist>("/robot1/cmd_vel");
        client.advertise::<ros::Bool>("/emergency_stop");
        let null = serde_json::Value::Null;
        let mut scene = Self { fleet, client, messages: BTreeMap::new(), state: null.clone(), zones: null };
        scene.run(2.0, |_| false);
        scene.client.connect();
        scene.run(0.5, |_| false);
        scene
    }

    /// Runs until a condition on the state holds; returns whether it did.
    fn run(&mut self, seconds: f64, is_done: impl Fn(&serde_json::Value) -> bool) -> bool {
        for _ in 0..(seconds * 100.0) as usize {
            let messages = &mut self.messages;
            self.fleet.tick(&mut |channel, bytes| {
                messages.entry(channel.to_owned()).or_default().extend_from_slice(bytes);
            });
            let Self { state, zones, .. } = self;
            self.client.receive(|topic, payload| {
                let text: ros::Text = ros::decode(payload).unwrap();
                let to = if topic == STATE { &mut *state } else { &mut *zones };
                *to = serde_json::from_str(&text.0).unwrap();
            });
            if is_done(&self.state) {
                return true;
            }
        }
        false
    }

    fn send_goal(&mut self, frame: &str, [x, y]: [f64; 2]) {
        let pose = ros::PoseStamped {
            frame_id: frame.into(),
            position: [x, y, 0.0],
            orientation: [0.0, 0.0, 0.0, 1.0],
            ..Default::default()
        };
        self.client.publish(GOAL, &pose);
    }

    fn is(&self, state: &str) -> bool {
        self.state["state"] == state
    }

    /// True pose of the first robot, and how often it has touched anything.
    fn truth(&self) -> (Pose2, u64) {
        let truths = self.messages["robot1/truth"].chunks_exact(size_of::<GroundTruth>());
        let truth: GroundTruth = bytemuck::pod_read_unaligned(truths.last().unwrap());
        (truth.world_from_base, truth.contacts)
    }

    /// Newest velocity that the robot got.
    fn velocity(&self) -> (f64, f64) {
        let commands = self.messages["robot1/command"].chunks_exact(size_of::<VelocityCommand>());
        let command: VelocityCommand = bytemuck::pod_read_unaligned(commands.last().unwrap());
        (command.linear_m_s, command.angular_rad_s)
    }
}

fn is_over(state: &serde_json::Value) -> bool {
    ["reached", "failed", "cancelled"].iter().any(|over| state["state"] == *over)
}

/// Drives the first robot 1 m ahead; returns all messages.
fn drive_ahead() -> BTreeMap<String, Vec<u8>> {
    let mut scene = Scene::new(2, FaultPlan::none());
    let (start, _) = scene.truth();
    scene.send_goal("base_link_1", [1.0, 0.0]);
    assert!(scene.run(40.0, is_over), "still {}", scene.state);
    assert!(scene.is("reached"), "{}", scene.state);
    let (end, contacts) = scene.truth();
    let goal = start * Pose2::new(1.0, 0.0, 0.0);
    assert!(
        goal.distance_m(end) < 0.2 && contacts == 0,
        "at {end:?} instead of {goal:?}, {contacts} contacts"
    );
    scene.messages
}

#[test]
fn a_goal_in_the_laboratory_is_reached_by_the_same_bytes_twice() {
    let (once, again) = (drive_ahead(), drive_ahead());
    assert!(once.contains_key("robot1/plan") && once.contains_key("nav/health"), "{:?}", once.keys());
    assert_eq!(once.keys().collect::<Vec<_>>(), again.keys().collect::<Vec<_>>());
    for (channel, bytes) in &once {
        assert!(bytes == &again[channel], "two runs differ on {channel}");
    }
    assert!(!once.contains_key("robot2/navigation_velocity"), "a robot without a goal is not driven");
}

#[test]
fn a_person_who_drives_pauses_the_goal_until_it_is_resumed() {
    let mut scene = Scene::new(1, FaultPlan::none());
    let (start, _) = scene.truth();
    scene.send_goal("base_link_1", [1.0, 0.0]);
    assert!(scene.run(5.0, |state| state["state"] == "driving"), "{}", scene.state);
    scene.run(1.0, |_| false);
    let turn = ros::Twist { angular: [0.0, 0.0, 0.5], ..Default::default() };
    scene.client.publish("/robot1/cmd_vel", &turn);
    assert!(scene.run(0.2, |state| state["state"] == "paused"), "{}", scene.state);
    assert_eq!(scene.velocity(), (0.0, 0.5), "the person's velocity is the last");
    scene.run(10.0, |_| false);
    assert!(scene.is("paused") && scene.velocity() == (0.0, 0.0), "the lease is over, and nobody drives");
    scene.client.publish("/robot1/resume_navigation", &ros::Empty);
    assert!(scene.run(40.0, is_over) && scene.is("reached"), "{}", scene.state);
    assert!((start * Pose2::new(1.0, 0.0, 0.0)).distance_m(scene.truth().0) < 0.2);
}

#[test]
fn the_emergency_stop_pauses_goals_and_refuses_new_ones() {
    let mut scene = Scene::new(1, FaultPlan::none());
    scene.send_goal("base_link_1", [1.0, 0.0]);
    assert!(scene.run(5.0, |state| state["state"] == "driving"), "{}", scene.state);
    scene.client.publish("/emergency_stop", &ros::Bool(true));
    assert!(scene.run(0.2, |state| state["state"] == "paused"), "{}", scene.state);
    assert_eq!(scene.velocity(), (0.0, 0.0));
    let goal = scene.state["goal"].clone();
    scene.send_goal("map", [0.0, 0.0]);
    scene.client.publish("/robot1/resume_navigation", &ros::Empty);
    scene.run(2.0, |_| false);
    assert!(scene.is("paused") && scene.state["goal"] == goal, "{}", scene.state);
}

#[test]
fn goals_end_with_the_reason_or_when_they_are_cancelled() {
    let mut scene = Scene::new(1, FaultPlan::none());
    scene.send_goal("map", [80.0, 0.0]);
    assert!(scene.run(40.0, is_over) && scene.is("failed"), "{}", scene.state);
    assert!(scene.state["reason"].as_str().unwrap().contains("outside the map"), "{}", scene.state);
    scene.send_goal("base_link_1", [1.0, 0.0]);
    assert!(scene.run(5.0, |state| state["state"] == "driving"), "{}", scene.state);
    scene.client.publish("/robot1/cancel_navigation", &ros::Empty);
    assert!(scene.run(0.2, is_over) && scene.is("cancelled"), "{}", scene.state);
    assert_eq!(scene.velocity(), (0.0, 0.0));
}

/// The navigation process of a fleet of one; its processes are sim, slam, merge, telemetry, bridge, nav.
const NAVIGATION: usize = 5;

/// Disturbs the navigation process 8 s after the start, while the robot drives.
fn disturbed(fault: impl Fn(usize) -> Fault) -> Scene {
    driving(FaultPlan::none().with(Monotonic(8_000_000_000), fault(NAVIGATION)))
}

/// A robot that drives to a goal, and faults that begin later.
fn driving(faults: FaultPlan) -> Scene {
    let mut scene = Scene::new(1, faults);
    scene.run(2.0, |_| false);
    scene.send_goal("base_link_1", [1.5, 0.0]);
    assert!(scene.run(2.0, |state| state["state"] == "driving"), "{}", scene.state);
    scene
}

#[test]
fn a_killed_navigation_process_leaves_a_standing_robot_and_goes_on_with_its_goal() {
    let mut scene = disturbed(Fault::Kill);
    let (start, _) = scene.truth();
    assert!(scene.run(40.0, is_over) && scene.is("reached"), "{}", scene.state);
    assert!(start.distance_m(scene.truth().0) > 0.8, "it went on after {start:?}");
}

#[test]
fn a_goal_that_is_cancelled_while_the_navigation_process_is_dead_does_not_come_back() {
    let mut scene = disturbed(Fault::Kill);
    while scene.fleet.now().seconds() < 8.05 {
        scene.run(0.01, |_| false);
    }
    scene.client.publish("/robot1/cancel_navigation", &ros::Empty);
    scene.run(1.0, |_| false);
    let (at, _) = scene.truth();
    scene.run(10.0, |_| false);
    assert!(at.distance_m(scene.truth().0) < 0.02, "{} at {:?}", scene.state, scene.truth());
}

#[test]
fn a_robot_stands_in_time_when_the_navigation_process_hangs() {
    let mut scene = disturbed(|process| Fault::Freeze(process, Duration::from_secs(1)));
    while scene.fleet.now().seconds() < 8.4 {
        scene.run(0.01, |_| false);
    }
    assert_eq!(scene.velocity(), (0.0, 0.0), "a zero comes 0.3 s after the last command");
    assert!(scene.run(40.0, is_over) && scene.is("reached"), "{}", scene.state);
}

#[test]
fn the_state_of_a_navigation_process_that_dies_again_and_again_is_not_shown_for_ever() {
    // It dies again as soon as it was started, until the pauses between its starts are seconds.
    let kills = (0..20).map(|k| Monotonic(8_000_000_000 + k * 250_000_000));
    let faults = kills.fold(FaultPlan::none(), |faults, at| faults.with(at, Fault::Kill(NAVIGATION)));
    let mut scene = driving(faults);
    let is_reported = |state: &serde_json::Value| {
        let reason = state["reason"].as_str().unwrap_or_default();
        state["state"] == "blocked" && state["remaining_m"].is_null() && reason.contains("has not answered")
    };
    assert!(scene.run(20.0, is_reported), "{}", scene.state);
    assert!(scene.run(40.0, is_over) && scene.is("reached"), "{}", scene.state);
}

#[test]
fn a_robot_whose_slam_is_paused_is_not_driven_and_goes_on_afterwards() {
    let mut scene = disturbed(|_| Fault::Pause(0, Duration::from_secs(5)));
    let newest = |scene: &Scene| -> PoseEstimate {
        let estimates = scene.messages["robot1/pose_estimate"].chunks_exact(size_of::<PoseEstimate>());
        bytemuck::pod_read_unaligned(estimates.last().unwrap())
    };
    while scene.fleet.now().seconds() < 8.5 {
        scene.run(0.01, |_| false);
    }
    assert_eq!(newest(&scene).state(), TrackingState::Paused);
    assert_eq!(scene.velocity(), (0.0, 0.0), "{}", scene.state);
    let reason = scene.state["reason"].as_str().unwrap_or_default();
    assert!(reason.contains("paused"), "{}", scene.state);
    scene.run(4.0, |_| false);
    let (at, _) = scene.truth();
    assert!(scene.velocity() == (0.0, 0.0) && !is_over(&scene.state), "{}", scene.state);
    assert!(scene.run(40.0, is_over) && scene.is("reached"), "{}", scene.state);
    assert!(at.distance_m(scene.truth().0) > 0.5, "it went on after {at:?}");
    assert_eq!(newest(&scene).state(), TrackingState::Tracking);
}

#[test]
fn a_goal_that_is_paused_is_reported_each_second() {
    let mut scene = disturbed(|_| Fault::EmergencyStop(Duration::from_secs(60)));
    assert!(scene.run(10.0, |state| state["state"] == "paused"), "{}", scene.state);
    let reports =
        |scene: &Scene| scene.messages["robot1/navigation_state"].len() / size_of::<NavigationReport>();
    let before = reports(&scene);
    scene.run(10.0, |_| false);
    assert!(scene.is("paused"), "{}", scene.state);
    let count = reports(&scene) - before;
    assert!((9..=11).contains(&count), "{count} reports in 10 s");
}

/// The square of 0.6 m around a point of the map.
fn square_around(centre: Pose2) -> ros::PolygonStamped {
    let corner = |(x, y): (f64, f64)| [(centre.x_m + x) as f32, (centre.y_m + y) as f32, 0.0];
    let corners = [(-0.3, -0.3), (0.3, -0.3), (0.3, 0.3), (-0.3, 0.3)].map(corner).to_vec();
    ros::PolygonStamped { frame_id: "map".into(), corners, ..Default::default() }
}

#[test]
fn an_exclusion_zone_holds_until_it_is_removed_and_outlives_the_navigation_process() {
    // The processes of a fleet of one, in their order: sim, slam, merge, telemetry, bridge, nav.
    let faults = FaultPlan::none().with(Monotonic(4_000_000_000), Fault::Kill(5));
    let mut scene = Scene::new(1, faults);
    let (start, _) = scene.truth();
    let goal = start * Pose2::new(1.0, 0.0, 0.0);
    scene.client.publish("/exclusion_zones/add", &square_around(goal));
    scene.run(1.0, |_| false);
    assert_eq!(scene.zones["zones"][0]["number"], 1, "{}", scene.zones);
    while scene.fleet.now().seconds() < 5.0 {
        scene.run(0.01, |_| false);
    }
    scene.send_goal("base_link_1", [1.0, 0.0]);
    assert!(scene.run(60.0, is_over) && scene.is("failed"), "{}", scene.state);
    assert!(scene.state["reason"].as_str().unwrap().contains("zone"), "{}", scene.state);
    assert!(start.distance_m(scene.truth().0) < 0.7, "it stands before the zone: {:?}", scene.truth());
    scene.client.publish("/exclusion_zones/remove", &ros::Int32(7));
    scene.run(1.0, |_| false);
    assert_eq!(scene.zones["refusal"], "no zone has this number", "{}", scene.zones);
    scene.client.publish("/exclusion_zones/remove", &ros::Int32(1));
    scene.run(1.0, |_| false);
    assert!(scene.zones["zones"].as_array().unwrap().is_empty(), "{}", scene.zones);
    scene.send_goal("base_link_1", [1.0, 0.0]);
    assert!(scene.run(40.0, is_over) && scene.is("reached"), "{}", scene.state);
}

#[test]
fn zones_sent_while_the_navigation_process_is_started_again_all_hold() {
    let faults = FaultPlan::none().with(Monotonic(2_000_000_000), Fault::Kill(5));
    let mut scene = Scene::new(1, faults);
    while scene.fleet.now().seconds() < 2.02 {
        scene.run(0.01, |_| false);
    }
    let (start, _) = scene.truth();
    for distance_m in [2.0, 4.0, 6.0] {
        let centre = start * Pose2::new(distance_m, 0.0, 0.0);
        scene.client.publish("/exclusion_zones/add", &square_around(centre));
    }
    scene.run(3.0, |_| false);
    assert_eq!(scene.zones["zones"].as_array().unwrap().len(), 3, "{}", scene.zones);
}

/// A room of 4 m by 4 m with a table of 1 m by 1 m in a corner, as scene JSON of MRUK.
fn room_with_a_table() -> String {
    let anchor = |label: &str, at: [f64; 3], turn: [f64; 3], shape: &str| {
        serde_json::json!({
            "SemanticClassifications": [label],
            "Transform": { "Translation": at, "Rotation": turn },
            shape: if shape == "VolumeBounds" {
                serde_json::json!({ "Min": [-0.5, -0.5, -0.7], "Max": [0.5, 0.5, 0.0] })
            } else {
                serde_json::json!({ "Min": [-2.0, -2.0], "Max": [2.0, 2.0] })
            },
        })
    };
    let wall = |at, turn| anchor("WALL_FACE", at, [0.0, turn, 0.0], "PlaneBounds");
    let anchors = [
        anchor("FLOOR", [0.0; 3], [270.0, 0.0, 0.0], "PlaneBounds"),
        wall([2.0, 1.0, 0.0], 270.0),
        wall([-2.0, 1.0, 0.0], 90.0),
        wall([0.0, 1.0, -2.0], 0.0),
        wall([0.0, 1.0, 2.0], 180.0),
        anchor("TABLE", [1.4, 0.7, 1.4], [270.0, 0.0, 0.0], "VolumeBounds"),
    ];
    serde_json::json!({ "CoordinateSystem": "OpenXR", "Rooms": [{ "Anchors": anchors }] }).to_string()
}

#[test]
fn labelled_furniture_makes_zones_that_people_may_remove() {
    let mut file = tempfile::NamedTempFile::with_suffix(".json").unwrap();
    std::io::Write::write_all(&mut file, room_with_a_table().as_bytes()).unwrap();
    let mut config = FleetConfig::default();
    (config.fleet.robots, config.fleet.room) = (1, file.path().display().to_string());
    config.fleet.starts = vec![[-1.0, -1.0, 0.0]];
    let mut scene = Scene::of(&config, FaultPlan::none().with(Monotonic(1_000_000_000), Fault::Kill(5)));
    assert_eq!(scene.zones["zones"][0]["furniture"], "TABLE", "{}", scene.zones);
    assert_eq!(scene.zones["zones"].as_array().unwrap().len(), 1, "also after the process was started again");
    // The table is at y = -1.4: z of the file points backwards.
    scene.send_goal("map", [1.4, -1.4]);
    assert!(scene.run(40.0, is_over) && scene.is("failed"), "{}", scene.state);
    scene.client.publish("/exclusion_zones/remove", &ros::Int32(1));
    scene.run(1.0, |_| false);
    assert!(scene.zones["zones"].as_array().unwrap().is_empty(), "{}", scene.zones);
    config.fleet.furniture_zones = false;
    let scene = Scene::of(&config, FaultPlan::none());
    assert!(scene.zones["zones"].as_array().unwrap().is_empty(), "{}", scene.zones);
}
