//! Files of the addresses that may drive, in this run and later ones, and of those that may not.

use super::saved_state::denied_file;
use crate::allowed;
use crate::run::Run;
use crate::storage::Storage;
use ::bridge::Bridge;
use std::io;
use std::net::IpAddr;
use std::path::{Path, PathBuf};

/// The two files.
pub struct PermissionFiles<S> {
    storage: S,
    /// The file of the allow list; `None` if addresses are not remembered.
    allowed: Option<PathBuf>,
    /// The file of the addresses that may not drive.
    denied: PathBuf,
}

impl<S: Storage> PermissionFiles<S> {
    /// Names the files of a run.
    pub fn new(run: &Run, storage: S) -> Self {
        let allowed = run.config.bridge.remember.then(|| allowed::file(run));
        Self { storage, allowed, denied: denied_file(run) }
    }

    /// Allows the addresses of the allow list to drive.
    pub fn allow(&self, bridge: &Bridge) {
        if let Some(path) = &self.allowed {
            for why in self.read(path).0.into_iter().filter_map(|address| bridge.allow(address).err()) {
                tracing::warn!("{}: {why}", path.display());
            }
        }
    }

    /// Forbids the denied addresses to drive. If nobody knows who is denied, the emergency stop is set: a person decides then.
    pub fn deny(&self, bridge: &Bridge) {
        let (addresses, is_whole) = self.read(&self.denied);
        let not_denied = addresses.into_iter().filter_map(|address| bridge.deny(address).err());
        let has_room = not_denied.map(|why| tracing::warn!("{}: {why}", self.denied.display())).count() == 0;
        if !is_whole || !has_room {
            tracing::warn!(
                "{}: who else may not drive is not known: the emergency stop is set; deny anew who must not, which writes the file \
                 anew, then `mr-slam release`",
                self.denied.display()
            );
            bridge.restore_stop();
        }
    }

    /// Writes a permission into the files of those who may drive and of those who may not.
    pub fn remember(&self, address: IpAddr, may_drive: bool) -> io::Result<()> {
        let allowed = self.allowed.iter().map(|path| (path, may_drive));
        allowed.chain([(&self.denied, !may_drive)]).try_for_each(|(path, is_listed)| {
            allowed::remember(&self.storage, path, address, is_listed)
                .map_err(|why| io::Error::other(format!("{}: {why}", path.display())))
        })
    }

    /// Reads a list of addresses, and reports what cannot be read. Returns whether all of it is text.
    fn read(&self, path: &Path) -> (Vec<IpAddr>, bool) {
        match allowed::read(&self.storage, path) {
            Ok((addresses, unsound)) => {
                unsound.iter().for_each(|line| {
                    tracing::warn!(
                        "{}: `{line}` is not the address of a client and is ignored",
                        path.display()
                    )
                });
                let is_text = unsound.iter().all(|line| !line.contains(char::REPLACEMENT_CHARACTER));
                (addresses, is_text)
            }
            Err(why) => {
                tracing::warn!("{}: {why}; no address is taken from it", path.display());
                (Vec::new(), false)
            }
        }
    }
}
