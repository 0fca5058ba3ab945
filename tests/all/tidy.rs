//! Keeps the sizes of files, functions and types, the docs and the errors as CONTRIBUTING asks for them.
//!
//! A limit may be tightened at any time. An exception is listed below with its reason.

use crate::sources::{Source, all_files, crates, product_files};

/// Most lines of a file.
const FILE_LINES_MAX: usize = 400;
/// Most lines of a function, from its first line to its closing brace.
const FUNCTION_LINES_MAX: usize = 60;
/// Most fields of a struct. A struct with more has a comment above it that starts with [`MANY_FIELDS`].
const FIELDS_MAX: usize = 12;
/// Start of the comment that gives the reason for more than [`FIELDS_MAX`] fields.
const MANY_FIELDS: &str = "// More than 12 fields:";
/// Largest share of one crate in the lines of product code, percent.
const CRATE_SHARE_MAX_PERCENT: f64 = 25.0;
/// Number of functions of product code that return a bare `Result<_, String>`. It must not grow.
const STRING_ERRORS_MAX: usize = 1;

/// Files that may have over [`FILE_LINES_MAX`] lines: path and reason.
const LONG_FILES: &[(&str, &str)] =
    &[("benches/slam/drive.rs", "a bench that drives one log through all stages")];

/// Functions that may have over [`FUNCTION_LINES_MAX`] lines: path, name and reason.
const LONG_FUNCTIONS: &[(&str, &str, &str)] = &[
    ("benches/slam/main.rs", "main", "the subcommands of a bench, in one match"),
    ("bridge/benches/ros_tcp/mix.rs", "mix", "one workload, written in the order of its steps"),
];

#[test]
fn files_have_at_most_400_lines() {
    let long = |source: &&Source| source.text.lines().count() > FILE_LINES_MAX;
    let found: Vec<String> = all_files().iter().filter(long).map(|source| source.path.clone()).collect();
    let excepted = |path: &str| LONG_FILES.iter().any(|(known, _)| *known == path);
    let new: Vec<&String> = found.iter().filter(|path| !excepted(path)).collect();
    assert!(new.is_empty(), "over {FILE_LINES_MAX} lines, split them: {new:#?}");
}

#[test]
fn functions_have_at_most_60_lines() {
    let mut found = Vec::new();
    for source in all_files() {
        for item in source.items(&["fn "]) {
            if item.lines.len() > FUNCTION_LINES_MAX {
                found.push((source.path.clone(), item.name.to_owned(), item.lines.len()));
            }
        }
    }
    let excepted = |path: &str, name: &str| LONG_FUNCTIONS.iter().any(|(p, n, _)| *p == path && *n == name);
    let new: Vec<_> = found.iter().filter(|(path, name, _)| !excepted(path, name)).collect();
    assert!(new.is_empty(), "over {FUNCTION_LINES_MAX} lines, split them: {new:#?}");
}

#[test]
fn structs_have_at_most_12_fields_or_a_reason_beside_them() {
    let mut found = Vec::new();
    for (_, folder) in crates() {
        for source in product_files(&folder) {
            for item in source.items(&["struct "]) {
                let explained = item.above.iter().any(|line| line.trim_start().starts_with(MANY_FIELDS));
                if fields(&item.lines) > FIELDS_MAX && !explained {
                    found.push(format!("{}: {}", source.path, item.name));
                }
            }
        }
    }
    let few = found.is_empty();
    assert!(few, "over {FIELDS_MAX} fields: split them, or say why in `{MANY_FIELDS} ...`: {found:#?}");
}

