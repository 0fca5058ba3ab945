//! Files of a recording: bytes are appended by a thread of its own, until the disk is nearly full.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

/// Most files of a recording.
const FILES_MAX: usize = 10_000;
/// Bytes of a megabyte, in messages.
const BYTES_PER_MB: u64 = 1_000_000;

/// Where the bytes of a recording go.
pub trait Output {
    /// Ends the file before and begins the next one.
    fn begin_file(&mut self);
    /// Appends bytes to the file.
    fn append(&mut self, bytes: Vec<u8>);
    /// Returns the number of bytes that wait for the disk.
    fn waiting_bytes(&self) -> usize;
    /// Returns why no more can be written.
    fn failure(&self) -> Option<String>;
    /// Waits until all is written. Returns the files, and why something could not be written.
    fn finish(self: Box<Self>) -> Written;
}

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

/// Reason why a recording cannot go on.
#[derive(Debug, thiserror::Error)]
enum FileError {
    #[error("cannot write {path}: {source}")]
    Io { path: PathBuf, source: io::Error },
    #[error("{path}: {free_mb} MB of disk are left, and {keep_mb} MB are kept for maps and report")]
    DiskFull { path: PathBuf, free_mb: u64, keep_mb: u64 },
}

/// Files of a recording, by their first name: `NAME.mcap`, `NAME_1.mcap` and so on. None is overwritten.
pub struct RecordingFiles {
    first: PathBuf,
    disk_free_bytes: u64,
    file: Option<(PathBuf, File)>,
    all: Vec<PathBuf>,
    /// Files that were there before the first of these.
    earlier: Vec<PathBuf>,
}

impl RecordingFiles {
    /// Names the files after the first; none is opened yet. So many bytes of the disk are left free.
    pub fn new(first: &Path, disk_free_bytes: u64) -> Self {
        Self { first: first.into(), disk_free_bytes, file: None, all: Vec::new(), earlier: Vec::new() }
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

    fn append(&mut self, bytes: &[u8]) -> Result<(), FileError> {
        let Some((path, file)) = &mut self.file else { return Ok(()) };
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

/// Writes the files in the calling thread, for lockstep.
pub struct DirectOutput {
    files: RecordingFiles,
    failure: Option<FileError>,
}

impl DirectOutput {
    /// Begins nothing yet.
    pub fn new(files: RecordingFiles) -> Self {
        Self { files, failure: None }
    }

    fn into_written(self) -> Written {
        let RecordingFiles { all, earlier, .. } = self.files;
        Written { files: all, earlier, failure: self.failure.as_ref().map(ToString::to_string) }
    }

    fn attempt(&mut self, write: impl FnOnce(&mut RecordingFiles) -> Result<(), FileError>) {
        if self.failure.is_none() {
            self.failure = write(&mut self.files).err();
        }
    }
}

impl Output for DirectOutput {
    fn begin_file(&mut self) {
        self.attempt(RecordingFiles::begin);
    }

    fn append(&mut self, bytes: Vec<u8>) {
        self.attempt(|files| files.append(&bytes));
    }

    fn waiting_bytes(&self) -> usize {
        0
    }

    fn failure(&self) -> Option<String> {
        self.failure.as_ref().map(ToString::to_string)
    }

    fn finish(self: Box<Self>) -> Written {
        self.into_written()
    }
}

/// Command to the thread that writes.
enum FileCommand {
    Begin,
    Append(Vec<u8>),
}

/// Writes the files in a thread, so that a slow disk holds nothing up. The recorder bounds what waits for it.
pub struct FileThread {
    commands: Sender<FileCommand>,
    waiting_bytes: Arc<AtomicUsize>,
    failure: Arc<Mutex<Option<String>>>,
    thread: JoinHandle<Written>,
}

impl FileThread {
    /// Starts the thread.
    pub fn start(files: RecordingFiles) -> Self {
        let (commands, received) = channel();
        let (waiting_bytes, failure) = (Arc::new(AtomicUsize::new(0)), Arc::new(Mutex::new(None)));
        let (waiting, failed) = (waiting_bytes.clone(), failure.clone());
        let thread = std::thread::spawn(move || {
            let mut output = DirectOutput::new(files);
            for command in received {
                match command {
                    FileCommand::Begin => output.begin_file(),
                    FileCommand::Append(bytes) => {
                        let length = bytes.len();
                        output.append(bytes);
                        waiting.fetch_sub(length, Ordering::Relaxed);
                    }
                }
                if let Some(why) = output.failure() {
                    *failed.lock().unwrap_or_else(|poisoned| poisoned.into_inner()) = Some(why);
                }
            }
            output.into_written()
        });
        Self { commands, waiting_bytes, failure, thread }
    }
}

impl Output for FileThread {
    fn begin_file(&mut self) {
        // The thread lives as long as this end.
        let _ = self.commands.send(FileCommand::Begin);
    }

    fn append(&mut self, bytes: Vec<u8>) {
        self.waiting_bytes.fetch_add(bytes.len(), Ordering::Relaxed);
        let _ = self.commands.send(FileCommand::Append(bytes));
    }

    fn waiting_bytes(&self) -> usize {
        self.waiting_bytes.load(Ordering::Relaxed)
    }

    fn failure(&self) -> Option<String> {
        self.failure.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).clone()
    }

    fn finish(self: Box<Self>) -> Written {
        drop(self.commands);
        self.thread.join().unwrap_or_else(|_| Written {
            failure: Some("the thread that writes the files panicked".into()),
            ..Written::default()
        })
    }
}
