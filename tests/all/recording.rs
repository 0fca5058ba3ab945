//! Recordings in lockstep: recording changes nothing, and a replay gives the same maps.

use crate::harness::{Folder, mr_slam, output_of};
use bridge::ros::{self, Bool, Empty, Int32, PoseWithCovarianceStamped, Text};
use mr_slam::config::FleetConfig;
use mr_slam::lockstep::Lockstep;
use mr_slam::lockstep::faults::{Fault, FaultPlan};
use mr_slam::process::record::{PLANAR_ODOMETRY, Summary, map_hash};
use mr_slam::recording_files::RecordingFiles;
use msg::Monotonic;
use recording::RecordingReader;
use recording::fleet::FleetRecording;
use sha2::{Digest, Sha256};
use std::fs::File;
use std::path::Path;

/// Ticks of a run: enough for maps, merging and a dozen nodes.
const TICKS: usize = 1500;

fn config() -> FleetConfig {
    let mut config = FleetConfig::default();
    config.fleet.robots = 2;
    config
}

/// Runs a fleet, recorded if a file is named. Returns the hashes of all messages and of the maps.
fn run(record: Option<&Path>) -> (String, String, Option<Summary>) {
    run_with(record, FaultPlan::none())
}

fn run_with(record: Option<&Path>, faults: FaultPlan) -> (String, String, Option<Summary>) {
    let config = config();
    let mut fleet = Lockstep::with_faults(&config, true, faults).unwrap();
    let mut recording = record.map(|path| {
        let files = RecordingFiles::new(path, config.recording.disk_free_bytes());
        fleet.record(files).unwrap()
    });
    let mut hash = Sha256::new();
    for _ in 0..TICKS {
        fleet.tick(&mut |channel, message| {
            hash.update(channel);
            hash.update(message);
        });
        recording.iter_mut().for_each(|recording| {
            recording.step();
        });
    }
    let all = format!("{:x?}", hash.finalize());
    (all, map_hash(fleet.maps()), recording.map(mr_slam::process::record::Recording::finish))
}

/// Replays a file and returns the hash of the maps.
fn replay(path: &Path) -> String {
    let config = config();
    let scan = bytemuck::allocation::zeroed_box();
    let mut recording = FleetRecording::new(&config.robot_names(), PLANAR_ODOMETRY, scan);
    let mut reader = RecordingReader::new(File::open(path).unwrap());
    while let Some(message) = reader.next_message().unwrap() {
        recording.add(&message);
    }
    assert_eq!((reader.damage(), recording.malformed), (None, 0));
    recording.sort();
    let mut fleet = Lockstep::replay(&config, recording).unwrap();
    for _ in 0..TICKS {
        fleet.tick(&mut |_, _| {});
    }
    map_hash(fleet.maps())
}

#[test]
fn a_recorded_run_is_the_run_and_its_replay_gives_the_same_maps() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let (messages, maps, _) = run(None);
    let (recorded_messages, recorded_maps, summary) = run(Some(&path));
    assert_eq!(recorded_messages, messages, "recording changes nothing");
    assert_eq!(recorded_maps, maps);
    let summary = summary.unwrap();
    assert_eq!((summary.dropped, summary.lost, &summary.ended), (Some(0), Some(0), &None));
    let count = |topic: &str| summary.topics.iter().find(|count| count.topic == topic).unwrap().messages;
    assert!((145..=150).contains(&count("/robot1/scan")), "{}", count("/robot1/scan"));
    assert_eq!(count("/robot1/odom"), count("/robot1/odom_2d"));
    assert!(count("/merged_map") > 3 && count("/robot2/cmd_vel") > 0 && count("/tf_static") > 0);
    assert_eq!(replay(&path), maps, "the replay gives the maps of the run");
}

#[test]
fn the_replay_knows_that_a_robots_driver_was_started_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    // The first process is the simulator of the first robot, which has driven by then.
    let faults = FaultPlan::none().with(Monotonic(8_000_000_000), Fault::Kill(0));
    let (_, maps, summary) = run_with(Some(&path), faults);
    let summary = summary.unwrap();
    let count = |topic: &str| summary.topics.iter().find(|count| count.topic == topic).unwrap().messages;
    assert_eq!((count("/robot1/odom_incarnation"), count("/robot2/odom_incarnation")), (2, 1));
    assert_eq!(replay(&path), maps, "the map goes on from where the robot stood");
}

