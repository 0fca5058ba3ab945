//! Finds results that would replace what they are made of.

use std::path::{Path, PathBuf};

/// Entries of a folder that are compared: a recording has fewer parts.
const ENTRIES_MAX: usize = 10_000;

/// Returns the first of the `outputs` that is one of the `inputs`, however both are written. What is in an input folder is an
/// input, too. Files that do not exist yet replace nothing.
pub fn replaced_input(outputs: &[PathBuf], inputs: &[PathBuf]) -> Option<PathBuf> {
    let canonical = |path: &Path| std::fs::canonicalize(path).ok().filter(|path| path.is_file());
    let mut read: Vec<PathBuf> = inputs.iter().filter_map(|path| canonical(path)).collect();
    for folder in inputs.iter().filter(|path| path.is_dir()) {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().take(ENTRIES_MAX);
        read.extend(entries.filter_map(|entry| canonical(&entry.path())));
    }
    outputs.iter().find(|path| canonical(path).is_some_and(|path| read.contains(&path))).cloned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_input_is_found_through_links_folders_and_other_spellings() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::fs::create_dir(path("bag")).unwrap();
        for name in ["a.yaml", "other.yaml", "bag/part.mcap"] {
            std::fs::write(path(name), "x").unwrap();
        }
        std::os::unix::fs::symlink(path("a.yaml"), path("link.yaml")).unwrap();
        let inputs = [path("a.yaml"), path("bag"), path("missing.yaml")];
        for name in ["a.yaml", "bag/../a.yaml", "link.yaml", "bag/part.mcap"] {
            assert_eq!(replaced_input(&[path("new"), path(name)], &inputs), Some(path(name)), "{name}");
        }
        for name in ["other.yaml", "missing.yaml", "bag/new.mcap", "bag"] {
            assert_eq!(replaced_input(&[path(name)], &inputs), None, "{name}");
        }
    }
}
