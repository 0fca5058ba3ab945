//! Storage of files that outlive a process: the run's folder on the disk, or a folder in memory for lockstep.

use formats::atomic::write_durably;
use formats::map_file::{self, MapFileError};
use formats::regular;
use msg::{Grid, GridView};
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Ending of a file that could not be used, and was kept.
const KEPT_ENDING: &str = "unreadable";
/// Largest number of files that are kept of one name.
const KEPT_MAX: u32 = 9;

/// Reads and writes files.
pub trait Storage: Clone + 'static {
    /// Reads a file of at most `bytes_max` bytes.
    fn read(&self, path: &Path, bytes_max: u64) -> io::Result<Vec<u8>>;
    /// Writes a file, and its folder if need be. At any moment the file is the old one or the new one.
    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()>;
    /// Writes a file without waiting for the disk: at any moment it is the old or the new one, but a power cut may lose it.
    fn replace(&self, path: &Path, bytes: &[u8]) -> io::Result<()>;
    /// Removes a file; it is no error if there is none.
    fn remove(&self, path: &Path) -> io::Result<()>;
    /// Renames a file. It is an error if the new name is taken.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;
    /// Writes bytes at a place in a file, and cuts off what follows. The file must reach to that place; at 0 it is made,
    /// with its folder. The bytes outlive the process, but not a power cut.
    fn append(&self, path: &Path, at: u64, bytes: &[u8]) -> io::Result<()>;
    /// Writes a map as PGM with YAML, and as PNG, with the reasons why it is unreliable.
    fn write_map(&self, stem: &Path, map: GridView<'_>, reasons: &[&str]) -> Result<(), MapFileError>;
    /// Reads a map from its YAML file.
    fn read_map(&self, path: &Path) -> Result<Grid, MapFileError>;
    /// Counts the files below a folder until there are `files_max`; a folder that is not there has none.
    fn count_files(&self, folder: &Path, files_max: usize) -> io::Result<FileCount>;
}

/// Number and size of files.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FileCount {
    /// Number of files.
    pub files: usize,
    /// Sum of their lengths, bytes.
    pub bytes: u64,
}

impl FileCount {
    /// Counts one more file of this length, bytes.
    pub fn add(&mut self, bytes: u64) {
        self.files += 1;
        self.bytes = self.bytes.saturating_add(bytes);
    }
}

/// Renames a file that cannot be used, so that what is saved in its place does not overwrite it: it may be whole, and only the disk may
/// have failed. Returns what came of it, for a person.
pub fn keep_unusable(storage: &impl Storage, path: &Path) -> String {
    let kept = |number: u32| {
        let mut name = path.to_owned().into_os_string();
        name.push(format!(".{KEPT_ENDING}"));
        if number > 1 {
            name.push(number.to_string());
        }
        PathBuf::from(name)
    };
    for to in (1..=KEPT_MAX).map(kept) {
        match storage.rename(path, &to) {
            Ok(()) => return format!("it is kept as {}", to.display()),
            Err(why) if why.kind() == io::ErrorKind::AlreadyExists => {}
            Err(why) => return format!("it cannot be renamed ({why}) and may be overwritten"),
        }
    }
    format!("{KEPT_MAX} such files are kept already, and this one may be overwritten")
}

/// The machine's file system; lockstep keeps files in memory instead.
#[derive(Clone, Copy, Debug)]
pub struct DiskStorage;

