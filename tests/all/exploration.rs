//! Exploration in lockstep: a fleet explores two small rooms by itself, and gives way to people.

use bridge::ros::{self, Message};
use mr_slam::config::FleetConfig;
use mr_slam::lockstep::Lockstep;
use mr_slam::lockstep::client::Client;
use mr_slam::lockstep::faults::{Fault, FaultPlan};
use msg::{GroundTruth, Monotonic, Pose2, VelocityCommand};
use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};

/// Two rooms of 9 square metres beside a corridor of the same size.
const ROOM: &str = "tests/rooms/two_rooms.obj";
const FLOOR_M2: f64 = 27.0;
const ROBOTS: usize = 2;
const EXPLORE: &str = "/explore/resume";
const STATE: &str = "/explore/state";
/// Virtual time in which the rooms are explored at the latest, seconds: it takes about half of that.
const SECONDS_MAX: f64 = 240.0;

/// A fleet with a client that starts and stops its exploration.
struct Scene {
    fleet: Lockstep,
    client: Client,
    /// Newest message of each channel.
    newest: BTreeMap<String, Vec<u8>>,
    hash: DefaultHasher,
    state: serde_json::Value,
}

impl Scene {
    fn new(faults: FaultPlan) -> Self {
        Self::of(&FleetConfig::default(), faults)
    }

    fn of(config: &FleetConfig, faults: FaultPlan) -> Self {
        let mut config = config.clone();
        (config.fleet.robots, config.fleet.seed) = (ROBOTS, 1);
        config.fleet.room = ROOM.into();
        let fleet = Lockstep::with_navigation(&config, faults).unwrap();
        let mut client = fleet.client(([127, 0, 0, 1], 7).into());
        client.subscribe(STATE, ros::Text::TYPE);
        client.advertise::<ros::Bool>(EXPLORE);
        client.advertise::<ros::Empty>("/robot1/resume_navigation");
        client.advertise::<ros::PolygonStamped>("/exclusion_zones/add");
        client.advertise::<ros::Twist>("/robot1/cmd_vel");
        client.advertise::<ros::Bool>("/emergency_stop");
        client.advertise::<ros::Empty>("/emergency_stop_release");
        let (newest, hash) = (BTreeMap::new(), DefaultHasher::new());
        let mut scene = Self { fleet, client, newest, hash, state: serde_json::Value::Null };
        scene.run(2.0, |_| false);
        scene.client.connect();
        scene.run(0.5, |_| false);
        scene
    }

    /// Runs until a condition on the state holds; returns whether it did.
    fn run(&mut self, seconds: f64, is_done: impl Fn(&serde_json::Value) -> bool) -> bool {
        for _ in 0..(seconds * 100.0) as usize {
            let Self { newest, hash, .. } = self;
            self.fleet.tick(&mut |channel, bytes| {
                (channel, bytes).hash(hash);
                let message = newest.entry(channel.to_owned()).or_default();
                message.clear();
                message.extend_from_slice(bytes);
            });
            let state = &mut self.state;
            self.client.receive(|topic, payload| {
                if topic == STATE {
                    let text: ros::Text = ros::decode(payload).unwrap();
                    *state = serde_json::from_str(&text.0).unwrap();
                }
            });
            if is_done(&self.state) {
                return true;
            }
        }
        false
    }

    fn explore(&mut self) {
        self.client.publish(EXPLORE, &ros::Bool(true));
        assert!(self.run(2.0, |state| state["state"] == "exploring"), "{}", self.state);
    }

    /// True pose of a robot, and how often it has touched anything.
    fn truth(&self, robot: usize) -> (Pose2, u64) {
        let bytes = &self.newest[&format!("robot{robot}/truth")];
        let truth: GroundTruth = bytemuck::pod_read_unaligned(bytes);
        (truth.world_from_base, truth.contacts)
    }

