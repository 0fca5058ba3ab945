//! Command line: printing into a closed pipe, and the choice among several running fleets.

use crate::harness::{Folder, mr_slam, output, output_of};
use mr_slam::runtime_folder::Lock;
use std::os::unix::fs::DirBuilderExt;
use std::path::PathBuf;
use std::process::Stdio;

#[test]
fn printing_into_a_closed_pipe_is_no_error() {
    for words in [&["doctor", "--json"][..], &["lockstep", "--seconds", "1", "--json"], &["--help"]] {
        let mut tool = mr_slam().args(words).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        drop(tool.stdout.take());
        let ended = tool.wait_with_output().unwrap();
        let error = String::from_utf8_lossy(&ended.stderr);
        assert!(ended.status.success() && !error.contains("panicked"), "{words:?}: {ended:?}");
    }
}

#[test]
fn help_lists_the_tools_and_hides_the_workers() {
    let help = String::from_utf8(output(&["--help"]).stdout).unwrap();
    assert!(help.contains("replay") && help.contains("merge"), "{help}");
    assert!(!help.contains("worker") && !help.contains("telemetry"), "{help}");
    assert!(output(&["worker", "slam", "--help"]).status.success());
}

/// Describes a run that seems to be alive in a folder for temporary files. It does as long as the lock is held.
fn pretend_run(temporary: &Folder, number: u32) -> (String, Lock) {
    let private = |path: PathBuf| {
        std::fs::DirBuilder::new().recursive(true).mode(0o700).create(&path).unwrap();
        path
    };
    let user = rustix::process::geteuid().as_raw();
    let home = private(temporary.path().join(format!("mr-slam-{user}")));
    let runtime = private(home.join(number.to_string()));
    let dir = private(temporary.path().join(format!("run-{number}")));
    let run = serde_json::json!({
        "pid": number, "domain": "test", "runtime": runtime, "epoch_ns": 0, "begun_ns": 1, "port": 0
    });
    std::fs::write(dir.join("run.json"), run.to_string()).unwrap();
    std::fs::write(dir.join("fleet.toml"), "").unwrap();
    std::fs::write(runtime.join("run-dir"), dir.as_os_str().as_encoded_bytes()).unwrap();
    (dir.display().to_string(), Lock::acquire(&runtime.join("lock")).unwrap().unwrap())
}

#[test]
fn a_change_must_name_the_run_if_several_fleets_run() {
    let temporary = Folder::new();
    let (runs, _locks): (Vec<String>, Vec<Lock>) =
        [1, 2].iter().map(|number| pretend_run(&temporary, *number)).unzip();
    for words in [
        &["release"][..],
        &["allow", "10.0.0.1"],
        &["deny", "10.0.0.1"],
        &["edges", "undo", "1", "2"],
        &["slam", "1", "pause"],
    ] {
        let ended = mr_slam()
            .args(words)
            .env("TMPDIR", temporary.path())
            .env("XDG_RUNTIME_DIR", temporary.path())
            .output()
            .unwrap();
        let error = String::from_utf8_lossy(&ended.stderr).into_owned();
        assert!(!ended.status.success(), "{words:?}");
        assert!(
            error.contains("--run-dir") && runs.iter().all(|run| error.contains(run)),
            "{words:?}: {error}"
        );
    }
}

#[test]
fn an_endless_file_is_refused_instead_of_read() {
    for words in [&["up", "--config", "/dev/zero"][..], &["replay", "/dev/zero", "--config", "/dev/zero"]] {
        let ended = output(words);
        let error = String::from_utf8_lossy(&ended.stderr).into_owned();
        assert!(!ended.status.success() && error.contains("longer than"), "{words:?}: {error}");
    }
}

#[test]
fn too_few_descriptors_are_said_in_words_before_the_start() {
    let folder = Folder::new();
    let mut shell = std::process::Command::new("sh");
    shell.args(["-c", "ulimit -n 64; exec \"$0\" up --port 0 --seconds 1 --run-dir \"$1\""]);
    let ended = output_of(shell.arg(env!("CARGO_BIN_EXE_mr-slam")).arg(folder.path()));
    let error = String::from_utf8_lossy(&ended.stderr).into_owned();
    assert!(!ended.status.success() && error.contains("ulimit -n"), "{error}");
}

