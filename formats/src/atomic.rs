//! Files that appear whole or not at all: written under a temporary name in the same folder, then renamed.

use std::fs::File;
use std::io::{self, Write};
use std::path::Path;

/// Writes a file that every user may read. A reader never sees half of it; a power cut may lose it.
pub fn write(path: &Path, fill: impl FnOnce(&mut io::BufWriter<&File>) -> io::Result<()>) -> io::Result<()> {
    let mut temporary = readable_by_all().tempfile_in(folder(path))?;
    let mut buffered = io::BufWriter::new(&*temporary.as_file_mut());
    fill(&mut buffered).and_then(|()| buffered.flush())?;
    drop(buffered);
    temporary.persist(path).map(drop).map_err(|error| error.error)
}

/// Writes a file of this user's and waits until the disk has it: after a crash, the file is the old one or the new one.
pub fn write_durably(path: &Path, fill: impl FnOnce(&mut File) -> io::Result<()>) -> io::Result<()> {
    let folder = folder(path);
    let mut temporary = tempfile::NamedTempFile::new_in(folder)?;
    fill(temporary.as_file_mut()).and_then(|()| temporary.as_file().sync_all())?;
    temporary.persist(path).map_err(|error| error.error)?;
    // The rename itself is in the folder.
    File::open(folder).and_then(|folder| folder.sync_all())
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