    /// Newest velocity that a robot got.
    fn velocity(&self, robot: usize) -> (f64, f64) {
        let bytes = &self.newest[&format!("robot{robot}/command")];
        let command: VelocityCommand = bytemuck::pod_read_unaligned(bytes);
        (command.linear_m_s, command.angular_rad_s)
    }

    /// Runs to the end of the exploration, and checks that it is complete and that the robots are back.
    fn finish(&mut self, starts: &[Pose2]) {
        let is_over = |state: &serde_json::Value| state["state"] == "completed" || state["state"] == "failed";
        assert!(self.run(SECONDS_MAX, is_over), "after {SECONDS_MAX} s: {}", self.state);
        assert_eq!(self.state["state"], "completed", "{}", self.state);
        assert!(self.state["known_m2"].as_f64().unwrap() > 0.95 * FLOOR_M2, "{}", self.state);
        for (robot, start) in (1..).zip(starts) {
            let (end, contacts) = self.truth(robot);
            assert!(start.distance_m(end) < 0.3, "robot{robot} ends at {end:?} instead of {start:?}");
            assert_eq!(contacts, 0, "robot{robot}");
        }
    }

    fn starts(&self) -> Vec<Pose2> {
        (1..=ROBOTS).map(|robot| self.truth(robot).0).collect()
    }
}

fn state_of(robot: usize, wanted: &str) -> impl Fn(&serde_json::Value) -> bool {
    move |state| state["robots"][robot - 1] == wanted
}

#[test]
fn two_robots_explore_two_rooms_to_the_end_by_the_same_bytes_twice() {
    let explore = || {
        let mut scene = Scene::new(FaultPlan::none());
        assert_eq!(scene.state["state"], "idle", "{}", scene.state);
        let starts = scene.starts();
        scene.explore();
        assert!(scene.run(5.0, |state| state["least_s"].is_f64() && state["most_s"].is_f64()));
        scene.finish(&starts);
        assert!(scene.state["left"].as_array().unwrap().iter().all(|left| left["reason"].is_string()));
        scene.hash.finish()
    };
    assert_eq!(explore(), explore());
}

#[test]
fn a_robot_that_a_person_takes_is_left_alone_until_it_is_given_back() {
    let mut scene = Scene::new(FaultPlan::none());
    scene.explore();
    scene.run(3.0, |_| false);
    let turn = ros::Twist { angular: [0.0, 0.0, 0.5], ..Default::default() };
    scene.client.publish("/robot1/cmd_vel", &turn);
    assert!(scene.run(1.0, state_of(1, "manual")), "{}", scene.state);
    scene.run(5.0, |_| false);
    let (at, other) = (scene.truth(1).0, scene.truth(2).0);
    assert_eq!(scene.velocity(1), (0.0, 0.0), "the lease is over, and nobody drives");
    scene.run(10.0, |_| false);
    assert!(at.distance_m(scene.truth(1).0) < 0.02, "robot1 stands");
    let moved = other.between(scene.truth(2).0);
    assert!(moved.x_m.hypot(moved.y_m) > 0.1 || moved.yaw_rad.abs() > 0.2, "robot2 goes on: {moved:?}");
    scene.client.publish("/robot1/resume_navigation", &ros::Empty);
    assert!(scene.run(1.0, state_of(1, "exploring")), "{}", scene.state);
}

