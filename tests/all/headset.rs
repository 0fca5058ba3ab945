//! The mode of the MR-SLAM paper: scans, transforms and the clock come from a headset, whose clock is five seconds
//! ahead.

use crate::harness::{Fleet, Folder, WATCHDOG, output};
use bridge::cdr::Writer;
use bridge::command::{Notice, Registration, name};
use bridge::frame::{Parser, Side};
use bridge::ros::{self, FrameNames, NameStyle, TfMessage, TransformStamped, write};
use bytemuck::Zeroable;
use mr_slam::clock::Epoch;
use mr_slam::config::FleetConfig;
use mr_slam::fleet;
use msg::{Pose2, RobotId, Scan, Stamp, VelocityCommand};
use rustix::process::Signal;
use sim::Simulator;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

const ROBOTS: usize = 2;
/// Difference of the two clocks in the MR-SLAM paper.
const AHEAD: Duration = Duration::from_secs(5);
const OUT: [(&str, &str); 4] = [
    ("/tf", "tf2_msgs/TFMessage"),
    ("/clock", "rosgraph_msgs/Clock"),
    ("/robot1/scan", "sensor_msgs/LaserScan"),
    ("/robot2/scan", "sensor_msgs/LaserScan"),
];
const IN: [(&str, &str); 3] = [
    ("/tf", "tf2_msgs/TFMessage"),
    ("/merged_map", "nav_msgs/OccupancyGrid"),
    ("/robot2/slam_stats", "std_msgs/Float32MultiArray"),
];

/// The headset's application: it simulates robots that turn in place.
struct Headset {
    stream: TcpStream,
    robots: Vec<(RobotId, Simulator)>,
    names: FrameNames,
    frames: Vec<u8>,
    scan: Box<Scan>,
}

impl Headset {
    fn attach(port: u16, config: &FleetConfig) -> Self {
        let room = fleet::room(config).unwrap();
        let starts = fleet::starts(config, &room).unwrap();
        let simulator = |(robot, start)| (robot, fleet::simulator(config, &room, robot, start).unwrap());
        let stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        let mut frames = bridge::frame::KEEPALIVE.to_vec();
        for (command, topics) in [(name::SUBSCRIBE, &IN[..]), (name::PUBLISH, &OUT[..])] {
            for (topic, class) in topics {
                let about = Registration {
                    topic: (*topic).into(),
                    message_name: (*class).into(),
                    queue_size: 10,
                    latch: false,
                };
                Side::Client.write_command(&mut frames, command, &about);
            }
        }
        (&stream).write_all(&frames).unwrap();
        Self {
            stream,
            robots: RobotId::first(ROBOTS).zip(starts).map(simulator).collect(),
            names: FrameNames::new(NameStyle::Flat, &ROBOTS.into()),
            frames,
            scan: Box::new(Scan::zeroed()),
        }
    }

