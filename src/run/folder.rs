//! Lock of a run's folder: nobody else writes into it while a fleet runs.

use super::{RunError, RunFile};
use crate::runtime_folder::Lock;
use std::path::Path;

/// Name of the file that a run's launcher holds locked.
const LOCK: &str = ".lock";

/// Locks the folder of a run, which must exist, until the lock is dropped.
///
/// Errors: a fleet runs in it, or the lock cannot be made.
pub fn lock_folder(dir: &Path) -> Result<Lock, RunError> {
    let lock = dir.join(LOCK);
    let locked = Lock::acquire(&lock).map_err(RunError::file(&lock))?;
    locked.ok_or_else(|| RunError::FolderInUse { dir: dir.into(), pid: launcher(dir) })
}

/// Checks that a file or folder of results does not lie in the folder of a running fleet.
pub fn check_output(path: &Path) -> Result<(), RunError> {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.into());
    let existing = path.ancestors().find_map(|path| path.canonicalize().ok()).unwrap_or_default();
    // Other programs lock files of this name, too.
    let is_in_use = |dir: &&Path| dir.join("run.json").exists() && Lock::is_held(&dir.join(LOCK));
    match existing.ancestors().find(is_in_use) {
        Some(dir) => Err(RunError::OutputInUse { dir: dir.into(), pid: launcher(dir) }),
        None => Ok(()),
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
}
