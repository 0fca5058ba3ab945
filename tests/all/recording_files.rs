//! Files of a recording: parts, the description of their folder, counts, and what is at the end.

use crate::harness::{mr_slam, output_of};
use bridge::ros::{OccupancyGrid, decode};
use formats::bag_folder::files_of;
use mr_slam::config::FleetConfig;
use mr_slam::lockstep::Lockstep;
use mr_slam::process::record::{Summary, describe_parts, write_description, write_summary};
use mr_slam::recording_files::RecordingFiles;
use msg::grid::{Occupancy, occupancy};
use recording::RecordingReader;
use recording::rosbag2::Bag;
use std::fs::File;
use std::path::Path;

/// Ticks of a run: enough for maps.
const TICKS: usize = 1500;

fn config() -> FleetConfig {
    let mut config = FleetConfig::default();
    config.fleet.robots = 2;
    config
}

/// Runs a fleet for so many ticks and records it to a path. `before_tick` is called with the number of each tick.
fn recorded(
    config: &FleetConfig,
    path: &Path,
    ticks: usize,
    mut before_tick: impl FnMut(usize),
) -> (Lockstep, Summary) {
    let mut fleet = Lockstep::new(config, true).unwrap();
    let files = RecordingFiles::new(path, config.recording.disk_free_bytes());
    let mut recording = fleet.record(files).unwrap();
    for tick in 0..ticks {
        before_tick(tick);
        fleet.tick(&mut |_, _| {});
        recording.step();
    }
    (fleet, recording.finish())
}

#[test]
fn a_recording_that_is_split_is_whole_in_each_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let mut config = config();
    // Below what the configuration permits, so that some files come in a short run.
    config.recording.split_mb = 0;
    let (_, summary) = recorded(&config, &path, 400, |_| {});
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
        assert_eq!(reader.damage(), None);
        assert!(has_fixed_transforms || index == 0, "latched messages begin each file: {}", file.display());
    }
    assert_eq!(messages, summary.topics.iter().map(|topic| topic.messages).sum::<u64>());
    // The folder is a bag of rosbag2: its description lists the files, and counts their messages.
    describe_parts(&summary.bag, &summary.files).unwrap();
    assert_eq!(files_of(folder.path()).unwrap(), summary.files);
    let description = std::fs::read_to_string(folder.path().join("metadata.yaml")).unwrap();
    let counted = format!("\n  message_count: {messages}\n");
    assert!(description.contains(&counted), "{counted}: {description}");
    // A part that a killed recorder was writing has no index, and is left out.
    let cut = folder.path().join("cut.mcap");
    std::fs::write(&cut, &std::fs::read(&path).unwrap()[..5000]).unwrap();
    let (bag, whole) = (&summary.bag, summary.files[0].clone());
    let later = Bag { files: bag.files[1..].to_vec(), ..bag.clone() };
    write_description(&later, folder.path(), &[whole, cut]).unwrap();
    assert_eq!(files_of(folder.path()).unwrap(), summary.files);
    let again = std::fs::read_to_string(folder.path().join("metadata.yaml")).unwrap();
    assert!(again.contains(&counted), "the earlier file is counted: {again}");
}

#[test]
fn each_message_of_a_recording_that_ends_is_in_a_file_or_dropped() {
    let folder = tempfile::tempdir().unwrap();
    let config = config();
    let record = |name: &str, delete_at: Option<usize>| {
        let path = folder.path().join(name);
        let (_, summary) = recorded(&config, &path, 600, |tick| {
            if delete_at == Some(tick) {
                // What was written can be read under another name.
                std::fs::rename(&path, path.with_extension("moved")).unwrap();
            }
        });
        let messages = summary.topics.iter().map(|topic| topic.messages).sum::<u64>();
        (messages, summary.dropped.unwrap(), summary.ended)
    };
    let (all, dropped, ended) = record("whole.mcap", None);
    assert_eq!((dropped, ended), (0, None));
    for tick in [100, 357, 599] {
        let (messages, dropped, ended) = record(&format!("{tick}.mcap"), Some(tick));
        let why = ended.expect("the file is gone");
        assert_eq!(messages + dropped, all, "{why}");
        let file = File::open(folder.path().join(format!("{tick}.moved"))).unwrap();
        let mut reader = RecordingReader::new(file);
        let read = std::iter::from_fn(|| reader.next_message().unwrap()).count() as u64;
        assert!(read > 0 && dropped > 0 && read == messages, "{read} are in the file, {messages} are told");
    }
}

