//! A fleet file that is wrong is refused with the file, the line and the reason.

use crate::harness::{Folder, output};
use mr_slam::config::FleetConfig;
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;
use std::process::Command;

/// Starts a fleet from `text`, which must be refused on `line` with all `words`.
fn refused(text: &str, line: usize, words: &[&str]) {
    let folder = Folder::new();
    let file = folder.file("fleet.toml", text);
    let up = output(&["up", "--port", "0", "--config", file.to_str().unwrap()]);
    assert!(!up.status.success());
    let said = String::from_utf8_lossy(&up.stderr).into_owned();
    let place = format!("fleet.toml:{line}:");
    assert!(said.contains(&place), "expected {place} in: {said}");
    for word in words {
        assert!(said.contains(word), "expected `{word}` in: {said}");
    }
}

#[test]
fn unknown_keys_are_refused() {
    refused("[fleet]\nrobots = 2\nrobotz = 3\n", 3, &["robotz"]);
    refused("\n[fleeet]\n", 2, &["fleeet"]);
}

#[test]
fn values_of_the_wrong_type_are_refused() {
    refused("[fleet]\n\nrobots = \"three\"\n", 3, &["`fleet.robots = \"three\"`"]);
    refused(
        "[bridge.dds]\ndomain = \"5\"\n",
        2,
        &["`bridge.dds.domain = \"5\"`", "\"environment\"", "without quotes"],
    );
    refused("[bridge]\nallow = [\"everywhere\"]\n", 2, &["`bridge.allow = [\"everywhere\"]`", "IP address"]);
    refused("[fleet\n", 1, &[]);
}

#[test]
fn values_out_of_range_are_refused() {
    refused("[fleet]\nseed = 1\nrobots = 65\n", 3, &["65", "64"]);
    refused("[fleet]\nrobots = 0\n", 2, &["1 to 64"]);
    refused("[fleet]\nrobots = 2\nstarts = [[0.0, 0.0, 0.0]]\n", 3, &["1 poses for 2"]);
    refused("[fleet]\nrobots = 1\nstarts = [[nan, 0.0, 0.0]]\n", 3, &["metres from -1000 to 1000"]);
    refused(
        "[fleet]\nrobots = 1\nstarts = [[15000.0, 0.0, 0.0]]\n",
        3,
        &["15000.0", "metres from -1000 to 1000"],
    );
    refused("[fleet]\naddress = \"everywhere\"\n", 2, &["everywhere"]);
}

#[test]
fn what_the_runs_file_cannot_hold_is_refused_before_a_fleet_is_started() {
    let no_text = OsStr::from_bytes(b"/sessions/\xff");
    for (option, value, said) in [
        ("--seed", OsStr::new("18446744073709551615"), "expected 0 to 9223372036854775807"),
        ("--sessions", no_text, "expected paths in UTF-8"),
    ] {
        for tool in ["up", "lockstep"] {
            let mut command = Command::new(env!("CARGO_BIN_EXE_mr-slam"));
            let output = command
                .args([tool, "--robots", "1", "--seconds", "1"])
                .arg(option)
                .arg(value)
                .output()
                .unwrap();
            let stderr = String::from_utf8_lossy(&output.stderr);
            assert!(!output.status.success() && stderr.contains(said), "{tool} {option}: {stderr}");
        }
    }
}

#[test]
fn missing_or_invalid_room_files_are_refused() {
    let folder = Folder::new();
    let text = folder.file("room.obj", "v 1 2 nan\n");
    for (room, word) in [
        ("/nowhere/room.glb", "/nowhere/room.glb"),
        (text.to_str().unwrap(), "room.obj"),
        ("office:abc", "a whole number from 0, as in `office:7`"),
    ] {
        let up = output(&["up", "--port", "0", "--room", room]);
        assert!(!up.status.success());
        let said = String::from_utf8_lossy(&up.stderr).into_owned();
        assert!(said.contains(word), "{said}");
    }
}