#[test]
fn a_fleet_that_has_ended_is_not_stopped_and_the_next_one_in_its_folder_may_drive() {
    let temporary = Folder::new();
    let (run, lock) = pretend_run(&temporary, 1);
    drop(lock);
    let mut command = mr_slam();
    command.args(["stop", "--run-dir", &run]).env("TMPDIR", temporary.path());
    let ended = command.output().unwrap();
    let said = String::from_utf8_lossy(&ended.stderr).into_owned();
    assert!(ended.status.code() == Some(3) && said.contains("has ended"), "{said}");
    assert!(!std::path::Path::new(&run).join("stopped").exists());
}

#[test]
fn stop_is_latched_in_every_fleet_whether_it_answers_or_not() {
    let temporary = Folder::new();
    let runs = [1, 2].map(|number| pretend_run(&temporary, number));
    let stop = || {
        let mut command = mr_slam();
        command.arg("stop").env("TMPDIR", temporary.path()).env("XDG_RUNTIME_DIR", temporary.path());
        command.output().unwrap()
    };
    let ended = stop();
    let said = String::from_utf8_lossy(&ended.stdout).into_owned();
    assert!(!ended.status.success(), "nobody has confirmed it: {said}");
    assert!(runs.iter().all(|(run, _)| said.contains(run)), "{said}");
    assert_eq!(said.matches("NOT CONFIRMED: the stop is latched").count(), runs.len(), "{said}");
    for (run, _) in &runs {
        let file = std::path::Path::new(run).join("stopped");
        std::fs::remove_file(&file).unwrap();
        // A file cannot replace a folder.
        std::fs::create_dir_all(file.join("in-the-way")).unwrap();
    }
    let ended = stop();
    assert!(!ended.status.success(), "it is neither set nor latched");
    assert!(String::from_utf8_lossy(&ended.stdout).contains("NOT STOPPED"));
}

#[test]
fn stop_fails_while_a_fleet_whose_folder_is_gone_may_drive() {
    let temporary = Folder::new();
    let (run, _lock) = pretend_run(&temporary, 7);
    std::fs::remove_dir_all(&run).unwrap();
    for words in [&["stop"][..], &["stop", "--run-dir", &run], &["status"]] {
        let mut command = mr_slam();
        command.args(words).env("TMPDIR", temporary.path()).env("XDG_RUNTIME_DIR", temporary.path());
        let ended = command.output().unwrap();
        let said = String::from_utf8_lossy(&[ended.stdout, ended.stderr].concat()).into_owned();
        assert!(!ended.status.success(), "{words:?}: {said}");
        assert!(said.contains("process 7") && said.contains("run.json"), "{words:?}: {said}");
        assert!(words[0] != "stop" || said.contains("NOT STOPPED"), "{words:?}: {said}");
    }
}

#[test]
fn results_of_other_tools_are_refused_in_the_folder_of_a_running_fleet() {
    let temporary = Folder::new();
    let (run, _runtime_lock) = pretend_run(&temporary, 1);
    let _lock = Lock::acquire(&std::path::Path::new(&run).join(".lock")).unwrap().unwrap();
    let before = std::fs::read_dir(&run).unwrap().count();
    let [map, session] = ["/merged_map", "/robot1.slam"].map(|name| run.clone() + name);
    for words in [
        &["lockstep", "--seconds", "1", "--robots", "1", "--run-dir", &run][..],
        &["replay", "/dev/null", "--map", &map],
        &["replay", "/dev/null", "--save-session", &session],
        &["experiment", "--fast", "--sessions", "1", "--seconds", "1", "--out", &run],
    ] {
        let ended = output(words);
        let error = String::from_utf8_lossy(&ended.stderr).into_owned();
        assert!(!ended.status.success() && error.contains(&run), "{words:?}: {error}");
        assert!(error.contains("choose another"), "{words:?}: {error}");
        assert_eq!(std::fs::read_dir(&run).unwrap().count(), before, "{words:?} wrote into it");
    }
}

