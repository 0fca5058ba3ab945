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

    // A program that defined a figure in another way named it otherwise.
    let path = out.join("session_1/session.json");
    let session = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, session.replace("\"scans lost\"", "\"scans missed\"")).unwrap();
    let (is_done, said) = experiment(&out, "3");
    assert!(!is_done && said.contains("whose figures are others") && said.contains("--out"), "{said}");
}

/// Runs one session of robots in a headset behind a link on virtual time; returns the figures.
fn headset_session(out: &Path, more: &[&str]) -> serde_json::Value {
    let mut command = mr_slam();
    command.args([
        "experiment",
        "--fast",
        "--world",
        "headset",
        "--robots",
        "2",
        "--sessions",
        "1",
        "--seconds",
        "15",
    ]);
    let ended = output_of(command.args(more).arg("--out").arg(out));
    assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
    serde_json::from_slice(&std::fs::read(out.join("experiment.json")).unwrap()).unwrap()
}

fn mean(results: &serde_json::Value, name: &str) -> f64 {
    let quantities = results["quantities"].as_array().unwrap();
    let quantity = quantities.iter().find(|quantity| quantity["name"].as_str().unwrap().starts_with(name));
    quantity.unwrap()["mean"].as_f64().unwrap_or_else(|| panic!("{name}: no data"))
}

#[test]
fn robots_in_a_headset_behind_a_link_are_mapped_the_same_each_time() {
    let folder = Folder::new();
    let [loopback, wifi, again] = ["loopback", "wifi", "again"].map(|name| folder.path().join(name));
    let clear = headset_session(&loopback, &["--link", "loopback"]);
    let beside = ["--additional-session", "--beside", loopback.to_str().unwrap()];
    let busy = headset_session(&wifi, &beside);
    assert_eq!(
        busy["link"].as_str().unwrap().split(" (").next(),
        Some("busy Wi-Fi"),
        "the headset's default"
    );
    for results in [&clear, &busy] {
        assert_eq!(mean(results, "scans lost"), 0.0);
        assert!(
            mean(results, "occupied F1 of the merged map against the room") > 30.0,
            "the experiment knows it"
        );
    }
    let jitter = "TF jitter in shared memory, median";
    let median_ms = mean(&busy, jitter);
    assert!((1.0..30.0).contains(&median_ms), "the link's jitter on virtual time: {median_ms} ms");
    assert_eq!(headset_session(&again, &["--additional-session"])["quantities"], busy["quantities"]);

    assert_eq!((&busy["seeds"], &busy["additional_seed"]), (&serde_json::json!([1]), &2.into()));
    let html = std::fs::read_to_string(wifi.join("report.html")).unwrap();
    for part in ["headset over loopback", "headset over busy Wi-Fi", "Additional session, seed 2"] {
        assert!(html.contains(part), "{part}");
    }
    let csv = std::fs::read_to_string(wifi.join("sessions.csv")).unwrap();
    assert!(csv.lines().last().unwrap().starts_with("additional,2,"), "{csv}");
}

#[test]
fn robots_in_a_headset_drive_and_are_mapped_in_real_time_over_a_link() {
    let folder = Folder::new();
    let out = folder.path().join("experiment");
    let mut command = mr_slam();
    command.args([
        "experiment",
        "--world",
        "headset",
        "--link",
        "quiet-wifi",
        "--robots",
        "1",
        "--sessions",
        "1",
    ]);
    let ended = output_of(command.args(["--seconds", "20", "--out"]).arg(&out));
    assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
    let results: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("experiment.json")).unwrap()).unwrap();
    assert!(mean(&results, "distance driven") > 0.02);
    assert!(mean(&results, "merged map, known share, walls") > 5.0);
    assert!(mean(&results, "TF jitter at a TCP client, median") > 0.0);
}

#[test]
fn worlds_that_an_experiment_cannot_simulate_and_bad_links_are_refused() {
    let refused = |args: &[&str]| {
        let ended = output_of(mr_slam().arg("experiment").args(args));
        assert!(!ended.status.success());
        String::from_utf8_lossy(&ended.stderr).into_owned()
    };
    assert!(refused(&["--world", "ros"]).contains("expected world"));
    assert!(refused(&["--link-loss", "2"]).contains("loss is 2; expected 0 to 1"));
    assert!(refused(&["--beside", "/nonexistent"]).contains("expected the folder of an experiment"));
}