#[test]
fn the_written_default_equals_the_built_in_default() {
    let config = FleetConfig::default();
    let folder = Folder::new();
    let file = folder.file("fleet.toml", config.to_toml());
    assert_eq!(FleetConfig::from_file(&file).unwrap(), config);
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/default.toml");
    assert_eq!(FleetConfig::from_file(&shipped).unwrap(), config);
}

#[test]
fn missing_keys_have_their_default() {
    let folder = Folder::new();
    let file = folder.file("fleet.toml", "[slam.tracking]\nreferences = 5\n");
    let config = FleetConfig::from_file(&file).unwrap();
    let mut expected = FleetConfig::default();
    expected.slam.tracking.references = 5;
    assert_eq!(config, expected);
}

/// Keys whose every value of their type works: random seeds.
const ANY_NUMBER: [&str; 1] = ["fleet.seed"];

/// Returns each key of the configuration that holds a value, as a dotted path, with its default.
fn all_keys() -> Vec<(String, toml::Value)> {
    fn collect(table: &toml::Table, prefix: &str, found: &mut Vec<(String, toml::Value)>) {
        for (name, value) in table {
            match value {
                toml::Value::Table(below) if !below.is_empty() => {
                    collect(below, &format!("{prefix}{name}."), found)
                }
                value => found.push((format!("{prefix}{name}"), value.clone())),
            }
        }
    }
    let mut found = Vec::new();
    collect(&FleetConfig::default().to_toml().parse().unwrap(), "", &mut found);
    found
}

/// Writes a file that sets one key on its fifth line, in each way that TOML has.
fn files_that_set(key: &str, value: &str) -> [String; 3] {
    let (table, name) = key.rsplit_once('.').unwrap_or(("", key));
    let header = if table.is_empty() { "#".into() } else { format!("[{table}]") };
    let inline = match key.split_once('.') {
        Some((first, rest)) => format!("{first} = {{ {rest} = {value} }}"),
        None => format!("{key} = {value}"),
    };
    [
        format!("# a fleet\n\n{header}\n\n{name} = {value}\n"),
        format!("\n\n\n\n{key} = {value}\n"),
        format!("\n# {name}\n\n\n{inline}\n"),
    ]
}

/// Returns what is wrong with the refusal of a value: each file that sets it must be refused at its fifth line, by the key's name.
fn faults_of_refusal(key: &str, value: &str) -> Vec<String> {
    let mut faults = Vec::new();
    for text in files_that_set(key, value) {
        match FleetConfig::from_text(Path::new("fleet.toml"), &text).err().map(|why| why.to_string()) {
            None => faults.push(format!("{key} = {value} is accepted")),
            Some(why) if !why.starts_with("fleet.toml:5: ") => {
                faults.push(format!("{key} = {value} is refused elsewhere: {why} in:\n{text}"));
            }
            Some(why) if !why.contains(key) => {
                faults.push(format!("{key} = {value} is refused without its name: {why} in:\n{text}"));
            }
            Some(_) => {}
        }
    }
    faults
}

#[test]
fn every_key_is_refused_at_its_line_if_its_type_is_wrong() {
    // No key holds a list of lists of booleans.
    let faults: Vec<_> =
        all_keys().into_iter().flat_map(|(key, _)| faults_of_refusal(&key, "[[true]]")).collect();
    assert!(faults.is_empty(), "{faults:#?}");
}

#[test]
fn every_number_is_refused_at_its_line_if_it_is_out_of_range() {
    let is_refused = |key: &str, value: &str| {
        FleetConfig::from_text(Path::new("fleet.toml"), &format!("{key} = {value}")).is_err()
    };
    let mut faults = Vec::new();
    for (key, default) in all_keys().into_iter().filter(|(key, _)| !ANY_NUMBER.contains(&key.as_str())) {
        match default {
            // What is not finite is never in range.
            toml::Value::Float(_) => {
                faults.extend(["nan", "inf", "-inf"].iter().flat_map(|value| faults_of_refusal(&key, value)));
            }
            toml::Value::Integer(_) => {
                let candidates = ["-1", "9223372036854775807"];
                let refused: Vec<_> = candidates.iter().filter(|value| is_refused(&key, value)).collect();
                if refused.is_empty() {
                    faults.push(format!("{key} has no range"));
                }
                faults.extend(refused.into_iter().flat_map(|value| faults_of_refusal(&key, value)));
            }
            _ => {}
        }
    }
    assert!(faults.is_empty(), "{faults:#?}");
}

