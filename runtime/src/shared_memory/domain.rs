//! Names of one run in shared memory, and the removal of what dead processes left there.

use super::failed;
use crate::held_signals::HeldSignals;
use crate::ports::ChannelError;
use crate::runtime_folder::{Forbidden, Lock, check_folder};
use iceoryx2::node::{NodeCleanupFailure, NodeView};
use iceoryx2::prelude::*;
use std::collections::BTreeMap;
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path as FsPath, PathBuf};
use std::time::{Duration, Instant};

/// Folder of the system's shared memory.
pub const SHARED_MEMORY: &str = "/dev/shm";

/// Start of the names of all files of fleets in shared memory.
const PREFIX: &str = "mrslam_";
/// Number of parts of a fleet's name: the launcher's process id and a random number, with `_` between them.
const NAME_PARTS: usize = 2;
/// Hexadecimal digits of the random number.
const RANDOM_DIGITS: usize = 8;
/// Name of the file that the launcher holds locked, at the end of its path.
const PROGRESS: &str = "progress";
/// Name of the folder of iceoryx2's files in shared memory, at the end of its path.
const FOLDER: &str = "ipc";
/// Age after which files without that file are leftovers: it is made first.
const UNLOCKED_AGE_MAX: Duration = Duration::from_secs(60);
/// Attempts to remove the files of a dead fleet.
const REMOVALS_MAX: usize = 20;
/// How long a writer's place may stay taken by a dead process before it counts as a living one's. On a loaded machine the process that
/// cleans up may take seconds.
const DEAD_WRITER_MAX: Duration = Duration::from_secs(5);
/// Pause between two attempts to get that place.
const DEAD_WRITER_PAUSE: Duration = Duration::from_millis(50);
/// Pause between two attempts.
const REMOVAL_PAUSE: Duration = Duration::from_millis(20);

/// Removes the files of this user's fleets whose launchers are dead. Files of other users stay.
pub fn remove_leftovers() {
    remove_leftovers_in(FsPath::new(SHARED_MEMORY));
}

/// Returns the name of a fleet and the rest of the name of one of its files in shared memory; `None`: it is none.
fn fleet_of_file(file_name: &str) -> Option<(String, &str)> {
    let parts: Vec<&str> = file_name.strip_prefix(PREFIX)?.splitn(NAME_PARTS + 1, '_').collect();
    let [pid, random, rest] = parts[..] else { return None };
    let is_name = pid.bytes().all(|byte| byte.is_ascii_digit())
        && random.len() == RANDOM_DIGITS
        && random.bytes().all(|byte| byte.is_ascii_hexdigit());
    is_name.then(|| (format!("{pid}_{random}"), rest))
}

/// Returns the name of the fleet whose launcher holds a file of this name in shared memory.
pub(crate) fn fleet_of_progress_file(file_name: &str) -> Option<String> {
    fleet_of_file(file_name).filter(|(_, rest)| *rest == PROGRESS).map(|(name, _)| name)
}

fn remove_leftovers_in(folder: &FsPath) {
    let user = rustix::process::geteuid().as_raw();
    let mut is_dead = BTreeMap::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let file_name = entry.file_name().to_string_lossy().into_owned();
        let Some((name, _)) = fleet_of_file(&file_name) else { continue };
        let Ok(about) = entry.path().symlink_metadata() else { continue };
        if about.uid() != user || !(about.is_file() || about.is_dir()) {
            continue;
        }
        let lock = folder.join(format!("{PREFIX}{name}_{PROGRESS}"));
        let is_old = || about.modified().ok().and_then(|at| at.elapsed().ok()) > Some(UNLOCKED_AGE_MAX);
        let dead = *is_dead.entry(name).or_insert_with(|| match lock.exists() {
            true => !Lock::is_held(&lock),
            false => is_old(),
        });
        if dead {
            remove_entry(&entry.path(), about.is_dir());
        }
    }
}

fn remove_entry(path: &FsPath, is_folder: bool) {
    let _ = if is_folder { std::fs::remove_dir_all(path) } else { std::fs::remove_file(path) };
}

/// Makes the folder of a run's files of iceoryx2 in shared memory. iceoryx2 makes several hundred small files at the start of a
/// fleet and waits for each to be on the disk: on a disk that takes a second and more, in memory nothing.
///
/// Without this folder the files are in the run's root: on a system without shared memory as a folder, and for a run that outlives
/// the user's login, at whose end systemd may empty the user's shared memory (`RemoveIPC`).
pub fn create_ipc_folder(name: &str) -> std::io::Result<()> {
    std::fs::DirBuilder::new().mode(0o700).create(ipc_folder(name))
}

/// Returns the path of that folder. Its name is not predictable, as that of the run.
fn ipc_folder(name: &str) -> PathBuf {
    FsPath::new(SHARED_MEMORY).join(format!("{PREFIX}{name}_{FOLDER}"))
}

