//! Reads the workspace's own Rust files for the tests about its structure.
//!
//! The files are formatted by rustfmt, which puts the closing brace of an item on a line of its own with the
//! item's indentation. A scan by lines is therefore enough, and no parser is needed.

use std::fs;
use std::path::{Path, PathBuf};

/// One Rust file of the workspace.
pub struct Source {
    /// Path from the workspace's root, with forward slashes.
    pub path: String,
    pub text: String,
}

/// A function, struct, enum or other item with a body in braces.
pub struct Item<'a> {
    pub name: &'a str,
    /// Comment and attribute lines directly above the item.
    pub above: Vec<&'a str>,
    /// Lines from the item's first to its closing brace.
    pub lines: Vec<&'a str>,
}

pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Names of the workspace's crates with their folders; the binary's crate is `mr-slam` in `.`.
pub fn crates() -> Vec<(String, String)> {
    let manifest = fs::read_to_string(root().join("Cargo.toml")).unwrap();
    let start = manifest.find("members = [").expect("Cargo.toml lists the members of the workspace");
    let list = &manifest[start..];
    let list = &list[..list.find(']').unwrap()];
    let members = list.split('"').skip(1).step_by(2).filter(|member| *member != ".");
    let mut found: Vec<(String, String)> = members.map(|name| (name.into(), name.into())).collect();
    found.push(("mr-slam".into(), ".".into()));
    found
}

/// All Rust files below a folder of the workspace, without build output.
pub fn files_below(folder: &str) -> Vec<Source> {
    let read = |path: PathBuf| Source { path: name_of(&path), text: fs::read_to_string(&path).unwrap() };
    paths_below(folder, "rs").into_iter().map(read).collect()
}

/// All Markdown files of the workspace, as paths from its root.
pub fn markdown_files() -> Vec<String> {
    paths_below(".", "md").iter().map(|path| name_of(path)).collect()
}

/// All files with an ending below a folder of the workspace, sorted, without build output and hidden folders.
fn paths_below(folder: &str, ending: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![root().join(folder)];
    while let Some(folder) = folders.pop() {
        let Ok(entries) = fs::read_dir(&folder) else { continue };
        for path in entries.map(|entry| entry.unwrap().path()) {
            let hidden = path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
            if path.is_dir() && !hidden && !path.ends_with("target") {
                folders.push(path);
            } else if path.extension().is_some_and(|found| found == ending) {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

/// The Rust files of a crate's product code: its `src` folder without files of tests.
pub fn product_files(folder: &str) -> Vec<Source> {
    let mut found = files_below(&format!("{folder}/src"));
    found.retain(|source| !is_test_file(&source.path));
    assert!(!found.is_empty(), "{folder}/src has no Rust files");
    found
}

/// All Rust files of the workspace: product code, tests, benches and examples.
pub fn all_files() -> Vec<Source> {
    files_below(".")
}

fn name_of(path: &Path) -> String {
    path.strip_prefix(root()).unwrap().to_string_lossy().trim_start_matches("./").replace('\\', "/")
}

fn is_test_file(path: &str) -> bool {
    path.split('/').any(|part| part == "tests" || part == "tests.rs" || part.ends_with("_tests.rs"))
}

impl Source {
    /// Lines of product code: without blank lines, comments and a module of tests at the end.
    pub fn code_lines(&self) -> usize {
        let product = self.text.split("\n#[cfg(test)]\nmod tests {").next().unwrap_or("");
        product.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with("//")).count()
    }

    /// Items whose first line contains one of `keywords`, such as `fn ` or `struct `.
    pub fn items(&self, keywords: &[&str]) -> Vec<Item<'_>> {
        let lines: Vec<&str> = self.text.lines().collect();
        let mut found = Vec::new();
        for (number, line) in lines.iter().enumerate() {
            let Some(name) = keywords.iter().find_map(|keyword| declared(line, keyword)) else { continue };
            let indent = &line[..line.len() - line.trim_start().len()];
            let (closing, end) = (format!("{indent}}}"), format!("{indent}) -> "));
            let length = lines[number..]
                .iter()
                .enumerate()
                .position(|(offset, line)| {
                    let code = line.trim_end();
                    *line == closing
                        || (offset == 0 && (code.ends_with('}') || code.ends_with(';')))
                        || (offset > 0 && code.ends_with(';') && code.starts_with(&end))
                })
                .map_or(1, |offset| offset + 1);
            let above = lines[..number].iter().rev().copied();
            let above = above.take_while(|line| {
                let line = line.trim_start();
                line.starts_with("//") || line.starts_with("#[")
            });
            found.push(Item { name, above: above.collect(), lines: lines[number..number + length].to_vec() });
        }
        found
    }
}

/// The name that a line declares with `keyword`, if it does.
fn declared<'a>(line: &'a str, keyword: &str) -> Option<&'a str> {
    let mut code = line.trim_start();
    if code.starts_with("pub(") {
        code = code.split_once(") ")?.1;
    }
    for modifier in ["pub ", "const ", "async ", "unsafe ", "extern \"C\" "] {
        code = code.strip_prefix(modifier).unwrap_or(code);
    }
    let name = code.strip_prefix(keyword)?;
    let end = name.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(name.len());
    Some(&name[..end]).filter(|name| !name.is_empty())
}

/// A file of the workspace that is no Rust file, such as `docs/GLOSSARY.md`.
pub fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

#[test]
fn items_are_found_with_their_length_and_comments() {
    let text = "/// Adds.\n// Why.\npub(crate) const fn add(\n    a: u8,\n) -> u8 {\n    a\n}\n\ntrait T {\n    fn one(&self);\n    fn two() {}\n}\n";
    let source = Source { path: "x.rs".into(), text: text.into() };
    let lengths: Vec<(&str, usize, usize)> =
        source.items(&["fn "]).iter().map(|item| (item.name, item.lines.len(), item.above.len())).collect();
    assert_eq!(lengths, [("add", 5, 2), ("one", 1, 0), ("two", 1, 0)]);
    assert_eq!(source.items(&["trait "])[0].lines.len(), 4);
}
