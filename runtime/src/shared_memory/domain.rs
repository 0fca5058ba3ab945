//! Names of one run in shared memory, and the removal of what dead processes left there.

use super::failed;
use crate::ports::ChannelError;
use crate::runtime_folder::Lock;
use iceoryx2::node::NodeView;
use iceoryx2::prelude::*;
use std::collections::BTreeMap;
use std::os::unix::fs::MetadataExt;
use std::path::{Path as FsPath, PathBuf};
use std::time::Duration;

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
/// Age after which files without that file are leftovers: it is made first.
const UNLOCKED_AGE_MAX: Duration = Duration::from_secs(60);

/// Removes the files of this user's fleets whose launchers are dead. Files of other users stay.
pub fn remove_leftovers() {
    remove_leftovers_in(FsPath::new(SHARED_MEMORY));
}

fn remove_leftovers_in(folder: &FsPath) {
    let user = rustix::process::geteuid().as_raw();
    let mut is_dead = BTreeMap::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let file_name = entry.file_name().to_string_lossy().into_owned();
        let Some(rest) = file_name.strip_prefix(PREFIX) else { continue };
        let parts: Vec<&str> = rest.splitn(NAME_PARTS + 1, '_').collect();
        let [pid, random, _] = parts[..] else { continue };
        let Ok(about) = entry.path().symlink_metadata() else { continue };
        let is_name = pid.bytes().all(|byte| byte.is_ascii_digit())
            && random.len() == RANDOM_DIGITS
            && random.bytes().all(|byte| byte.is_ascii_hexdigit());
        if !is_name || about.uid() != user || !about.is_file() {
            continue;
        }
        let name = format!("{pid}_{random}");
        let lock = folder.join(format!("{PREFIX}{name}_{PROGRESS}"));
        let is_old = || about.modified().ok().and_then(|at| at.elapsed().ok()) > Some(UNLOCKED_AGE_MAX);
        let dead = *is_dead.entry(name).or_insert_with(|| match lock.exists() {
            true => !Lock::is_held(&lock),
            false => is_old(),
        });
        if dead {
            let _ = std::fs::remove_file(entry.path());
        }
    }
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
    /// `name`: letters, digits, `_`; unique on the machine. `root`: the run's private folder; short, because sockets
    /// live below it and their paths have 108 bytes.
    pub fn new(name: &str, root: &FsPath) -> Result<Self, ChannelError> {
        let prefix = format!("{PREFIX}{name}_");
        let root = root.to_path_buf();
        let mut config = Config::default();
        config.global.prefix =
            FileName::new(prefix.as_bytes()).map_err(failed("a run cannot be called", name))?;
        let root_bytes = root.as_os_str().as_encoded_bytes();
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

    /// Removes what dead processes of this run left behind. Safe at any time.
    pub fn clean_up_after_the_dead(&self) {
        let _ = iceoryx2::node::Node::<ipc::Service>::list(&self.config, |state| {
            if let NodeState::Dead(dead) = state {
                let id = *dead.id();
                if let Err(why) = dead.try_remove_stale_resources() {
                    tracing::warn!("shared memory of the dead process {id:?} stays: {why:?}");
                }
            }
            CallbackProgression::Continue
        });
    }

    /// Removes all files of the run. Call it only when none of its processes lives.
    pub fn remove(&self) {
        self.clean_up_after_the_dead();
        let _ = std::fs::remove_dir_all(&self.root);
        for entry in std::fs::read_dir(SHARED_MEMORY).into_iter().flatten().flatten() {
            if entry.file_name().to_string_lossy().starts_with(&self.prefix) {
                let _ = std::fs::remove_file(entry.path());
            }
        }
    }

    /// Returns the path of the file with the progress of the run's threads; [`Domain::remove`] removes it.
    pub fn progress_file(&self) -> PathBuf {
        FsPath::new(SHARED_MEMORY).join(format!("{}{PROGRESS}", self.prefix))
    }

    pub(super) fn config(&self) -> &Config {
        &self.config
    }

    /// Returns the folder of the run's sockets and service files.
    pub fn root(&self) -> &FsPath {
        &self.root
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_files_of_dead_launchers_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, "").unwrap();
            path
        };
        let dead = [file("mrslam_1_aaaaaaaa_progress"), file("mrslam_1_aaaaaaaa_data")];
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
}
