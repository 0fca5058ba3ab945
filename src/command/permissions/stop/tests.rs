//! What came of a stop, for bridges that answer late and fleets of others.

use super::*;
use std::io::{BufRead, BufReader, Write};
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
fn fleets_of_other_users_decide_nothing() {
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
