//! What holds the maps of a running fleet together can be seen, held and taken back from the command line.

use crate::harness::{Fleet, mr_slam};
use mr_slam::fleet::known_starts;
use serde_json::Value;
use std::path::Path;
use std::process::Output;

fn edges(run_dir: &Path, words: &[&str]) -> Output {
    mr_slam().args(["edges", "--json", "--run-dir"]).arg(run_dir).args(words).output().unwrap()
}

/// The only edge of a fleet of two, after what was asked for.
fn edge(run_dir: &Path, words: &[&str]) -> Value {
    let done = edges(run_dir, words);
    assert!(done.status.success(), "{words:?}: {}", String::from_utf8_lossy(&done.stderr));
    let all: Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!(all["edges"].as_array().unwrap().len(), 1, "{all}");
    all["edges"][0].clone()
}

#[test]
fn an_edge_is_pinned_let_loose_and_undone_while_the_fleet_runs() {
    let mut fleet = Fleet::start("up", &["--robots", "2"]);
    fleet.until("scans of both robots", |view| view.robots.iter().filter(|r| r.scans >= 20).count() == 2);
    let run_dir = fleet.folder.path().to_owned();
    let state = |words: &[&str]| edge(&run_dir, words)["state"].as_str().unwrap().to_owned();

    // Their starts are given, so there is something to hold although nothing has been found yet.
    assert_eq!(state(&["pin", "1", "2"]), "pinned");
    // It lies as they were started.
    let starts = known_starts(&fleet.run.config).unwrap();
    let (truth, pinned) = (starts[0].unwrap().between(starts[1].unwrap()), edge(&run_dir, &[]));
    for (k, value) in [truth.x_m, truth.y_m, truth.yaw_rad].into_iter().enumerate() {
        assert!((pinned["a_from_b"][k].as_f64().unwrap() - value).abs() < 0.05, "{pinned} where {truth:?}");
    }
    assert_eq!(state(&["unpin", "1", "2"]), "accepted");
    assert_eq!(state(&["undo", "1", "2"]), "undone");
    // Undone for good, until the operator says otherwise.
    let refused = edges(&run_dir, &["unpin", "1", "2"]);
    assert!(!refused.status.success());
    assert!(String::from_utf8_lossy(&refused.stderr).contains("refused"), "{refused:?}");
    let stranger = edges(&run_dir, &["pin", "1", "3"]);
    assert!(String::from_utf8_lossy(&stranger.stderr).contains("robots 1 to 2"), "{stranger:?}");
    assert_eq!(state(&[]), "undone");
    assert_eq!(state(&["pin", "1", "2"]), "pinned");
}
