//! With `--json`, standard output is one JSON document for every tool, whatever fails. The tools and their words are those of the
//! command line itself, so a new tool is tried without a line here, unless it has words of a kind that none had before.

use crate::harness::{Fleet, Folder, mr_slam, output_of};
use clap::{Arg, Command, CommandFactory as _};
use mr_slam::command::Cli;
use serde_json::Value;
use std::path::Path;
use std::process::Output;

/// Tools that need no fleet, with words that let them end soon.
const WITHOUT_FLEET: [(&str, &[&str]); 2] =
    [("doctor", &[]), ("lockstep", &["--robots", "1", "--seconds", "1"])];
/// Tools that fail without a fleet only with these words, or would run long.
const MORE_WORDS: [(&str, &[&str]); 4] = [
    ("experiment", &["--out", "/dev/null", "--fast"]),
    ("goto", &["0.5,0.5", "--no-wait"]),
    ("operator", &["--seconds", "1", "--robots", "2"]),
    ("record", &["--seconds", "1"]),
];
/// Tools that know no `--run-dir`, or whose `--run-dir` is for their own results.
const NO_RUN_DIR: [&str; 6] = ["doctor", "lockstep", "experiment", "replay", "merge", "operator"];

/// Returns the words of every tool that knows `--json`, with its required words.
fn tools(folder: &Path) -> Vec<Vec<String>> {
    let mut root = Cli::command();
    root.build();
    let mut found = Vec::new();
    collect(&root, &[], folder, &mut found);
    assert!(found.len() > 30, "{found:?}");
    found
}

fn collect(command: &Command, before: &[String], folder: &Path, found: &mut Vec<Vec<String>>) {
    let required = command.get_positionals().filter(|arg| arg.is_required_set());
    let words: Vec<String> =
        before.iter().cloned().chain(required.flat_map(|arg| values(arg, folder))).collect();
    let has_json = command.get_arguments().any(|arg| arg.get_long() == Some("json"));
    if has_json && !command.is_subcommand_required_set() {
        found.push(words.clone());
    }
    for inner in command.get_subcommands().filter(|inner| inner.get_name() != "help" && !inner.is_hide_set())
    {
        let words = [&words[..], &[inner.get_name().to_owned()]].concat();
        collect(inner, &words, folder, found);
    }
}

/// Returns a sound value for a required word.
fn values(arg: &Arg, folder: &Path) -> Vec<String> {
    let file = |name: &str| folder.join(name).display().to_string();
    match arg.get_id().as_str() {
        "robot" | "a" | "name" => vec!["1".into()],
        "b" => vec!["2".into()],
        "number" => vec!["1".into()],
        "corners" => ["8,8", "9,8", "9,9"].map(String::from).into(),
        "address" => vec!["10.0.0.1".into()],
        "file" => vec![file("written")],
        "pose" => vec!["0,0,0".into()],
        "mode" => vec![arg.get_possible_values()[0].get_name().to_owned()],
        "logs" => vec![file("no.log")],
        "maps" => vec![file("no.yaml"), file("none.yaml")],
        unknown => panic!("a required word of a new kind, {unknown}: expected a value for it here"),
    }
}

/// Runs a tool with `--json`, and reads what it prints.
fn run(tool: &[String], run_dir: &Path, more: &[&str]) -> (Output, Value) {
    let extra = MORE_WORDS.iter().chain(&WITHOUT_FLEET).find(|(name, _)| *name == tool[0]);
    let mut command = mr_slam();
    command.args(tool).args(extra.map_or(&[][..], |(_, words)| *words)).args(more).arg("--json");
    if !NO_RUN_DIR.contains(&tool[0].as_str()) {
        command.arg("--run-dir").arg(run_dir);
    }
    let done =
        output_of(command.env("XDG_STATE_HOME", run_dir.join("state")).env("XDG_RUNTIME_DIR", run_dir));
    let json = serde_json::from_slice(&done.stdout)
        .unwrap_or_else(|why| panic!("{tool:?} prints no JSON document: {why}: {done:?}"));
    (done, json)
}

/// Asserts that exit code, JSON and what is said to people agree.
fn check(tool: &[String], done: &Output, json: &Value) {
    let said = String::from_utf8_lossy(&done.stderr);
    if done.status.success() {
        assert!(json.get("error").is_none(), "{tool:?} succeeds with an error: {json}");
    } else {
        let error = json.get("error").and_then(Value::as_str);
        assert!(error.is_none_or(|error| !error.is_empty()), "{tool:?}: {json}");
        assert!(
            said.lines().any(|line| line.starts_with("mr-slam: ")),
            "{tool:?} fails without a word: {said}"
        );
    }
}

#[test]
fn a_tool_without_a_fleet_says_so_in_json() {
    let folder = Folder::new();
    for tool in tools(folder.path()) {
        let more: &[&str] = if tool[0] == "operator" { &["--port", "1"] } else { &[] };
        let (done, json) = run(&tool, folder.path(), more);
        check(&tool, &done, &json);
        let needs_none = WITHOUT_FLEET.iter().any(|(name, _)| *name == tool[0]);
        assert!(needs_none || json["error"].is_string(), "{tool:?} succeeds without a fleet: {json}");
    }
}

#[test]
fn a_wrong_option_is_an_error_in_json() {
    let folder = Folder::new();
    for tool in tools(folder.path()) {
        let (done, json) = run(&tool, folder.path(), &["--no-such-option"]);
        let error = json["error"].as_str().unwrap();
        assert!(error.contains("--no-such-option") && !error.contains('\n'), "{tool:?}: {error}");
        assert_eq!(done.status.code(), Some(2), "{tool:?}");
    }
}

#[test]
fn tools_of_a_running_fleet_print_json() {
    let mut fleet = Fleet::start("up", &["--robots", "2"]);
    fleet.until("scans of both robots", |view| view.robots.iter().filter(|r| r.scans >= 20).count() == 2);
    let run_dir = fleet.folder.path().to_owned();
    let port = fleet.run.port.to_string();
    let inside =
        |tool: &Vec<String>| !["doctor", "lockstep", "experiment", "replay", "merge"].contains(&&*tool[0]);
    let mut succeeded = 0;
    for tool in tools(&run_dir).iter().filter(|tool| inside(tool)) {
        let more: &[&str] = match &*tool[0] {
            "operator" => &["--port", &port],
            "explore" => &["--no-wait"],
            _ => &[],
        };
        let (done, json) = run(tool, &run_dir, more);
        check(tool, &done, &json);
        succeeded += usize::from(done.status.success());
        println!("{tool:?} {} {}", done.status, json.to_string().chars().take(200).collect::<String>());
    }
    assert!(succeeded > 20, "{succeeded}");
}
