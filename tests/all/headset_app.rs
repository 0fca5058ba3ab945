//! A headset's application, as in the mode of the MR-SLAM paper: it simulates robots, and sends their scans, transforms and clock.

use bridge::cdr::Writer;
use bridge::command::{Registration, name};
use bridge::frame::Side;
use bridge::ros::{self, FrameNames, NameStyle, TfMessage, TransformStamped, write};
use bytemuck::Zeroable;
use mr_slam::clock::Epoch;
use mr_slam::config::FleetConfig;
use mr_slam::world;
use msg::{RobotId, Scan, Stamp, VelocityCommand};
use sim::Simulator;
use std::io::Write;
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How far the headset's clock is ahead: the difference of the two clocks in the paper.
pub const AHEAD: Duration = Duration::from_secs(5);
/// What it subscribes to.
const IN: [(&str, &str); 3] = [
    ("/tf", "tf2_msgs/TFMessage"),
    ("/merged_map", "nav_msgs/OccupancyGrid"),
    ("/robot2/slam_stats", "std_msgs/Float32MultiArray"),
];
/// What it publishes beside the scans.
const OUT: [(&str, &str); 2] = [("/tf", "tf2_msgs/TFMessage"), ("/clock", "rosgraph_msgs/Clock")];

/// The headset's application: it simulates robots that turn in place.
pub struct Headset {
    /// Its connection.
    pub stream: TcpStream,
    robots: Vec<(RobotId, Simulator)>,
    names: FrameNames,
    frames: Vec<u8>,
    scan: Box<Scan>,
}

impl Headset {
    /// Connects, and registers the topics of the fleet's robots.
    pub fn attach(port: u16, config: &FleetConfig) -> Self {
        let room = world::room(config).unwrap();
        let starts = world::starts(config, &room).unwrap();
        let simulator = |(robot, start)| (robot, world::simulator(config, &room, robot, start).unwrap());
        let stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        let mut frames = bridge::frame::KEEPALIVE.to_vec();
        let mut register = |command, topic: String, class: &str| {
            let about = Registration { topic, message_name: class.into(), queue_size: 10, latch: false };
            Side::Client.write_command(&mut frames, command, &about);
        };
        IN.iter().for_each(|(topic, class)| register(name::SUBSCRIBE, (*topic).into(), class));
        OUT.iter().for_each(|(topic, class)| register(name::PUBLISH, (*topic).into(), class));
        for robot in RobotId::first(starts.len()) {
            register(name::PUBLISH, format!("/{robot}/scan"), "sensor_msgs/LaserScan");
        }
        (&stream).write_all(&frames).unwrap();
        let names = FrameNames::new(NameStyle::Flat, &starts.len().into());
        Self {
            stream,
            robots: RobotId::first(starts.len()).zip(starts).map(simulator).collect(),
            names,
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
            simulator
                .set_velocity_command(&VelocityCommand { angular_rad_s: 0.5, ..VelocityCommand::default() });
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
                let (topic, frame) =
                    (format!("/{robot}/scan"), names.robot_frame(robot, msg::RobotFrame::BaseScan));
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
    ///
    /// With `guarded`, it also sends a transform each second that only SLAM may send.
    pub fn play(mut self, guarded: bool, stop: &AtomicBool) {
        let begun = Instant::now();
        // The headset's time of day.
        let first = Epoch::unix().stamp(mr_slam::clock::now()) + AHEAD;
        for tick in 0_u32.. {
            if stop.load(Ordering::Relaxed) {
                break;
            }
            let at = Simulator::TICK * tick;
            std::thread::sleep((begun + at).saturating_duration_since(Instant::now()));
            self.tick(first + at, guarded && tick % 100 == 50);
        }
    }
}
