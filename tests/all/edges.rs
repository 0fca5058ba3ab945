//! The merge edges of a running fleet are listed, pinned and undone from the command line.

use crate::harness::{Fleet, mr_slam, output_of, process, send};
use mr_slam::channel::{self, Opener, Program};
use mr_slam::shared_memory::Participant;
use mr_slam::world::known_starts;
use msg::{MapTransforms, Pose2, Role};
use rustix::process::Signal;
use serde_json::Value;
use std::path::Path;
use std::process::Output;

fn edges(run_dir: &Path, words: &[&str]) -> Output {
    output_of(mr_slam().args(["edges", "--json", "--run-dir"]).arg(run_dir).args(words))
}

/// The only edge of a fleet of two, after what was asked for.
fn edge(run_dir: &Path, words: &[&str]) -> Value {
    let done = edges(run_dir, words);
    assert!(done.status.success(), "{words:?}: {}", String::from_utf8_lossy(&done.stderr));
    let all: Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!(all["edges"].as_array().unwrap().len(), 1, "{all}");
    all["edges"][0].clone()
}

#[test]
fn an_edge_is_pinned_unpinned_and_undone_while_the_fleet_runs() {
    let mut fleet = Fleet::start("up", &["--robots", "2"]);
    fleet.until("scans of both robots", |view| view.robots.iter().filter(|r| r.scans >= 20).count() == 2);
    let run_dir = fleet.folder.path().to_owned();
    let state = |words: &[&str]| edge(&run_dir, words)["state"].as_str().unwrap().to_owned();

    // Their starts are given, so there is something to hold although nothing has been found yet.
    assert_eq!(state(&["pin", "1", "2"]), "pinned");
    // It lies as they were started.
    let starts = known_starts(&fleet.run.config).unwrap();
    let (truth, pinned) = (starts[0].unwrap().between(starts[1].unwrap()), edge(&run_dir, &[]));
    for (k, value) in [truth.x_m, truth.y_m, truth.yaw_rad].into_iter().enumerate() {
        assert!((pinned["a_from_b"][k].as_f64().unwrap() - value).abs() < 0.05, "{pinned} where {truth:?}");
    }
    assert_eq!(state(&["unpin", "1", "2"]), "accepted");
    assert_eq!(state(&["undo", "1", "2"]), "undone");
    // Undone for good, until the operator says otherwise.
    let refused = edges(&run_dir, &["unpin", "1", "2"]);
    assert!(!refused.status.success());
    assert!(String::from_utf8_lossy(&refused.stderr).contains("refused"), "{refused:?}");
    let stranger = edges(&run_dir, &["pin", "1", "3"]);
    assert!(
        String::from_utf8_lossy(&stranger.stderr).contains("this fleet has robot1 to robot2"),
        "{stranger:?}"
    );
    assert_eq!(state(&[]), "undone");
    assert_eq!(state(&["pin", "1", "2"]), "pinned");
}

/// Kills the merge process, and waits for the map_transforms of the one that takes its place. Those before, and those after.
fn kill_merge(fleet: &mut Fleet) -> [MapTransforms; 2] {
    let node =
        Participant::open(&fleet.run.domain, Opener::of_fleet(Program::Worker(Role::Telemetry)), "test")
            .unwrap();
    let mut reader = node.reader(&channel::map_transforms()).unwrap();
    let mut newest: Option<MapTransforms> = None;
    let before = fleet.until("merging", |view| {
        newest = reader.newest().map(|map_transforms| *map_transforms).or(newest);
        newest.is_some() && process(view, "merge").is_some()
    });
    let (killed, old) = (process(&before, "merge").unwrap().pid, newest.unwrap());
    send(killed, Signal::KILL);
    fleet.until("merging again", |view| {
        newest = reader.newest().map(|map_transforms| *map_transforms).or(newest);
        let is_back = process(view, "merge").is_some_and(|p| p.pid != killed && p.state == "up");
        is_back && newest.unwrap().header.incarnation != old.header.incarnation
    });
    [old, newest.unwrap()]
}

#[test]
fn a_pinned_edge_survives_the_merge_process_and_the_map_does_not_move() {
    let mut fleet = Fleet::start("up", &["--robots", "2"]);
    fleet.until("scans of both robots", |view| view.robots.iter().filter(|r| r.scans >= 20).count() == 2);
    let run_dir = fleet.folder.path().to_owned();
    let before = edge(&run_dir, &["pin", "1", "2"]);
    let [old, new] = kill_merge(&mut fleet);
    assert_eq!(new.robots, old.robots);
    let after = edge(&run_dir, &[]);
    assert_eq!((&after["state"], &after["a_from_b"]), (&before["state"], &before["a_from_b"]), "{after}");
    assert_eq!(after["state"], "pinned");
    // What he undoes, too.
    assert_eq!(edge(&run_dir, &["undo", "1", "2"])["state"], "undone");
    kill_merge(&mut fleet);
    assert_eq!(edge(&run_dir, &[])["state"], "undone");
}

#[test]
fn merged_robots_keep_their_poses_when_the_merge_process_restarts() {
    let mut fleet = Fleet::start("up", &["--robots", "2", "--starts", "unknown"]);
    let path = fleet.folder.path().join("merge.json");
    fleet.until("the first robot's map, saved", |view| {
        view.robots[0].merged && view.robots[1].scans >= 20 && path.exists()
    });
    let kept = |path: &Path| serde_json::from_slice::<Value>(&std::fs::read(path).unwrap()).unwrap();
    let mut memory = kept(&path);
    let transforms = [0, 1].map(|robot| memory["fleet"]["robots"][robot]["map_from_robot_map"].clone());
    assert_eq!(transforms, [serde_json::json!([0.0, 0.0, 0.0]), Value::Null]);
    // As if it had been found, which takes a minute and more of driving.
    let place = [1.5, -0.5, 0.25];
    memory["fleet"]["robots"][1]["map_from_robot_map"] = serde_json::json!(place);
    memory["fleet"]["pairs"] =
        serde_json::json!([{"edge": 1, "state": 2, "a_from_b": place, "evidence": null, "rejected": []}]);
    std::fs::write(&path, memory.to_string()).unwrap();
    let [old, new] = kill_merge(&mut fleet);
    assert_eq!((old.robots[1].known, new.robots[0]), (0, old.robots[0]));
    let [x_m, y_m, yaw_rad] = place;
    assert_eq!((new.robots[1].known, new.robots[1].map_from_robot_map), (1, Pose2::new(x_m, y_m, yaw_rad)));
    fleet.until("the second robot's map in the first one's", |view| {
        view.robots.iter().all(|robot| robot.merged)
    });
    assert_eq!(kept(&path)["fleet"], memory["fleet"]);
}
