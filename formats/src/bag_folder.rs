//! Files of a bag: a file, or the folder of a rosbag2 bag, and what is no bag that is read.

use crate::recording_folder::RecordingFolder;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Largest metadata.yaml of a rosbag2 folder, bytes.
const METADATA_BYTES_MAX: u64 = 4 << 20;
/// First and last bytes of an MCAP file.
const MCAP_MAGIC: &[u8; 8] = b"\x89MCAP0\r\n";
/// Bytes that tell a format, which is the longest of those that are known.
const FIRST_BYTES: u64 = 16;
/// Most files of a bag.
const FILES_MAX: usize = 10_000;

/// Reason why a folder or a file is no bag that is read.
#[derive(Debug, Error)]
pub enum BagFilesError {
    /// A folder is no bag.
    #[error(
        "{} is a folder; expected a rosbag2 bag with its metadata.yaml (`ros2 bag reindex` writes it), or names of .mcap files: {source}",
        path.display()
    )]
    Folder {
        /// Path of the folder.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// A bag without messages.
    #[error("{}: the recording holds no messages{}", path.display(), because(.ended))]
    Empty {
        /// Path of the folder.
        path: PathBuf,
        /// Why it ended, if the recorder says so.
        ended: Option<String>,
    },
    /// A bag of a kind that is not read.
    #[error(
        "{} is {what}, which is not supported; expected MCAP, uncompressed or with compressed chunks: convert it with \
         `ros2 bag convert` to storage_id mcap without compression_mode, or with `rosbags-convert`",
        path.display()
    )]
    Format {
        /// Path of the file or folder.
        path: PathBuf,
        /// What it is.
        what: String,
    },
}

fn because(ended: &Option<String>) -> String {
    ended.as_ref().map_or_else(String::new, |why| format!("; it ended because {why}"))
}

/// Returns the files of a log in order: those of a folder that `recording.json` of a fleet's recorder names, else those that its
/// metadata.yaml lists, or the file itself.
pub fn files_of(path: &Path) -> Result<Vec<PathBuf>, BagFilesError> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    match RecordingFolder::read(path) {
        Some(recording) if !recording.files.is_empty() => Ok(recording.files),
        Some(recording) if unlisted(path, &[]).iter().all(|name| is_empty(&path.join(name))) => {
            Err(BagFilesError::Empty { path: path.to_owned(), ended: recording.ended })
        }
        _ => listed_files(path),
    }
}

fn is_empty(file: &Path) -> bool {
    file.metadata().is_ok_and(|about| about.len() == 0)
}

/// Returns the files that the metadata.yaml of a folder lists, in order.
fn listed_files(path: &Path) -> Result<Vec<PathBuf>, BagFilesError> {
    let metadata = path.join("metadata.yaml");
    let text = crate::limited::read_text(&metadata, METADATA_BYTES_MAX)
        .map_err(|source| BagFilesError::Folder { path: path.to_owned(), source })?;
    let unsupported = |what: String| BagFilesError::Format { path: path.to_owned(), what };
    let value = |key: &str| text.lines().find_map(|line| Some(unquoted(line.trim().strip_prefix(key)?)));
    if let Some(storage) = value("storage_identifier:").filter(|storage| *storage != "mcap") {
        return Err(unsupported(format!("a rosbag2 bag with the storage `{storage}`")));
    }
    if let Some(mode) =
        value("compression_mode:").filter(|mode| !["", "none"].contains(&&*mode.to_lowercase()))
    {
        return Err(unsupported(format!("a rosbag2 bag with the compression_mode {mode}")));
    }
    if text.lines().any(|line| line.trim() == "relative_file_paths: []") {
        return Err(BagFilesError::Empty { path: path.to_owned(), ended: None });
    }
    let listed = text.lines().skip_while(|line| line.trim() != "relative_file_paths:").skip(1);
    let names = listed.map_while(|line| line.trim().strip_prefix("- ")).map(unquoted);
    // Older bags have the folder's name before the file's; nothing outside the folder is read.
    let files: Vec<PathBuf> =
        names.filter_map(|name| Some(path.join(Path::new(name).file_name()?))).take(FILES_MAX).collect();
    if files.is_empty() {
        return Err(unsupported("a folder whose metadata.yaml lists no relative_file_paths".into()));
    }
    Ok(files)
}

