//! Session files of SLAM: [`Session`]s written durably and read with a limit.
//!
//! Errors name the file and the reason. A map file (YAML with PGM) may take a session's place for localization.

use formats::atomic;
use formats::map_file::{MapFileError, read_map};
use formats::regular;
use slam::session::BYTES_MAX;
use slam::{Session, SessionError, SessionIdentity, SlamConfig};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

/// Reason why a session file could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum SessionFileError {
    /// The operating system refused to open, read or write the file.
    #[error("{}: {source}", file.display())]
    Io {
        /// Path of the file.
        file: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The content is not a valid session, or belongs to another robot.
    #[error("{} {why}", file.display())]
    Content {
        /// Path of the file.
        file: PathBuf,
        /// Reason of the codec.
        why: SessionError,
    },
    /// The map file in a session's place could not be read.
    #[error(transparent)]
    Map(#[from] MapFileError),
}

impl SessionFileError {
    /// Returns whether the reason is that there is no such file.
    pub fn is_missing(&self) -> bool {
        matches!(self, Self::Io { source, .. } if source.kind() == std::io::ErrorKind::NotFound)
    }
}

/// Writes a session, durably: after a crash or on a full disk, the file is the old one or the new one.
pub fn write(path: &Path, session: &Session) -> Result<(), SessionFileError> {
    let invalid = |why| SessionFileError::Content { file: path.to_owned(), why };
    let bytes = session.encode().map_err(invalid)?;
    atomic::write_durably(path, |file| file.write_all(&bytes))
        .map_err(|source| SessionFileError::Io { file: path.to_owned(), source })
}

/// Reads a session of this robot.
pub fn read(path: &Path, identity: &SessionIdentity) -> Result<Session, SessionFileError> {
    let fail = |source| SessionFileError::Io { file: path.to_owned(), source };
    let mut bytes = Vec::new();
    regular::open(path)
        .and_then(|file| file.take(BYTES_MAX as u64 + 1).read_to_end(&mut bytes))
        .map_err(fail)?;
    Session::decode(&bytes, identity).map_err(|why| SessionFileError::Content { file: path.to_owned(), why })
}

/// Returns whether a path names a map (.yaml) and no session. A map is good for localization only.
pub fn is_map(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending == "yaml" || ending == "yml")
}

/// Reads a session, or a map in its place, which becomes a session for localization.
pub fn read_any(
    path: &Path,
    identity: &SessionIdentity,
    config: &SlamConfig,
) -> Result<Session, SessionFileError> {
    match is_map(path) {
        true => Ok(Session::from_grid(*identity, read_map(path)?.view(), config)),
        false => read(path, identity),
    }
}
