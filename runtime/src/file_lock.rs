//! Locks of files and folders, by which others see that a process lives.

use rustix::fs::{FlockOperation, Mode, OFlags, flock};
use rustix::io::Errno;
use std::fs::File;
use std::io;
use std::path::Path;
use std::time::Duration;

/// Attempts to get a lock that somebody may hold for a moment to look at it.
const LOCK_ATTEMPTS: u32 = 10;
/// Pause between two attempts to get a lock.
const LOCK_PAUSE: Duration = Duration::from_millis(5);

/// A locked file or folder. The lock ends with the process.
#[derive(Debug)]
pub struct Lock(#[expect(dead_code, reason = "the open file holds the lock")] File);

impl Lock {
    /// Locks a file of this user, which is made if it does not exist. `None`: another process holds the lock.
    pub fn acquire(path: &Path) -> io::Result<Option<Self>> {
        let flags = OFlags::CREATE | OFlags::RDWR | OFlags::NOFOLLOW | OFlags::CLOEXEC;
        Self::take(File::from(rustix::fs::open(path, flags, Mode::RUSR | Mode::WUSR)?), wait)
    }

    /// Locks a folder of this user: systemd-tmpfiles, which removes old files below `/tmp`, leaves out locked folders. `None`: another
    /// process holds the lock.
    pub fn acquire_folder(path: &Path) -> io::Result<Option<Self>> {
        let flags = OFlags::DIRECTORY | OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::CLOEXEC;
        Self::take(File::from(rustix::fs::open(path, flags, Mode::empty())?), wait)
    }

    /// Takes the lock, with some patience: who looks whether it is held takes it for a moment.
    fn take(file: File, mut wait: impl FnMut()) -> io::Result<Option<Self>> {
        for attempt in 1.. {
            match flock(&file, FlockOperation::NonBlockingLockExclusive) {
                Ok(()) => return Ok(Some(Self(file))),
                Err(Errno::WOULDBLOCK) if attempt < LOCK_ATTEMPTS => wait(),
                Err(Errno::WOULDBLOCK) => break,
                Err(why) => return Err(why.into()),
            }
        }
        Ok(None)
    }

    /// Returns whether a process holds the lock of a file or folder.
    pub fn is_held(path: &Path) -> bool {
        let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::CLOEXEC;
        let Ok(file) = rustix::fs::open(path, flags, Mode::empty()) else { return false };
        flock(&file, FlockOperation::NonBlockingLockShared) == Err(Errno::WOULDBLOCK)
    }
}

/// Waits until a lock is tried again.
fn wait() {
    std::thread::sleep(LOCK_PAUSE);
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::os::unix::fs::symlink;

    #[test]
    fn a_lock_is_held_by_one_and_never_through_a_link() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lock");
        assert!(!Lock::is_held(&path));
        let lock = Lock::acquire(&path).unwrap().unwrap();
        assert!(Lock::is_held(&path) && Lock::acquire(&path).unwrap().is_none());
        drop(lock);
        assert!(!Lock::is_held(&path));
        let victim = folder.path().join("victim");
        fs::write(&victim, "precious").unwrap();
        let link = folder.path().join("link");
        symlink(&victim, &link).unwrap();
        assert!(Lock::acquire(&link).is_err() && !Lock::is_held(&link));
    }

    #[test]
    fn who_looks_at_a_lock_does_not_keep_another_from_taking_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lock");
        drop(Lock::acquire(&path).unwrap());
        let open = || File::open(&path).unwrap();
        let looker = open();
        flock(&looker, FlockOperation::NonBlockingLockShared).unwrap();
        let mut looker = Some(looker);
        assert!(Lock::take(open(), || drop(looker.take())).unwrap().is_some());
        let _holder = Lock::acquire(&path).unwrap().unwrap();
        let mut waits = 0;
        assert!(Lock::take(open(), || waits += 1).unwrap().is_none() && waits < LOCK_ATTEMPTS);
    }
}
