//! `config/default.toml`: every key of the configuration with its default and its explanation.
//!
//! Values come from the types' defaults, explanations from the doc comments of their fields. After a change of either,
//! `MR_SLAM_WRITE_DEFAULT_CONFIG=1 cargo test --test all default_config` writes the file anew.

use mr_slam::config::FleetConfig;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Longest line of a comment, characters.
const COMMENT_WIDTH: usize = 118;
/// First lines of the file.
const HEADING: &str = "# Default configuration: a fleet of three simulated TurtleBot3 Burgers.\n\
                       # A file needs only the keys that differ: mr-slam up --config FILE\n\
                       # Generated from the types of the configuration; see tests/all/default_config.rs.\n";

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn shipped() -> PathBuf {
    root().join("config/default.toml")
}

/// Field of a configuration's type.
struct Field {
    /// Name of its type without path.
    type_name: String,
    /// Crate of its type.
    type_crate: String,
    doc: String,
}

/// Fields of all structs, by crate, struct and field.
type Fields = BTreeMap<(String, String, String), Field>;

/// Reads the fields and doc comments of a crate's structs. Sources are formatted, so lines are enough.
fn read_fields(crate_name: &str, folder: &Path, fields: &mut Fields) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            read_fields(crate_name, &path, fields);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            read_file(crate_name, &std::fs::read_to_string(&path).unwrap(), fields);
        }
    }
}

fn read_file(crate_name: &str, text: &str, fields: &mut Fields) {
    let (mut of_struct, mut doc) = (None, String::new());
    for line in text.lines() {
        let line = line.trim();
        if let Some(comment) = line.strip_prefix("///") {
            doc += comment;
            continue;
        }
        if let Some(name) = line.strip_prefix("pub struct ").and_then(|rest| rest.strip_suffix(" {")) {
            of_struct = Some(name.to_string());
        } else if line == "}" {
            of_struct = None;
        } else if let (Some(of_struct), Some(field)) = (&of_struct, line.strip_prefix("pub "))
            && let Some((name, kind)) = field.split_once(": ")
        {
            let kind = kind.trim_end_matches(',');
            let (path, type_name) = kind.rsplit_once("::").unwrap_or((crate_name, kind));
            let type_crate = match path.split("::").next() {
                Some("crate" | "super") | None => crate_name,
                Some(other) => other,
            };
            let field =
                Field { type_name: type_name.into(), type_crate: type_crate.into(), doc: doc.trim().into() };
            fields.insert((crate_name.into(), of_struct.clone(), name.into()), field);
        }
        if !line.starts_with("#[") {
            doc.clear();
        }
    }
}

fn all_fields() -> Fields {
    let mut fields = Fields::new();
    for (name, folder) in [
        // The configuration names the modules of `runtime` and its own.
        ("config", "config/src"),
        ("runtime", "runtime/src"),
        ("sim", "sim/src"),
        ("slam", "slam/src"),
        ("merge", "merge/src"),
        ("bridge", "bridge/src"),
    ] {
        read_fields(name, &root().join(folder), &mut fields);
    }
    fields
}

/// Finds the field of a dotted key such as `slam.tracking.cell_m`.
fn find<'a>(fields: &'a Fields, key: &str) -> Option<&'a Field> {
    let (mut of_crate, mut of_struct, mut found) = ("config", "FleetConfig", None);
    for name in key.split('.') {
        let field = fields.get(&(of_crate.into(), of_struct.into(), name.into()))?;
        (of_crate, of_struct, found) = (&field.type_crate, &field.type_name, Some(field));
    }
    found
}

/// Formats a doc comment as TOML comments.
fn comment(doc: &str) -> String {
    let plain = doc.replace("[`", "`").replace("`]", "`").replace("[default: ", "(default: ");
    let (mut text, mut line) = (String::new(), String::from("#"));
    for word in plain.split_whitespace() {
        if line.chars().count() + 1 + word.chars().count() > COMMENT_WIDTH {
            text += &format!("{line}\n");
            line = "#".into();
        }
        line += &format!(" {word}");
    }
    text + &format!("{line}\n")
}

/// Writes the default configuration with the explanation of each key above it.
fn generate() -> String {
    let fields = all_fields();
    let explain = |key: &str| match find(&fields, key) {
        Some(field) if !field.doc.is_empty() => comment(&field.doc),
        _ => panic!("{key}: no doc comment found; expected one above the field of this name"),
    };
    let (mut text, mut section, mut depth) = (HEADING.to_string() + "\n", String::new(), 0_usize);
    for line in FleetConfig::default().to_toml().lines() {
        if depth == 0 {
            if let Some(name) = line.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
                section = format!("{name}.");
                text += &explain(name);
            } else if let Some((name, _)) = line.split_once(" = ") {
                text += &explain(&format!("{section}{name}"));
            }
        }
        depth = (depth + line.matches('[').count()).saturating_sub(line.matches(']').count());
        text += &format!("{line}\n");
    }
    text
}

/// All dotted keys of a table that hold values.
fn keys(table: &toml::Table, prefix: &str, found: &mut BTreeMap<String, toml::Value>) {
    for (name, value) in table {
        let key = format!("{prefix}{name}");
        match value {
            toml::Value::Table(below) => {
                found.insert(key.clone(), toml::Value::Boolean(true));
                keys(below, &format!("{key}."), found);
            }
            value => drop(found.insert(key, value.clone())),
        }
    }
}

#[test]
fn the_shipped_file_has_every_key_with_its_default() {
    let file: toml::Table = std::fs::read_to_string(shipped()).unwrap().parse().unwrap();
    let (mut shipped, mut expected) = (BTreeMap::new(), BTreeMap::new());
    keys(&file, "", &mut shipped);
    // By way of text: single precision has fewer digits there than as a table.
    keys(&FleetConfig::default().to_toml().parse().unwrap(), "", &mut expected);
    for (key, value) in &expected {
        assert_eq!(shipped.get(key), Some(value), "{key} in config/default.toml");
    }
    for key in shipped.keys() {
        assert!(expected.contains_key(key), "config/default.toml has {key}, the configuration has not");
    }
}

#[test]
fn the_shipped_file_explains_every_key_as_the_types_do() {
    let generated = generate();
    let same = toml::from_str::<FleetConfig>(&generated).unwrap();
    assert_eq!(same, FleetConfig::default());
    if std::env::var_os("MR_SLAM_WRITE_DEFAULT_CONFIG").is_some() {
        std::fs::write(shipped(), &generated).unwrap();
    }
    let text = std::fs::read_to_string(shipped()).unwrap();
    let different = generated.lines().zip(text.lines()).find(|(new, old)| new != old);
    let advice = "MR_SLAM_WRITE_DEFAULT_CONFIG=1 cargo test --test all default_config";
    assert!(generated == text, "config/default.toml is not as generated: {different:?}; run {advice}");
}
