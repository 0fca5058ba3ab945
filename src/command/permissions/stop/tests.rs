//! What came of a stop, for bridges that answer late and fleets of others.

use super::*;
use crate::config::FleetConfig;
use crate::shared_memory::DomainGuard;
use std::fs::Permissions;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::thread;

/// Reads a request; a socket that is closed with an unread one takes its answer with it.
fn read_request(stream: &UnixStream) {
    BufReader::new(stream).read_line(&mut String::new()).unwrap();
}

fn confirm_stop(mut stream: UnixStream) {
    let answer = Ok::<_, String>(BridgeState { stopped: true, ..BridgeState::default() });
    stream.write_all((serde_json::to_string(&answer).unwrap() + "\n").as_bytes()).unwrap();
}

#[test]
fn a_stop_in_another_users_run_says_what_holds() {
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("run.json");
    std::fs::write(&json, "{}").unwrap();
    let is_root = std::os::unix::fs::chown(&json, Some(65_533), None).is_ok();
    let fleet = confirm(folder.path().into());
    assert!(fleet.latched && !fleet.confirmed && stop_file(folder.path()).exists());
    if is_root {
        let line = fleet.line();
        assert!(
            line.contains("NOT CONFIRMED") && line.contains("user 65533") && line.contains("sets it"),
            "{line}"
        );
    }
}

#[test]
fn fleets_of_other_users_do_not_change_the_exit_code() {
    let other = |is_own| {
        StoppedFleet::from(OtherFleet { process: 7, user: "somebody".into(), is_own, run_dir: None })
    };
    let own = |confirmed| StoppedFleet { confirmed, latched: true, other: None, ..other(true) };
    for others in 0..3 {
        let with = |mut fleets: Vec<StoppedFleet>| {
            fleets.extend((0..others).map(|_| other(false)));
            outcome(&fleets)
        };
        assert!(with(vec![own(true), own(true)]).is_ok());
        let nothing = with(vec![]).unwrap_err();
        assert!(nothing.is_nothing_to_stop(), "{nothing}");
        assert_eq!(nothing.to_string().contains("other users"), others > 0, "{nothing}");
        let elsewhere = with(vec![own(true), other(true)]).unwrap_err();
        assert!(matches!(elsewhere, PermissionError::NotStopped { failed: 1, all: 2 }), "{elsewhere}");
        let failed = with(vec![own(false)]).unwrap_err();
        assert!(matches!(failed, PermissionError::NotStopped { failed: 1, all: 1 }), "{failed}");
    }
}

#[test]
fn a_named_fleet_has_ended_only_if_that_is_known() {
    let folder = tempfile::tempdir().unwrap();
    let run = Run::create(folder.path(), FleetConfig::default(), 0, false).unwrap();
    let guard = DomainGuard::new(run.domain.clone());
    let root = run.domain.root().to_owned();
    assert_eq!(named(&run.dir).unwrap().runs, [run.dir.as_path()]);
    // Others may write there, as if it were another user's.
    std::fs::set_permissions(&root, Permissions::from_mode(0o777)).unwrap();
    let why = PermissionError::from(named(&run.dir).unwrap_err());
    assert!(matches!(why, PermissionError::Run(RunError::Trust(_))) && !why.is_nothing_to_stop(), "{why}");
    assert!(!stop_file(&run.dir).exists(), "another user's fleet is not touched");
    std::fs::set_permissions(&root, Permissions::from_mode(0o700)).unwrap();
    let dir = run.dir.clone();
    drop((guard, run));
    assert!(matches!(named(&dir), Err(RunError::Ended(_))));
}

#[test]
fn a_stop_reaches_a_fleet_whose_configuration_is_of_another_build() {
    let folder = tempfile::tempdir().unwrap();
    let run = Run::create(folder.path(), FleetConfig::default(), 0, false).unwrap();
    let _guard = DomainGuard::new(run.domain.clone());
    std::fs::write(run.domain.root().join("build"), "0.0.9, layout 1").unwrap();
    std::fs::write(run.dir.join("fleet.toml"), "[of_another_build]\nkey = 1\n").unwrap();
    Run::open(&run.dir).unwrap_err();
    let bridge = UnixListener::bind(control::socket(&run)).unwrap();
    let fleet = thread::scope(|scope| {
        scope.spawn(|| {
            let (asked, _) = bridge.accept().unwrap();
            read_request(&asked);
            confirm_stop(asked);
        });
        let fleet = confirm(run.dir.clone());
        // A bridge that nobody asked goes on, too.
        let _ = UnixStream::connect(control::socket(&run));
        fleet
    });
    assert!(!fleet.may_drive() && fleet.latched, "{}", fleet.line());
}

#[test]
fn a_bridge_that_answers_late_keeps_no_other_fleet_from_its_stop() {
    let folders = [0, 1].map(|_| tempfile::tempdir().unwrap());
    let [late, next] =
        folders.each_ref().map(|folder| UnixListener::bind(folder.path().join("bridge.sock")).unwrap());
    let lost = folders.each_ref().map(|folder| LostFleet {
        pid: None,
        runtime: folder.path().into(),
        folder: None,
        missing: "run.json".into(),
        has_remote_robots: false,
    });
    let fleets = thread::scope(|scope| {
        scope.spawn(|| {
            let (waits, _) = late.accept().unwrap();
            read_request(&waits);
            // It answers when the other bridge has been asked.
            let (asked, _) = next.accept().unwrap();
            read_request(&asked);
            [asked, waits].into_iter().for_each(confirm_stop);
        });
        stop_all(Vec::new(), lost.into())
    });
    let lines: Vec<String> = fleets.iter().map(StoppedFleet::line).collect();
    assert!(fleets.iter().all(|fleet| !fleet.may_drive()), "{lines:?}");
    let runs: Vec<&Path> = fleets.iter().map(|fleet| fleet.run.as_path()).collect();
    assert_eq!(runs, folders.each_ref().map(|folder| folder.path()));
}