#[test]
fn the_emergency_stop_pauses_the_exploration_until_it_is_started_again() {
    let mut scene = Scene::new(FaultPlan::none());
    scene.explore();
    scene.run(3.0, |_| false);
    scene.client.publish("/emergency_stop", &ros::Bool(true));
    assert!(scene.run(1.0, |state| state["state"] == "paused"), "{}", scene.state);
    scene.client.publish(EXPLORE, &ros::Bool(true));
    scene.run(70.0, |_| false);
    assert_eq!(scene.state["state"], "paused", "it neither goes on nor ends: {}", scene.state);
    scene.client.publish("/emergency_stop_release", &ros::Empty);
    scene.run(2.0, |_| false);
    assert_eq!(scene.state["state"], "paused", "a release starts nothing: {}", scene.state);
    assert!((1..=ROBOTS).all(|robot| scene.velocity(robot) == (0.0, 0.0)));
    scene.explore();
    assert!(scene.run(1.0, state_of(2, "exploring")), "{}", scene.state);
    scene.client.publish(EXPLORE, &ros::Bool(false));
    assert!(scene.run(1.0, |state| state["state"] == "stopped"), "{}", scene.state);
    scene.run(1.0, |_| false);
    assert!((1..=ROBOTS).all(|robot| scene.velocity(robot) == (0.0, 0.0)));
}

#[test]
fn a_killed_navigation_process_goes_on_exploring_and_the_robots_find_home() {
    // The processes of a fleet of two, in their order: two sims, two SLAMs, merge, telemetry, bridge, nav.
    let faults = FaultPlan::none().with(Monotonic(20_000_000_000), Fault::Kill(7));
    let mut scene = Scene::new(faults);
    let starts = scene.starts();
    scene.explore();
    scene.finish(&starts);
}

#[test]
fn robots_that_do_not_know_where_the_others_are_explore_their_own_maps() {
    let mut config = FleetConfig::default();
    config.fleet.starts_known = false;
    let mut scene = Scene::of(&config, FaultPlan::none());
    let starts = scene.starts();
    scene.explore();
    scene.run(15.0, |_| false);
    assert_eq!(scene.state["state"], "exploring", "{}", scene.state);
    for (robot, start) in (1..).zip(&starts) {
        let moved = start.between(scene.truth(robot).0);
        let has_moved = moved.x_m.hypot(moved.y_m) > 0.1 || moved.yaw_rad.abs() > 0.2;
        assert!(has_moved && state_of(robot, "exploring")(&scene.state), "robot{robot}: {}", scene.state);
    }
}

/// Square of an exclusion zone around a robot, so large that it does not get out by itself.
fn zone_around(centre: Pose2, half_m: f64) -> ros::PolygonStamped {
    let corner = |[x, y]: [f64; 2]| [(centre.x_m + half_m * x) as f32, (centre.y_m + half_m * y) as f32, 0.0];
    let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(corner).to_vec();
    ros::PolygonStamped { frame_id: "map".into(), corners, ..Default::default() }
}

#[test]
fn the_result_names_robots_in_exclusion_zones() {
    let is_over = |state: &serde_json::Value| state["state"] == "completed" || state["state"] == "failed";
    let mut scene = Scene::new(FaultPlan::none());
    let inside = scene.truth(2).0;
    scene.client.publish("/exclusion_zones/add", &zone_around(inside, 0.7));
    scene.run(0.5, |_| false);
    scene.explore();
    assert!(scene.run(10.0, state_of(2, "excluded")), "{}", scene.state);
    assert!(scene.run(SECONDS_MAX, is_over), "{}", scene.state);
    let reason = scene.state["reason"].as_str().unwrap();
    assert!(
        reason.contains("robot2 (in an exclusion zone)") && !reason.contains("robot1"),
        "{}",
        scene.state
    );
    assert_eq!(scene.state["robots"][1], "excluded", "as long as the result stands: {}", scene.state);
    assert!(inside.distance_m(scene.truth(2).0) < 0.02, "it stands");

    let mut scene = Scene::new(FaultPlan::none());
    scene.client.publish("/exclusion_zones/add", &zone_around(Pose2::IDENTITY, 100.0));
    scene.run(0.5, |_| false);
    scene.explore();
    assert!(scene.run(SECONDS_MAX, is_over), "{}", scene.state);
    assert_eq!(scene.state["state"], "failed", "{}", scene.state);
    let reason = scene.state["reason"].as_str().unwrap();
    assert!(reason.contains("robot1, robot2 (in an exclusion zone)"), "{}", scene.state);
}
