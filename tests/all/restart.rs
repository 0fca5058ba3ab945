//! A killed process is restarted, and the other processes are not affected.

use crate::harness::{Fleet, Folder, WATCHDOG, mr_slam, output, output_of, process, send};
use reports::FleetView;
use rustix::process::Signal;

/// Kills one process of a running fleet of three, waits for its return, and checks the others.
fn kill_and_recover(name: &str) {
    let mut fleet = Fleet::start("up", &["--robots", "3"]);
    let before = fleet.until("scans of all robots", |view| {
        view.robots.len() == 3
            && view.robots.iter().all(|robot| robot.scans >= 20)
            && process(view, name).is_some()
    });
    let killed = process(&before, name).unwrap().pid;
    send(killed, Signal::KILL);
    let after = fleet.until("the process's return", |view| {
        let back = process(view, name).is_some_and(|p| p.pid != killed && p.state == "up" && p.restarts == 1);
        back && view.robots.iter().zip(&before.robots).all(|(now, then)| now.scans >= then.scans + 30)
    });
    for peer in after.processes.iter().filter(|peer| peer.process != name) {
        assert_eq!(peer.restarts, 0, "{peer:?}");
    }
    // Nobody lost its place, not even the robot whose process died.
    for robot in &after.robots {
        assert!(robot.pose_error_m.is_some_and(|error| error < 0.10), "{robot:?}");
    }
    for robot in after.robots.iter().filter(|robot| !name.ends_with(&robot.robot)) {
        assert_eq!(robot.scans_lost, Some(0), "{robot:?}");
        assert_eq!(robot.state, "tracking", "{robot:?}");
    }
}

#[test]
fn a_fleet_survives_a_killed_slam_process() {
    kill_and_recover("slam of robot2");
}

#[test]
fn a_fleet_survives_a_killed_bridge() {
    kill_and_recover("bridge");
}

#[test]
fn a_fleet_survives_a_killed_simulator() {
    kill_and_recover("sim of robot3");
}

#[test]
fn stopped_processes_are_replaced() {
    let names = ["bridge", "telemetry", "merge", "slam of robot1", "sim of robot1"];
    let mut fleet = Fleet::start("up", &["--robots", "1"]);
    let pids = |view: &FleetView| names.map(|name| process(view, name).map(|p| p.pid));
    let before = fleet.until("all processes", |view| {
        pids(view).iter().all(Option::is_some) && view.robots.iter().all(|robot| robot.scans >= 20)
    });
    let stopped = pids(&before);
    stopped.iter().flatten().for_each(|pid| send(*pid, Signal::STOP));
    fleet.until("the replacements", |view| {
        let up = |name| process(view, name).is_some_and(|p| p.state == "up");
        let all_up = names.iter().all(|name| up(name));
        let now = pids(view);
        all_up
            && now.iter().zip(&stopped).all(|(now, then)| now != then)
            && view.robots.iter().all(|robot| robot.scans >= 20)
    });
    // A replaced process is gone, not just forgotten.
    for pid in stopped.iter().flatten() {
        assert!(!std::path::Path::new(&format!("/proc/{pid}")).exists(), "process {pid} is still there");
    }
    let ended = fleet.end(Signal::TERM);
    let report = std::fs::read_to_string(ended.folder.path().join("report.json")).unwrap();
    for name in names {
        let event = format!("the {name} has not answered for");
        assert!(report.contains(&event), "no `{event}` in {report}");
    }
}

#[test]
fn a_fleet_whose_folder_was_moved_makes_it_anew_and_its_next_bridge_stops_the_robots() {
    let mut fleet = Fleet::start("up", &["--robots", "1"]);
    let before = fleet.until("all processes", |view| {
        let has = |name| process(view, name).is_some();
        has("bridge") && has("slam of robot1") && view.robots.iter().all(|robot| robot.scans >= 20)
    });
    let elsewhere = Folder::new();
    std::fs::rename(fleet.folder.path(), elsewhere.path().join("moved")).unwrap();
    for name in ["bridge", "slam of robot1"] {
        send(process(&before, name).unwrap().pid, Signal::KILL);
    }
    fleet.until("the returns", |view| {
        let is_back = |name| process(view, name).is_some_and(|p| p.state == "up" && p.restarts == 1);
        let is_tracking = view.robots.iter().all(|robot| robot.state == "tracking" && robot.scans >= 20);
        is_back("bridge") && is_back("slam of robot1") && is_tracking
    });
    let folder = fleet.folder.path().to_str().unwrap().to_owned();
    let status = output(&["status", "--json", "--run-dir", &folder]);
    let status: serde_json::Value = serde_json::from_slice(&status.stdout).unwrap();
    assert_eq!(status["bridge"]["stopped"], true, "what was saved of a stop is gone: {status}");
    let goal = output(&["goto", "1", "0.3,0", "--no-wait", "--run-dir", &folder]);
    let said = String::from_utf8_lossy(&goal.stderr).into_owned();
    assert!(!goal.status.success() && said.contains("the emergency stop is set"), "{said}");
    let released = output(&["release", "--run-dir", &folder]);
    assert!(released.status.success(), "{released:?}");
    let ended = fleet.end(Signal::TERM);
    assert!(ended.success);
    let report = std::fs::read_to_string(ended.folder.path().join("report.json")).unwrap();
    assert!(report.contains("was moved or deleted and is made anew"), "{report}");
}

