//! A recording that is played for clients: its messages, its services, and that it gives the maps of a replay from files.

use crate::harness::{Folder, mr_slam, output, send};
use bridge::cdr::{Reader, Writer};
use bridge::command::{Call, Registration, name};
use bridge::frame::{Parser, Side};
use rustix::process::Signal;
use serde_json::Value;
use std::collections::BTreeSet;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Ipv4Addr, TcpStream};
use std::path::Path;
use std::process::{Child, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

/// Longest wait for anything.
const PATIENCE: Duration = Duration::from_secs(120);
/// Duration of the recorded run, seconds.
const SECONDS: &str = "8";

/// A replay in a process of its own, which ends with the test.
struct Replay {
    child: Child,
    lines: Receiver<String>,
}

impl Drop for Replay {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Replay {
    fn start(recording: &Path, words: &[&str]) -> Self {
        let mut command = mr_slam();
        command.arg("replay").arg(recording).args(["--serve", "--port", "0", "--json"]).args(words);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let output = BufReader::new(child.stderr.take().unwrap());
        let (to_test, lines) = channel();
        std::thread::spawn(move || {
            output.lines().map_while(Result::ok).for_each(|line| {
                let _ = to_test.send(line);
            });
        });
        Self { child, lines }
    }

    /// Waits for a line, and returns it.
    fn line(&self, text: &str) -> String {
        let begun = Instant::now();
        while begun.elapsed() < PATIENCE {
            match self.lines.recv_timeout(PATIENCE) {
                Ok(line) if line.contains(text) => return line,
                Ok(_) => {}
                Err(why) => panic!("no line with `{text}`: {why}"),
            }
        }
        panic!("no line with `{text}`");
    }

    fn connect(&self) -> Client {
        let line = self.line("clients connect to port");
        let port: u16 = line.rsplit(' ').next().unwrap().parse().unwrap();
        let stream = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        Client { stream, parser: Parser::new(1 << 24), calls: 0, topics: BTreeSet::new() }
    }

    /// Ends the replay and returns what it printed.
    fn end(mut self) -> Value {
        send(self.child.id(), Signal::TERM);
        let mut text = String::new();
        self.child.stdout.take().unwrap().read_to_string(&mut text).unwrap();
        assert!(self.child.wait().unwrap().success());
        serde_json::from_str(&text).unwrap()
    }
}

/// A ros_tcp client that calls services.
struct Client {
    stream: TcpStream,
    parser: Parser,
    calls: i64,
    /// Topics of which a message came.
    topics: BTreeSet<String>,
}

impl Client {
    fn register(&mut self, command: &str, topic: &str, message_name: &str) {
        let (topic, message_name) = (topic.to_owned(), message_name.to_owned());
        let mut bytes = Vec::new();
        let registration = Registration { topic, message_name, ..Registration::default() };
        Side::Client.write_command(&mut bytes, command, &registration);
        self.stream.write_all(&bytes).unwrap();
    }

    /// Returns the next frame.
    fn next(&mut self) -> (String, Vec<u8>) {
        loop {
            if let Some(frame) = self.parser.next_frame().unwrap() {
                return (String::from_utf8(frame.name.into()).unwrap(), frame.json().to_owned());
            }
            let mut bytes = [0; 65536];
            let count = self.stream.read(&mut bytes).unwrap();
            assert_ne!(count, 0, "the replay closed the connection");
            self.parser.push(&bytes[..count]);
        }
    }

    /// Calls a service of the player, and returns the bytes of the response.
    fn call(&mut self, service: &str, service_type: &str, fill: impl FnOnce(&mut Writer<'_>)) -> Vec<u8> {
        let service = format!("/rosbag2_player/{service}");
        self.register(name::ROS_SERVICE, &service, &format!("rosbag2_interfaces/{service_type}"));
        self.calls += 1;
        let (mut bytes, mut request) = (Vec::new(), Vec::new());
        fill(&mut Writer::new(&mut request));
        Side::Client.write_command(&mut bytes, name::REQUEST, &Call { srv_id: self.calls });
        Side::Client.write(&mut bytes, &service, &request);
        self.stream.write_all(&bytes).unwrap();
        let mut is_next = false;
        loop {
            let (name, payload) = self.next();
            if is_next && name == service {
                return [&payload[..], &[0; 12]].concat();
            }
            assert_ne!(name, name::ERROR, "{}", String::from_utf8_lossy(&payload));
            is_next = name == name::RESPONSE;
            self.topics.insert(name);
        }
    }

    fn seek(&mut self, second: i32) -> bool {
        let response = self.call("seek", "Seek", |to| {
            to.i32(second);
            to.u32(0);
        });
        Reader::new(&response).unwrap().bool("success").unwrap()
    }

    fn set_rate(&mut self, rate: f64) -> bool {
        let response = self.call("set_rate", "SetRate", |to| to.f64(rate));
        Reader::new(&response).unwrap().bool("success").unwrap()
    }
}

/// Records a run in lockstep, and returns the hash of its maps. A replay from files has the same.
fn record(path: &Path) -> String {
    let path = path.to_str().unwrap();
    let run = output(&["lockstep", "--robots", "2", "--seconds", SECONDS, "--record", path, "--json"]);
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let ran: Value = serde_json::from_slice(&run.stdout).unwrap();
    let replayed = output(&["replay", path, "--json"]);
    let summary: Value = serde_json::from_slice(&replayed.stdout).unwrap();
    assert_eq!(summary["maps_sha256"], ran["maps_sha256"]);
    summary["maps_sha256"].as_str().unwrap().to_owned()
}

#[test]
fn a_client_of_a_replay_pauses_it_seeks_and_receives_what_was_recorded() {
    let folder = Folder::new();
    let path = folder.path().join("run.mcap");
    let hash = record(&path);
    let replay = Replay::start(&path, &["--page", "off", "--speed", "0.01"]);
    let mut client = replay.connect();
    for (topic, message_type) in [
        ("/robot2/scan", "sensor_msgs/LaserScan"),
        ("/merged_map", "nav_msgs/OccupancyGrid"),
        ("/tf", "tf2_msgs/TFMessage"),
    ] {
        client.register(name::SUBSCRIBE, topic, message_type);
    }
    client.call("pause", "Pause", |to| to.u8(0));
    let is_paused = client.call("is_paused", "IsPaused", |to| to.u8(0));
    assert!(Reader::new(&is_paused).unwrap().bool("paused").unwrap());
    assert!(client.seek(5), "a place in the recording, while it is paused");
    assert!(!client.seek(9), "behind its end");
    replay.line("9.00 s is not in the recording, which has 0.00 to 8.00 s");
    assert!(!client.set_rate(0.0) && client.set_rate(20.0));
    client.call("resume", "Resume", |to| to.u8(0));
    replay.line("the recording is over at 8.00 s");
    assert!(client.seek(1), "back, when all was played");
    replay.line("the recording is over at 8.00 s");
    client.call("get_rate", "GetRate", |to| to.u8(0));
    for topic in ["/robot2/scan", "/merged_map", "/tf"] {
        assert!(client.topics.contains(topic), "no {topic} in {:?}", client.topics);
    }
    let summary = replay.end();
    assert_eq!(summary["maps_sha256"], *hash, "played in pieces or from files: the same maps");
    assert_eq!(summary["seconds"], 8.0);
}

#[test]
fn a_log_from_elsewhere_is_not_served_and_the_reason_is_said() {
    let folder = Folder::new();
    let log = folder.file("box.log", "FLASER 3 1 2 3 0 0 0 0 0 0 1 host 0\n");
    let ended = output(&["replay", log.to_str().unwrap(), "--serve"]);
    let why = String::from_utf8_lossy(&ended.stderr);
    assert!(
        !ended.status.success() && why.contains("--serve plays the recording of a simulated fleet"),
        "{why}"
    );
}
