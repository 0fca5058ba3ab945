//! Running fleets of this user, also those whose run's folder cannot be read any more.

use super::{FILE_BYTES_MAX, Run, RunError, RunFile};
use crate::config::RobotSource;
use crate::lossy_path;
use crate::other_fleets::{self, OtherFleet, RUN_POINTER, other_fleets};
use crate::runtime_folder;
use serde::Serialize;
use std::fmt;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Name of the file that a fleet has whose robots are on other machines.
const REMOTE_ROBOTS: &str = "remote-robots";

/// Fleets of this user whose launcher is alive.
#[derive(Debug, Default)]
pub struct RunningFleets {
    /// Folders of the runs, in the order of their start.
    pub runs: Vec<PathBuf>,
    /// Fleets whose run's folder cannot be read.
    pub lost: Vec<LostFleet>,
    /// Fleets of other users, or of another place for runtime folders.
    pub others: Vec<OtherFleet>,
}

/// Running fleet whose run's folder was moved or deleted, or cannot be read.
#[derive(Clone, Debug, Serialize)]
pub struct LostFleet {
    /// Process id of the launcher.
    pub pid: Option<u32>,
    /// Folder of its sockets and locks.
    #[serde(serialize_with = "lossy_path::serialize")]
    pub runtime: PathBuf,
    /// Folder of the run, as the launcher has made it.
    #[serde(serialize_with = "lossy_path::serialize_optional")]
    pub folder: Option<PathBuf>,
    /// What is missing.
    pub missing: String,
    /// Whether robots of it are on other machines.
    pub has_remote_robots: bool,
}

impl LostFleet {
    fn new(runtime: &Path, folder: Option<PathBuf>, missing: String) -> Self {
        // A fleet's folder is named after its launcher's process.
        let name = runtime.file_name().unwrap_or_default().to_string_lossy();
        let pid = name.split('_').next().and_then(|pid| pid.parse().ok());
        let has_remote_robots = has_remote_robots(runtime);
        Self { pid, runtime: runtime.into(), folder, missing, has_remote_robots }
    }
}

impl fmt::Display for LostFleet {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let pid = self.pid.map_or("unknown".into(), |pid| pid.to_string());
        let (runtime, missing) = (self.runtime.display(), &self.missing);
        write!(
            out,
            "a fleet runs whose folder cannot be read (process {pid}, runtime folder {runtime}): {missing}"
        )
    }
}

impl RunningFleets {
    /// Finds all of them.
    pub fn find() -> Self {
        let (roots, others) = other_fleets(runtime_folder::live_fleets);
        Self { others, ..Self::of(&roots) }
    }

    /// Describes the fleets in these runtime folders, without those whose launcher is dead.
    fn of(roots: &[PathBuf]) -> Self {
        let (mut found, mut lost) = (Vec::new(), Vec::new());
        for root in roots {
            match begin_and_folder(root) {
                // Process ids do not grow with time, so the start is read from the run's own file.
                Ok(run) if runtime_folder::is_alive(root) => found.push(run),
                // A fleet that ended meanwhile has removed its files.
                Err(fleet) if runtime_folder::is_alive(root) => lost.push(fleet),
                Ok(_) | Err(_) => {}
            }
        }
        found.sort();
        Self { runs: found.into_iter().map(|(_, dir)| dir).collect(), lost, others: Vec::new() }
    }
}

/// Returns whether robots of the fleet in a runtime folder are on other machines.
pub fn has_remote_robots(root: &Path) -> bool {
    root.join(REMOTE_ROBOTS).exists()
}

/// Returns the runtime folder that `run.json` in the folder of a run names. The configuration, which another build may have written, is
/// not read.
///
/// # Errors
/// `run.json` cannot be read, or is not this user's.
pub fn runtime_folder_of(dir: &Path) -> Result<PathBuf, RunError> {
    Ok(RunFile::read(dir)?.runtime)
}

/// Returns the start of the fleet in a runtime folder, in nanoseconds of CLOCK_MONOTONIC, and the folder of its run.
fn begin_and_folder(root: &Path) -> Result<(u64, PathBuf), LostFleet> {
    let pointer = root.join(RUN_POINTER);
    let dir = formats::limited::read(&pointer, FILE_BYTES_MAX).map_err(|why| {
        LostFleet::new(root, None, format!("{}: {why}; it may be starting", pointer.display()))
    })?;
    let dir = other_fleets::path(dir);
    match RunFile::read(&dir) {
        Ok(file) if file.runtime == *root => Ok((file.begun_ns, dir)),
        Ok(_) => {
            let missing = format!("{}: describes another fleet", dir.join("run.json").display());
            Err(LostFleet::new(root, Some(dir), missing))
        }
        Err(why) => Err(LostFleet::new(root, Some(dir), why.to_string())),
    }
}

