//! A run's folder is written by one fleet at a time, and what the run before left there is kept.

use super::{Run, RunError, RunFile, create_folder};
use crate::runtime_folder::Lock;
use crate::storage::{DiskStorage, Storage as _};
use std::io::ErrorKind;
use std::path::Path;

/// Name of the file that a run's launcher holds locked.
const LOCK: &str = ".lock";
/// Name of the folder with the results of the run before.
const EARLIER: &str = "results.earlier";

/// Returns a folder name that sorts by time, UTC.
pub fn folder_name_now() -> String {
    chrono::Utc::now().format("%Y-%m-%dT%H-%M-%S").to_string()
}

/// Locks the folder of a run, which must exist, until the lock is dropped.
///
/// Errors: a fleet runs in it, or the lock cannot be made.
pub fn lock_folder(dir: &Path) -> Result<Lock, RunError> {
    let lock = dir.join(LOCK);
    let locked = Lock::acquire(&lock).map_err(RunError::file(&lock))?;
    locked.ok_or_else(|| RunError::FolderInUse { dir: dir.into(), pid: launcher(dir) })
}

/// Name of the file with the figures of the link to other machines.
pub const LINK_REPORT: &str = "link.json";

/// Removes the figures of an earlier fleet's link: what that heard says nothing of this one.
///
/// # Errors
/// The file cannot be removed.
pub fn remove_link_report(dir: &Path) -> Result<(), RunError> {
    let path = dir.join(LINK_REPORT);
    DiskStorage.remove(&path).map_err(RunError::file(&path))
}

/// Makes the folder of a running fleet anew if it was moved or deleted, so that its processes can be started again. Returns the new
/// folder's lock; `None` if the folder is there.
///
/// # Errors
/// The folder cannot be looked at or made, or another fleet runs in it.
pub fn restore_folder(run: &Run) -> Result<Option<Lock>, RunError> {
    let file = run.dir.join("run.json");
    match std::fs::symlink_metadata(&file) {
        Err(why) if why.kind() == ErrorKind::NotFound => {}
        // A server that does not answer has the folder all the same.
        Err(why) => return Err(RunError::file(&file)(why)),
        Ok(_) => return Ok(None),
    }
    let lock = lock_folder(&create_folder(&run.dir)?)?;
    run.write_description()?;
    Ok(Some(lock))
}

/// Checks that a file or folder of results does not lie in the folder of a running fleet.
pub fn check_output(path: &Path) -> Result<(), RunError> {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.into());
    let existing = path.ancestors().find_map(|path| path.canonicalize().ok()).unwrap_or_default();
    // Other programs lock files of this name, too.
    let is_in_use = |dir: &&Path| dir.join("run.json").exists() && Lock::is_held(&dir.join(LOCK));
    match existing.ancestors().find(is_in_use) {
        Some(dir) => Err(RunError::FolderInUse { dir: dir.into(), pid: launcher(dir) }),
        None => Ok(()),
    }
}

/// Moves the maps and the report that an earlier run left in a folder into `results.earlier` there, which has those of one run.
pub fn keep_earlier_results(dir: &Path) -> Result<(), RunError> {
    let entries = std::fs::read_dir(dir).map_err(RunError::file(dir))?.flatten();
    let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
    let mut names = names.filter(|name| is_result(name) && dir.join(name).is_file()).peekable();
    if names.peek().is_none() {
        return Ok(());
    }
    let earlier = dir.join(EARLIER);
    let failed = RunError::file(&earlier);
    let removed = if earlier.exists() { std::fs::remove_dir_all(&earlier) } else { Ok(()) };
    removed.and_then(|()| std::fs::create_dir(&earlier)).map_err(failed)?;
    for name in names {
        let path = dir.join(&name);
        std::fs::rename(&path, earlier.join(&name)).map_err(RunError::file(&path))?;
    }
    tracing::warn!("maps and report of an earlier run are in {}, until the next run here", earlier.display());
    Ok(())
}

/// Returns whether a file of this name is a map or a report, as a run writes them at its end.
fn is_result(name: &str) -> bool {
    let is_robot =
        |name: &str| name.strip_prefix("robot").is_some_and(|number| number.parse::<u32>().is_ok());
    match name.rsplit_once('.') {
        Some(("report", kind)) => matches!(kind, "json" | "html"),
        Some((stem, "yaml" | "pgm" | "png")) => {
            stem.strip_suffix("_map").is_some_and(|of| of == "merged" || is_robot(of))
        }
        _ => false,
    }
}

fn launcher(dir: &Path) -> Option<u32> {
    RunFile::read(dir).ok().map(|file| file.pid)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::FleetConfig;
    use crate::run::Run;

    #[test]
    fn a_folder_in_use_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let _lock = Lock::acquire(&folder.path().join(LOCK)).unwrap().unwrap();
        let result = Run::create(folder.path(), FleetConfig::default(), 0, false);
        let why = result.unwrap_err();
        assert!(matches!(why, RunError::FolderInUse { pid: None, .. }));
        assert!(why.to_string().contains("is starting") && why.to_string().contains("--run-dir"), "{why}");
    }

    #[test]
    fn results_are_refused_at_any_depth_of_a_running_fleets_folder_and_beside_it_not() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path().join("run");
        std::fs::create_dir_all(dir.join("sessions")).unwrap();
        std::fs::write(dir.join("run.json"), "{}").unwrap();
        std::os::unix::fs::symlink(&dir, folder.path().join("link")).unwrap();
        let inside = ["run", "run/map", "run/sessions/robot1.slam", "run/new/a.tum", "link/map"];
        let check = |name: &str| check_output(&folder.path().join(name));
        let lock = lock_folder(&dir).unwrap();
        for name in inside {
            let why = check(name).unwrap_err().to_string();
            assert!(why.contains("run") && why.contains("choose another folder"), "{name}: {why}");
        }
        check("other/map").unwrap();
        drop(lock);
        inside.iter().for_each(|name| check(name).unwrap());
    }

    #[test]
    fn results_of_the_run_before_are_kept_and_other_files_stay() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        let results = ["merged_map.yaml", "merged_map.pgm", "robot12_map.png", "report.json"];
        let others = ["fleet.toml", "photo.png", "robot_map.yaml", "room.yaml"];
        others.iter().for_each(|name| std::fs::write(place(name), "mine").unwrap());
        for run in ["first", "second", "third"] {
            keep_earlier_results(folder.path()).unwrap();
            for name in results {
                assert!(!place(name).exists(), "{run}: {name} would be overwritten");
                std::fs::write(place(name), run).unwrap();
            }
        }
        for name in results {
            let kept = place(EARLIER).join(name);
            assert_eq!(std::fs::read_to_string(kept).unwrap(), "second", "{name}");
        }
        assert!(others.iter().all(|name| place(name).exists()));
    }
}