#[test]
fn addresses_that_no_client_has_and_zones_that_cross_are_refused_before_anything_is_asked() {
    let temporary = Folder::new();
    let (run, _lock) = pretend_run(&temporary, 1);
    for (words, wanted) in [
        (&["allow", "0.0.0.0"][..], "which no client has"),
        (&["deny", "255.255.255.255"], "which no client has"),
        (&["up", "--allow", "224.0.0.1", "--port", "0", "--seconds", "1"], "which no client has"),
        (&["zone", "add", "0,0", "2,2", "2,0", "0,2"], "cross or touch"),
        (&["zone", "add", "-1,0", "2,2", "-1,0"], "the same point"),
    ] {
        let mut tool = mr_slam();
        tool.args(words).args(["--run-dir", &run]).env("TMPDIR", temporary.path());
        let ended = tool.env("XDG_RUNTIME_DIR", temporary.path()).output().unwrap();
        let error = String::from_utf8_lossy(&ended.stderr).into_owned();
        assert!(!ended.status.success() && error.contains(wanted), "{words:?}: {error}");
    }
}

#[test]
fn results_that_cannot_be_printed_name_standard_output() {
    for words in [&["doctor"][..], &["lockstep", "--robots", "1", "--seconds", "1"]] {
        let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
        let output =
            mr_slam().args(words).stdout(full).stderr(std::process::Stdio::piped()).output().unwrap();
        let reported = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success(), "{words:?}: {reported}");
        assert!(reported.contains("cannot write to standard output: No space left"), "{words:?}: {reported}");
    }
}

/// Runs a tool as a program would, and returns its exit code, the error in its JSON, and what is said to people.
fn run_for_program(words: &[&str], folder: &std::path::Path) -> (Option<i32>, String, String) {
    let mut tool = mr_slam();
    let of_folder = ["TMPDIR", "XDG_RUNTIME_DIR", "XDG_STATE_HOME"];
    tool.args(words).envs(of_folder.map(|name| (name, folder))).current_dir(folder);
    let ended = tool.output().unwrap();
    let json = serde_json::from_slice::<serde_json::Value>(&ended.stdout).unwrap_or_default();
    let error = json["error"].as_str().unwrap_or_default().to_owned();
    (ended.status.code(), error, String::from_utf8_lossy(&ended.stderr).into_owned())
}

/// Asserts that each command line ends with 2, says why, and with `--json` in JSON, too.
fn check_refused(invocations: &[&[&str]], folder: &std::path::Path) {
    for words in invocations {
        let (code, error, said) = run_for_program(words, folder);
        assert_eq!(code, Some(2), "{words:?}: {said}");
        assert!(!said.is_empty(), "{words:?} says nothing");
        assert_eq!(!error.is_empty(), words.contains(&"--json"), "{words:?}: {error} {said}");
    }
}

#[test]
fn a_wrong_command_line_ends_with_2_whatever_is_wrong() {
    let temporary = Folder::new();
    let (run, _lock) = pretend_run(&temporary, 1);
    let at = |name: &str| temporary.path().join(name).display().to_string();
    std::fs::write(at("wrong.toml"), "[fleet]\nrobots = 99\n").unwrap();
    std::fs::write(at("unknown.toml"), "[fleet]\nrobot = 2\n").unwrap();
    std::fs::write(at("empty.log"), "").unwrap();
    let [wrong, unknown, missing, empty] = ["wrong.toml", "unknown.toml", "missing", "empty.log"].map(at);
    let no_run = at("no-run");
    let invocations: &[&[&str]] = &[
        // Refused by the parser.
        &[],
        &["fly"],
        &["status", "--no-such-option", "--json"],
        &["lockstep", "--seconds", "0", "--json"],
        &["goto", "1", "here", "--json"],
        &["edges", "pin", "1", "--json"],
        &["allow", "0.0.0.0", "--json"],
        &["record", "--seconds", "-1", "--json"],
        &["replay", &empty, "--at", "0,0,0", "--json"],
        // Values that are checked together, and the fleet file.
        &["up", "--robots", "65", "--port", "0"],
        &["up", "--config", &wrong, "--port", "0"],
        &["up", "--config", &unknown, "--port", "0"],
        &["up", "--config", &missing, "--port", "0"],
        &["up", "--names", "a b", "--port", "0"],
        &["up", "--localize", "--port", "0"],
        &["up", "--room", &missing, "--port", "0"],
        &["up", "--sessions", &missing, "--port", "0"],
        &["up", "--people", "99", "--port", "0"],
        &["up", "--robots", "65", "--detach"],
        &["demo", "--split-mb", "1", "--port", "0"],
        &["lockstep", "--robots", "0", "--json"],
        &["lockstep", "--world", "ros", "--json"],
        &["lockstep", "--room", "office:x", "--json"],
        &["lockstep", "--room", &missing, "--seconds", "1", "--json"],
        &["experiment", "--world", "ros", "--fast", "--json"],
        &["experiment", "--link-loss", "7", "--fast", "--json"],
        &["experiment", "--fast", "--out", &run, "--json"],
        &["experiment", "--fast", "--out", &missing, "--beside", &no_run, "--json"],
        &["operator", "tour", "--seconds", "nan", "--json"],
        &["operator", "tour", "--names", "a b", "--json"],
        &["keys", "robot", "a b", "--keys", &missing],
    ];
    check_refused(invocations, temporary.path());
}