impl Storage for DiskStorage {
    fn read(&self, path: &Path, bytes_max: u64) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        regular::open(path)?.take(bytes_max.saturating_add(1)).read_to_end(&mut bytes)?;
        if bytes.len() as u64 > bytes_max {
            return Err(io::Error::other(format!("is longer than {bytes_max} bytes")));
        }
        Ok(bytes)
    }

    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        create_folder_of(path)?;
        write_durably(path, |file| file.write_all(bytes))
    }

    fn replace(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        create_folder_of(path)?;
        formats::atomic::write(path, |file| file.write_all(bytes))
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        match std::fs::remove_file(path) {
            Err(why) if why.kind() == io::ErrorKind::NotFound => Ok(()),
            result => result,
        }
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        if to.symlink_metadata().is_ok() {
            return Err(io::ErrorKind::AlreadyExists.into());
        }
        std::fs::rename(from, to)
    }

    fn append(&self, path: &Path, at: u64, bytes: &[u8]) -> io::Result<()> {
        if at == 0 {
            create_folder_of(path)?;
        }
        let mut file = File::options().write(true).create(at == 0).truncate(at == 0).open(path)?;
        let length = file.metadata()?.len();
        if length < at {
            return Err(io::Error::other(format!("has {length} bytes, expected {at}")));
        }
        file.set_len(at)?;
        file.seek(SeekFrom::Start(at))?;
        file.write_all(bytes)
    }

    fn write_map(&self, stem: &Path, map: GridView<'_>, reasons: &[&str]) -> Result<(), MapFileError> {
        // If this fails, writing the file reports the reason.
        let _ = create_folder_of(stem);
        map_file::write_map_with_reasons(stem, map, reasons)
    }

    fn read_map(&self, path: &Path) -> Result<Grid, MapFileError> {
        map_file::read_map(path)
    }

    fn count_files(&self, folder: &Path, files_max: usize) -> io::Result<FileCount> {
        let mut count = FileCount::default();
        let mut folders = vec![folder.to_owned()];
        while let Some(folder) = folders.pop() {
            let entries = match std::fs::read_dir(&folder) {
                Err(why) if why.kind() == io::ErrorKind::NotFound => continue,
                entries => entries?,
            };
            for entry in entries {
                // Not through links, which may lead in circles.
                let about = entry.as_ref().map_err(|why| io::Error::from(why.kind()))?.metadata()?;
                match about.is_dir() {
                    true => folders.push(entry?.path()),
                    false => count.add(about.len()),
                }
                // Folders that clients made count by what they take of the limit, too.
                if count.files + folders.len() >= files_max {
                    return Ok(FileCount { files: files_max, ..count });
                }
            }
        }
        Ok(count)
    }
}

fn create_folder_of(path: &Path) -> io::Result<()> {
    path.parent().map_or(Ok(()), std::fs::create_dir_all)
}

/// Bytes that are free in the file system of a folder; `None`: it cannot be asked.
pub fn free_bytes(folder: &Path) -> Option<u64> {
    rustix::fs::statvfs(folder).ok().map(|about| about.f_bavail * about.f_frsize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_counted_in_all_folders_and_no_further_than_asked() {
        let folder = tempfile::tempdir().unwrap();
        let count = |files_max| DiskStorage.count_files(folder.path(), files_max).unwrap();
        assert_eq!(DiskStorage.count_files(&folder.path().join("none"), 9).unwrap(), FileCount::default());
        for name in ["a.slam", "b/c.slam", "b/d/e.slam"] {
            DiskStorage.replace(&folder.path().join(name), b"1234").unwrap();
        }
        std::os::unix::fs::symlink(folder.path(), folder.path().join("b/circle")).unwrap();
        let all = count(100);
        assert!(all.files == 4 && all.bytes >= 12, "{all:?}");
        assert_eq!(count(2).files, 2);
    }

    #[test]
    fn a_file_that_cannot_be_used_is_kept_whatever_was_kept_before() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("robot1.slam");
        for number in 1..=KEPT_MAX {
            std::fs::write(&path, number.to_string()).unwrap();
            let said = keep_unusable(&DiskStorage, &path);
            assert!(said.contains("robot1.slam.unreadable") && !path.exists(), "{said}");
        }
        std::fs::write(&path, "one more").unwrap();
        assert!(keep_unusable(&DiskStorage, &path).contains("may be overwritten"));
        let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
        assert_eq!(
            ["unreadable", "unreadable2", "unreadable9"].map(|ending| read(&format!("robot1.slam.{ending}"))),
            ["1", "2", "9"]
        );
        assert_eq!(read("robot1.slam"), "one more");
        let missing = keep_unusable(&DiskStorage, &folder.path().join("missing"));
        assert!(missing.contains("cannot be renamed"), "{missing}");
    }
}