/// Returns the names of recordings in a bag's folder that are not among the files that are read.
pub fn unlisted(folder: &Path, listed: &[PathBuf]) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().take(FILES_MAX).flatten();
    let files = entries.map(|entry| entry.path());
    let is_unlisted = |file: &PathBuf| {
        let has_other_name = listed.iter().all(|known| known.file_name() != file.file_name());
        file.extension().is_some_and(|extension| extension == "mcap") && has_other_name
    };
    let names =
        files.filter(is_unlisted).filter_map(|file| Some(file.file_name()?.to_string_lossy().into_owned()));
    let mut names: Vec<String> = names.collect();
    names.sort();
    names
}

/// Returns whether a file ends as an MCAP file with its index does, and not in the middle, where a recorder was killed.
pub fn is_whole_mcap(path: &Path) -> bool {
    let mut last = [0; MCAP_MAGIC.len()];
    let read = File::open(path).and_then(|mut file| {
        file.seek(SeekFrom::End(-(last.len() as i64)))?;
        file.read_exact(&mut last)
    });
    read.is_ok() && last == *MCAP_MAGIC
}

fn unquoted(text: &str) -> &str {
    text.trim().trim_matches(['"', '\''])
}

/// Refuses a file that is no CARMEN log by its first bytes, however long it is. One that cannot be opened, or is a pipe, is for its reader.
pub fn refuse_file_of_other_formats(path: &Path) -> Result<(), BagFilesError> {
    let mut first = Vec::new();
    if path.is_file()
        && let Ok(file) = File::open(path)
        && file.take(FIRST_BYTES).read_to_end(&mut first).is_ok()
    {
        refuse_other_formats(path, &first)?;
    }
    Ok(())
}

