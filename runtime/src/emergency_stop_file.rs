//! The emergency stop of a run on the disk, where it outlives a bridge that does not answer.

use crate::storage::{DiskStorage, Storage};
use msg::Monotonic;
use std::io;
use std::os::unix::fs::MetadataExt as _;
use std::panic::resume_unwind;
use std::path::Path;

/// Sets a run's emergency stop on the disk: the bridge sets it when it reads the file, or when it starts.
pub fn latch_stop(storage: &impl Storage, path: &Path, now: Monotonic) -> io::Result<()> {
    let pid = std::process::id();
    let text = format!("The emergency stop is set, by `mr-slam stop` of process {pid} at {} ns.\n", now.0);
    storage.write(path, text.as_bytes())
}

/// A stop on the disk, as it is at one moment. One that is set anew differs, even with the same content.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LatchedStop {
    inode: u64,
    /// Time of its last change, seconds and nanoseconds.
    changed: [i64; 2],
}

impl LatchedStop {
    /// Looks at a run's stop; `None`: there is none, or it cannot be looked at.
    pub fn look(path: &Path) -> Option<Self> {
        let about = path.metadata().ok()?;
        Some(Self { inode: about.ino(), changed: [about.ctime(), about.ctime_nsec()] })
    }
}

/// Sets it on the disk while `ask` asks the bridge for it: neither waits for the other, as a disk may be slow and a bridge may hang.
/// Returns what `ask` does, and whether the file was written.
pub fn latch_while<T>(path: &Path, ask: impl FnOnce() -> T) -> (T, io::Result<()>) {
    std::thread::scope(|scope| {
        let latched = scope.spawn(|| latch_stop(&DiskStorage, path, crate::clock::now()));
        (ask(), latched.join().unwrap_or_else(|why| resume_unwind(why)))
    })
}