#[test]
fn the_newest_maps_are_at_the_end_of_a_recording() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let mut config = config();
    // Longer than the run: only the first map is due, and the last.
    config.recording.map_period_s = 1000.0;
    let (mut fleet, _) = recorded(&config, &path, TICKS, |_| {});
    let mut reader = RecordingReader::new(File::open(&path).unwrap());
    let mut maps = Vec::new();
    while let Some(message) = reader.next_message().unwrap() {
        if &*message.topic == "/robot1/map" {
            maps.push(message.payload);
        }
    }
    assert_eq!(maps.len(), 2, "the first and the last");
    let (_, map) = fleet.maps().find(|(name, _)| *name == "robot1_map").expect("the first robot has a map");
    let last: OccupancyGrid = decode(&maps[1]).unwrap();
    assert_eq!((last.width, last.height), (map.header.width, map.header.height));
    let unknown = map.cells.iter().filter(|cell| occupancy(**cell) == Occupancy::Unknown).count();
    assert_eq!(last.data.iter().filter(|cell| **cell == -1).count(), unknown);
}

#[test]
fn a_replay_reads_what_recording_json_names_and_says_what_it_leaves_out() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (killed, whole, other) = (path("recording.mcap"), path("recording_1.mcap"), path("other.mcap"));
    let (_, summary) = recorded(&config(), &whole, 400, |_| {});
    let bytes = std::fs::read(&whole).unwrap();
    std::fs::write(&killed, &bytes[..bytes.len() / 2]).unwrap();
    std::fs::write(&other, &bytes).unwrap();
    write_description(&summary.bag, folder.path(), &[]).unwrap();
    let named = Summary { files: vec![whole.clone()], earlier: vec![killed.clone()], ..Summary::default() };
    write_summary(&path("recording.json"), &named).unwrap();
    let replay = |files: &[&Path]| -> serde_json::Value {
        let output = output_of(mr_slam().arg("replay").args(files).arg("--json"));
        let reported = String::from_utf8_lossy(&output.stderr);
        serde_json::from_slice(&output.stdout).unwrap_or_else(|why| panic!("{why}: {reported}"))
    };
    let by_folder = replay(&[folder.path()]);
    assert_eq!(by_folder["not_read"], serde_json::json!([other.display().to_string()]), "{by_folder}");
    assert!(by_folder["damage"].to_string().contains("recording.mcap"), "{by_folder}");
    let by_names = replay(&[&killed, &whole]);
    assert_eq!(by_names["not_read"], serde_json::json!([]));
    assert_eq!(by_names["seconds"], by_folder["seconds"]);
    assert_eq!(by_names["maps_sha256"], by_folder["maps_sha256"], "{by_folder}");
}

#[test]
fn lockstep_refuses_a_full_disk_at_the_start_and_keeps_its_figures_if_the_disk_is_full_later() {
    // No memory has as much as is kept free.
    let folder = tempfile::tempdir_in("/dev/shm").unwrap();
    let (file, path) = (folder.path().join("fleet.toml"), folder.path().join("a.mcap"));
    std::fs::write(&file, "[recording]\ndisk_free_mb = 1000000\n").unwrap();
    let lockstep = ["lockstep", "--robots", "1", "--seconds", "2", "--json", "--record"];
    let output = output_of(mr_slam().args(lockstep).arg(&path).arg("--config").arg(&file));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let why = json["error"].as_str().unwrap();
    assert!(!output.status.success() && why.contains("MB of disk are left") && !path.exists(), "{json}");
    // A limit of the size of files fails as a full disk does.
    let mut limited = std::process::Command::new("sh");
    limited.args(["-c", r#"trap '' XFSZ; ulimit -f 8; exec "$@""#, "sh"]).arg(mr_slam().get_program());
    let output = output_of(limited.args(lockstep).arg(&path));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let reported = String::from_utf8_lossy(&output.stderr);
    assert!(json["sha256"].is_string() && json["recording"]["ended"].is_string(), "{json}");
    assert!(output.status.code() == Some(1) && reported.contains("the recording is not whole"), "{reported}");
}
