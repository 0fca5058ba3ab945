//! The ROS 2 package: its RViz configuration, Foxglove layout, launch file and manifest fit the program.

use super::harness::mr_slam;
use bridge::OUTGOING_TOPICS;
use mr_slam::config::FleetConfig;
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Robots whose topics the configurations show.
const ROBOTS: [&str; 3] = ["/robot1/", "/robot2/", "/robot3/"];

fn package() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("packaging/ros2/mr_slam")
}

fn read(name: &str) -> String {
    let path = package().join(name);
    std::fs::read_to_string(&path).unwrap_or_else(|why| panic!("{}: {why}", path.display()))
}

/// Returns the topics that ROS nodes may publish to the fleet, from the table of documented inputs.
///
/// Another test compares that table with the bridge.
fn documented_inputs() -> BTreeSet<String> {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/headset.md");
    let page = std::fs::read_to_string(page).unwrap();
    let rows = page.lines().skip_while(|line| *line != "In:").skip(1).skip_while(|line| line.is_empty());
    let rows = rows.take_while(|line| line.starts_with('|'));
    let names = rows.flat_map(|row| row.split('`').filter(|part| part.starts_with('/')));
    // A PoseStamped on it goes to all, and to the selected robot.
    names.map(str::to_owned).chain(["/goal_pose".to_owned()]).collect()
}

/// Panics if the fleet neither publishes a topic in ROS 2 nor listens to it.
fn check_topic(name: &str, inputs: &BTreeSet<String>, file: &str) {
    let of_robot = ROBOTS.iter().find_map(|prefix| name.strip_prefix(prefix));
    let row_name = of_robot.map_or(name.to_owned(), |rest| format!("/robotN/{rest}"));
    let is_published = OUTGOING_TOPICS.iter().any(|row| row.dds.is_some() && row.name == row_name);
    assert!(is_published || inputs.contains(&row_name), "{file} names {name}, which the fleet does not have");
}

#[test]
fn rviz_shows_topics_that_the_fleet_has() {
    let (text, inputs) = (read("rviz/mr_slam.rviz"), documented_inputs());
    let topics: Vec<_> = text.lines().filter_map(|line| line.trim().strip_prefix("Value: /")).collect();
    assert!(topics.len() >= 12, "expected four topics for each robot, found {topics:?}");
    for name in topics {
        check_topic(&format!("/{name}"), &inputs, "mr_slam.rviz");
    }
    assert!(text.contains("Fixed Frame: map\n"));
}

/// Collects every string and every key that begins like a topic.
fn topics_of(value: &Value, found: &mut BTreeSet<String>) {
    let mut add = |text: &str| {
        if text.starts_with('/') {
            // A path into a message begins with the topic.
            found.insert(text.split('.').next().unwrap_or(text).to_owned());
        }
    };
    match value {
        Value::String(text) => add(text),
        Value::Array(items) => items.iter().for_each(|item| topics_of(item, found)),
        Value::Object(fields) => {
            fields.keys().for_each(|key| add(key));
            fields.values().for_each(|item| topics_of(item, found));
        }
        _ => {}
    }
}

/// Collects the panels that a layout shows.
fn panels_of(layout: &Value, found: &mut BTreeSet<String>) {
    match layout {
        Value::String(panel) => drop(found.insert(panel.clone())),
        _ => ["first", "second"].iter().for_each(|side| panels_of(&layout[side], found)),
    }
}

#[test]
fn foxglove_shows_topics_that_the_fleet_has() {
    let layout: Value = serde_json::from_str(&read("foxglove/mr_slam.json")).unwrap();
    let (mut topics, inputs) = (BTreeSet::new(), documented_inputs());
    topics_of(&layout["configById"], &mut topics);
    assert!(topics.len() >= 12, "expected four topics for each robot, found {topics:?}");
    for name in &topics {
        check_topic(name, &inputs, "mr_slam.json");
    }
    let mut panels = BTreeSet::new();
    panels_of(&layout["layout"], &mut panels);
    let configured: BTreeSet<_> = layout["configById"].as_object().unwrap().keys().cloned().collect();
    assert_eq!(panels, configured, "panels of the layout, and panels with a configuration");
}

#[test]
fn the_launch_file_gives_options_that_the_program_has() {
    let launch = read("launch/mr_slam.launch.py");
    let options: BTreeSet<_> = launch.split('\'').filter(|part| part.starts_with("--")).collect();
    assert!(options.len() >= 6, "{options:?}");
    let help = |mode: &str| {
        let output = mr_slam().args([mode, "--help"]).output().unwrap();
        String::from_utf8(output.stdout).unwrap()
    };
    let help = ["up", "robot", "base"].map(help).concat();
    for option in options {
        assert!(help.contains(&format!("{option} ")) || help.contains(&format!("{option}\n")), "{option}");
    }
}

#[test]
fn the_packages_fleet_file_is_valid_and_its_manifest_has_the_programs_version() {
    let config = FleetConfig::from_file(&package().join("config/twist_stamped.toml")).unwrap();
    assert_eq!(format!("{:?}", config.bridge.dds.velocity), "TwistStamped");
    let manifest = read("package.xml");
    assert!(manifest.contains(&format!("<version>{}</version>", env!("CARGO_PKG_VERSION"))));
    let cmake = read("CMakeLists.txt");
    let installed = cmake.split("install(DIRECTORY ").nth(1).unwrap().split(" DESTINATION").next().unwrap();
    let installed: BTreeSet<_> = installed.split(' ').map(str::to_owned).collect();
    let folders = std::fs::read_dir(package()).unwrap().flatten().filter(|entry| entry.path().is_dir());
    let folders = folders.map(|entry| entry.file_name().into_string().unwrap()).collect();
    assert_eq!(installed, folders, "folders that CMakeLists.txt installs, and folders of the package");
}