/// Longest path of a Unix socket, bytes: sun_path of unix(7) without its NUL.
const SOCKET_PATH_MAX: usize = 107;
/// What iceoryx2 adds to folder and prefix, bytes: a slash, a number of 128 bits in decimal, and `.event`.
const SOCKET_NAME_BYTES: usize = 1 + 39 + 6;

/// Names of one run in shared memory. Two runs on one machine have different names.
#[derive(Clone, Debug)]
pub struct Domain {
    config: Config,
    prefix: String,
    root: PathBuf,
}

impl Domain {
    /// `name`: letters, digits, `_`; unique on the machine. `root`: the run's private folder. If there is no folder in shared
    /// memory ([`create_ipc_folder`]), it must be short, because sockets live below it and their paths have 108 bytes.
    pub fn new(name: &str, root: &FsPath) -> Result<Self, ChannelError> {
        // iceoryx2 warns of every dead process, and of what two clean up at a time; the launcher says what matters of it.
        set_log_level(LogLevel::Error);
        let prefix = format!("{PREFIX}{name}_");
        let root = root.to_path_buf();
        let mut config = Config::default();
        config.global.prefix =
            FileName::new(prefix.as_bytes()).map_err(failed("a run cannot be called", name))?;
        let in_memory =
            Some(ipc_folder(name)).filter(|path| check_folder(path, Forbidden::Everything).is_ok());
        let root_bytes = in_memory.as_ref().unwrap_or(&root).as_os_str().as_encoded_bytes();
        let socket_bytes = root_bytes.len() + prefix.len() + SOCKET_NAME_BYTES;
        if socket_bytes > SOCKET_PATH_MAX {
            return Err(ChannelError::SharedMemory {
                what: "a shorter path is needed for sockets (set XDG_RUNTIME_DIR or TMPDIR) than",
                name: root.display().to_string(),
                why: format!(
                    "a socket's path would have {socket_bytes} bytes, the limit is {SOCKET_PATH_MAX}"
                ),
            });
        }
        config.global.set_root_path(&Path::new(root_bytes).map_err(failed("no folder", name))?);
        Ok(Self { config, prefix, root })
    }

    /// Removes what dead processes of this run left behind. Safe at any time. Returns whether another process is removing some of
    /// it at this moment: places in channels are taken until it has.
    pub fn clean_up_after_the_dead(&self) -> bool {
        let _held = HeldSignals::hold();
        let mut others_clean = false;
        let _ = iceoryx2::node::Node::<ipc::Service>::list(&self.config, |state| {
            if let NodeState::Dead(dead) = state {
                let id = *dead.id();
                match dead.try_remove_stale_resources() {
                    Ok(()) | Err(NodeCleanupFailure::ResourcesAlreadyCleanedUp) => (),
                    Err(why @ NodeCleanupFailure::AnotherInstanceIsCleaningUpTheNode) => {
                        others_clean = true;
                        tracing::debug!("shared memory of the dead process {id:?}: {why:?}");
                    }
                    Err(why) => tracing::warn!("shared memory of the dead process {id:?} stays: {why:?}"),
                }
            }
            CallbackProgression::Continue
        });
        others_clean
    }

    /// Opens a writer's port. While all places of its channel are taken, removes what dead processes left and tries again: another
    /// process may be cleaning up after the writer before.
    pub(super) fn open_writer<T, E>(
        &self,
        is_full: impl Fn(&E) -> bool,
        open: impl Fn() -> Result<T, E>,
    ) -> Result<T, E> {
        let begun = Instant::now();
        loop {
            match open() {
                Err(why) if is_full(&why) && begun.elapsed() < DEAD_WRITER_MAX => {
                    self.clean_up_after_the_dead();
                    std::thread::sleep(DEAD_WRITER_PAUSE);
                }
                opened => return opened,
            }
        }
    }

    /// Removes all files of a run whose launcher seems to be dead. Returns false, and removes nothing, if it lives all the same: it
    /// holds its file in shared memory.
    pub fn remove_leftover(&self) -> bool {
        let is_dead = !Lock::is_held(&self.progress_file());
        if is_dead {
            self.remove();
        }
        is_dead
    }

    /// Removes all files of the run. Call it only when none of its processes lives, observers apart.
    ///
    /// An observer that detaches meanwhile still makes files of its own, so that the removal is repeated until nothing is left.
    pub fn remove(&self) {
        self.clean_up_after_the_dead();
        for attempt in 0..REMOVALS_MAX {
            if attempt > 0 {
                std::thread::sleep(REMOVAL_PAUSE);
            }
            let files = self.files();
            if files.is_empty() {
                return;
            }
            files.iter().for_each(|path| remove_entry(path, path.is_dir()));
        }
        if let [first, ..] = &self.files()[..] {
            tracing::warn!("{} of a dead fleet could not be removed", first.display());
        }
    }

