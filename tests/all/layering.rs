//! The house keeps its walls: who may import whom, and what the pure rooms must not know.

use std::fs;
use std::path::{Path, PathBuf};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn sources(room: &str) -> Vec<(PathBuf, String)> {
    let mut found = Vec::new();
    let mut folders = vec![root().join(room).join("src")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap_or_else(|why| panic!("{}: {why}", folder.display())) {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|ending| ending == "rs") {
                let text = fs::read_to_string(&path).unwrap();
                found.push((path, text));
            }
        }
    }
    assert!(!found.is_empty(), "{room} has no sources");
    found
}

/// The names in a manifest's `[dependencies]`.
fn dependencies(room: &str) -> Vec<String> {
    let text = fs::read_to_string(root().join(room).join("Cargo.toml")).unwrap();
    let manifest: toml::Table = text.parse().unwrap();
    let table = manifest.get("dependencies").and_then(|table| table.as_table());
    table.map(|table| table.keys().cloned().collect()).unwrap_or_default()
}

#[test]
fn rooms_import_only_to_the_right() {
    let rooms =
        ["msg", "posegraph", "sim", "slam", "merge", "telemetry", "nav", "bridge", "operator", "formats"];
    for room in rooms {
        for dependency in dependencies(room) {
            // The operator is a client: it plans with `nav` and writes and reads ros_tcp with `bridge`.
            let client = room == "operator" && ["nav", "bridge"].contains(&dependency.as_str());
            let shared = dependency == "msg" || (dependency == "posegraph" && room != "msg");
            let allowed = client || shared || !rooms.contains(&dependency.as_str());
            assert!(allowed, "{room} imports {dependency}; crates may import msg and posegraph alone");
            assert_ne!(dependency, "mr-slam", "{room} imports the shell");
        }
    }
}

#[test]
fn shared_memory_is_the_shells_and_sockets_the_bridges() {
    for room in
        ["msg", "posegraph", "sim", "slam", "merge", "telemetry", "nav", "bridge", "operator", "formats"]
    {
        for dependency in dependencies(room) {
            assert!(!dependency.starts_with("iceoryx2"), "{room} knows iceoryx2");
            assert!(room == "bridge" || dependency != "tokio", "{room} knows tokio");
        }
    }
    for (path, text) in sources(".") {
        let folder = path.parent().is_some_and(|folder| folder.ends_with("shared_memory"));
        let owns = path.ends_with("shared_memory.rs") || folder;
        assert!(owns || !text.contains("iceoryx2::"), "{} uses iceoryx2", path.display());
    }
}

#[test]
fn pure_rooms_know_no_clock_file_socket_or_thread() {
    let banned = [
        "std::fs",
        "std::net",
        "std::thread",
        "std::process",
        "std::env",
        "Instant::now",
        "SystemTime",
        "println!",
        "eprintln!",
    ];
    for room in ["msg", "posegraph", "sim", "slam", "merge", "telemetry", "nav"] {
        for (path, text) in sources(room) {
            for word in banned {
                assert!(!text.contains(word), "{} knows {word}", path.display());
            }
        }
    }
}

#[test]
fn unsafe_lives_in_one_file() {
    for room in
        [".", "msg", "posegraph", "sim", "slam", "merge", "telemetry", "nav", "bridge", "operator", "formats"]
    {
        for (path, text) in sources(room) {
            let found = text.lines().any(|line| {
                let code = line.split("//").next().unwrap_or("");
                code.split(|c: char| !c.is_alphanumeric() && c != '_').any(|word| word == "unsafe")
            });
            assert!(!found || path.ends_with("shared_memory.rs"), "{} has unsafe code", path.display());
        }
    }
}

#[test]
fn every_file_says_what_it_is() {
    for room in
        [".", "msg", "posegraph", "sim", "slam", "merge", "telemetry", "nav", "bridge", "operator", "formats"]
    {
        for (path, text) in sources(room) {
            let tests =
                path.components().any(|part| part.as_os_str() == "tests.rs" || part.as_os_str() == "tests");
            assert!(
                tests || text.starts_with("//!"),
                "{} begins without a word about itself",
                path.display()
            );
        }
    }
}

#[test]
fn slam_and_merge_never_see_the_truth() {
    for room in ["slam", "merge"] {
        for (path, text) in sources(room) {
            assert!(!text.contains("GroundTruth"), "{} mentions the truth", path.display());
        }
    }
}