#[test]
fn an_input_that_cannot_be_used_ends_with_2() {
    let temporary = Folder::new();
    let at = |name: &str| temporary.path().join(name).display().to_string();
    std::fs::write(at("wrong.toml"), "[fleet]\nrobots = 99\n").unwrap();
    std::fs::write(at("empty.log"), "").unwrap();
    let [wrong, missing, empty, no_yaml] = ["wrong.toml", "missing", "empty.log", "no.yaml"].map(at);
    let maps = vec![no_yaml.as_str(); 65];
    let many_maps: Vec<&str> = [&["merge"][..], &maps, &["--json"]].concat();
    let invocations: &[&[&str]] = &[
        &["replay", &missing, "--json"],
        &["replay", &empty, "--json"],
        &["replay", &empty, "--fov-deg", "400", "--json"],
        &["replay", &empty, "--serve", "--json"],
        &["replay", &empty, "--mode", "localize", "--json"],
        &["replay", &empty, "--trajectory", &empty, "--json"],
        &["replay", &empty, "--config", &wrong, "--json"],
        &["replay", &empty, &empty, "--json"],
        &["merge", &no_yaml, &no_yaml, "--json"],
        &many_maps,
    ];
    check_refused(invocations, temporary.path());
}

#[test]
fn a_wrong_robot_run_or_value_of_a_running_fleet_ends_with_2() {
    let temporary = Folder::new();
    let (run, _lock) = pretend_run(&temporary, 1);
    let at = |name: &str| temporary.path().join(name).display().to_string();
    std::fs::write(at("there.mcap"), "a recording").unwrap();
    let [no_run, no_mcap, there] = ["no-run", "a.bag", "there.mcap"].map(at);
    let invocations: &[&[&str]] = &[
        &["status", "--run-dir", &no_run, "--json"],
        &["goto", "9", "1,1", "--run-dir", &run, "--json"],
        &["edges", "pin", "1", "1", "--run-dir", &run, "--json"],
        &["edges", "undo", "1", "77", "--run-dir", &run, "--json"],
        &["slam", "zebra", "state", "--run-dir", &run, "--json"],
        &["slam", "1", "save", "maps/", "--run-dir", &run, "--json"],
        &["zone", "add", "0,0", "2,2", "2,0", "0,2", "--run-dir", &run, "--json"],
        &["record", "--split-mb", "0", "--run-dir", &run, "--json"],
        &["record", "--out", &no_mcap, "--run-dir", &run, "--json"],
        &["record", "--out", &there, "--run-dir", &run, "--json"],
    ];
    check_refused(invocations, temporary.path());
}

#[test]
fn what_the_machine_or_a_fleet_lacks_is_a_failure() {
    let temporary = Folder::new();
    for words in [
        &["status", "--json"][..],
        &["goto", "1", "0,0", "--json"],
        &["slam", "1", "state", "--json"],
        &["operator", "tour", "--seconds", "0.2", "--port", "1", "--json"],
        &["lockstep", "--seconds", "1", "--robots", "1", "--run-dir", "/dev/null/folder", "--json"],
        &["replay", "/dev/null", "--map", "/dev/null/folder/map", "--json"],
    ] {
        let (code, error, said) = run_for_program(words, temporary.path());
        assert!(code == Some(1) && !error.is_empty(), "{words:?} ended with {code:?}: {said}");
    }
}
