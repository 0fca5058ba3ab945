//! What a run leaves for those who were not there: ratings of its people, counts of a recording, and nothing running.

use crate::harness::{Fleet, Folder, mr_slam, output_of, process, send};
use recording::RecordingReader;
use rustix::process::Signal;
use serde_json::Value;
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Ipv4Addr, TcpStream};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Longest wait for anything.
const PATIENCE: Duration = Duration::from_secs(60);

const ANSWER: &str = r#"{"mental_demand":70,"physical_demand":5,"temporal_demand":40,"performance":20,"effort":60,"frustration":0}"#;

/// Sends an answer as the form on the page does, and returns the response.
fn post(port: u16, answer: &str) -> String {
    let mut stream = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let (host, length) = (format!("localhost:{port}"), answer.len());
    let head = format!(
        "POST /tlx HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\nContent-Type: application/json\r\n\
         Content-Length: {length}\r\n\r\n{answer}"
    );
    stream.write_all(head.as_bytes()).unwrap();
    let mut response = String::new();
    stream.read_to_string(&mut response).unwrap();
    response
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

/// Returns the newest message of a topic, without its CDR header and length.
fn newest_text(path: &Path, topic: &str) -> Option<String> {
    let mut reader = RecordingReader::new(File::open(path).unwrap());
    let mut newest = None;
    while let Some(message) = reader.next_message().unwrap() {
        if &*message.topic == topic {
            newest = Some(String::from_utf8_lossy(&message.payload[8..]).trim_end_matches('\0').to_owned());
        }
    }
    newest
}

#[test]
fn ratings_of_workload_are_in_recording_and_report_and_an_attached_recording_leaves_its_counts() {
    let mut fleet = Fleet::start("up", &["--robots", "1", "--record", "--page", "0"]);
    fleet.until("figures", |view| view.robots[0].scans > 5);
    let numbers = "recording/recording.json";
    let begun = json(&fleet.folder.path().join(numbers));
    let why = begun["ended"].as_str().unwrap_or_default();
    assert!(why.contains("killed") && begun["dropped"].is_null() && begun["lost"].is_null(), "{begun:#}");
    let port = fleet.run.config.bridge.page.port;
    assert!(post(port, &ANSWER.replace("70", "71")).starts_with("HTTP/1.1 422 "));
    assert!(post(port, ANSWER).starts_with("HTTP/1.1 201 "));
    let attached = fleet.folder.path().join("attached.mcap");
    let mut command = mr_slam();
    command.args(["record", "--seconds", "2", "--out"]).arg(&attached);
    command.arg("--run-dir").arg(fleet.folder.path());
    let recorded = output_of(&mut command);
    assert!(recorded.status.success(), "{}", String::from_utf8_lossy(&recorded.stderr));
    let counts = json(&attached.with_extension("json"));
    let scans = counts["topics"].as_array().unwrap().iter().find(|topic| topic["topic"] == "/robot1/scan");
    assert!(scans.unwrap()["messages"].as_u64() > Some(5), "{counts:#}");
    assert!(!output_of(&mut command).status.success(), "nothing is overwritten");
    let ended = fleet.end(Signal::TERM);
    let dir = ended.folder.path();
    let counts = json(&dir.join(numbers));
    assert!(counts["ended"].is_null() && counts["dropped"].is_u64() && counts["lost"].is_u64(), "{counts:#}");
    let report = json(&dir.join("report.json"));
    assert_eq!(report["nasa_tlx"][0]["answer"]["mental_demand"], 70, "{:#}", report["nasa_tlx"]);
    let html = std::fs::read_to_string(dir.join("report.html")).unwrap();
    for part in ["raw TLX", "32.5", "robot1/base_scan", "Hardware and software", "/robot", "nobody drove"] {
        assert!(html.contains(part), "no `{part}` in the report");
    }
    for path in [dir.join("recording").join("recording.mcap"), attached.clone()] {
        let text = newest_text(&path, "/nasa_tlx").unwrap_or_default();
        assert!(text.contains("\"effort\":60"), "{}: {text}", path.display());
    }
}

#[test]
fn a_fleet_ends_when_the_program_that_measures_it_is_killed() {
    let folder = Folder::new();
    let program = mr_slam().get_program().to_owned();
    // The shell stands for a bench.
    let mut shell = Command::new("sh")
        .args(["-c", "\"$0\" up --port 0 --page off --robots 1 --parent-pid $$ --run-dir \"$1\" & wait"])
        .arg(program)
        .arg(folder.path())
        .stdin(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(shell.stderr.take().unwrap()).lines().map_while(Result::ok);
    assert!(lines.any(|line| line.starts_with("fleet of")));
    let launcher = json(&folder.path().join("run.json"))["pid"].as_u64().unwrap() as u32;
    send(shell.id(), Signal::KILL);
    shell.wait().unwrap();
    let begun = Instant::now();
    while Path::new(&format!("/proc/{launcher}")).exists() {
        if begun.elapsed() > PATIENCE {
            send(launcher, Signal::TERM);
            panic!("the fleet outlives what measured it");
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    assert!(folder.path().join("report.json").exists(), "it has ended in order");
}

/// Returns the paths of the files that a process has open, and that are the launcher's own in shared memory.
fn ports_of_launcher(pid: u32, launcher: u32) -> Vec<String> {
    let entries = std::fs::read_dir(format!("/proc/{pid}/fd")).unwrap().flatten();
    let paths = entries.filter_map(|entry| std::fs::read_link(entry.path()).ok());
    let of_launcher = ports(launcher);
    paths.map(|path| path.display().to_string()).filter(|path| of_launcher.contains(path)).collect()
}

/// Returns the tags of a process's ports, which no other process opens.
fn ports(pid: u32) -> Vec<String> {
    let entries = std::fs::read_dir(format!("/proc/{pid}/fd")).unwrap().flatten();
    let paths = entries.filter_map(|entry| std::fs::read_link(entry.path()).ok());
    paths.map(|path| path.display().to_string()).filter(|path| path.ends_with(".port_tag")).collect()
}

#[test]
fn a_process_that_is_started_again_inherits_no_descriptors_of_the_launcher() {
    let mut fleet = Fleet::start("up", &["--robots", "1", "--page", "off"]);
    let pid_of = |view: &reports::FleetView| process(view, "telemetry").map(|process| process.pid);
    let before = pid_of(&fleet.until("telemetry", |view| pid_of(view).is_some())).unwrap();
    let launcher = fleet.run.pid;
    assert!(!ports(launcher).is_empty(), "the launcher has ports whose descriptors could be inherited");
    send(before, Signal::KILL);
    let is_other = |view: &reports::FleetView| pid_of(view).is_some_and(|pid| pid != before);
    let after = pid_of(&fleet.until("telemetry again", is_other)).unwrap();
    assert_eq!(ports_of_launcher(after, launcher), Vec::<String>::new());
}
