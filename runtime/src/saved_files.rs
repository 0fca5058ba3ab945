//! Files that clients save and load by name: a folder of their own in the run's folder, so that no name is that of a run's own file.
//!
//! A name that a client gives is relative and gets the ending of its kind, whatever it ends with. The command line gives absolute paths.

use crate::storage::{FileCount, Storage};
use msg::{FileNameError, check_file_name, check_relative_file_name};
use std::io;
use std::path::{Path, PathBuf};

/// Name of the folder in a run's folder.
pub const FOLDER: &str = "saved";
/// Most files in that folder: a session and the three files of a map, four times for each of 64 robots. Clients may save again and again.
pub const FILES_MAX: usize = 1024;
/// Most bytes in that folder before a file is added: 4 GiB, hundreds of sessions of a large building.
pub const BYTES_MAX: u64 = 4 << 30;
/// Ending of a session file.
const SESSION_ENDING: &str = "slam";
/// Endings of the files that can be loaded: sessions and maps.
const LOADED_ENDINGS: [&str; 3] = [SESSION_ENDING, "yaml", "yml"];

/// Returns the path to save a session at: `saved/NAME.slam` below the run's folder, or the absolute path with that ending.
///
/// # Errors
/// The name is no file's, or leads out of the folder.
pub fn session_to_save(run_folder: &Path, name: &str) -> Result<PathBuf, FileNameError> {
    Ok(with_ending(path_to_save(run_folder, name)?, &[SESSION_ENDING]))
}

/// Returns the path of a map to save, without the endings that its files get: `saved/NAME` below the run's folder, or the absolute path.
///
/// # Errors
/// The name is no file's, or leads out of the folder.
pub fn map_to_save(run_folder: &Path, name: &str) -> Result<PathBuf, FileNameError> {
    Ok(formats::map_file::stem(&path_to_save(run_folder, name)?))
}

/// Returns the paths at which a session or a map may be, in the order in which they are looked at.
///
/// Of a relative name these are below `saved/` in the run's folder, then below the run's folder itself, as `sessions/robot1`. At both
/// the name with the ending of a session comes before the name as it is, unless it has the ending of a session or of a map.
///
/// # Errors
/// The name is no file's, or leads out of the folder.
pub fn files_to_load(run_folder: &Path, name: &str) -> Result<Vec<PathBuf>, FileNameError> {
    let saved = path_to_save(run_folder, name)?;
    let bases = if is_absolute(name) { vec![saved] } else { vec![saved, run_folder.join(name)] };
    let mut files: Vec<PathBuf> =
        bases.into_iter().flat_map(|base| [with_ending(base.clone(), &LOADED_ENDINGS), base]).collect();
    files.dedup();
    Ok(files)
}

/// Reason why the folder takes no more files.
#[derive(Debug, thiserror::Error)]
pub enum SavedFilesError {
    /// The folder has the most files or bytes that it may have.
    #[error(
        "{}: has {files} files of {bytes} bytes in all, and at most {FILES_MAX} files and {BYTES_MAX} bytes may be saved there; \
         remove some", folder.display()
    )]
    Full {
        /// The folder of saved files.
        folder: PathBuf,
        /// Number of its files; it is not counted further than the limit.
        files: usize,
        /// Sum of their lengths, bytes.
        bytes: u64,
    },
    /// The folder cannot be read.
    #[error("{}: {source}", folder.display())]
    Read {
        /// The folder of saved files.
        folder: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
}

/// Checks that the folder of saved files of a run has room for files at `path`. Files elsewhere, which only the command line names, need
/// none.
///
/// # Errors
/// The folder is full, or cannot be read.
pub fn check_room(storage: &impl Storage, run_folder: &Path, path: &Path) -> Result<(), SavedFilesError> {
    let folder = run_folder.join(FOLDER);
    if !path.starts_with(&folder) {
        return Ok(());
    }
    match storage.count_files(&folder, FILES_MAX) {
        Ok(FileCount { files, bytes }) if files >= FILES_MAX || bytes >= BYTES_MAX => {
            Err(SavedFilesError::Full { folder, files, bytes })
        }
        Ok(_) => Ok(()),
        Err(source) => Err(SavedFilesError::Read { folder, source }),
    }
}

fn is_absolute(name: &str) -> bool {
    Path::new(name).is_absolute()
}

fn path_to_save(run_folder: &Path, name: &str) -> Result<PathBuf, FileNameError> {
    if is_absolute(name) {
        check_file_name(name)?;
        return Ok(name.into());
    }
    check_relative_file_name(name)?;
    Ok(run_folder.join(FOLDER).join(name))
}

