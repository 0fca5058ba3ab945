//! Fleets of this machine that a tool does not find: those of other users, and of other places for the runtime folder.
//!
//! The names of all fleets are in shared memory, where everybody may list them.

use crate::shared_memory::{SHARED_MEMORY, fleet_of_progress_file};
use rustix::process::geteuid;
use serde::Serialize;
use std::fmt;
use std::fs;
use std::os::unix::ffi::OsStringExt;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Largest size of a file that is read here, bytes.
const FILE_BYTES_MAX: u64 = 1 << 20;
/// Name of the program in `/proc/PID/comm`.
const PROGRAM: &str = "mr-slam";
/// Name of the file in a fleet's runtime folder that has the path of the run's folder.
pub const RUN_POINTER: &str = "run-dir";

/// A running fleet that was not found in the places for runtime folders.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct OtherFleet {
    /// Process id of the launcher.
    pub process: u32,
    /// Name of its user, or `#` and the number.
    pub user: String,
    /// Whether that is this process's user.
    pub is_own: bool,
    /// Folder of the run; `None`: this user may not see it.
    #[serde(serialize_with = "crate::lossy_path::serialize_optional")]
    pub run_dir: Option<PathBuf>,
}

impl fmt::Display for OtherFleet {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { process, user, is_own, run_dir } = self;
        let folder = run_dir.as_ref().map_or("FOLDER_OF_ITS_RUN".into(), |dir| dir.display().to_string());
        let prefix = if *is_own { String::new() } else { format!("sudo -u '{user}' ") };
        write!(
            out,
            "a fleet of user {user} runs (process {process}) that this command cannot find; `{prefix}mr-slam stop --run-dir {folder}` \
             stops it, and other tools take the same option"
        )
    }
}

/// Lists the fleets of this machine that run, without those whose runtime folders `find` finds; returns both.
///
/// A fleet has its runtime folder before it has a name in shared memory, so one that starts meanwhile is found, or not listed.
pub fn other_fleets(find: impl FnOnce() -> Vec<PathBuf>) -> (Vec<PathBuf>, Vec<OtherFleet>) {
    list(Path::new(SHARED_MEMORY), Path::new("/proc"), find)
}

fn list(
    shared_memory: &Path,
    proc: &Path,
    find: impl FnOnce() -> Vec<PathBuf>,
) -> (Vec<PathBuf>, Vec<OtherFleet>) {
    let entries = fs::read_dir(shared_memory).into_iter().flatten().flatten();
    let named = |entry: fs::DirEntry| {
        Some((fleet_of_progress_file(&entry.file_name().to_string_lossy())?, entry.path()))
    };
    let all: Vec<(String, PathBuf)> = entries.filter_map(named).collect();
    let found = find();
    let is_found = |name: &str| found.iter().any(|root| root.file_name().is_some_and(|own| own == name));
    let others = all.iter().filter(|(name, _)| !is_found(name));
    let mut others: Vec<OtherFleet> =
        others.filter_map(|(name, progress)| describe(name, progress, proc)).collect();
    others.sort_by_key(|fleet| fleet.process);
    (found, others)
}

/// Describes the fleet of this name; `None` if its launcher does not live.
fn describe(name: &str, progress: &Path, proc: &Path) -> Option<OtherFleet> {
    let about = fs::symlink_metadata(progress).ok()?;
    let process: u32 = name.split('_').next()?.parse().ok()?;
    let folder = proc.join(process.to_string());
    // The number may be another process's by now.
    let is_users = fs::metadata(&folder).is_ok_and(|process| process.uid() == about.uid());
    if !about.is_file() || !is_users {
        return None;
    }
    let open = open_files(&folder);
    let is_launcher = match &open {
        Some(files) => files.iter().any(|file| file == progress),
        None => fs::read_to_string(folder.join("comm")).is_ok_and(|comm| comm.trim() == PROGRAM),
    };
    let lock = Path::new(name).join("lock");
    let runtime = open.iter().flatten().find(|file| file.ends_with(&lock)).and_then(|file| file.parent());
    is_launcher.then(|| OtherFleet {
        process,
        user: user_name(about.uid()),
        is_own: about.uid() == geteuid().as_raw(),
        run_dir: runtime
            .and_then(|root| formats::limited::read(&root.join(RUN_POINTER), FILE_BYTES_MAX).ok())
            .map(path),
    })
}

/// Returns the path that a file holds, whatever its bytes are.
pub fn path(bytes: Vec<u8>) -> PathBuf {
    std::ffi::OsString::from_vec(bytes).into()
}

/// Returns the paths of the files that a process has open; `None`: this user may not see them.
fn open_files(process: &Path) -> Option<Vec<PathBuf>> {
    let entries = fs::read_dir(process.join("fd")).ok()?.flatten();
    Some(entries.filter_map(|entry| fs::read_link(entry.path()).ok()).collect())
}

