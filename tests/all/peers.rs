//! A robot is not mapped as an obstacle, neither where it stands nor where it stood, though others see it there.

use crate::harness::{Fleet, Folder, WATCHDOG};
use bridge::command::{Registration, name};
use bridge::frame::Side;
use bridge::ros::{Message, Twist, encode};
use formats::map_file::read_map;
use mr_slam::config::FleetConfig;
use mr_slam::lockstep::Lockstep;
use mr_slam::world;
use msg::grid::{Occupancy, occupancy};
use msg::pose::wrap_angle;
use msg::{Grid, GridView, GroundTruth, Pose2, RobotId, Role, Scan, VelocityCommand};
use sim::Simulator;
use sim::burger::ROBOT_RADIUS_M;
use slam::Slam;
use std::io::Write;
use std::net::TcpStream;
use std::time::{Duration, Instant};

/// How well a robot knows where it is, metres: its footprint in the map is so much smaller.
const POSE_M: f64 = 0.02;

/// Cells that are taken for obstacles under a robot that stands at this point of the map.
fn under(map: GridView<'_>, [x_m, y_m]: [f64; 2], radius_m: f64) -> usize {
    let reach = (radius_m / map.header.resolution_m).ceil() as i64;
    let (x, y) = map.cell_of([x_m, y_m]);
    let square = (y - reach..=y + reach).flat_map(|y| (x - reach..=x + reach).map(move |x| (x, y)));
    let occupied = square.filter(|(x, y)| {
        let [u, v] = map.centre_m(*x, *y);
        (u - x_m).hypot(v - y_m) <= radius_m && occupancy(map.cell(*x, *y)) == Occupancy::Occupied
    });
    occupied.count()
}

struct Member {
    robot: RobotId,
    simulator: Simulator,
    slam: Slam,
    scan: Box<Scan>,
    truth: GroundTruth,
    /// Where it has been.
    way_m: Vec<[f64; 2]>,
}

/// Two robots that go where the test wants, and the map of both.
struct Duo {
    members: Vec<Member>,
    merger: merge::Merger,
    config: FleetConfig,
}

impl Duo {
    fn new(starts: [[f64; 3]; 2], robot_radius_m: f64) -> Self {
        let mut config = FleetConfig::default();
        (config.fleet.robots, config.fleet.starts) = (2, starts.to_vec());
        config.slam.map.robot_radius_m = robot_radius_m;
        let room = world::room(&config).unwrap();
        let poses = config.configured_starts().unwrap();
        let member = |(robot, start): (RobotId, &Pose2)| Member {
            robot,
            simulator: world::simulator(&config, &room, robot, *start).unwrap(),
            slam: Slam::new(config.slam.clone()),
            scan: bytemuck::allocation::zeroed_box(),
            truth: GroundTruth { world_from_base: *start, ..GroundTruth::default() },
            way_m: Vec::new(),
        };
        let members = RobotId::first(2).zip(&poses).map(member).collect();
        let known: Vec<_> = poses.iter().copied().map(Some).collect();
        Self { members, merger: merge::Merger::new(&config.merge, &known), config }
    }

    fn tick(&mut self) {
        let truths: Vec<GroundTruth> = self.members.iter().map(|member| member.truth).collect();
        for member in &mut self.members {
            for (peer, truth) in RobotId::first(2).zip(&truths).filter(|(peer, _)| *peer != member.robot) {
                member.simulator.update_peer(peer, truth);
            }
            let tick = member.simulator.step();
            member.truth = tick.truth;
            if let Some(odometry) = tick.odometry {
                member.slam.add_odometry(&odometry);
            }
            if tick.scan_due {
                let at = member.truth.world_from_base;
                member.way_m.push([at.x_m, at.y_m]);
                member.simulator.scan_into(&mut member.scan);
                let pose_estimate = member.slam.process(&member.scan).pose_estimate;
                member.slam.work();
                let radius_m = self.config.slam.map.robot_radius_m;
                self.merger.add_robot_pose(member.robot, pose_estimate.map_from_base, radius_m);
                self.merger.update_tiles(member.robot, member.slam.tiles()).unwrap();
            }
        }
    }

    fn steer(&mut self, robot: usize, linear_m_s: f64, angular_rad_s: f64) {
        let command = VelocityCommand { linear_m_s, angular_rad_s, ..VelocityCommand::default() };
        self.members[robot - 1].simulator.set_velocity_command(&command);
        self.tick();
    }

    fn at(&self, robot: usize) -> Pose2 {
        self.members[robot - 1].truth.world_from_base
    }

