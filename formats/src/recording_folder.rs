//! What `recording.json` says of the folder of a fleet's recording: its files, and why it ended.

use serde::Deserialize;
use std::path::{Path, PathBuf};

/// Name of the file.
pub const RECORDING_JSON: &str = "recording.json";
/// Largest such file, bytes: it counts the messages of each topic.
const BYTES_MAX: u64 = 4 << 20;
/// Most files of a recording.
const FILES_MAX: usize = 10_000;

/// The part of the file by which a recording is read.
#[derive(Debug, Deserialize)]
struct Content {
    files: Vec<PathBuf>,
    earlier: Vec<PathBuf>,
    ended: Option<String>,
}

/// Files of a recording, and why it ended.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RecordingFolder {
    /// Files that are not empty, in the order of their messages: those of recorders that were killed come first.
    pub files: Vec<PathBuf>,
    /// Why the recording ended before the fleet; `None`: it did not.
    pub ended: Option<String>,
}

impl RecordingFolder {
    /// Reads the file of a folder; `None`: there is none of a fleet's recording. A recorder that was killed has named no files: then they
    /// are those with its names.
    pub fn read(folder: &Path) -> Option<Self> {
        let text = crate::limited::read_text(&folder.join(RECORDING_JSON), BYTES_MAX).ok()?;
        // JSON is YAML.
        let Content { files, earlier, ended } = serde_saphyr::from_str(&text).ok()?;
        // The folder may have been moved, and nothing outside of it is read.
        let in_folder = |file: &PathBuf| Some(folder.join(file.file_name()?));
        let mut named: Vec<PathBuf> =
            earlier.iter().chain(&files).take(FILES_MAX).filter_map(in_folder).collect();
        if named.is_empty() {
            let name = |number: usize| match number {
                0 => folder.join("recording.mcap"),
                _ => folder.join(format!("recording_{number}.mcap")),
            };
            named = (0..FILES_MAX).map(name).take_while(|file| file.exists()).collect();
        }
        named.retain(|file| file.metadata().is_ok_and(|about| about.len() > 0));
        Some(Self { files: named, ended })
    }
}
