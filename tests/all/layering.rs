//! Keeps the crates apart: which crate may import which, and what the pure crates must not use.

use crate::sources::{Source, all_files, crates, product_files, read};
use std::collections::{BTreeMap, BTreeSet};

/// The crates of the workspace that each crate may import. The binary `mr-slam` may import all.
const ARROWS: &[(&str, &[&str])] = &[
    ("msg", &[]),
    ("posegraph", &["msg"]),
    ("fft2d", &[]),
    ("sim", &["msg"]),
    ("slam", &["msg", "posegraph"]),
    ("merge", &["msg", "posegraph", "fft2d"]),
    ("telemetry", &["msg"]),
    ("nav", &["msg"]),
    ("formats", &["msg"]),
    ("ros_messages", &["msg"]),
    ("link", &["msg"]),
    ("link_transport", &["link", "formats", "ros_messages"]),
    ("bridge", &["msg", "ros_messages"]),
    ("runtime", &["msg", "formats"]),
    // Each crate has its part of the file.
    ("config", &["msg", "sim", "slam", "merge", "formats", "bridge", "runtime"]),
    ("recording", &["msg", "ros_messages"]),
    // A headset's application is a client that simulates robots.
    ("headset", &["msg", "sim", "ros_messages", "bridge", "runtime"]),
    // A report shows the bridge's clients.
    ("reports", &["msg", "formats", "bridge"]),
    // The operator is a client: it plans with `nav`, and writes and reads ros_tcp with `bridge`.
    ("operator", &["msg", "nav", "bridge"]),
    // The loops join the pure crates with channels and sockets.
    (
        "fleet",
        &[
            "msg",
            "sim",
            "slam",
            "merge",
            "telemetry",
            "nav",
            "bridge",
            "formats",
            "operator",
            "runtime",
            "config",
            "recording",
            "reports",
            "link",
            "link_transport",
            "headset",
            "ros_messages",
        ],
    ),
];

/// Crates of pure computation: the same input gives the same output.
const PURE: &[&str] = &[
    "msg",
    "posegraph",
    "fft2d",
    "sim",
    "slam",
    "merge",
    "telemetry",
    "nav",
    "ros_messages",
    "recording",
    "link",
];