/// Refuses what is no CARMEN log, by its first bytes.
pub fn refuse_other_formats(path: &Path, bytes: &[u8]) -> Result<(), BagFilesError> {
    let formats: [(&[u8], &str); 4] = [
        (b"SQLite format 3\0", "a rosbag2 bag with the storage `sqlite3`"),
        (b"\x28\xb5\x2f\xfd", "a file that is compressed with zstd (unpack it with `zstd -d`)"),
        (b"#ROSBAG V2.0", "a bag of ROS 1"),
        (MCAP_MAGIC, "an MCAP file whose name does not end in .mcap (unpack it if need be, and rename it)"),
    ];
    match formats.iter().find(|(magic, _)| bytes.starts_with(magic)) {
        Some((_, what)) => Err(BagFilesError::Format { path: path.to_owned(), what: (*what).to_owned() }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder_with(metadata: &str) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("metadata.yaml"), metadata).unwrap();
        folder
    }

    #[test]
    fn the_files_of_a_folder_are_those_that_its_metadata_lists_in_order() {
        let folder = folder_with(
            "rosbag2_bagfile_information:\n  compression_mode: ''\n  relative_file_paths:\n  - \"b_1.mcap\"\n  - bag/../../a_0.mcap\n  \
             ros_distro: jazzy\n  storage_identifier: mcap\n",
        );
        let names = ["b_1.mcap", "a_0.mcap"].map(|name| folder.path().join(name));
        assert_eq!(files_of(folder.path()).unwrap(), names);
        assert_eq!(files_of(Path::new("one.mcap")).unwrap(), [Path::new("one.mcap")]);
    }

    #[test]
    fn recordings_that_the_metadata_does_not_list_are_named() {
        let folder = folder_with("  relative_file_paths:\n  - a_0.mcap\n  storage_identifier: mcap\n");
        for name in ["a_0.mcap", "a_1.mcap", "notes.txt"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let listed = files_of(folder.path()).unwrap();
        assert_eq!(unlisted(folder.path(), &listed), ["a_1.mcap"]);
    }

    #[test]
    fn a_fleets_recording_has_all_files_that_the_recorder_names() {
        let folder =
            folder_with("  relative_file_paths:\n  - recording_1.mcap\n  storage_identifier: mcap\n");
        let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
        let names = || {
            let files = files_of(folder.path()).unwrap();
            let names: Vec<_> = files.iter().map(|file| file.file_name().unwrap().to_owned()).collect();
            (names, unlisted(folder.path(), &files))
        };
        write("recording.mcap", "x");
        write("recording_1.mcap", "x");
        write("recording_2.mcap", "");
        write("other.mcap", "x");
        let metadata_alone = (
            vec!["recording_1.mcap".into()],
            ["other.mcap", "recording.mcap", "recording_2.mcap"].map(str::to_owned).to_vec(),
        );
        assert_eq!(names(), metadata_alone);
        write("recording.json", r#"{"something": "else"}"#);
        assert_eq!(names(), metadata_alone, "it is no recorder's");
        let not_read = ["other.mcap", "recording_2.mcap"].map(str::to_owned).to_vec();
        let both = (vec!["recording.mcap".into(), "recording_1.mcap".into()], not_read);
        // The folder was somewhere else then.
        let json = r#"{"files": ["/there/recording_1.mcap", "/there/recording_2.mcap"], "earlier": ["/there/recording.mcap"],
            "topics": [{"topic": "/clock", "messages": 3}], "dropped": 0, "ended": null}"#;
        write("recording.json", json);
        assert_eq!(names(), both);
        write("recording.json", r#"{"files": [], "earlier": [], "ended": "it was killed"}"#);
        assert_eq!(names(), both, "a recorder that was killed names none");
    }

    #[test]
    fn an_empty_recording_says_so_and_why() {
        let folder = folder_with("  relative_file_paths: []\n  storage_identifier: mcap\n");
        let why = || files_of(folder.path()).unwrap_err().to_string();
        assert!(why().ends_with("the recording holds no messages"), "{}", why());
        std::fs::write(folder.path().join("recording.mcap"), "").unwrap();
        let json = r#"{"files": ["x/recording.mcap"], "earlier": [], "ended": "the disk is full"}"#;
        std::fs::write(folder.path().join("recording.json"), json).unwrap();
        assert!(why().ends_with("holds no messages; it ended because the disk is full"), "{}", why());
    }

    #[test]
    fn folders_and_files_of_other_formats_say_what_they_are_and_what_to_do() {
        let other = |metadata: &str| files_of(folder_with(metadata).path()).unwrap_err().to_string();
        for (metadata, word) in [
            ("storage_identifier: sqlite3\n", "sqlite3"),
            ("compression_mode: MESSAGE\nstorage_identifier: mcap\n", "MESSAGE"),
            ("compression_mode: FILE\n", "FILE"),
            ("storage_identifier: mcap\n", "relative_file_paths"),
        ] {
            let text = other(metadata);
            assert!(text.contains(word) && text.contains("ros2 bag convert"), "{text}");
        }
        let empty = tempfile::tempdir().unwrap();
        let text = files_of(empty.path()).unwrap_err().to_string();
        assert!(text.contains("metadata.yaml"), "{text}");
        for (bytes, word) in [
            (&b"SQLite format 3\0..."[..], "sqlite3"),
            (b"\x28\xb5\x2f\xfd....", "zstd -d"),
            (b"#ROSBAG V2.0\n", "ROS 1"),
            (b"\x89MCAP0\r\n", "rename"),
        ] {
            let text = refuse_other_formats(Path::new("x"), bytes).unwrap_err().to_string();
            assert!(text.contains(word), "{text}");
        }
        assert!(refuse_other_formats(Path::new("x"), b"FLASER 3 1 2 3").is_ok());
    }

    #[test]
    fn an_mcap_file_is_whole_if_it_ends_as_it_begins() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let is_whole = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            is_whole_mcap(&path)
        };
        assert!(is_whole(b"\x89MCAP0\r\n...\x89MCAP0\r\n"));
        assert!(!is_whole(b"\x89MCAP0\r\n...") && !is_whole(b"") && !is_whole_mcap(folder.path()));
    }

    #[test]
    fn a_bag_of_any_length_is_told_by_its_first_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bag.db3");
        std::fs::write(&path, b"SQLite format 3\0").unwrap();
        // Longer than any log that is read, without its blocks.
        std::fs::OpenOptions::new().write(true).open(&path).unwrap().set_len(5 << 30).unwrap();
        let why = refuse_file_of_other_formats(&path).unwrap_err().to_string();
        assert!(why.contains("sqlite3"), "{why}");
        std::fs::write(&path, b"FLASER").unwrap();
        assert!(refuse_file_of_other_formats(&path).is_ok());
        assert!(refuse_file_of_other_formats(folder.path()).is_ok());
    }
}