    /// How far to turn to look at a point, radians.
    fn bearing(&self, robot: usize, [x, y]: [f64; 2]) -> f64 {
        let at = self.at(robot);
        wrap_angle((y - at.y_m).atan2(x - at.x_m) - at.yaw_rad)
    }

    fn face(&mut self, robot: usize, point: [f64; 2]) {
        for _ in 0..2000 {
            let off = self.bearing(robot, point);
            if off.abs() < 0.05 {
                return self.rest(20);
            }
            self.steer(robot, 0.0, (3.0 * off).clamp(-1.0, 1.0));
        }
        panic!("robot{robot} does not turn to {point:?}");
    }

    fn go(&mut self, robot: usize, point: [f64; 2]) {
        for _ in 0..6000 {
            let (at, off) = (self.at(robot), self.bearing(robot, point));
            if (at.x_m - point[0]).hypot(at.y_m - point[1]) < 0.03 {
                return self.rest(20);
            }
            let linear_m_s = if off.abs() < 0.3 { 0.15 } else { 0.0 };
            self.steer(robot, linear_m_s, (3.0 * off).clamp(-1.0, 1.0));
        }
        panic!("robot{robot} does not get to {point:?}, it is at {:?}", self.at(robot));
    }

    fn rest(&mut self, ticks: usize) {
        (0..ticks).for_each(|_| self.tick());
    }

    /// Obstacles in the fleet's map under a robot where it has been so far.
    fn on_its_way(&mut self, robot: usize) -> usize {
        let map = self.merger.merged();
        let way = &self.members[robot - 1].way_m;
        way.iter().map(|point| under(map, *point, ROBOT_RADIUS_M - POSE_M)).max().unwrap()
    }

    /// Obstacles in robot 1's own map at a point of the world.
    fn in_the_map_of_robot1(&mut self, point: [f64; 2]) -> usize {
        let map_from_world = self.config.configured_starts().unwrap()[0].inverse();
        under(self.members[0].slam.map(), map_from_world.apply(point), ROBOT_RADIUS_M)
    }
}

/// Robot 2 backs up a little, less than a node is apart, and stands where it has never looked; robot 1 drives around it and looks at it from all
/// sides, then turns away; robot 2 goes far off. Obstacles under robot 2 while it stands, and on all its way at last.
fn drive_around(robot_radius_m: f64) -> [usize; 2] {
    let middle = [-1.9, -1.3];
    let mut duo = Duo::new([[-2.5, -1.3, 0.0], [-1.7, -1.3, 0.0]], robot_radius_m);
    duo.rest(50);
    while duo.at(2).x_m > middle[0] {
        duo.steer(2, -0.1, 0.0);
    }
    duo.rest(50);
    let mut worst = 0;
    for k in 0..9 {
        let angle = std::f64::consts::PI + f64::from(k) * std::f64::consts::TAU / 8.0;
        duo.go(1, [middle[0] + 0.6 * angle.cos(), middle[1] + 0.6 * angle.sin()]);
        duo.face(1, middle);
        worst = worst.max(duo.on_its_way(2));
    }
    let stood = duo.at(2);
    assert!(duo.in_the_map_of_robot1([stood.x_m, stood.y_m]) > 0, "robot 1 has not seen robot 2");
    // It turns its back, and is out of the way.
    duo.go(1, [-2.7, -1.4]);
    duo.face(1, [-4.0, -1.4]);
    for point in [[-1.2, -1.45], [0.3, -1.6], [0.3, 0.4]] {
        duo.go(2, point);
    }
    assert!(duo.in_the_map_of_robot1([stood.x_m, stood.y_m]) > 0, "robot 1 has looked there again");
    [worst, duo.on_its_way(2)]
}

#[test]
fn a_robot_is_not_mapped_where_it_stands_or_stood() {
    assert_eq!(drive_around(ROBOT_RADIUS_M), [0, 0]);
    // Whose size is not known is one: the scene is what it should be.
    let [stands, stood] = drive_around(0.0);
    assert!(stands > 0 && stood > 0, "{stands} {stood}");
}

/// Obstacles in the map of a fleet whose robots drive one after the other while the rest stands in their way, wherever
/// robots have been; each five seconds.
fn on_all_ways(robot_radius_m: f64) -> Vec<usize> {
    let mut config = FleetConfig::default();
    (config.fleet.robots, config.slam.map.robot_radius_m) = (5, robot_radius_m);
    let mut fleet = Lockstep::new(&config, false).unwrap();
    let mut places: Vec<[f64; 2]> = Vec::new();
    let mut obstacles = Vec::new();
    for ticks in 1..=60 * 100_u64 {
        fleet.tick(&mut |channel, bytes| {
            if channel.ends_with("/truth") && ticks.is_multiple_of(10) {
                let truth: GroundTruth = bytemuck::pod_read_unaligned(bytes);
                let at = truth.world_from_base;
                places.push([at.x_m, at.y_m]);
            }
        });
        if ticks.is_multiple_of(500) {
            let (_, map) = fleet.maps().find(|(name, _)| *name == "merged_map").unwrap();
            let here = places.iter().map(|point| under(map, *point, ROBOT_RADIUS_M - POSE_M));
            obstacles.push(here.sum());
        }
    }
    obstacles
}

