//! SLAM's modes and services in a running fleet from the command line, and the requests that are refused.

use crate::harness::{Fleet, Folder, mr_slam, output, output_of, process, send};
use mr_slam::channel::{self, Opener, Program};
use mr_slam::run::Run;
use mr_slam::sessions::FOLDER;
use mr_slam::shared_memory::Participant;
use mr_slam::world;
use msg::{Pose2, RobotId};
use reports::FleetView;
use rustix::process::Signal;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Output;

/// Runs `mr-slam slam ROBOT ARGS` in a run.
fn ask(run_dir: &Path, robot: &str, args: &[&str]) -> Output {
    let mut command = mr_slam();
    command.args(["slam", robot]).args(args).arg("--json").arg("--run-dir").arg(run_dir);
    output_of(&mut command)
}

/// Sends a request and returns the response as JSON.
fn answer(run_dir: &Path, robot: &str, args: &[&str]) -> Value {
    let done = ask(run_dir, robot, args);
    assert!(done.status.success(), "{args:?}: {}", String::from_utf8_lossy(&done.stderr));
    serde_json::from_slice(&done.stdout).unwrap()
}

/// Sends a request that must be refused, and returns the reason.
fn refusal(run_dir: &Path, robot: &str, args: &[&str]) -> String {
    let done = ask(run_dir, robot, args);
    assert!(!done.status.success(), "{args:?} was done");
    String::from_utf8(done.stderr).unwrap()
}

/// Returns whether SLAM knows its robot's pose in the map.
fn located(run_dir: &Path) -> bool {
    answer(run_dir, "robot1", &["state"])["located"] == true
}

