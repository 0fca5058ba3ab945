//! Reasons why a request to SLAM, or a job on a file, is refused.

use crate::saved_files::SavedFilesError;
use crate::session_file::{self, SessionFileError};
use formats::map_file::MapFileError;
use msg::FileNameError;
use std::path::PathBuf;

/// Reason why a request is refused. Its text is the answer to the client.
#[derive(Debug, thiserror::Error)]
pub enum RequestRefused {
    /// The queue to the front end is full.
    #[error("the front end does not keep up; try again in a moment")]
    FrontEndBusy,
    /// Too many requests wait for the front end's state.
    #[error("too many requests wait; try again in a moment")]
    TooManyRequests,
    /// The queue of the file worker is full.
    #[error("too many files are being written; try again in a moment")]
    TooManyFiles,
    /// The disk does not answer.
    #[error("{}: the disk has not answered for {seconds} s; what is to be written may be written when it does, nothing is loaded", path.display())]
    DiskSilent {
        /// Path of the file.
        path: PathBuf,
        /// For how long, seconds.
        seconds: u64,
    },
    /// A file is being loaded.
    #[error("another file is being loaded; try again when it is")]
    Loading,
    /// The code of the request has no meaning.
    #[error("request code {0} is unknown")]
    UnknownRequest(u32),
    /// The code of the mode has no meaning.
    #[error("mode code {0} is unknown")]
    UnknownMode(u32),
    /// The pose or its uncertainty has NaN or infinity in it.
    #[error("the pose has numbers that are not finite")]
    PoseNotFinite,
    /// The map has no nodes.
    #[error("there is nothing in the map yet: no scan has come")]
    EmptyMap,
    /// The mode is localization.
    #[error("in localization the map stays as it is; set the mode to mapping first")]
    MapIsFixed,
    /// The robot has no pose in the map.
    #[error("while the robot is relocalizing, the map does not change")]
    Relocalizing,
    /// The closure does not exist or has no effect.
    #[error("closure {number} is not part of the graph; {count} were found")]
    NoClosure {
        /// Number of the closure in the request.
        number: u32,
        /// Number of closures in the graph.
        count: usize,
    },
    /// The text of the request is no file name, or leads out of the folder for saved files.
    #[error(transparent)]
    FileName(#[from] FileNameError),
    /// The job on the request's file failed.
    #[error(transparent)]
    File(#[from] FileJobError),
}

/// Reason why a job on a file failed.
#[derive(Debug, thiserror::Error)]
pub enum FileJobError {
    /// The operating system refused to write the file.
    #[error("{}: {source}", path.display())]
    Write {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// Clients have saved as much as they may.
    #[error(transparent)]
    NoRoom(#[from] SavedFilesError),
    /// A map could not be read or written.
    #[error(transparent)]
    Map(#[from] MapFileError),
    /// A session could not be read, or has a value with which it could not be read again.
    #[error(transparent)]
    Session(#[from] SessionFileError),
    /// A map can only be localized in.
    #[error(
        "{} is a map and no session: it can be localized in, but not continued (load FILE --localize)",
        .0.display()
    )]
    MapIsNoSession(PathBuf),
    /// There is no file at any of the places.
    #[error("no session or map of that name: there is no {}", .0.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(" and no "))]
    NoneToLoad(Vec<PathBuf>),
    /// A session without nodes.
    #[error("{} has no map in it", .0.display())]
    EmptySession(PathBuf),
}

impl FileJobError {
    /// Returns whether the reason is that there is no such file.
    pub fn is_missing(&self) -> bool {
        match self {
            Self::Session(why) => why.is_missing(),
            // A map whose image is missing is there.
            Self::Map(MapFileError::Io { file, source }) => {
                source.kind() == std::io::ErrorKind::NotFound && session_file::is_map(file)
            }
            _ => false,
        }
    }
}
