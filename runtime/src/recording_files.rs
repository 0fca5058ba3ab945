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

    /// Counts messages that are in a file.
    pub fn add_messages(&self, count: u64) {
        self.messages.fetch_add(count, Ordering::Relaxed);
    }

    /// Returns the number of messages that were dropped, because too much waited or the recording had ended.
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Counts messages that were dropped.
    pub fn add_dropped(&self, count: u64) {
        self.dropped.fetch_add(count, Ordering::Relaxed);
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
pub enum FileError {
    /// The system refuses to write.
    #[error("cannot write {path}: {source}")]
    Io {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The disk is nearly full.
    #[error("{path}: {free_mb} MB of disk are left, and {keep_mb} MB are kept for maps and report")]
    DiskFull {
        /// Path of the file.
        path: PathBuf,
        /// Free space, megabytes.
        free_mb: u64,
        /// Space that is left free, megabytes.
        keep_mb: u64,
    },
    /// The file is not where it was.
    #[error("{path} was moved or deleted while it was written: what was recorded until then went with it")]
    Gone {
        /// Path of the file.
        path: PathBuf,
    },
}

/// Returns an error if less than `keep_bytes` would be free on a disk after so many more bytes.
fn check_free(path: &Path, disk: &rustix::fs::StatVfs, keep_bytes: u64, bytes: u64) -> Result<(), FileError> {
    let free = disk.f_bavail.saturating_mul(disk.f_frsize);
    if free >= keep_bytes.saturating_add(bytes) {
        return Ok(());
    }
    let (free_mb, keep_mb) = (free / BYTES_PER_MB, keep_bytes / BYTES_PER_MB);
    Err(FileError::DiskFull { path: path.to_owned(), free_mb, keep_mb })
}

/// Files of a recording, by their first name: `NAME.mcap`, `NAME_1.mcap` and so on. None is overwritten.
pub struct RecordingFiles {
    first: PathBuf,
    disk_free_bytes: u64,
    file: Option<(PathBuf, File)>,
    /// Bytes of this file.
    file_bytes: u64,
    all: Vec<PathBuf>,
    /// Files that were there before the first of these.
    earlier: Vec<PathBuf>,
}

impl RecordingFiles {
    /// Names the files after the first; none is opened yet. So many bytes of the disk are left free.
    pub fn new(first: &Path, disk_free_bytes: u64) -> Self {
        let (all, earlier) = (Vec::new(), Vec::new());
        Self { first: first.into(), disk_free_bytes, file: None, file_bytes: 0, all, earlier }
    }

    /// Returns the files.
    pub fn finish(self) -> Written {
        Written { files: self.all, earlier: self.earlier }
    }

    /// Checks whether the disk of the files has space for a recording, before one begins.
    ///
    /// # Errors
    /// The disk is nearly full.
    pub fn check_space(&self) -> Result<(), FileError> {
        let folder = self.first.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."));
        let disk = rustix::fs::statvfs(folder);
        disk.map_or(Ok(()), |disk| check_free(&self.first, &disk, self.disk_free_bytes, 0))
    }

    /// Ends the file before, begins the next one and returns its name.
    ///
    /// # Errors
    /// No file can be created.
    pub fn begin_file(&mut self) -> Result<String, FileError> {
        self.file = None;
        let stem = self.first.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let extension = self.first.extension().unwrap_or("mcap".as_ref()).to_string_lossy().into_owned();
        let name = |index: usize| match index {
            0 => self.first.clone(),
            // A point in the stem belongs to the name.
            _ => self.first.with_file_name(format!("{stem}_{index}.{extension}")),
        };
        for path in (0..FILES_MAX).map(name) {
            match OpenOptions::new().write(true).create_new(true).open(&path) {
                Ok(file) => {
                    self.all.push(path.clone());
                    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
                    (self.file, self.file_bytes) = (Some((path, file)), 0);
                    return Ok(name);
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

    /// Appends bytes to the file, all of them or none that counts.
    ///
    /// # Errors
    /// The file is gone, the disk is nearly full, or the system refuses. Append nothing more then.
    pub fn append(&mut self, bytes: &[u8]) -> Result<(), FileError> {
        let Some((path, file)) = &mut self.file else { return Ok(()) };
        let identity = |of: Metadata| (of.dev(), of.ino());
        if std::fs::metadata(&*path).ok().map(identity) != file.metadata().ok().map(identity) {
            return Err(FileError::Gone { path: path.clone() });
        }
        // A system that does not say how much is free writes until it fails.
        if let Ok(disk) = rustix::fs::fstatvfs(&*file) {
            check_free(path, &disk, self.disk_free_bytes, bytes.len() as u64)?;
        }
        file.write_all(bytes).map_err(|source| FileError::Io { path: path.clone(), source })?;
        self.file_bytes += bytes.len() as u64;
        Ok(())
    }

    /// Returns the bytes of the file that was begun last.
    pub fn file_bytes(&self) -> u64 {
        self.file_bytes
    }
}