#[test]
fn a_full_disk_ends_the_recording_with_a_reason_and_not_the_fleet() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = config();
    // No disk has as much.
    config.recording.disk_free_mb = u64::MAX >> 21;
    let mut fleet = Lockstep::new(&config, true).unwrap();
    let files = RecordingFiles::new(&folder.path().join("run.mcap"), config.recording.disk_free_bytes());
    let mut recording = fleet.record(files).unwrap();
    for _ in 0..300 {
        fleet.tick(&mut |_, _| {});
        recording.step();
    }
    assert!(recording.has_ended());
    let why = recording.finish().ended.unwrap();
    assert!(why.contains("MB of disk are left"), "{why}");
    assert!(fleet.stats().robots[0].scans > 10, "the fleet goes on");
}

#[test]
fn a_file_that_is_moved_or_deleted_ends_the_recording_with_a_reason() {
    for is_moved in [true, false] {
        let folder = tempfile::tempdir().unwrap();
        let config = config();
        let mut fleet = Lockstep::new(&config, true).unwrap();
        let path = folder.path().join("run.mcap");
        let files = RecordingFiles::new(&path, config.recording.disk_free_bytes());
        let mut recording = fleet.record(files).unwrap();
        for tick in 0..900 {
            if tick == 300 {
                assert!(!recording.has_ended());
                match is_moved {
                    true => std::fs::rename(&path, folder.path().join("moved.mcap")).unwrap(),
                    false => std::fs::remove_file(&path).unwrap(),
                }
            }
            fleet.tick(&mut |_, _| {});
            recording.step();
        }
        let why = recording.finish().ended.unwrap();
        assert!(why.contains("run.mcap was moved or deleted"), "{why}");
    }
}

/// Returns a guess of a robot's pose at the origin of a frame.
fn at_the_origin_of(frame: &str) -> PoseWithCovarianceStamped {
    PoseWithCovarianceStamped {
        stamp: msg::Stamp(0),
        frame_id: frame.into(),
        position: [0.0; 3],
        orientation: [0.0, 0.0, 0.0, 1.0],
        covariance: [0.0; 36],
    }
}

/// Reads the texts of a topic of a recording.
fn texts(path: &Path, topic: &str) -> Vec<String> {
    let mut reader = RecordingReader::new(File::open(path).unwrap());
    let mut texts = Vec::new();
    while let Some(message) = reader.next_message().unwrap() {
        if &*message.topic == topic {
            texts.push(ros::decode::<Text>(&message.payload).unwrap().0);
        }
    }
    texts
}

#[test]
fn each_command_in_a_recording_says_who_sent_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let config = config();
    let mut fleet = Lockstep::new(&config, true).unwrap();
    let files = RecordingFiles::new(&path, config.recording.disk_free_bytes());
    let mut recording = fleet.record(files).unwrap();
    let mut client = fleet.client(([127, 0, 0, 1], 50_100).into());
    client.advertise::<Bool>("/emergency_stop");
    client.advertise::<Empty>("/emergency_stop_release");
    client.advertise::<Int32>("/selected_robot");
    client.advertise::<Text>("/merge_edge_command");
    client.advertise::<PoseWithCovarianceStamped>("/robot2/initialpose");
    client.connect();
    for tick in 0..800 {
        match tick {
            400 => client.publish("/selected_robot", &Int32(2)),
            410 => client.publish("/merge_edge_command", &Text("pin 2 1".into())),
            420 => client.publish("/robot2/initialpose", &at_the_origin_of("map_2")),
            500 => client.publish("/emergency_stop", &Bool(true)),
            600 => client.publish("/emergency_stop_release", &Empty),
            _ => {}
        }
        fleet.tick(&mut |_, _| {});
        recording.step();
    }
    recording.finish();
    let senders = texts(&path, "/robot1/cmd_vel_sender");
    assert_eq!(senders[..2], ["bridge", "client 127.0.0.1:50001"], "zeros first, then the operator's");
    assert!(senders.contains(&"client 127.0.0.1:50100".to_owned()), "it stopped all robots: {senders:?}");
    assert_eq!(senders.last().unwrap(), "client 127.0.0.1:50001", "{senders:?}");
    let json = |topic: &str| -> Vec<serde_json::Value> {
        texts(&path, topic).iter().map(|text| serde_json::from_str(text).unwrap()).collect()
    };
    let sender = "client 127.0.0.1:50100";
    let events = json("/operator_event");
    let event = |action: &str, robot: Option<&str>| serde_json::json!({ "sender": sender, "action": action, "robot": robot });
    let expected = [
        event("select_robot", Some("robot2")),
        event("emergency_stop", None),
        event("emergency_stop_release", None),
    ];
    assert_eq!(events, expected);
    let pin = serde_json::json!({ "sender": sender, "action": "pin", "robots": [1, 2] });
    assert_eq!(json("/merge_edge_command"), [pin]);
    let requests = json("/robot2/slam_request");
    assert_eq!(
        (requests.len(), &requests[0]["request"], &requests[0]["sender"]),
        (1, &"pose".into(), &sender.into())
    );
}