#[test]
fn no_robot_of_a_driving_fleet_is_mapped_as_an_obstacle() {
    let obstacles = on_all_ways(ROBOT_RADIUS_M);
    assert!(obstacles.iter().all(|count| *count == 0), "{obstacles:?}");
    let obstacles = on_all_ways(0.0);
    assert!(obstacles.iter().any(|count| *count > 0), "robots did not see each other: {obstacles:?}");
}

/// Two robots of a running fleet, and a hand that drives them over TCP.
struct Scene {
    fleet: Fleet,
    stream: TcpStream,
}

impl Scene {
    fn new(starts: [[f64; 3]; 2]) -> Self {
        let folder = Folder::new();
        let file = folder.file("fleet.toml", format!("[fleet]\nrobots = 2\nstarts = {starts:?}\n"));
        let fleet = Fleet::start("up", &["--config", file.to_str().unwrap()]);
        let mut stream = TcpStream::connect(("127.0.0.1", fleet.run.port)).unwrap();
        let mut out = Vec::new();
        for topic in ["/cmd_vel_1", "/cmd_vel_2"] {
            let about = Registration {
                topic: topic.into(),
                message_name: Twist::TYPE.into(),
                ..Registration::default()
            };
            Side::Client.write_command(&mut out, name::PUBLISH, &about);
        }
        stream.write_all(&out).unwrap();
        Self { fleet, stream }
    }

    /// Drives a robot until it is where it should be.
    fn drive(&mut self, robot: usize, linear_m_s: f64, angular_rad_s: f64, there: impl Fn(Pose2) -> bool) {
        let mut push = |linear_m_s, angular_rad_s| {
            let twist = Twist { linear: [linear_m_s, 0.0, 0.0], angular: [0.0, 0.0, angular_rad_s] };
            let mut out = Vec::new();
            Side::Client.write_with(&mut out, &format!("/cmd_vel_{robot}"), |out| encode(&twist, out));
            self.stream.write_all(&out).unwrap();
        };
        let (begun, robot) = (Instant::now(), RobotId::new(robot).unwrap());
        while !self.fleet.observer.last_seen(Role::Sim, robot).is_some_and(&there) {
            push(linear_m_s, angular_rad_s);
            self.fleet.observer.wait(Duration::from_millis(50));
            assert!(begun.elapsed() < WATCHDOG, "{robot} does not get there");
        }
        push(0.0, 0.0);
    }

    /// A map as it is now.
    fn map(&mut self, name: &str) -> Option<Grid> {
        self.fleet.observer.wait(Duration::from_millis(100));
        let folder = self.fleet.folder.path();
        assert!(self.fleet.observer.write_maps(folder).1.is_empty());
        read_map(&folder.join(format!("{name}.yaml"))).ok()
    }
}

#[test]
fn a_robot_that_backed_up_in_a_running_fleet_is_not_mapped_as_an_obstacle() {
    let starts = [[-2.5, -1.3, 0.0], [-1.7, -1.3, 0.0]];
    let mut scene = Scene::new(starts);
    scene
        .fleet
        .until("scans of both robots", |view| view.robots.iter().filter(|r| r.scans >= 20).count() == 2);
    // Not so far that it is a new node; where its own beams have never been.
    scene.drive(2, -0.05, 0.0, |at| at.x_m < -1.88);
    scene.drive(1, 0.0, 0.3, |at| at.yaw_rad > 0.4);
    let stands = scene.fleet.observer.last_seen(Role::Sim, RobotId::new(2).unwrap()).unwrap();
    let at = [stands.x_m, stands.y_m];
    let [x, y, yaw] = starts[0];
    let in_its_own = Pose2::new(x, y, yaw).inverse().apply(at);
    let begun = Instant::now();
    while scene.map("robot1_map").is_none_or(|map| under(map.view(), in_its_own, ROBOT_RADIUS_M) == 0) {
        assert!(begun.elapsed() < WATCHDOG, "robot 1 has not seen robot 2");
    }
    // Whenever one looks: with robot 1's map as it is now, and after.
    for _ in 0..20 {
        let merged = scene.map("merged_map").unwrap();
        assert_eq!(under(merged.view(), at, ROBOT_RADIUS_M - POSE_M), 0);
    }
}
