//! A fleet file that is wrong is refused with the file, the line and the reason.

use crate::harness::{Folder, output};

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
    refused("[fleet]\n\nrobots = \"three\"\n", 3, &["three"]);
    refused("[fleet\n", 1, &[]);
}

#[test]
fn values_out_of_range_are_refused() {
    refused("[fleet]\nseed = 1\nrobots = 17\n", 3, &["17", "16"]);
    refused("[fleet]\nrobots = 0\n", 2, &["1 to 64"]);
    refused("[fleet]\nrobots = 2\nstarts = [[0.0, 0.0, 0.0]]\n", 3, &["1 poses for 2"]);
    refused("[fleet]\nrobots = 1\nstarts = [[nan, 0.0, 0.0]]\n", 3, &["finite"]);
    refused("[fleet]\naddress = \"everywhere\"\n", 2, &["everywhere"]);
}

#[test]
fn missing_or_invalid_room_files_are_refused() {
    let folder = Folder::new();
    let text = folder.file("room.obj", "v 1 2 nan\n");
    for (room, word) in [("/nowhere/room.glb", "/nowhere/room.glb"), (text.to_str().unwrap(), "room.obj")] {
        let up = output(&["up", "--port", "0", "--room", room]);
        assert!(!up.status.success());
        let said = String::from_utf8_lossy(&up.stderr).into_owned();
        assert!(said.contains(word), "{said}");
    }
}

#[test]
fn the_written_default_equals_the_built_in_default() {
    let config = mr_slam::config::FleetConfig::default();
    let folder = Folder::new();
    let file = folder.file("fleet.toml", config.to_toml());
    assert_eq!(mr_slam::config::FleetConfig::from_file(&file).unwrap(), config);
    let shipped = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("config/default.toml");
    assert_eq!(mr_slam::config::FleetConfig::from_file(&shipped).unwrap(), config);
}

#[test]
fn missing_keys_have_their_default() {
    let folder = Folder::new();
    let file = folder.file("fleet.toml", "[slam.tracking]\nreferences = 5\n");
    let config = mr_slam::config::FleetConfig::from_file(&file).unwrap();
    let mut expected = mr_slam::config::FleetConfig::default();
    expected.slam.tracking.references = 5;
    assert_eq!(config, expected);
}