/// Writes into a run's runtime folder where its own folder is.
pub(super) fn write_pointer(run: &Run) -> Result<(), RunError> {
    let write = |name: &str, content: &[u8]| {
        let path = run.domain.root().join(name);
        formats::atomic::write_durably(&path, |file| file.write_all(content)).map_err(RunError::file(&path))
    };
    if run.config.world == RobotSource::Robots {
        write(REMOTE_ROBOTS, b"")?;
    }
    write(RUN_POINTER, run.dir.as_os_str().as_encoded_bytes())
}

#[cfg(test)]
mod tests {
    use super::super::create_folder;
    use super::*;
    use crate::runtime_folder::Lock;
    use std::fs;
    use std::os::unix::fs::{DirBuilderExt, PermissionsExt, symlink};

    /// Makes what a fleet that began at `begun_ns` has in the user's folder and in its own; returns both.
    fn pretend_run(folder: &Path, begun_ns: u64) -> (PathBuf, PathBuf) {
        let runtime = folder.join(format!("fleet_{begun_ns}"));
        fs::DirBuilder::new().mode(0o700).create(&runtime).unwrap();
        let dir = create_folder(&folder.join(format!("run-{begun_ns}"))).unwrap();
        let (pid, domain) = (std::process::id(), "test".into());
        let file = RunFile { pid, domain, runtime: runtime.clone(), epoch_ns: 0, begun_ns, port: 0 };
        fs::write(dir.join("run.json"), serde_json::to_string(&file).unwrap()).unwrap();
        fs::write(runtime.join(RUN_POINTER), dir.as_os_str().as_encoded_bytes()).unwrap();
        (runtime, dir)
    }

    #[test]
    fn running_fleets_are_listed_in_the_order_of_their_start() {
        let folder = tempfile::tempdir().unwrap();
        let (mut roots, mut dirs, mut locks) = (Vec::new(), Vec::new(), Vec::new());
        for begun_ns in [2, 1] {
            let (root, dir) = pretend_run(folder.path(), begun_ns);
            locks.push(Lock::acquire(&root.join("lock")).unwrap().unwrap());
            roots.push(root);
            dirs.insert(0, dir);
        }
        let runs = RunningFleets::of(&roots).runs;
        assert_eq!(runs, dirs);
        let several = RunError::SeveralRunning { runs }.to_string();
        assert!(several.contains("--run-dir") && several.contains("run-2"), "{several}");
        locks.remove(0);
        let left = RunningFleets::of(&roots);
        assert!(left.lost.is_empty(), "{left:?}");
        assert_eq!(left.runs, dirs[..1], "its launcher is dead");
    }

    #[test]
    fn nobody_can_pretend_to_be_a_fleet() {
        let folder = tempfile::tempdir().unwrap();
        let (root, dir) = pretend_run(folder.path(), 1);
        let _lock = Lock::acquire(&root.join("lock")).unwrap().unwrap();
        let runs = || RunningFleets::of(std::slice::from_ref(&root)).runs;
        assert_eq!(runs(), std::slice::from_ref(&dir));
        let json = dir.join("run.json");
        fs::set_permissions(&json, fs::Permissions::from_mode(0o666)).unwrap();
        assert_eq!(runs(), Vec::<PathBuf>::new(), "anybody could have written it");
        fs::rename(&json, folder.path().join("elsewhere")).unwrap();
        symlink(folder.path().join("elsewhere"), &json).unwrap();
        assert_eq!(runs(), Vec::<PathBuf>::new(), "a link may lead anywhere");
        assert!(matches!(Run::open_running(&dir), Err(RunError::Trust(_))));
    }

    #[test]
    fn a_live_fleet_is_never_left_out_whatever_became_of_its_folder() {
        type Change = fn(&Path, &Path);
        let changes: [(&str, Change); 6] = [
            ("deleted", |dir, _| fs::remove_dir_all(dir).unwrap()),
            ("moved", |dir, _| fs::rename(dir, dir.with_extension("moved")).unwrap()),
            ("without run.json", |dir, _| fs::remove_file(dir.join("run.json")).unwrap()),
            ("broken", |dir, _| fs::write(dir.join("run.json"), "{").unwrap()),
            ("without its pointer", |_, root| fs::remove_file(root.join(RUN_POINTER)).unwrap()),
            ("used again", |dir, root| {
                let json = fs::read_to_string(dir.join("run.json")).unwrap();
                let other = json.replace(root.to_str().unwrap(), "/another");
                fs::write(dir.join("run.json"), other).unwrap();
            }),
        ];
        for (what, change) in changes {
            let folder = tempfile::tempdir().unwrap();
            let (root, dir) = pretend_run(folder.path(), 1);
            let _lock = Lock::acquire(&root.join("lock")).unwrap().unwrap();
            change(&dir, &root);
            let fleets = RunningFleets::of(std::slice::from_ref(&root));
            assert!(fleets.runs.is_empty() && fleets.lost.len() == 1, "{what}: {fleets:?}");
            let said = fleets.lost[0].to_string();
            assert!(said.contains(root.to_str().unwrap()) && said.contains("run"), "{what}: {said}");
        }
    }
}
