//! `mr-slam experiment`: what a folder has is not run again, and other settings are refused.

use crate::harness::{Folder, mr_slam, output_of};
use std::path::Path;

/// Runs an experiment of two short sessions on virtual time; returns whether it succeeded, and what it said.
fn experiment(out: &Path, seconds: &str) -> (bool, String) {
    let mut command = mr_slam();
    command.args(["experiment", "--fast", "--robots", "1", "--sessions", "2", "--seconds", seconds, "--out"]);
    let ended = output_of(command.arg(out));
    (ended.status.success(), String::from_utf8_lossy(&ended.stderr).into_owned())
}

#[test]
fn an_interrupted_experiment_goes_on_with_the_sessions_that_are_missing() {
    let folder = Folder::new();
    let out = folder.path().join("experiment");
    let (is_done, said) = experiment(&out, "3");
    assert!(is_done, "{said}");
    let results = std::fs::read_to_string(out.join("experiment.json")).unwrap();
    let first = std::fs::read(out.join("session_1/report.json")).unwrap();
    // The second session was interrupted: it left maps, and no session.json.
    std::fs::remove_file(out.join("session_2/session.json")).unwrap();
    std::fs::write(out.join("session_1/report.json"), "kept").unwrap();
    let (is_done, said) = experiment(&out, "3");
    assert!(is_done && said.contains("session 1 of 2: is there already"), "{said}");
    assert!(said.contains("session 2 of 2: seed 2"), "{said}");
    assert_eq!(std::fs::read_to_string(out.join("experiment.json")).unwrap(), results);
    assert_eq!(std::fs::read(out.join("session_1/report.json")).unwrap(), b"kept", "it was not run again");
    assert_ne!(first, b"kept");
    assert!(out.join("session_2.unfinished-1").is_dir(), "nothing is removed");
    let html = std::fs::read_to_string(out.join("report.html")).unwrap();
    assert!(html.contains("Session 1, seed 1") && html.contains("Session 2, seed 2"));
    assert_eq!(html.matches("<svg").count() % 2, 0, "both sessions have the same pictures");
    let csv = std::fs::read_to_string(out.join("sessions.csv")).unwrap();
    assert_eq!(csv.lines().count(), 3, "{csv}");

    let (is_done, said) = experiment(&out, "4");
    assert!(!is_done && said.contains("other settings") && said.contains("--out"), "{said}");
}
