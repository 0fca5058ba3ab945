//! Access control of clients in a running fleet, and the emergency stop, which survives the bridge's process.

use crate::harness::{Fleet, output, send};
use bridge::command::{Notice, Registration, name};
use bridge::frame::{Parser, Side};
use bridge::ros::{Message, Twist, encode};
use rustix::process::Signal;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

/// A headset that drives robot 1 forward and receives notices.
struct Headset {
    stream: TcpStream,
    parser: Parser,
    frame: Vec<u8>,
}

impl Headset {
    fn attach(port: u16) -> Self {
        let stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        stream.set_read_timeout(Some(Duration::from_millis(50))).unwrap();
        let mut out = Vec::new();
        let about = Registration {
            topic: "/cmd_vel_1".into(),
            message_name: Twist::TYPE.into(),
            ..Registration::default()
        };
        Side::Client.write_command(&mut out, name::PUBLISH, &about);
        (&stream).write_all(&out).unwrap();
        let mut frame = Vec::new();
        let forward = Twist { linear: [0.1, 0.0, 0.0], angular: [0.0; 3] };
        Side::Client.write_with(&mut frame, "/cmd_vel_1", |out| encode(&forward, out));
        Self { stream, parser: Parser::new(1 << 20), frame }
    }

    /// Sends a velocity command and returns the notices received meanwhile. The connection may be closed.
    fn drive(&mut self) -> Vec<(String, String)> {
        let _ = self.stream.write_all(&self.frame);
        let mut reported = Vec::new();
        if let Ok(count) = self.stream.read(self.parser.space()) {
            self.parser.filled(count);
        }
        while let Some(frame) = self.parser.next_frame().unwrap() {
            if let Ok(notice) = serde_json::from_slice::<Notice>(frame.payload) {
                reported.push((String::from_utf8_lossy(frame.name).into_owned(), notice.text));
            }
        }
        reported
    }

    /// Drives until it receives a notice with `words`.
    fn drive_until_answered(&mut self, kind: &str, words: &str) {
        let begun = std::time::Instant::now();
        while !self.drive().iter().any(|(name, text)| name == kind && text.contains(words)) {
            assert!(begun.elapsed() < crate::harness::WATCHDOG, "no notice with {words}");
        }
    }
}

fn say(words: &[&str], dir: &str) -> String {
    let said = output(&[words, &["--run-dir", dir]].concat());
    assert!(said.status.success(), "{words:?}: {}", String::from_utf8_lossy(&said.stderr));
    String::from_utf8_lossy(&said.stdout).into_owned()
}

fn distance(view: &reports::FleetView) -> f64 {
    view.robots.first().and_then(|robot| robot.pose).map_or(0.0, |[x, y, _]| x.hypot(y))
}

#[test]
fn an_allowed_headset_and_an_emergency_stop_survive_the_bridge() {
    let folder = crate::harness::Folder::new();
    let text = "[bridge]\ntrust_loopback = false\n[fleet]\nrobots = 1\n";
    let file = folder.file("fleet.toml", text);
    let mut fleet = Fleet::start("up", &["--config", file.to_str().unwrap()]);
    let dir = fleet.folder.path().to_str().unwrap().to_string();
    fleet.until("a robot that maps", |view| view.robots.iter().any(|robot| robot.scans >= 5));

    let mut headset = Headset::attach(fleet.run.port);
    headset.drive_until_answered("__error", "mr-slam allow 127.0.0.1");
    assert_eq!(say(&["allow"], &dir), "127.0.0.1 waits for an answer\n");
    assert_eq!(say(&["allow", "127.0.0.1"], &dir), format!("127.0.0.1 may drive (run {dir})\n"));
    headset.drive_until_answered("__log", "you may drive now");
    let moved = |fleet: &mut Fleet, headset: &mut Headset, by: f64| {
        let from = distance(&fleet.until("figures", |_| true));
        fleet.until("a robot that moves", |view| {
            (0..10).for_each(|_| drop(headset.drive()));
            distance(view) > from + by
        })
    };
    let view = moved(&mut fleet, &mut headset, 0.1);
    let bridge = view.processes.iter().find(|process| process.process == "bridge").unwrap().pid;

    // The operator stops the fleet, and the bridge is killed. The stop and the allowed client remain.
    say(&["stop"], &dir);
    headset.drive_until_answered("__error", "emergency stop is set");
    send(bridge, Signal::KILL);
    fleet.until("another bridge", |view| {
        view.processes.iter().any(|p| p.process == "bridge" && p.pid != bridge && p.state == "up")
    });
    let mut headset = Headset::attach(fleet.run.port);
    headset.drive_until_answered("__error", "emergency stop is set");
    assert_eq!(say(&["allow"], &dir), "127.0.0.1 may drive\n");
    say(&["release"], &dir);
    moved(&mut fleet, &mut headset, 0.1);

    say(&["deny", "127.0.0.1"], &dir);
    headset.drive_until_answered("__error", "may not drive: it is denied");
    assert_eq!(say(&["allow"], &dir), "127.0.0.1 is denied\n", "a no is not asked for again");
    assert!(fleet.end(Signal::TERM).success);
}

#[test]
fn commands_without_a_fleet_report_the_missing_run() {
    let nowhere = crate::harness::Folder::new();
    for words in [&["allow", "10.0.0.1"][..], &["stop"], &["release"]] {
        let said = output(&[words, &["--run-dir", nowhere.path().to_str().unwrap()]].concat());
        assert!(!said.status.success());
        assert!(String::from_utf8_lossy(&said.stderr).contains("run.json"));
    }
}