    /// Returns the paths of the run's root and of its files in shared memory, as far as they exist.
    fn files(&self) -> Vec<PathBuf> {
        let entries = std::fs::read_dir(SHARED_MEMORY).into_iter().flatten().flatten();
        let in_memory = entries.filter(|entry| entry.file_name().to_string_lossy().starts_with(&self.prefix));
        let root = self.root.exists().then(|| self.root.clone());
        in_memory.map(|entry| entry.path()).chain(root).collect()
    }

    /// Returns the path of the file with the progress of the run's threads; [`Domain::remove`] removes it.
    pub fn progress_file(&self) -> PathBuf {
        FsPath::new(SHARED_MEMORY).join(format!("{}{PROGRESS}", self.prefix))
    }

    pub(super) fn config(&self) -> &Config {
        &self.config
    }

    /// Returns the folder of the run's lock, of the bridge's control socket, and of what else is not in shared memory.
    pub fn root(&self) -> &FsPath {
        &self.root
    }
}

/// Removes the files of a run when it is dropped: a fleet that did not start leaves none.
#[derive(Debug)]
pub struct DomainGuard(Option<Domain>);

impl DomainGuard {
    /// Guards the files of a run.
    pub fn new(domain: Domain) -> Self {
        Self(Some(domain))
    }

    /// Leaves the files where they are.
    pub fn keep(mut self) {
        self.0 = None;
    }
}

impl Drop for DomainGuard {
    fn drop(&mut self) {
        if let Some(domain) = &self.0 {
            domain.remove();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_writer_waits_for_the_place_of_a_dead_one_and_for_nothing_else() {
        let root = tempfile::tempdir().unwrap();
        let domain = Domain::new("1_00000000", root.path()).unwrap();
        let opened = |failures: Vec<&'static str>| {
            let failures = std::cell::RefCell::new(failures);
            let open = || failures.borrow_mut().pop().map_or(Ok("open"), Err);
            (domain.open_writer(|why: &&str| *why == "full", open), failures.take().len())
        };
        assert_eq!(opened(vec!["full", "full"]), (Ok("open"), 0));
        assert_eq!(opened(vec!["full", "broken", "full"]), (Err("broken"), 1));
    }

    #[test]
    fn what_a_live_launcher_has_in_shared_memory_is_no_leftover() {
        let root = tempfile::tempdir().unwrap();
        let name = format!("{}_{:08x}", std::process::id(), std::process::id() ^ 0x3c3c);
        let domain = Domain::new(&name, root.path()).unwrap();
        let lock = Lock::acquire(&domain.progress_file()).unwrap().unwrap();
        assert!(!domain.remove_leftover() && domain.progress_file().exists() && root.path().exists());
        drop(lock);
        assert!(domain.remove_leftover() && !domain.progress_file().exists());
    }

    #[test]
    fn only_files_of_dead_launchers_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, "").unwrap();
            path
        };
        let dead_folder = folder.path().join("mrslam_1_aaaaaaaa_ipc");
        std::fs::create_dir_all(dead_folder.join("nodes")).unwrap();
        let dead = [file("mrslam_1_aaaaaaaa_progress"), file("mrslam_1_aaaaaaaa_data"), dead_folder];
        let _lock = Lock::acquire(&file("mrslam_2_bbbbbbbb_progress")).unwrap().unwrap();
        // A live fleet, one that is just starting, and what is not ours.
        let kept = [
            file("mrslam_2_bbbbbbbb_data"),
            file("mrslam_3_cccccccc_data"),
            file("mrslam_x_data"),
            file("other_1_aaaaaaaa_x"),
        ];
        remove_leftovers_in(folder.path());
        assert!(dead.iter().all(|path| !path.exists()));
        assert!(kept.iter().all(|path| path.exists()));
    }

    #[test]
    fn the_files_of_a_run_are_in_shared_memory_if_its_folder_is_there_and_private() {
        let root = tempfile::tempdir().unwrap();
        let name = format!("{}_{:08x}", std::process::id(), std::process::id() ^ 0x5a5a);
        let path_of = |domain: &Domain| PathBuf::from(domain.config().global.root_path().to_string());
        assert_eq!(path_of(&Domain::new(&name, root.path()).unwrap()), root.path());
        create_ipc_folder(&name).unwrap();
        assert!(create_ipc_folder(&name).is_err(), "a folder that is there may be another's");
        let domain = Domain::new(&name, root.path()).unwrap();
        assert_eq!((path_of(&domain), domain.root()), (ipc_folder(&name), root.path()));
        let open = std::os::unix::fs::PermissionsExt::from_mode(0o755);
        std::fs::set_permissions(ipc_folder(&name), open).unwrap();
        assert_eq!(path_of(&Domain::new(&name, root.path()).unwrap()), root.path(), "others could look in");
        domain.remove();
        assert!(!ipc_folder(&name).exists());
    }
}
