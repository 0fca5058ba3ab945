//! Files that clients save and load by name: a folder of their own in the run's folder, so that no name is that of a run's own file.
//!
//! A name that a client gives is relative and gets the ending of its kind, whatever it ends with. The command line gives absolute paths.

use msg::{FileNameError, check_file_name, check_relative_file_name};
use std::path::{Path, PathBuf};

/// Name of the folder in a run's folder.
pub const FOLDER: &str = "saved";
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

    fn session(name: &str) -> String {
        session_to_save(Path::new("/run"), name).unwrap().display().to_string()
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