fn nodes(answer: &Value) -> u64 {
    answer["nodes"].as_u64().unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A fleet file below a folder.
fn config(folder: &Folder, autosave_s: f64) -> PathBuf {
    folder.file("fleet.toml", format!("[sessions]\nautosave_s = {autosave_s:?}\n"))
}

/// The process id of one of the fleet.
fn worker(fleet: &mut Fleet, name: &str) -> u32 {
    let mut pid = None;
    fleet.until("its process", |view| {
        pid = view.processes.iter().find(|p| p.process == name).map(|p| p.pid);
        pid.is_some()
    });
    pid.unwrap()
}

/// The nodes in a session file; it must be whole.
fn nodes_in(file: &Path) -> Option<u64> {
    let bytes = std::fs::read(file).ok()?;
    Some(slam::Session::decode_any(&bytes).unwrap().back.nodes.len() as u64)
}

/// A TurtleBot3's own LiDAR, which sees all around: with 90 degrees and 3.5 m a robot that is put down in a
/// room takes minutes to be sure where it is.
const ALL_AROUND: &str = "[sim.lidar]\nbeams = 360\nangle_min_deg = -180.0\nfov_deg = 360.0\n";

/// A room mapped by one robot, on virtual time: its folder of sessions, and how many nodes there are.
fn mapped(folder: &Folder, seconds: u32) -> (PathBuf, u64) {
    let dir = folder.path().join("mapped");
    let (seconds, config) = (seconds.to_string(), folder.file("mapping.toml", ALL_AROUND));
    let args = ["lockstep", "--robots", "1", "--config", text(&config), "--seconds", &seconds];
    let done = output(&[&args[..], &["--run-dir", text(&dir)]].concat());
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let sessions = dir.join(FOLDER);
    let nodes = nodes_in(&sessions.join("robot1.slam")).unwrap();
    (sessions, nodes)
}

/// A fleet file of one robot that starts elsewhere in the room than the one that mapped it.
fn elsewhere(folder: &Folder) -> PathBuf {
    folder.file(
        "elsewhere.toml",
        format!(
            "[fleet]\nrobots = 1\nstarts = [[1.2, -1.2, 1.0]]\n[sessions]\nautosave_s = 1.0\n{ALL_AROUND}"
        ),
    )
}

#[test]
fn a_lockstep_run_depends_on_its_seed_and_sessions_alone() {
    let folder = Folder::new();
    let (sessions, _) = mapped(&folder, 60);
    let config = elsewhere(&folder);
    let run = |more: &[&str]| {
        let args = ["lockstep", "--config", text(&config), "--sessions", text(&sessions)];
        let args = [&args[..], &["--seconds", "60", "--json"]].concat();
        let done = output(&[&args, more].concat());
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        serde_json::from_slice::<Value>(&done.stdout).unwrap()
    };
    let (once, again, localized) = (run(&[]), run(&[]), run(&["--localize"]));
    assert_eq!(once["sha256"], again["sha256"]);
    assert_ne!(once["sha256"], localized["sha256"]);
    let error = localized["fleet"]["robots"][0]["pose_error_m"].as_f64().unwrap();
    assert!(error < 0.10, "it is found: {localized}");
}

/// Whether robot1's SLAM runs again after the process with this number.
fn is_started_again(view: &FleetView, before: u32) -> bool {
    process(view, "slam of robot1").is_some_and(|p| p.pid != before && p.state == "up")
}

#[test]
fn a_killed_slam_process_comes_back_with_its_map() {
    let folder = Folder::new();
    let config = config(&folder, 1.0);
    let mut fleet = Fleet::start("demo", &["--robots", "1", "--config", text(&config)]);
    let dir = fleet.run.dir.clone();
    let file = dir.join(FOLDER).join("robot1.slam");
    fleet.until("a map that was saved", |_| nodes_in(&file).is_some_and(|nodes| nodes >= 12));
    let saved = nodes_in(&file).unwrap();
    let before =
        fleet.until("its process", |view| view.processes.iter().any(|p| p.process == "slam of robot1"));
    let worker = before.processes.iter().find(|p| p.process == "slam of robot1").unwrap().pid;
    send(worker, Signal::KILL);
    fleet.until("its return", |view| is_started_again(view, worker));
    let state = answer(&dir, "1", &["state"]);
    assert!(nodes(&state) >= saved, "{state} after {saved} nodes were saved");
    // It goes on, in the same frame.
    let more = nodes(&state) + 5;
    fleet.until("its going on", |view| {
        view.robots[0].state == "tracking" && nodes(&answer(&dir, "1", &["state"])) >= more
    });
    let after = fleet.until("figures", |_| true);
    assert!(after.robots[0].pose_error_m.is_some_and(|error| error < 0.10), "{after:?}");
    // A pause outlives the process that was told of it.
    assert_eq!(answer(&dir, "1", &["pause"])["paused"], true);
    let paused = self::worker(&mut fleet, "slam of robot1");
    send(paused, Signal::KILL);
    fleet.until("its return in the pause", |view| {
        is_started_again(view, paused) && view.robots[0].state == "paused"
    });
    assert_eq!(answer(&dir, "1", &["state"])["paused"], true);
    assert_eq!(answer(&dir, "1", &["resume"])["paused"], false);
    fleet.until("its going on after the pause", |view| view.robots[0].state == "tracking");
}

#[test]
fn a_slam_process_with_a_damaged_session_starts_a_new_map_in_the_same_frame() {
    let folder = Folder::new();
    let config = config(&folder, 0.0);
    let mut fleet = Fleet::start("demo", &["--robots", "1", "--config", text(&config)]);
    let dir = fleet.run.dir.clone();
    fleet.until("a map", |view| view.robots.first().is_some_and(|robot| robot.nodes >= 6));
    answer(&dir, "robot1", &["save", text(&dir.join(FOLDER).join("robot1"))]);
    let file = dir.join(FOLDER).join("robot1.slam");
    let whole = std::fs::read(&file).unwrap();
    std::fs::write(&file, &whole[..whole.len() - 1]).unwrap();
    let worker = worker(&mut fleet, "slam of robot1");
    send(worker, Signal::KILL);
    fleet
        .until("its return", |view| is_started_again(view, worker) && (1..6).contains(&view.robots[0].nodes));
    let after = fleet.until("its going on", |view| view.robots[0].nodes >= 6);
    assert!(after.robots[0].pose_error_m.is_some_and(|error| error < 0.10), "{:?}", after.robots);
    assert_eq!(std::fs::read(&file).unwrap().len(), whole.len() - 1, "it is not to save");
}

#[test]
fn a_session_is_localized_in_continued_saved_and_loaded_again() {
    let folder = Folder::new();
    // The map covers most of the room, so that the robot does not leave it before it is localized.
    let (sessions, mapped) = mapped(&folder, 120);
    let (kept, map) = localize_and_continue(&folder, &sessions, mapped);
    load_into_another_fleet(&folder, &map, &kept, mapped);
}

/// Starts a fleet in `sessions`, localizes its robot, continues the map, and saves it as session and picture.
fn localize_and_continue(folder: &Folder, sessions: &Path, mapped: u64) -> (PathBuf, PathBuf) {
    let config = elsewhere(folder);
    let args = ["--config", text(&config), "--sessions", text(sessions), "--localize"];
    let mut fleet = Fleet::start("demo", &args);
    let dir = fleet.run.dir.clone();
    fleet.until("the robot found in its map", |view| {
        let found = located(&dir);
        found && view.robots[0].pose_error_m.is_some_and(|error| error < 0.10)
    });
    let state = answer(&dir, "robot1", &["state"]);
    assert_eq!((&state["mode"], nodes(&state)), (&"localization".into(), mapped), "{state}");
    assert!(refusal(&dir, "robot1", &["clear"]).contains("localization"));
    // A killed SLAM process returns in the same mode with its session.
    let own = dir.join(FOLDER).join("robot1.slam");
    fleet.until("its session", |_| own.exists());
    let killed = worker(&mut fleet, "slam of robot1");
    send(killed, Signal::KILL);
    fleet.until("its return", |view| {
        let back = view
            .processes
            .iter()
            .any(|p| p.process == "slam of robot1" && p.pid != killed && p.state == "up");
        back && located(&dir) && view.robots[0].pose_error_m.is_some_and(|error| error < 0.10)
    });
    let state = answer(&dir, "robot1", &["state"]);
    assert_eq!((&state["mode"], nodes(&state)), (&"localization".into(), mapped), "{state}");
    // In mapping mode the map grows.
    assert_eq!(answer(&dir, "robot1", &["mode", "mapping"])["mode"], "mapping");
    fleet.until("a map that grows", |view| {
        let grown = nodes(&answer(&dir, "robot1", &["state"])) > mapped + 3;
        grown && view.robots[0].pose_error_m.is_some_and(|error| error < 0.10)
    });
    let closures = answer(&dir, "robot1", &["closures"]);
    let listed = closures["list"].as_array().unwrap();
    let active = listed.iter().filter(|closure| closure["is_active"] == true).count() as u64;
    assert_eq!(closures["closures"].as_u64().unwrap(), active, "{closures}");
    let cleared = answer(&dir, "robot1", &["clear"]);
    assert_eq!(cleared["closures"], 0, "{cleared}");
    // The session is saved under a name without an extension, and the map as a picture.
    let kept = folder.path().join("kept");
    answer(&dir, "robot1", &["save", text(&kept)]);
    let kept = kept.with_extension("slam");
    assert!(nodes_in(&kept).unwrap() > mapped);
    let map = folder.path().join("room.yaml");
    answer(&dir, "robot1", &["map", text(&map)]);
    assert!(map.exists() && map.with_extension("pgm").exists() && map.with_extension("png").exists());
    // The file is whole although the process is killed directly after its response.
    let killed = worker(&mut fleet, "slam of robot1");
    send(killed, Signal::KILL);
    assert!(nodes_in(&kept).unwrap() > mapped);
    fleet.end(Signal::TERM);
    (kept, map)
}

/// Returns the distance of the robot's pose in its map from its true pose, metres, if the map began at the robot's start.
///
/// The fleet's figures do not have it for a map that was loaded: where that map lies is not known to them.
fn error_of_loaded_m(run: &Run) -> f64 {
    let robot = RobotId::new(1).unwrap();
    let node = Participant::open(&run.domain, Opener::of_fleet(Program::RecordTool), "test").unwrap();
    let mut truths = node.reader(&channel::truth(robot)).unwrap();
    let [x_m, y_m, yaw_rad] =
        serde_json::from_value(answer(&run.dir, "robot1", &["state"])["map_from_base"].take()).unwrap();
    let truth = loop {
        match truths.receive() {
            Some(truth) => break truth.world_from_base,
            None => std::thread::yield_now(),
        }
    };
    let world_from_map = world::true_starts(&run.config).unwrap()[0].expect("a start in the room");
    (world_from_map * Pose2::new(x_m, y_m, yaw_rad)).distance_m(truth)
}

/// Starts a fleet with a new map, loads the picture and then the session, sets the pose and resets the map.
fn load_into_another_fleet(folder: &Folder, map: &Path, kept: &Path, mapped: u64) {
    let config = folder.file("mapping.toml", ALL_AROUND);
    let mut fleet = Fleet::start("demo", &["--robots", "1", "--config", text(&config)]);
    let dir = fleet.run.dir.clone();
    fleet.until("scans", |view| view.robots.first().is_some_and(|robot| robot.scans > 20));
    for (file, args, mode) in [(map, vec!["--localize"], "localization"), (kept, vec![], "mapping")] {
        let loaded = answer(&dir, "robot1", &[vec!["load", text(file)], args].concat());
        assert_eq!(loaded["mode"], mode, "{loaded}");
        assert!(
            loaded["text"].as_str().is_some_and(|text| text.contains("merging finds anew where it lies")),
            "{loaded}"
        );
        let run = fleet.run.clone();
        let view = fleet
            .until("the robot found in what was loaded", |_| located(&dir) && error_of_loaded_m(&run) < 0.15);
        assert_eq!(view.robots[0].pose_error_m, None, "nobody knows where the map lies");
    }
    // SLAM accepts a pose from outside, and then localizes the robot in the whole map.
    let at = answer(&dir, "robot1", &["state"])["map_from_base"].to_string();
    let at = at.trim_matches(['[', ']']).to_owned();
    answer(&dir, "robot1", &["pose", &at]);
    answer(&dir, "robot1", &["relocalize"]);
    let run = fleet.run.clone();
    fleet.until("the robot found again", |_| located(&dir) && error_of_loaded_m(&run) < 0.15);
    // After a reset a new map starts in the same frame.
    let reset = answer(&dir, "robot1", &["reset"]);
    // The answer comes when the new map is saved, and it may have grown meanwhile.
    assert!(nodes(&reset) < mapped, "{reset}");
    fleet.until("a new map", |_| {
        let grown = (2..mapped).contains(&nodes(&answer(&dir, "robot1", &["state"])));
        grown && error_of_loaded_m(&run) < 0.20
    });
    assert!(fleet.end(Signal::TERM).success);
}

/// Stops robot 2's SLAM for a moment: a request to it is answered with who is silent.
fn a_silent_process_is_named(fleet: &mut Fleet) {
    let dir = fleet.run.dir.clone();
    let view =
        fleet.until("its process", |view| view.processes.iter().any(|p| p.process == "slam of robot2"));
    let worker = view.processes.iter().find(|p| p.process == "slam of robot2").unwrap().pid;
    // The launcher would replace it.
    let launcher = fleet.run.pid;
    send(launcher, Signal::STOP);
    send(worker, Signal::STOP);
    let said = refusal(&dir, "robot2", &["state"]);
    send(worker, Signal::CONT);
    send(launcher, Signal::CONT);
    assert!(said.contains("robot2's SLAM does not answer") && said.contains("mr-slam status"), "{said}");
    assert_eq!(answer(&dir, "robot2", &["state"])["robot"], "robot2");
}

#[test]
fn invalid_requests_are_refused_with_the_reason() {
    let folder = Folder::new();
    let mut fleet = Fleet::start("up", &["--robots", "2"]);
    let dir = fleet.run.dir.clone();
    fleet.until("scans", |view| view.robots.len() == 2 && view.robots.iter().all(|robot| robot.scans > 10));
    let good = folder.path().join("good.slam");
    answer(&dir, "robot1", &["save", text(&good)]);
    let bytes = std::fs::read(&good).unwrap();
    let mut flipped = bytes.clone();
    flipped[200] ^= 1;
    let mut version = bytes.clone();
    version[8] = 77;
    for (name, content, reason) in [
        ("cut.slam", &bytes[..bytes.len() - 9], "truncated"),
        ("flipped.slam", &flipped, "checksum"),
        ("new.slam", &version, "version 77"),
        ("picture.slam", b"P5\n1 1\n255\nx", "not a session"),
    ] {
        let file = folder.file(name, content);
        let said = refusal(&dir, "robot1", &["load", text(&file)]);
        assert!(said.contains(name) && said.contains(reason), "{name}: {said}");
    }
    let said = refusal(&dir, "robot2", &["load", text(&good)]);
    assert!(said.contains("another robot's") && said.contains("good.slam"), "{said}");
    let said = refusal(&dir, "robot1", &["load", text(&folder.path().join("nothing.slam"))]);
    assert!(said.contains("nothing.slam"), "{said}");
    let map = folder.path().join("room.yaml");
    answer(&dir, "robot1", &["map", text(&map)]);
    let said = refusal(&dir, "robot1", &["load", text(&map)]);
    assert!(said.contains("--localize"), "{said}");
    let said = refusal(&dir, "robot1", &["save", "/proc/nowhere/a.slam"]);
    assert!(said.contains("/proc/nowhere"), "{said}");
    assert!(refusal(&dir, "robot1", &["undo", "3"]).contains("closure 3 is not part of the graph"));
    assert!(refusal(&dir, "robot3", &["state"]).contains("this fleet has robot1 to robot2"));
    // None of it has cost it its map, and it can be paused.
    assert_eq!(answer(&dir, "robot1", &["pause"])["paused"], true);
    let paused = answer(&dir, "robot1", &["state"]);
    assert_eq!((&paused["paused"], nodes(&paused) >= 1), (&true.into(), true), "{paused}");
    assert_eq!(answer(&dir, "robot1", &["resume"])["paused"], false);

    a_silent_process_is_named(&mut fleet);

    // A fleet that is to begin with such files is not started.
    folder.file("robot1.slam", &bytes[..bytes.len() / 2]);
    let up = output(&["up", "--port", "0", "--robots", "1", "--sessions", text(folder.path())]);
    let said = String::from_utf8_lossy(&up.stderr).into_owned();
    assert!(!up.status.success() && said.contains("robot1.slam") && said.contains("truncated"), "{said}");
    let up = output(&["up", "--port", "0", "--localize"]);
    let said = String::from_utf8_lossy(&up.stderr).into_owned();
    assert!(!up.status.success() && said.contains("--sessions"), "{said}");
}
