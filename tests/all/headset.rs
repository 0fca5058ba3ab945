//! The mode of the MR-SLAM paper: scans, transforms and the clock come from a headset, whose clock is five seconds
//! ahead.

use crate::harness::{Fleet, Folder, WATCHDOG, output};
use crate::headset_app::{AHEAD, Headset};
use bridge::command::Notice;
use bridge::frame::Parser;
use bridge::ros::{self, TfMessage};
use mr_slam::clock::Epoch;
use mr_slam::config::FleetConfig;
use mr_slam::world;
use msg::{Pose2, Stamp};
use rustix::process::Signal;
use std::io::Read;
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

const ROBOTS: usize = 2;

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
    let room = world::room(&FleetConfig::default()).unwrap();
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
    let player = std::thread::spawn(move || headset.play(true, &stopped));

    let view = fleet.until("maps of the headset's robots, merged", |view| {
        view.robots.len() == ROBOTS
            && view.robots.iter().all(|robot| robot.scans >= 60 && robot.map.slam_stats[0] > 500.0)
            && view.merged_map.slam_stats[0] > 500.0
    });
    for robot in &view.robots {
        assert_eq!((robot.state, robot.scans_lost), ("tracking", Some(0)), "{robot:?}");
        assert_eq!(robot.pose_error_m, None, "nobody knows the truth");
    }
    assert_eq!(view.processes.len(), 2 + 4, "no simulators: {:?}", view.processes);

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
    let mut config = FleetConfig { world: mr_slam::config::RobotSource::Headset, ..FleetConfig::default() };
    let known = world::known_starts(&config).unwrap();
    assert_eq!(known, [Some(Pose2::IDENTITY), None, None]);
    config.fleet.starts = vec![[1.0, 2.0, 0.5]; 3];
    assert_eq!(world::known_starts(&config).unwrap(), [Some(Pose2::new(1.0, 2.0, 0.5)); 3]);
}