#[test]
fn a_value_out_of_range_is_named_with_its_line_its_key_and_what_is_expected() {
    for (text, words) in [
        ("[bridge]\n[bridge.limits]\nheld_bytes_max = 9000000", "fleet.toml:3: bridge.frame_bytes_max is "),
        ("[sim.lidar]\nrange_min_m = 5", "fleet.toml:2: sim.lidar.range_max_m is 3.5; expected more than"),
        (
            "[bridge.velocity]\nrobots = [\n  { robot = 1, linear_m_s = 1, angular_rad_s = 1 },\n  \
             { robot = 2, linear_m_s = 99, angular_rad_s = 1 },\n]",
            "fleet.toml:4: bridge.velocity.robots[1].linear_m_s is 99; expected above 0",
        ),
        (
            "[fleet]\nrobots = 2\n[bridge.velocity]\nrobots = [\n  { robot = 3, linear_m_s = 1, angular_rad_s = 1 },\n]",
            "fleet.toml:5: bridge.velocity.robots[0].robot is 3; expected a robot of this fleet, 1 to 2",
        ),
        (
            "[bridge.velocity]\nrobots = [\n  { robot = 2, linear_m_s = 1, angular_rad_s = 1 },\n  \
             { robot = 2, linear_m_s = 2, angular_rad_s = 1 },\n]",
            "fleet.toml:4: bridge.velocity.robots[1].robot is 2; expected one entry for each robot",
        ),
        (
            "[realtime]\nroles = [\n  \"sim\",\n  \"robot\",\n]",
            "fleet.toml:4: realtime.roles[1] names `robot`; expected ",
        ),
        ("[realtime.cores]\nsim = [0]\nslam = [99999]", "fleet.toml:3: realtime.cores.slam has core 99999"),
        ("[sessions]\nmode = \"localization\"", "fleet.toml:2: sessions.mode is `localization`, which needs"),
        ("[slam.map]\nhit_log_odds = 99", "fleet.toml:2: slam.map.hit_log_odds is 99, expected"),
        ("[merge.align]\nmargin_min = -2", "fleet.toml:2: merge.align.margin_min is -2; expected"),
        ("world = \"ros\"", "fleet.toml:1: world is `ros`, which needs ROS 2; expected bridge.dds.enabled"),
    ] {
        let error = FleetConfig::from_text(Path::new("fleet.toml"), text).unwrap_err().to_string();
        assert!(error.starts_with(words), "{error}; expected {words}");
    }
}

#[test]
fn the_bridge_has_the_limits_of_simulated_robots_and_its_own_for_others() {
    let text = "[bridge.velocity]\nlinear_m_s = 0.1\nrobots = [{ robot = 2, linear_m_s = 0.2, angular_rad_s = 0.5 }]\n";
    let folder = Folder::new();
    let config = FleetConfig::from_file(&folder.file("fleet.toml", text)).unwrap();
    let limits = |config: &FleetConfig| {
        let velocity = config.bridge_config().velocity;
        let second = &velocity.robots[0];
        [velocity.linear_m_s, velocity.angular_rad_s, second.linear_m_s, second.angular_rad_s]
    };
    assert_eq!(limits(&config), [0.1, 1.5, 0.15, 0.5]);
    let outside = FleetConfig { world: mr_slam::config::RobotSource::Ros, ..config };
    assert_eq!(limits(&outside), [0.1, 2.84, 0.2, 0.5]);
}
