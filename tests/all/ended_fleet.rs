//! A tool that waits for a fleet ends with it.

use crate::harness::{Fleet, mr_slam};
use rustix::process::Signal;
use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Stdio};

/// A tool that waits, which is killed with its test.
struct Tool(Child);

impl Drop for Tool {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Starts a tool, ends the fleet when the tool has told its first progress, and returns what the tool says then.
fn said_after_the_end(words: &[&str]) -> String {
    let mut fleet = Fleet::start("up", &["--robots", "1"]);
    fleet.until("a map", |view| view.robots.first().is_some_and(|robot| robot.map.slam_stats[0] > 0.0));
    let run_dir = fleet.folder.path().to_owned();
    let mut command = mr_slam();
    command.args(words).arg("--run-dir").arg(run_dir).stdin(Stdio::null());
    let mut tool = Tool(command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap());
    let mut messages = BufReader::new(tool.0.stderr.take().unwrap());
    let mut said = String::new();
    assert!(messages.read_line(&mut said).unwrap() > 0, "{words:?} tells no progress");
    let _ended = fleet.end(Signal::INT);
    let (reported, end) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        let mut rest = String::new();
        let _ = messages.read_to_string(&mut rest);
        let _ = reported.send(rest);
    });
    said += &end.recv_timeout(crate::harness::WATCHDOG).expect("the tool waits on after the fleet's end");
    assert!(!tool.0.wait().unwrap().success(), "{said}");
    said
}

#[test]
fn goto_and_explore_end_with_their_fleet() {
    for (words, unknown) in [
        (&["goto", "1", "1.5,0"][..], "robot1: whether it has arrived is not known"),
        (&["explore"][..], "how far the exploration came is not known"),
    ] {
        let said = said_after_the_end(words);
        assert!(said.contains("the fleet has ended meanwhile") && said.contains(unknown), "{said}");
    }
}