    fn frame(&mut self, topic: &str, message: impl FnOnce(&mut Writer<'_>)) {
        Side::Client.write_with(&mut self.frames, topic, |out| message(&mut Writer::new(out)));
    }

    /// One tick of the world, stamped by the headset's clock.
    fn tick(&mut self, stamp: Stamp, guarded: bool) {
        self.frames.clear();
        self.frame("/clock", |to| write::stamp(to, stamp));
        for index in 0..self.robots.len() {
            let (robot, simulator) = &mut self.robots[index];
            let robot = *robot;
            simulator.command(&VelocityCommand { angular_rad_s: 0.5, ..VelocityCommand::default() });
            let tick = simulator.step();
            let names = self.names.clone();
            if let Some(mut transforms) = tick.transforms {
                transforms.header.stamp = stamp;
                self.frame("/tf", |to| write::transforms(to, &names, robot, &transforms));
            }
            if tick.scan_due {
                let mut scan = self.scan.clone();
                self.robots[index].1.scan_into(&mut scan);
                scan.header.stamp = stamp;
                let (topic, frame) = (format!("/{robot}/scan"), names.link(robot, msg::Link::BaseScan));
                self.frame(&topic, |to| write::laser_scan(to, frame, &scan));
            }
        }
        if guarded {
            let correction = TransformStamped {
                stamp,
                frame_id: "map".into(),
                child_frame_id: "odom_1".into(),
                rotation: [0.0, 0.0, 0.0, 1.0],
                ..TransformStamped::default()
            };
            let tree = TfMessage { transforms: vec![correction] };
            self.frame("/tf", |to| ros::Message::write(&tree, to));
        }
        self.stream.write_all(&self.frames).unwrap();
    }

    /// Plays until told to stop, in real time: what stamps say is what a clock would.
    fn play(mut self, stop: &AtomicBool) {
        let begun = Instant::now();
        // The headset's time of day.
        let first = Epoch::unix().stamp(mr_slam::clock::now()) + AHEAD;
        for tick in 0_u32.. {
            if stop.load(Ordering::Relaxed) {
                break;
            }
            let at = Simulator::TICK * tick;
            std::thread::sleep((begun + at).saturating_duration_since(Instant::now()));
            self.tick(first + at, tick % 100 == 50);
        }
    }
}

/// What came back to the headset.
#[derive(Default)]
struct Heard {
    errors: Vec<String>,
    /// Of map_1 -> odom_1.
    corrections: Vec<Stamp>,
    maps: usize,
    stats: usize,
}

fn listen(mut stream: TcpStream) -> Heard {
    stream.set_read_timeout(Some(WATCHDOG)).unwrap();
    let (mut heard, mut parser) = (Heard::default(), Parser::new(64 << 20));
    while let Ok(count @ 1..) = stream.read(parser.space()) {
        parser.filled(count);
        while let Some(frame) = parser.next_frame().unwrap() {
            match frame.name {
                b"__error" => {
                    heard.errors.push(serde_json::from_slice::<Notice>(frame.payload).unwrap().text)
                }
                b"/tf" => {
                    let tree: TfMessage = ros::decode(frame.payload).unwrap();
                    let slams = tree.transforms.iter().filter(|edge| edge.child_frame_id == "odom_1");
                    heard.corrections.extend(slams.map(|edge| edge.stamp));
                }
                b"/merged_map" => heard.maps += 1,
                b"/robot2/slam_stats" => heard.stats += 1,
                _ => {}
            }
        }
    }
    heard
}

#[test]
fn the_world_of_a_headset_is_mapped_on_the_runs_clock() {
    let room = fleet::room(&FleetConfig::default()).unwrap();
    let starts = room.starts(ROBOTS).unwrap().iter().map(|p| [p.x_m, p.y_m, p.yaw_rad]).collect::<Vec<_>>();
    let folder = Folder::new();
    let text = format!("world = \"headset\"\n[fleet]\nrobots = {ROBOTS}\nstarts = {starts:?}\n");
    let file = folder.file("fleet.toml", text);
    let mut fleet = Fleet::start("up", &["--config", file.to_str().unwrap()]);

    let config = FleetConfig::from_file(&file).unwrap();
    let headset = Headset::attach(fleet.run.port, &config);
    let stream = headset.stream.try_clone().unwrap();
    let ears = std::thread::spawn(move || listen(stream));
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = stop.clone();
    let player = std::thread::spawn(move || headset.play(&stopped));

    let view = fleet.until("maps of the headset's robots, merged", |view| {
        view.robots.len() == ROBOTS
            && view.robots.iter().all(|robot| robot.scans >= 60 && robot.map.slam_stats[0] > 500.0)
            && view.merged_map.slam_stats[0] > 500.0
    });
    for robot in &view.robots {
        assert_eq!((robot.state, robot.scans_lost), ("tracking", 0), "{robot:?}");
        assert_eq!(robot.pose_error_m, None, "nobody knows the truth");
    }
    assert_eq!(view.processes.len(), 2 + 3, "no simulators: {:?}", view.processes);

    let dir = fleet.folder.path().to_str().unwrap().to_string();
    let status = output(&["status", "--json", "--run-dir", &dir]);
    let status: serde_json::Value = serde_json::from_slice(&status.stdout).unwrap();
    let clock = &status["bridge"]["clients"][0]["clock"];
    let offset_s = clock["offset_s"].as_f64().unwrap();
    assert!((offset_s - AHEAD.as_secs_f64()).abs() < 0.02, "{clock}");
    assert!(clock["spread_p95_ms"].as_f64().unwrap() >= 0.0, "{clock}");

    let now = Epoch::unix().stamp(mr_slam::clock::now());
    stop.store(true, Ordering::Relaxed);
    player.join().unwrap();
    assert!(fleet.end(Signal::TERM).success);
    let heard = ears.join().unwrap();
    assert!(heard.maps > 0 && heard.stats > 0);
    let newest = *heard.corrections.last().unwrap();
    assert!((newest - now).abs() < 4.0, "SLAM's transforms are on our clock, not five seconds ahead");
    assert!(heard.errors.iter().all(|text| text.contains("SLAM owns map -> odom")), "{:?}", heard.errors);
    assert!(!heard.errors.is_empty());
}

#[test]
fn lockstep_refuses_an_external_world() {
    let refused = output(&["lockstep", "--world", "headset", "--seconds", "1"]);
    assert!(!refused.status.success());
    assert!(String::from_utf8_lossy(&refused.stderr).contains("simulator"));
}

#[test]
fn maps_with_known_starts_are_merged_at_their_starts() {
    let mut config = FleetConfig { world: mr_slam::config::World::Headset, ..FleetConfig::default() };
    let known = fleet::known_starts(&config).unwrap();
    assert_eq!(known, [Some(Pose2::IDENTITY), None, None]);
    config.fleet.starts = vec![[1.0, 2.0, 0.5]; 3];
    assert_eq!(fleet::known_starts(&config).unwrap(), [Some(Pose2::new(1.0, 2.0, 0.5)); 3]);
}