/// Appends the ending of a session to a path that has none of these endings. Other points belong to the name, as in `map.v2`.
fn with_ending(path: PathBuf, endings: &[&str]) -> PathBuf {
    let has_ending = path.extension().is_some_and(|of_path| endings.iter().any(|ending| of_path == *ending));
    if has_ending {
        return path;
    }
    let mut path = path.into_os_string();
    path.push(".");
    path.push(SESSION_ENDING);
    path.into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::storage::DiskStorage;

    fn session(name: &str) -> String {
        session_to_save(Path::new("/run"), name).unwrap().display().to_string()
    }

    #[test]
    fn a_folder_that_is_full_takes_no_more_and_says_so() {
        let run = tempfile::tempdir().unwrap();
        let check = |path: PathBuf| check_room(&DiskStorage, run.path(), &path);
        let saved = run.path().join(FOLDER);
        for number in 0..FILES_MAX - 1 {
            DiskStorage.replace(&saved.join(format!("{}/{number}.slam", number % 7)), b"").unwrap();
        }
        // Its folders count, too: a client makes one with each name.
        std::fs::remove_dir_all(saved.join("6")).unwrap();
        check(saved.join("one-more.slam")).unwrap();
        for number in 0..FILES_MAX / 4 {
            DiskStorage.replace(&saved.join(format!("{number}.slam")), b"").unwrap();
        }
        let why = check(saved.join("one-more.slam")).unwrap_err().to_string();
        assert!(why.contains("has 1024 files") && why.contains("saved: "), "{why}");
        check(run.path().join("elsewhere.slam")).unwrap();
    }

    #[test]
    fn no_name_is_that_of_a_file_of_the_run() {
        let own =
            ["accepted-room.json", "run.json", "sessions/robot2.slam", "merge.json", "recording/a.mcap"];
        for name in own {
            assert!(session(name).starts_with("/run/saved/") && session(name).ends_with(".slam"), "{name}");
            let stem = map_to_save(Path::new("/run"), name).unwrap();
            for file in formats::map_file::written_files(&stem) {
                assert!(file.starts_with("/run/saved"), "{}", file.display());
            }
        }
    }

    #[test]
    fn files_have_the_ending_of_their_kind() {
        assert_eq!(session("monday"), "/run/saved/monday.slam");
        assert_eq!(session("maps/monday.slam"), "/run/saved/maps/monday.slam");
        assert_eq!(session("map.v2"), "/run/saved/map.v2.slam");
        assert_eq!(session("map.yaml"), "/run/saved/map.yaml.slam");
        assert_eq!(session("/elsewhere/starts.json"), "/elsewhere/starts.json.slam");
        let map = |name| map_to_save(Path::new("/run"), name).unwrap();
        assert_eq!(map("monday.yaml"), Path::new("/run/saved/monday"));
        assert_eq!(map("/elsewhere/map.v2"), Path::new("/elsewhere/map.v2"));
        for (name, reason) in [("../a", "leads out"), ("", "no file"), ("a\n", "no file"), ("/", "no file")] {
            let run = Path::new("/run");
            let results = [
                session_to_save(run, name),
                map_to_save(run, name),
                files_to_load(run, name).map(|_| "".into()),
            ];
            for result in results {
                assert!(result.unwrap_err().to_string().contains(reason), "{name}");
            }
        }
    }

    #[test]
    fn what_clients_saved_is_looked_for_before_the_files_of_the_run() {
        let load = |name| files_to_load(Path::new("/run"), name).unwrap();
        let paths = |paths: &[&str]| paths.iter().map(PathBuf::from).collect::<Vec<_>>();
        assert_eq!(
            load("maps/monday.yaml"),
            paths(&["/run/saved/maps/monday.yaml", "/run/maps/monday.yaml"])
        );
        assert_eq!(
            load("sessions/robot1"),
            paths(&[
                "/run/saved/sessions/robot1.slam",
                "/run/saved/sessions/robot1",
                "/run/sessions/robot1.slam",
                "/run/sessions/robot1",
            ])
        );
        assert_eq!(load("/a/b.slam.earlier"), paths(&["/a/b.slam.earlier.slam", "/a/b.slam.earlier"]));
        assert_eq!(load("/a/b.slam"), paths(&["/a/b.slam"]));
        // What was saved by a name is found by it.
        for name in ["monday", "map.v2", "a/b.slam", "/elsewhere/starts.json"] {
            assert_eq!(load(name)[0], session_to_save(Path::new("/run"), name).unwrap(), "{name}");
        }
    }
}