#[test]
fn the_operator_of_a_demo_comes_back() {
    let mut fleet = Fleet::start("demo", &["--robots", "1"]);
    let operator = |fleet: &Fleet| {
        let launcher = fleet.run.pid;
        let children = std::fs::read_to_string(format!("/proc/{launcher}/task/{launcher}/children")).unwrap();
        let is_operator = |pid: &u32| {
            let line = std::fs::read_to_string(format!("/proc/{pid}/cmdline")).unwrap_or_default();
            line.split('\0').nth(1) == Some("operator")
        };
        children.split_whitespace().filter_map(|pid| pid.parse().ok()).find(is_operator)
    };
    let drives = |view: &FleetView| process(view, "bridge").is_some_and(|bridge| bridge.clients == 1);
    for signal in [Signal::KILL, Signal::STOP] {
        fleet.until("an operator", drives);
        let old: u32 = operator(&fleet).unwrap();
        send(old, signal);
        let begun = std::time::Instant::now();
        while operator(&fleet).is_none_or(|pid| pid == old) {
            assert!(begun.elapsed() < WATCHDOG, "nobody drives after {signal:?}");
            fleet.observer.wait(std::time::Duration::from_millis(100));
        }
    }
    fleet.until("an operator", drives);
    let ended = fleet.end(Signal::TERM);
    let report = std::fs::read_to_string(ended.folder.path().join("report.json")).unwrap();
    assert_eq!(report.matches("the operator was started again").count(), 2, "{report}");
    assert!(report.contains("the operator has not answered"), "{report}");
}

#[test]
fn a_process_is_started_again_after_the_program_was_replaced() {
    // A copy would be open for writing in the processes that other tests start meanwhile, and could not be started then.
    let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
    let program = folder.path().join("mr-slam");
    std::fs::hard_link(env!("CARGO_BIN_EXE_mr-slam"), &program).unwrap();
    let mut fleet = Fleet::start_program(&program, "up", &["--robots", "1"]);
    let view = fleet.until("merging", |view| process(view, "merge").is_some());
    // As an update does it: another file is there under this name.
    std::fs::remove_file(&program).unwrap();
    std::fs::write(&program, "another build").unwrap();
    let killed = process(&view, "merge").unwrap().pid;
    send(killed, Signal::KILL);
    let view = fleet.until("merging", |view| {
        process(view, "merge").is_some_and(|p| p.pid != killed && p.state == "up" && p.restarts == 1)
    });
    let pid = process(&view, "merge").unwrap().pid;
    let read = |name: &str| std::fs::read_to_string(format!("/proc/{pid}/{name}")).unwrap();
    assert_eq!((read("comm").trim(), read("cmdline").split('\0').next()), ("mr-slam", Some("mr-slam")));
}

#[test]
fn a_launcher_that_is_stopped_is_told_by_status() {
    let mut fleet = Fleet::start("up", &["--robots", "1"]);
    fleet.until("a bridge", |view| process(view, "bridge").is_some());
    let pid = fleet.run.pid;
    let alarms = || {
        let status = output(&["status", "--json", "--run-dir", fleet.folder.path().to_str().unwrap()]);
        let status: serde_json::Value = serde_json::from_slice(&status.stdout).unwrap();
        status["alarms"].to_string()
    };
    send(pid, Signal::STOP);
    let stopped = alarms();
    send(pid, Signal::CONT);
    assert!(stopped.contains(&format!("kill -CONT {pid}")), "{stopped}");
    assert!(!alarms().contains("kill -CONT"));
}

#[test]
fn a_second_request_to_end_kills_what_is_waited_for_and_the_report_is_written() {
    let mut fleet = Fleet::start("up", &["--robots", "1"]);
    let view = fleet.until("SLAM", |view| process(view, "slam of robot1").is_some());
    let launcher = fleet.run.pid;
    send(process(&view, "slam of robot1").unwrap().pid, Signal::STOP);
    send(launcher, Signal::TERM);
    // The launcher waits for the bridge first, then for SLAM, which never ends.
    let bridge = format!("/proc/{}", process(&view, "bridge").unwrap().pid);
    let begun = std::time::Instant::now();
    while std::path::Path::new(&bridge).exists() {
        assert!(begun.elapsed() < WATCHDOG, "the bridge does not end");
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    // A closed terminal and `timeout` send more than one, too: only Ctrl-C asks again.
    send(launcher, Signal::TERM);
    let ended = fleet.end(Signal::INT);
    assert!(!ended.success, "the last map of SLAM is not saved");
    let report = std::fs::read_to_string(ended.folder.path().join("report.json")).unwrap();
    assert!(report.contains("was killed, as a second request asked: its last map is not saved"), "{report}");
}

#[test]
fn messages_of_processes_are_shown_and_kept_in_the_log() {
    let folder = Folder::new();
    // Merging says that it cannot go on with this.
    folder.file("merge.json", "{");
    let mut up = mr_slam();
    up.args(["up", "--robots", "1", "--port", "0", "--page", "off", "--seconds", "3", "--run-dir"]);
    let done = output_of(up.arg(folder.path()).env("XDG_STATE_HOME", folder.path().join("state")));
    let shown = String::from_utf8_lossy(&done.stderr).into_owned();
    let log = std::fs::read_to_string(folder.path().join("launcher.log")).unwrap();
    assert!(done.status.success() && log.contains("merge.json"), "{log}");
    assert!(log.lines().all(|line| shown.contains(line)), "{log}\n---\n{shown}");
}