/// Counts the fields in the lines of a struct.
fn fields(lines: &[&str]) -> usize {
    let indent = lines.last().map_or(0, |line| line.len() - line.trim_start().len()) + 4;
    let is_field = |line: &&&str| {
        let code = line.trim_start();
        let code =
            if code.starts_with("pub(") { code.split_once(") ").map_or("", |parts| parts.1) } else { code };
        let name = code.strip_prefix("pub ").unwrap_or(code).split(':').next().unwrap_or("");
        line.len() - line.trim_start().len() == indent
            && code.contains(": ")
            && !name.is_empty()
            && name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_')
    };
    lines.iter().skip(1).filter(is_field).count()
}

#[test]
fn docs_have_more_than_two_words() {
    let mut short = Vec::new();
    for (_, folder) in crates() {
        for source in product_files(&folder) {
            let lines: Vec<&str> = source.text.lines().map(str::trim_start).collect();
            for doc in lines.chunk_by(|a, b| a.starts_with("///") == b.starts_with("///")) {
                if doc[0].starts_with("///") {
                    let words = doc.iter().flat_map(|line| line[3..].split_whitespace()).count();
                    if words <= 2 {
                        short.push(format!("{}: {}", source.path, doc.join(" ")));
                    }
                }
            }
        }
    }
    assert!(short.is_empty(), "docs of one or two words: {short:#?}");
}

#[test]
fn no_crate_holds_more_than_its_share_of_the_product_code() {
    let sizes: Vec<(String, usize)> = crates()
        .into_iter()
        .map(|(name, folder)| (name, product_files(&folder).iter().map(Source::code_lines).sum()))
        .collect();
    let total: usize = sizes.iter().map(|(_, lines)| lines).sum();
    for (name, lines) in &sizes {
        let percent = 100.0 * *lines as f64 / total as f64;
        let is_small = percent <= CRATE_SHARE_MAX_PERCENT;
        assert!(is_small, "{name} has {percent:.1} % of {total} lines: {sizes:?}");
    }
}

#[test]
fn messages_to_people_have_no_debug_output() {
    let begins = ["tracing::warn!(", "tracing::error!(", "tracing::info!(", "note(&format!(", "#[error("];
    // Errors of iceoryx2 have no other text, and lists of numbers read the same.
    let plain = [
        "{id:?} stays: {why:?}",
        "is {start:?}; expected [x, y, yaw]",
        "{robot} at {pose:?}; expected [x m, y m, yaw rad]",
        "the position {position:?} and the rotation {rotation:?}",
        "its rotation {rotation_xyzw:?} is not a unit quaternion",
        "Transform.Scale is {0:?}; only [1, 1, 1]",
        "points to {normal:?} (x, y up, z)",
    ];
    let mut found = Vec::new();
    for (_, folder) in crates() {
        for source in product_files(&folder) {
            let lines: Vec<&str> = source.text.lines().collect();
            for (at, _) in
                lines.iter().enumerate().filter(|(_, line)| begins.iter().any(|b| line.contains(b)))
            {
                // To the end of the statement or attribute, of a few lines.
                let end = lines[at..].iter().take(8).position(|line| line.ends_with([';', ']', ',']));
                let mut text = lines[at..=at + end.unwrap_or(0)].join("\n");
                plain.iter().for_each(|known| text = text.replace(known, ""));
                if text.contains(":?}") {
                    found.push((source.path.clone(), text));
                }
            }
        }
    }
    assert!(found.is_empty(), "write these for people: {found:#?}");
}

#[test]
fn bare_string_errors_do_not_grow() {
    let mut found = Vec::new();
    for (_, folder) in crates() {
        for source in product_files(&folder) {
            let product = source.text.split("\n#[cfg(test)]\nmod tests {").next().unwrap_or("");
            let lines = product.lines().filter(|line| {
                line.split_once("-> Result<").is_some_and(|(_, result)| result.contains(", String>"))
            });
            found.extend(lines.map(|line| format!("{}: {}", source.path, line.trim())));
        }
    }
    let count = found.len();
    assert!(
        count <= STRING_ERRORS_MAX,
        "{count} functions return Result<_, String>, use a typed error: {found:#?}"
    );
}