/// What a pure crate must not use, because it depends on the machine or talks to the outside.
const IMPURE: &[&str] = &[
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

/// Names in a manifest's table, such as `[dependencies]`.
fn dependencies(folder: &str) -> Vec<String> {
    let manifest: toml::Table = read(&format!("{folder}/Cargo.toml")).parse().unwrap();
    let table = manifest.get("dependencies").and_then(|table| table.as_table());
    table.map(|table| table.keys().cloned().collect()).unwrap_or_default()
}

#[test]
fn crates_import_only_along_the_arrows() {
    let crates = crates();
    for (name, folder) in crates.iter().filter(|(name, _)| name != "mr-slam") {
        let arrow = ARROWS.iter().find(|(known, _)| known == name);
        let (_, allowed) = arrow.unwrap_or_else(|| panic!("add the new crate {name} to ARROWS"));
        for dependency in dependencies(folder) {
            let is_ours = crates.iter().any(|(known, _)| *known == dependency);
            assert!(
                !is_ours || allowed.contains(&dependency.as_str()),
                "{name} must not import {dependency}"
            );
        }
    }
}

#[test]
fn only_runtime_uses_shared_memory_and_only_the_bridge_uses_sockets() {
    for (name, folder) in crates().iter().filter(|(name, _)| name != "mr-slam") {
        for dependency in dependencies(folder) {
            assert!(
                name == "runtime" || !dependency.starts_with("iceoryx2"),
                "{name} must not import {dependency}"
            );
            assert!(
                ["bridge", "runtime", "fleet"].contains(&name.as_str()) || dependency != "tokio",
                "{name} must not import tokio"
            );
        }
    }
    for source in crates().iter().flat_map(|(_, folder)| product_files(folder)) {
        let owns = source.path.starts_with("runtime/src/shared_memory");
        assert!(owns || !source.text.contains("iceoryx2::"), "{} uses iceoryx2", source.path);
    }
}

#[test]
fn pure_crates_use_no_clock_file_socket_or_thread() {
    for (name, folder) in crates().iter().filter(|(name, _)| PURE.contains(&name.as_str())) {
        for source in product_files(folder) {
            for word in IMPURE {
                assert!(!source.text.contains(word), "{name} is pure, but {} uses {word}", source.path);
            }
        }
    }
}

/// Where unsafe code is, each with its reason in the file.
const UNSAFE: &[&str] = &["runtime/src/shared_memory", "runtime/src/time_slice.rs"];

#[test]
fn only_shared_memory_and_time_slices_have_unsafe_code() {
    for source in all_files().iter().filter(|source| source.path.contains("src/")) {
        let unsafe_line = source.text.lines().find(|line| {
            let code = line.split("//").next().unwrap_or("");
            code.split(|c: char| !c.is_alphanumeric() && c != '_').any(|word| word == "unsafe")
        });
        let owns = UNSAFE.iter().any(|path| source.path.starts_with(path));
        assert!(owns || unsafe_line.is_none(), "{} has unsafe code: {unsafe_line:?}", source.path);
    }
}

#[test]
fn every_file_begins_with_a_description() {
    for (_, folder) in crates() {
        for source in product_files(&folder) {
            assert!(source.text.starts_with("//!"), "{} begins without a `//!` description", source.path);
        }
    }
}

#[test]
fn slam_and_merge_never_use_the_ground_truth() {
    for folder in ["slam", "merge"] {
        for source in product_files(folder) {
            assert!(!source.text.contains("GroundTruth"), "{} uses the ground truth", source.path);
        }
    }
}

#[test]
fn modules_do_not_import_each_other_in_cycles() {
    let mut cyclic = Vec::new();
    for (name, folder) in crates() {
        let imports = imports(&product_files(&folder), &folder);
        let reached = |from: &str| {
            let (mut seen, mut open) = (BTreeSet::new(), vec![from.to_owned()]);
            while let Some(module) = open.pop() {
                let next = imports.get(&module).into_iter().flatten();
                open.extend(next.filter(|next| seen.insert((*next).clone())).cloned());
            }
            seen
        };
        cyclic.extend(
            imports.keys().filter(|module| reached(module).contains(*module)).map(|m| format!("{name}::{m}")),
        );
    }
    assert!(cyclic.is_empty(), "move what they share to where it belongs; modules in cycles: {cyclic:#?}");
}

/// The other top-level modules that each top-level module of a crate names with `crate::`.
fn imports(files: &[Source], folder: &str) -> BTreeMap<String, BTreeSet<String>> {
    let module_of = |path: &str| {
        let inside = path.trim_start_matches(folder).trim_start_matches('/').trim_start_matches("src/");
        inside.split('/').next().unwrap_or("").trim_end_matches(".rs").to_owned()
    };
    let modules: BTreeSet<String> = files.iter().map(|source| module_of(&source.path)).collect();
    let mut found: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for source in files {
        let module = module_of(&source.path);
        if ["lib", "main"].contains(&module.as_str()) {
            continue;
        }
        let product = source.text.split("\n#[cfg(test)]\n").next().unwrap_or("");
        let code: String = product.lines().filter(|line| !line.trim_start().starts_with("//")).collect();
        let named = code.split("crate::").skip(1).flat_map(first_names);
        let others = named.filter(|name| *name != module && modules.contains(name));
        found.entry(module.clone()).or_default().extend(others);
    }
    found
}

/// First path segments after `crate::`: one, or those of a list in braces.
fn first_names(after: &str) -> Vec<String> {
    let Some(list) = after.strip_prefix('{') else { return vec![first_name(after)] };
    let (mut depth, mut names) = (0, vec![first_name(list)]);
    for (at, c) in list.char_indices() {
        depth += i32::from(c == '{') - i32::from(c == '}');
        if depth < 0 {
            break;
        }
        if depth == 0 && c == ',' {
            names.push(first_name(&list[at + 1..]));
        }
    }
    names
}

fn first_name(text: &str) -> String {
    text.trim_start().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect()
}

#[test]
fn names_after_crate_are_found_in_lists_and_alone() {
    assert_eq!(first_names("run::Run;"), ["run"]);
    assert_eq!(first_names("{a::{b, c}, d, e::F};"), ["a", "d", "e"]);
}