/// Returns the name of a user of this machine's own list, else `#` and the number, which `sudo` understands.
fn user_name(user: u32) -> String {
    let users = formats::limited::read_text(Path::new("/etc/passwd"), FILE_BYTES_MAX).unwrap_or_default();
    let name_of = |line: &str| {
        let mut fields = line.split(':');
        let name = fields.next()?.to_owned();
        (fields.nth(1)?.parse() == Ok(user)).then_some(name)
    };
    users.lines().find_map(name_of).unwrap_or_else(|| format!("#{user}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    /// What a pretended machine shows of a fleet.
    struct Machine {
        folder: tempfile::TempDir,
    }

    impl Machine {
        fn new() -> Self {
            let folder = tempfile::tempdir().unwrap();
            fs::create_dir(folder.path().join("shm")).unwrap();
            Self { folder }
        }

        fn path(&self, name: &str) -> PathBuf {
            self.folder.path().join(name)
        }

        /// Adds a fleet with its runtime folder, whose launcher is this process.
        fn add(&self, process: u32) -> PathBuf {
            let root = self.path(&format!("run/{process}_0123abcd"));
            fs::create_dir_all(&root).unwrap();
            fs::write(root.join(RUN_POINTER), b"/runs/\xff").unwrap();
            let progress = self.path(&format!("shm/mrslam_{process}_0123abcd_progress"));
            fs::write(&progress, "").unwrap();
            let fd = self.path(&format!("proc/{process}/fd"));
            fs::create_dir_all(&fd).unwrap();
            symlink(&progress, fd.join("3")).unwrap();
            symlink(root.join("lock"), fd.join("4")).unwrap();
            root
        }

        fn others(&self, found: &[PathBuf]) -> Vec<OtherFleet> {
            list(&self.path("shm"), &self.path("proc"), || found.to_vec()).1
        }
    }

    #[test]
    fn a_fleet_of_another_place_is_named_with_the_command_that_reaches_it() {
        let machine = Machine::new();
        let (first, _second) = (machine.add(7), machine.add(8));
        let others = machine.others(&[first]);
        assert_eq!(others.iter().map(|fleet| fleet.process).collect::<Vec<_>>(), [8]);
        assert!(others[0].is_own && others[0].run_dir == Some(path(b"/runs/\xff".to_vec())));
        let said = others[0].to_string();
        assert!(said.contains("process 8") && said.contains("`mr-slam stop --run-dir /runs/"), "{said}");
    }

    #[test]
    fn a_fleet_that_starts_or_ends_meanwhile_is_no_fleet_of_others() {
        let machine = Machine::new();
        let first = machine.add(7);
        machine.add(8);
        let (found, others) = list(&machine.path("shm"), &machine.path("proc"), || {
            let starts = machine.add(9);
            fs::remove_dir_all(machine.path("proc/8")).unwrap();
            vec![first.clone(), starts]
        });
        assert_eq!((found.len(), others), (2, Vec::new()));
        // It starts after the place for runtime folders was read: nobody says of it that it is not found.
        let (_, others) = list(&machine.path("shm"), &machine.path("proc"), || {
            let found = vec![first.clone(), machine.path("run/9_0123abcd")];
            machine.add(10);
            found
        });
        assert_eq!(others, []);
    }

    #[test]
    fn a_dead_launcher_and_another_process_of_its_number_are_no_fleet() {
        let machine = Machine::new();
        machine.add(7);
        fs::remove_file(machine.path("proc/7/fd/3")).unwrap();
        assert_eq!(machine.others(&[]), [], "it does not hold the fleet's file");
        fs::remove_dir_all(machine.path("proc/7")).unwrap();
        assert_eq!(machine.others(&[]), []);
    }

    #[test]
    fn a_fleet_whose_files_are_hidden_is_told_by_its_programs_name_and_its_user() {
        let machine = Machine::new();
        machine.add(7);
        fs::remove_dir_all(machine.path("proc/7/fd")).unwrap();
        let comm = machine.path("proc/7/comm");
        fs::write(&comm, "cat\n").unwrap();
        assert_eq!(machine.others(&[]), []);
        fs::write(&comm, "mr-slam\n").unwrap();
        assert_eq!(machine.others(&[]).len(), 1);
        let fleet = OtherFleet { process: 7, user: "mr-slam".into(), is_own: false, run_dir: None };
        assert!(fleet.to_string().contains("sudo -u 'mr-slam' mr-slam stop --run-dir"), "{fleet}");
        assert_eq!((user_name(0), user_name(u32::MAX - 7)), ("root".into(), format!("#{}", u32::MAX - 7)));
    }
}