/// Records some seconds of a fleet that has driven for so many ticks.
fn record_from(path: &Path, seed: u64, tick: usize) {
    let mut config = config();
    config.fleet.seed = seed;
    record(path, &config, tick);
}

/// Records some seconds of a fleet of this configuration that has driven for so many ticks.
fn record(path: &Path, config: &FleetConfig, tick: usize) {
    let mut fleet = Lockstep::new(config, true).unwrap();
    for _ in 0..tick {
        fleet.tick(&mut |_, _| {});
    }
    let files = RecordingFiles::new(path, config.recording.disk_free_bytes());
    let mut recording = fleet.record(files).unwrap();
    for _ in 0..300 {
        fleet.tick(&mut |_, _| {});
        recording.step();
    }
    assert_eq!(recording.finish().ended, None);
}

#[test]
fn what_a_replay_cannot_do_is_refused_or_said() {
    let folder = Folder::new();
    let [whole, midway, other] =
        ["whole", "midway", "other"].map(|name| folder.path().join(name).with_extension("mcap"));
    record_from(&whole, 1, 0);
    record_from(&midway, 1, 900);
    record_from(&other, 2, 0);
    let replay = |args: &[&std::ffi::OsStr]| {
        let ended = output_of(mr_slam().arg("replay").args(args));
        (ended.status.success(), String::from_utf8_lossy(&ended.stderr).into_owned())
    };
    let unknown = "where their maps begin is unknown";
    let (is_done, said) = replay(&[whole.as_os_str()]);
    assert!(is_done && !said.contains(unknown), "{said}");
    let (is_done, said) = replay(&[midway.as_os_str()]);
    assert!(is_done && said.contains(unknown), "{said}");
    let ended = output_of(mr_slam().args(["replay", "--json"]).arg(&midway));
    let figures: serde_json::Value = serde_json::from_slice(&ended.stdout).unwrap();
    let seconds = figures["seconds"].as_f64().unwrap();
    assert!((2.5..4.0).contains(&seconds), "it has 3 s, which begin 9 s after the run: {seconds}");
    let (is_done, said) = replay(&[whole.as_os_str(), other.as_os_str()]);
    assert!(!is_done && said.contains("other.mcap is of another run"), "{said}");
    let (is_done, said) =
        replay(&[whole.as_os_str(), "--no-closures".as_ref(), "--skip".as_ref(), "3".as_ref()]);
    assert!(!is_done && said.contains("--no-closures, --skip: without effect"), "{said}");
    // Each robot of one recording has its topic of scans.
    let merged = output_of(mr_slam().args(["replay", "--merge", "unknown", "--json"]).arg(&whole));
    let merged: serde_json::Value = serde_json::from_slice(&merged.stdout).unwrap();
    let logs: Vec<&str> = merged["robots"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(|robot| robot["slam"]["log"].as_str())
        .collect();
    assert!(logs.len() == 2 && logs[1].ends_with("whole.mcap /robot2/scan"), "{logs:?}");
}

#[test]
fn one_robot_of_a_recording_is_mapped_as_the_recorded_fleet_was_and_compared_with_the_truth() {
    let folder = Folder::new();
    let path = folder.path().join("run.mcap");
    let mut config = config();
    config.slam.tracking.node_turn_rad = 0.05;
    record(&path, &config, 0);
    let default = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/default.toml");
    let replay = |options: &[&std::ffi::OsStr]| -> serde_json::Value {
        let of_robot = ["--scan-topic", "/robot1/scan", "--json"];
        let ended = output_of(mr_slam().arg("replay").arg(&path).args(of_robot).args(options));
        assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
        serde_json::from_slice(&ended.stdout).unwrap()
    };
    let (own, other) = (replay(&[]), replay(&["--config".as_ref(), default.as_os_str()]));
    let nodes = |summary: &serde_json::Value| summary["nodes"].as_u64().unwrap();
    assert!(nodes(&own) > 2 * nodes(&other), "{own} has a node each 0.05 rad, {other} each 0.3 rad");
    let error = &own["error"];
    assert_eq!(error["scans"], own["scans"]);
    assert!(error["max_m"].as_f64().unwrap() < 0.1, "{error}");
}
