//! A whole fleet of real processes starts, maps, answers and ends without leaving anything.

use crate::harness::{Fleet, output};
use rustix::process::Signal;
use std::time::Duration;

/// Time within which a fleet ends after a signal.
const END_MAX: Duration = Duration::from_secs(5);

#[test]
fn a_fleet_maps_and_leaves_no_process_or_shared_memory() {
    let mut fleet = Fleet::start("up", &["--robots", "2", "--seed", "7"]);
    let view = fleet.until("maps of both robots, merged", |view| {
        view.robots.len() == 2
            && view.robots.iter().all(|robot| robot.scans >= 20 && robot.map.slam_stats[0] > 0.0)
            && view.merged_map.slam_stats[0] > 0.0
            && view.processes.len() == 8
    });
    for robot in &view.robots {
        assert_eq!(robot.scans_lost, Some(0), "{robot:?}");
        assert_eq!(robot.state, "tracking", "{robot:?}");
        assert!(robot.pose_error_m.is_some_and(|error| error < 0.05), "a robot at rest: {robot:?}");
    }
    assert!(view.processes.iter().all(|process| process.state == "up" && process.restarts == 0), "{view:?}");

    let dir = fleet.folder.path().to_str().unwrap().to_string();
    let status = output(&["status", "--json", "--run-dir", &dir]);
    let status: serde_json::Value = serde_json::from_slice(&status.stdout).unwrap();
    assert_eq!(status["robots"].as_array().unwrap().len(), 2);

    let children = view.processes.iter().map(|process| process.pid).collect::<Vec<_>>();
    let ended = fleet.end(Signal::TERM);
    assert!(ended.success);
    assert!(ended.took <= END_MAX, "{:?}", ended.took);
    for pid in children {
        assert!(!std::path::Path::new(&format!("/proc/{pid}")).exists(), "process {pid} survived");
    }
    assert!(!ended.run.domain.root().exists());
    let prefix = format!("mrslam_{}_", ended.run.pid);
    let left = std::fs::read_dir("/dev/shm").unwrap().flatten();
    let left: Vec<_> = left.filter(|file| file.file_name().to_string_lossy().starts_with(&prefix)).collect();
    assert!(left.is_empty(), "{left:?}");
    for file in ["robot1_map.pgm", "robot1_map.yaml", "merged_map.png", "report.json", "fleet.toml"] {
        assert!(ended.folder.path().join(file).exists(), "no {file}");
    }
}

