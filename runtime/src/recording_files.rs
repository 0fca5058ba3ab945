//! Files of a recording, to which bytes are appended until the disk is nearly full.

use std::fs::{File, Metadata, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Most files of a recording.
const FILES_MAX: usize = 10_000;
/// Bytes of a megabyte, in messages.
const BYTES_PER_MB: u64 = 1_000_000;

/// What has become of a recording.
#[derive(Debug, Default)]
pub struct Written {
    /// Files, in the order of their messages.
    pub files: Vec<PathBuf>,
    /// Files of the same name that were there before, as after a recorder was killed.
    pub earlier: Vec<PathBuf>,
    /// Why something could not be written.
    pub failure: Option<String>,
}

/// Numbers of messages, which other threads read while it records.
#[derive(Debug, Default)]
pub struct RecordingCounts {
    messages: AtomicU64,
    dropped: AtomicU64,
    has_ended: AtomicBool,
}

impl RecordingCounts {
    /// Returns the number of recorded messages.
    pub fn messages(&self) -> u64 {
        self.messages.load(Ordering::Relaxed)
    }

    /// Counts a message that was recorded.
    pub fn add_message(&self) {
        self.messages.fetch_add(1, Ordering::Relaxed);
    }

    /// Returns the number of messages that were dropped, because too much waited or the recording had ended.
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Counts a message that was dropped.
    pub fn add_dropped(&self) {
        self.dropped.fetch_add(1, Ordering::Relaxed);
    }

    /// Returns whether the recording has ended, because the disk is full.
    pub fn has_ended(&self) -> bool {
        self.has_ended.load(Ordering::Relaxed)
    }

    /// Says that the recording has ended.
    pub fn set_ended(&self) {
        self.has_ended.store(true, Ordering::Relaxed);
    }
}

/// Reason why a recording cannot go on.
#[derive(Debug, thiserror::Error)]
enum FileError {
    #[error("cannot write {path}: {source}")]
    Io { path: PathBuf, source: io::Error },
    #[error("{path}: {free_mb} MB of disk are left, and {keep_mb} MB are kept for maps and report")]
    DiskFull { path: PathBuf, free_mb: u64, keep_mb: u64 },
    #[error("{path} was moved or deleted while it was written: what was recorded until then went with it")]
    Gone { path: PathBuf },
}

/// Files of a recording, by their first name: `NAME.mcap`, `NAME_1.mcap` and so on. None is overwritten.
pub struct RecordingFiles {
    first: PathBuf,
    disk_free_bytes: u64,
    file: Option<(PathBuf, File)>,
    all: Vec<PathBuf>,
    /// Files that were there before the first of these.
    earlier: Vec<PathBuf>,
    /// Why no more can be written.
    failure: Option<FileError>,
}

impl RecordingFiles {
    /// Names the files after the first; none is opened yet. So many bytes of the disk are left free.
    pub fn new(first: &Path, disk_free_bytes: u64) -> Self {
        let (all, earlier) = (Vec::new(), Vec::new());
        Self { first: first.into(), disk_free_bytes, file: None, all, earlier, failure: None }
    }

    /// Ends the file before and begins the next one.
    pub fn begin_file(&mut self) {
        self.attempt(Self::begin);
    }

    /// Appends bytes to the file.
    pub fn append(&mut self, bytes: &[u8]) {
        self.attempt(|files| files.write(bytes));
    }

    /// Returns why no more can be written.
    pub fn failure(&self) -> Option<String> {
        self.failure.as_ref().map(ToString::to_string)
    }

    /// Returns the files, and why something could not be written.
    pub fn finish(self) -> Written {
        let failure = self.failure();
        Written { files: self.all, earlier: self.earlier, failure }
    }

    fn attempt(&mut self, act: impl FnOnce(&mut Self) -> Result<(), FileError>) {
        if self.failure.is_none() {
            self.failure = act(self).err();
        }
    }

    fn begin(&mut self) -> Result<(), FileError> {
        self.file = None;
        let stem = self.first.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let extension = self.first.extension().unwrap_or("mcap".as_ref()).to_owned();
        let name = |index: usize| match index {
            0 => self.first.clone(),
            _ => self.first.with_file_name(format!("{stem}_{index}")).with_extension(&extension),
        };
        for path in (0..FILES_MAX).map(name) {
            match OpenOptions::new().write(true).create_new(true).open(&path) {
                Ok(file) => {
                    self.all.push(path.clone());
                    self.file = Some((path, file));
                    return Ok(());
                }
                Err(why) if why.kind() == io::ErrorKind::AlreadyExists => {
                    if self.all.is_empty() {
                        self.earlier.push(path);
                    }
                }
                Err(source) => return Err(FileError::Io { path, source }),
            }
        }
        let source = io::Error::other(format!("{FILES_MAX} files exist"));
        Err(FileError::Io { path: self.first.clone(), source })
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), FileError> {
        let Some((path, file)) = &mut self.file else { return Ok(()) };
        let identity = |of: Metadata| (of.dev(), of.ino());
        if std::fs::metadata(&*path).ok().map(identity) != file.metadata().ok().map(identity) {
            return Err(FileError::Gone { path: path.clone() });
        }
        // A system that does not say how much is free writes until it fails.
        if let Ok(disk) = rustix::fs::fstatvfs(&*file) {
            let free = disk.f_bavail.saturating_mul(disk.f_frsize);
            if free < self.disk_free_bytes.saturating_add(bytes.len() as u64) {
                let (free_mb, keep_mb) = (free / BYTES_PER_MB, self.disk_free_bytes / BYTES_PER_MB);
                return Err(FileError::DiskFull { path: path.clone(), free_mb, keep_mb });
            }
        }
        file.write_all(bytes).map_err(|source| FileError::Io { path: path.clone(), source })
    }
}
