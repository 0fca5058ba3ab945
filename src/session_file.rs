//! Session files: written so that neither a crash nor a full disk costs the one before, read with a
//! limit, refused with the file's name and the reason. PGM and YAML maps stand in for localization.

use crate::map_file::{MapFileError, read_map};
use slam::{Identity, Session, SessionError, SlamConfig};
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

/// The largest file that is read: 20 000 nodes of a dense LiDAR take about 300 MB.
const BYTES_MAX: u64 = 1 << 30;

/// Why a session was not read or written.
#[derive(Debug, thiserror::Error)]
pub enum SessionFileError {
    /// The system refused.
    #[error("{}: {source}", file.display())]
    Io {
        /// Which file.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// It is none, or another robot's.
    #[error("{} {why}", file.display())]
    Content {
        /// Which file.
        file: PathBuf,
        /// What is wrong with it.
        why: SessionError,
    },
    /// A map that stands in for a session.
    #[error(transparent)]
    Map(#[from] MapFileError),
}

impl SessionFileError {
    /// There is no such file.
    pub fn is_missing(&self) -> bool {
        matches!(self, Self::Io { source, .. } if source.kind() == std::io::ErrorKind::NotFound)
    }
}

/// Writes beside the place, waits until the disk has it, renames, and waits for that too: the file
/// is the old one or the new one at any moment.
pub fn write(path: &Path, session: &Session) -> Result<(), SessionFileError> {
    write_with(path, |file| file.write_all(&session.encode()))
}

/// The same of anything.
pub(crate) fn write_with(
    path: &Path,
    write: impl FnOnce(&mut File) -> std::io::Result<()>,
) -> Result<(), SessionFileError> {
    let fail = |source| SessionFileError::Io { file: path.to_owned(), source };
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut beside = tempfile::NamedTempFile::new_in(folder).map_err(fail)?;
    write(beside.as_file_mut()).and_then(|()| beside.as_file().sync_all()).map_err(fail)?;
    beside.persist(path).map_err(|error| fail(error.error))?;
    File::open(folder).and_then(|folder| folder.sync_all()).map_err(fail)
}

/// Reads a session of this robot.
pub fn read(path: &Path, identity: &Identity) -> Result<Session, SessionFileError> {
    let fail = |source| SessionFileError::Io { file: path.to_owned(), source };
    let mut bytes = Vec::new();
    File::open(path).and_then(|file| file.take(BYTES_MAX + 1).read_to_end(&mut bytes)).map_err(fail)?;
    if bytes.len() as u64 > BYTES_MAX {
        return Err(fail(std::io::Error::other("more than 1 GiB")));
    }
    Session::decode(&bytes, identity).map_err(|why| SessionFileError::Content { file: path.to_owned(), why })
}

/// Whether a path names a map (.yaml) and no session: good for localization only.
pub fn is_map(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending == "yaml" || ending == "yml")
}

/// Reads a session, or a map in its place.
pub fn read_any(path: &Path, identity: &Identity, config: &SlamConfig) -> Result<Session, SessionFileError> {
    match is_map(path) {
        true => Ok(Session::from_grid(*identity, read_map(path)?.view(), config)),
        false => read(path, identity),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disk_that_fills_up_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.slam");
        write_with(&path, |file| file.write_all(b"old")).unwrap();
        let full = |file: &mut File| {
            file.write_all(b"ne")?;
            Err(std::io::Error::from(std::io::ErrorKind::StorageFull))
        };
        let said = write_with(&path, full).unwrap_err().to_string();
        assert!(said.contains("a.slam"), "{said}");
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