#[test]
fn an_operator_drives_a_fleet_over_tcp() {
    let mut fleet = Fleet::start("demo", &["--robots", "1"]);
    let moved = |pose: [f64; 3]| pose[0].hypot(pose[1]);
    let view = fleet.until("a robot half a metre away", |view| {
        view.robots.first().and_then(|robot| robot.pose).is_some_and(|pose| moved(pose) > 0.5)
    });
    assert_eq!(view.robots[0].scans_lost, Some(0));
    let ended = fleet.end(Signal::INT);
    assert!(ended.success);
    assert!(ended.took <= END_MAX, "{:?}", ended.took);
    let report = std::fs::read_to_string(ended.folder.path().join("report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    assert!(report["paper"]["scan_hz"].as_f64().unwrap() > 9.0, "{report:#}");
    assert!(report["operator"].is_object(), "{report:#}");
}

#[test]
fn a_fleet_with_a_time_limit_ends_by_itself() {
    let ended = Fleet::start("up", &["--robots", "1", "--seconds", "1.5"]).wait();
    assert!(ended.success);
    assert!(ended.folder.path().join("report.json").exists());
}

#[test]
fn status_without_a_fleet_reports_the_missing_run() {
    let nowhere = crate::harness::Folder::new();
    let status = output(&["status", "--run-dir", nowhere.path().to_str().unwrap()]);
    assert!(!status.status.success());
    let said = String::from_utf8_lossy(&status.stderr).into_owned();
    assert!(said.contains("run.json"), "{said}");
}

#[test]
fn a_port_in_use_is_reported_with_the_option_to_change_it() {
    let taken = std::net::TcpListener::bind("0.0.0.0:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let folder = crate::harness::Folder::new();
    let up = output(&["up", "--port", &port, "--run-dir", folder.path().to_str().unwrap()]);
    assert!(!up.status.success());
    let said = String::from_utf8_lossy(&up.stderr).into_owned();
    assert!(said.contains(&port) && said.contains("--port"), "{said}");
}

/// Returns whether this process, and so its children, ignores SIGHUP: bit 0 of SigIgn in proc(5).
fn is_hangup_ignored() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:")).unwrap();
    u64::from_str_radix(mask.trim(), 16).unwrap() & 1 == 1
}

#[test]
fn a_closed_terminal_ends_a_fleet_with_its_maps_and_report() {
    let mut fleet = Fleet::start("up", &["--robots", "1"]);
    fleet.until("a map", |view| view.merged_map.slam_stats[0] > 0.0);
    // A second fleet may not use the folder of a live one.
    let dir = fleet.folder.path().to_str().unwrap().to_string();
    let second = output(&["up", "--port", "0", "--seconds", "1", "--run-dir", &dir]);
    let said = String::from_utf8_lossy(&second.stderr).into_owned();
    assert!(!second.status.success() && said.contains("a fleet is running (process "), "{said}");
    // Who starts a program with `nohup` wants it to go on.
    let ended = if is_hangup_ignored() {
        rustix::process::kill_process(
            rustix::process::Pid::from_raw(fleet.run.pid as i32).unwrap(),
            Signal::HUP,
        )
        .unwrap();
        fleet.until("figures after the hangup", |view| view.time_s > 0.0);
        fleet.end(Signal::TERM)
    } else {
        fleet.end(Signal::HUP)
    };
    assert!(ended.success);
    for file in ["robot1_map.pgm", "merged_map.png", "report.json"] {
        assert!(ended.folder.path().join(file).exists(), "no {file}");
    }
}

#[test]
fn a_fleet_removes_what_a_killed_launcher_left() {
    let mut fleet = Fleet::start("up", &["--robots", "1"]);
    fleet.until("a scan", |view| view.robots.first().is_some_and(|robot| robot.scans > 0));
    let killed = fleet.kill();
    let left = |run: &mr_slam::run::Run| -> Vec<std::path::PathBuf> {
        let prefix = format!("mrslam_{}_", run.pid);
        let files = std::fs::read_dir("/dev/shm").unwrap().flatten();
        let files = files.filter(|file| file.file_name().to_string_lossy().starts_with(&prefix));
        let root = run.domain.root().to_path_buf();
        files.map(|file| file.path()).chain(root.exists().then_some(root)).collect()
    };
    // Another test's fleet may have removed it already.
    let ended = Fleet::start("up", &["--robots", "1", "--seconds", "1"]).wait();
    assert!(ended.success);
    let left = left(&killed.run);
    assert!(left.is_empty(), "{left:?}");
}

/// Session of a process: 0 if it was opened outside this PID namespace, where `getsid` has no valid answer. See proc_pid_stat(5).
fn session_of(pid: u32) -> u32 {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    let (_, after_name) = stat.rsplit_once(')').unwrap();
    after_name.split_whitespace().nth(3).unwrap().parse().unwrap()
}

#[test]
fn a_detached_fleet_goes_on_and_says_how_to_end_it() {
    let folder = crate::harness::Folder::new();
    let dir = folder.path().to_str().unwrap();
    let up = output(&["up", "--robots", "1", "--port", "0", "--seconds", "60", "--detach", "--run-dir", dir]);
    let said = String::from_utf8_lossy(&up.stdout).into_owned();
    assert!(up.status.success(), "{up:?}");
    let run = mr_slam::run::Run::open_running(folder.path()).unwrap();
    assert!(said.contains(&format!("kill {}", run.pid)) && said.contains("launcher.log"), "{said}");
    assert_ne!(session_of(run.pid), session_of(std::process::id()), "it has a session of its own");
    crate::harness::send(run.pid, Signal::TERM);
    let begun = std::time::Instant::now();
    while !folder.path().join("report.json").exists() {
        let log = || std::fs::read_to_string(folder.path().join("launcher.log")).unwrap_or_default();
        assert!(begun.elapsed() < crate::harness::WATCHDOG, "no report; the launcher's log: {}", log());
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn a_map_that_cannot_be_written_does_not_cost_the_report() {
    let mut fleet = Fleet::start("up", &["--robots", "1"]);
    fleet.until("a map", |view| view.merged_map.slam_stats[0] > 0.0);
    // A folder stands where the map is to be.
    std::fs::create_dir_all(fleet.folder.path().join("robot1_map.pgm/in_the_way")).unwrap();
    let ended = fleet.end(Signal::TERM);
    assert!(!ended.success, "the exit code says that something is missing");
    assert!(ended.folder.path().join("merged_map.png").exists(), "the other map is there");
    let report = std::fs::read_to_string(ended.folder.path().join("report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    let missing = report["not_written"].as_array().unwrap();
    assert!(missing.len() == 1 && missing[0].as_str().unwrap().contains("robot1_map"), "{missing:?}");
    assert!(report["paper"]["duration_s"].as_f64().unwrap() > 0.0);
}
