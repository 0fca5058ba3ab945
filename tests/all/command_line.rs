//! Command line: printing into a closed pipe, and the choice among several running fleets.

use crate::harness::{Folder, mr_slam, output};
use std::process::Stdio;

#[test]
fn printing_into_a_closed_pipe_is_no_error() {
    let mut doctor =
        mr_slam().args(["doctor", "--json"]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(doctor.stdout.take());
    let ended = doctor.wait_with_output().unwrap();
    assert!(ended.status.success() && ended.stderr.is_empty(), "{ended:?}");
}

#[test]
fn help_lists_the_tools_and_hides_the_workers() {
    let help = String::from_utf8(output(&["--help"]).stdout).unwrap();
    assert!(help.contains("replay") && help.contains("merge"), "{help}");
    assert!(!help.contains("worker") && !help.contains("telemetry"), "{help}");
    assert!(output(&["worker", "slam", "--help"]).status.success());
}

/// Describes a run that seems to be alive in a folder for temporary files.
fn pretend_run(temporary: &Folder, pid: u32) -> String {
    let dir = temporary.path().join(format!("run-{pid}"));
    std::fs::create_dir_all(&dir).unwrap();
    let run =
        serde_json::json!({ "pid": pid, "domain": pid.to_string(), "epoch_ns": 0, "begun_ns": 1, "port": 0 });
    std::fs::write(dir.join("run.json"), run.to_string()).unwrap();
    let pointer = temporary.path().join(format!("mrslam-{pid}"));
    std::fs::create_dir_all(&pointer).unwrap();
    std::fs::write(pointer.join("run-dir"), dir.as_os_str().as_encoded_bytes()).unwrap();
    dir.display().to_string()
}

#[test]
fn a_change_must_name_the_run_if_several_fleets_run() {
    let temporary = Folder::new();
    // Process 1 always lives, and so does this one.
    let runs = [1, std::process::id()].map(|pid| pretend_run(&temporary, pid));
    for words in [
        &["release"][..],
        &["allow", "10.0.0.1"],
        &["deny", "10.0.0.1"],
        &["edges", "undo", "1", "2"],
        &["slam", "1", "pause"],
    ] {
        let ended = mr_slam().args(words).env("TMPDIR", temporary.path()).output().unwrap();
        let error = String::from_utf8_lossy(&ended.stderr).into_owned();
        assert!(!ended.status.success(), "{words:?}");
        assert!(
            error.contains("--run-dir") && runs.iter().all(|run| error.contains(run)),
            "{words:?}: {error}"
        );
    }
}

#[test]
fn stop_is_latched_in_every_fleet_whether_it_answers_or_not() {
    let temporary = Folder::new();
    let runs = [1, std::process::id()].map(|pid| pretend_run(&temporary, pid));
    let stop = || mr_slam().arg("stop").env("TMPDIR", temporary.path()).output().unwrap();
    let ended = stop();
    let said = String::from_utf8_lossy(&ended.stdout).into_owned();
    assert!(ended.status.success(), "{said}");
    assert!(runs.iter().all(|run| said.contains(run)) && said.contains("latched"), "{said}");
    for run in &runs {
        let file = std::path::Path::new(run).join("stopped");
        std::fs::remove_file(&file).unwrap();
        // A file cannot replace a folder.
        std::fs::create_dir_all(file.join("in-the-way")).unwrap();
    }
    let ended = stop();
    assert!(!ended.status.success(), "it is neither set nor latched");
    assert!(String::from_utf8_lossy(&ended.stdout).contains("NOT STOPPED"));
}
