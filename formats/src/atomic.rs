//! Files that appear whole or not at all: written under a temporary name in the same folder, then renamed.

use crate::regular;
use std::borrow::Cow;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use tempfile::NamedTempFile;

/// A file that is written whole, under a temporary name. It is removed if it does not replace another.
pub struct Prepared {
    path: PathBuf,
    temporary: NamedTempFile,
}

impl Prepared {
    /// Writes a file that every user may read under a temporary name beside its path. Of a link the file is written to which it leads;
    /// a device or pipe is an error.
    pub fn write(
        path: &Path,
        fill: impl FnOnce(&mut io::BufWriter<&File>) -> io::Result<()>,
    ) -> io::Result<Self> {
        let path = target(path)?.into_owned();
        let mut temporary = readable_by_all().tempfile_in(folder(&path))?;
        let mut buffered = io::BufWriter::new(&*temporary.as_file_mut());
        fill(&mut buffered).and_then(|()| buffered.flush())?;
        drop(buffered);
        Ok(Self { path, temporary })
    }

    /// Gives the file its name, and replaces one that has it.
    pub fn replace(self) -> io::Result<()> {
        self.temporary.persist(self.path).map(drop).map_err(|error| error.error)
    }
}

/// Writes a file that every user may read. A reader never sees half of it; a power cut may lose it. Links and devices as in
/// [`Prepared::write`].
pub fn write(path: &Path, fill: impl FnOnce(&mut io::BufWriter<&File>) -> io::Result<()>) -> io::Result<()> {
    Prepared::write(path, fill)?.replace()
}

/// Writes a file of this user's and waits until the disk has it: after a crash, the file is the old one or the new one. Links and
/// devices as in [`write()`].
pub fn write_durably(path: &Path, fill: impl FnOnce(&mut File) -> io::Result<()>) -> io::Result<()> {
    let path = &*target(path)?;
    let folder = folder(path);
    let mut temporary = NamedTempFile::new_in(folder)?;
    fill(temporary.as_file_mut()).and_then(|()| temporary.as_file().sync_all())?;
    temporary.persist(path).map_err(|error| error.error)?;
    // The rename itself is in the folder.
    File::open(folder).and_then(|folder| folder.sync_all())
}

/// The file that a new one replaces: a link's target, if it exists.
fn target(path: &Path) -> io::Result<Cow<'_, Path>> {
    if let Ok(kind) = std::fs::metadata(path) {
        regular::check(&kind)?;
    }
    let is_link = std::fs::symlink_metadata(path).is_ok_and(|kind| kind.is_symlink());
    let real = if is_link { path.canonicalize().ok() } else { None };
    Ok(real.map_or(Cow::Borrowed(path), Cow::Owned))
}

fn folder(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Temporary files are private by default; a map is not.
fn readable_by_all() -> tempfile::Builder<'static, 'static> {
    let mut builder = tempfile::Builder::new();
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(unix)]
    #[test]
    fn a_link_stays_and_a_device_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let (path, link) = (folder.path().join("a.slam"), folder.path().join("link.slam"));
        std::fs::write(&path, "old").unwrap();
        std::os::unix::fs::symlink("a.slam", &link).unwrap();
        write(&link, |file| file.write_all(b"new")).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        write_durably(&link, |file| file.write_all(b"newer")).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"newer");
        assert!(std::fs::symlink_metadata(&link).unwrap().is_symlink());
        let (socket, inside) = (folder.path().join("socket"), folder.path().join("inside"));
        let _socket = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        std::fs::create_dir(&inside).unwrap();
        for other in [socket, inside] {
            let why = write(&other, |file| file.write_all(b"new")).unwrap_err();
            assert_eq!(
                why.to_string(),
                "is a folder, device or pipe; expected a file",
                "{}",
                other.display()
            );
            assert!(write_durably(&other, |file| file.write_all(b"new")).is_err());
            assert!(!other.is_file());
        }
    }

    #[test]
    fn a_full_disk_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.slam");
        write_durably(&path, |file| file.write_all(b"old")).unwrap();
        let full = || Err(io::Error::from(io::ErrorKind::StorageFull));
        let error = write_durably(&path, |file| file.write_all(b"ne").and_then(|()| full())).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::StorageFull);
        assert!(write(&path, |file| file.write_all(b"ne").and_then(|()| full())).is_err());
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
