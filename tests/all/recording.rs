//! Recordings in lockstep: recording changes nothing, and a replay gives the same maps.

use mr_slam::config::FleetConfig;
use mr_slam::lockstep::Lockstep;
use mr_slam::process::record::files::{DirectOutput, RecordingFiles};
use mr_slam::process::record::{PLANAR_ODOMETRY, Summary, map_hash};
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
    let config = config();
    let mut fleet = Lockstep::new(&config, true).unwrap();
    let mut recording = record.map(|path| {
        let files = RecordingFiles::new(path, &config.recording);
        fleet.record(Box::new(DirectOutput::new(files))).unwrap()
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
    assert_eq!((reader.broken(), recording.malformed), (None, 0));
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
    assert_eq!((summary.dropped, summary.lost, &summary.ended), (0, 0, &None));
    let count = |topic: &str| summary.topics.iter().find(|count| count.topic == topic).unwrap().messages;
    assert!((145..=150).contains(&count("/robot1/scan")), "{}", count("/robot1/scan"));
    assert_eq!(count("/robot1/odom"), count("/robot1/odom_2d"));
    assert!(count("/merged_map") > 3 && count("/robot2/cmd_vel") > 0 && count("/tf_static") > 0);
    assert_eq!(replay(&path), maps, "the replay gives the maps of the run");
}

#[test]
fn a_recording_that_is_split_is_whole_in_each_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let mut config = config();
    // Below what the configuration permits, so that some files come in a short run.
    config.recording.split_mb = 0;
    let mut fleet = Lockstep::new(&config, true).unwrap();
    let files = RecordingFiles::new(&path, &config.recording);
    let mut recording = fleet.record(Box::new(DirectOutput::new(files))).unwrap();
    for _ in 0..400 {
        fleet.tick(&mut |_, _| {});
        recording.step();
    }
    let summary = recording.finish();
    assert!(summary.files.len() >= 3, "{:?}", summary.files);
    assert_eq!(summary.files[1].file_name().unwrap(), "run_1.mcap");
    let mut messages = 0;
    for (index, file) in summary.files.iter().enumerate() {
        let mut reader = RecordingReader::new(File::open(file).unwrap());
        let mut has_fixed_transforms = false;
        while let Some(message) = reader.next_message().unwrap() {
            has_fixed_transforms |= &*message.topic == "/tf_static";
            messages += 1;
        }
        assert_eq!(reader.broken(), None);
        assert!(has_fixed_transforms || index == 0, "latched messages begin each file: {}", file.display());
    }
    assert_eq!(messages, summary.topics.iter().map(|topic| topic.messages).sum::<u64>());
}

#[test]
fn a_full_disk_ends_the_recording_with_a_reason_and_not_the_fleet() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = config();
    // No disk has as much.
    config.recording.disk_free_mb = u64::MAX >> 21;
    let mut fleet = Lockstep::new(&config, true).unwrap();
    let files = RecordingFiles::new(&folder.path().join("run.mcap"), &config.recording);
    let mut recording = fleet.record(Box::new(DirectOutput::new(files))).unwrap();
    for _ in 0..300 {
        fleet.tick(&mut |_, _| {});
        recording.step();
    }
    assert!(recording.has_ended());
    let why = recording.finish().ended.unwrap();
    assert!(why.contains("MB of disk are left"), "{why}");
    assert!(fleet.stats().robots[0].scans > 10, "the fleet goes on");
}
