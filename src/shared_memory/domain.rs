//! Names of one run in shared memory, and the removal of what dead processes left there.

use super::failed;
use crate::ports::ChannelError;
use iceoryx2::node::NodeView;
use iceoryx2::prelude::*;
use std::path::{Path as FsPath, PathBuf};

/// Folder of the system's shared memory.
pub const SHARED_MEMORY: &str = "/dev/shm";

/// Names of one run in shared memory. Two runs on one machine have different names.
#[derive(Clone, Debug)]
pub struct Domain {
    config: Config,
    prefix: String,
    root: PathBuf,
}

impl Domain {
    /// `name`: letters, digits, `_`; unique on the machine (the launcher's process id is).
    pub fn new(name: &str) -> Result<Self, ChannelError> {
        let prefix = format!("mrslam_{name}_");
        // Short, because sockets live below it and their paths have 108 bytes.
        let root = std::env::temp_dir().join(format!("mrslam-{name}"));
        let mut config = Config::default();
        config.global.prefix =
            FileName::new(prefix.as_bytes()).map_err(failed("a run cannot be called", name))?;
        let root_bytes = root.as_os_str().as_encoded_bytes();
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

    /// Returns the path of a file of the run in the shared memory of the system; [`Domain::remove`] removes it.
    pub fn shared_file(&self, name: &str) -> PathBuf {
        FsPath::new(SHARED_MEMORY).join(format!("{}{name}", self.prefix))
    }

    pub(super) fn config(&self) -> &Config {
        &self.config
    }

    /// Returns the folder of the run's sockets and service files.
    pub fn root(&self) -> &FsPath {
        &self.root
    }
}
