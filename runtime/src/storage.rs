//! Storage of files that outlive a process: the run's folder on the disk, or a folder in memory for lockstep.

use formats::atomic::write_durably;
use formats::map_file::{self, MapFileError};
use formats::regular;
use msg::{Grid, GridView};
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;

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
    /// Writes bytes at a place in a file, and cuts off what follows. The file must reach to that place; at 0 it is made,
    /// with its folder. The bytes outlive the process, but not a power cut.
    fn append(&self, path: &Path, at: u64, bytes: &[u8]) -> io::Result<()>;
    /// Writes a map as PGM with YAML, and as PNG, with the reasons why it is unreliable.
    fn write_map(&self, stem: &Path, map: GridView<'_>, reasons: &[&str]) -> Result<(), MapFileError>;
    /// Reads a map from its YAML file.
    fn read_map(&self, path: &Path) -> Result<Grid, MapFileError>;
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
}

fn create_folder_of(path: &Path) -> io::Result<()> {
    path.parent().map_or(Ok(()), std::fs::create_dir_all)
}

/// Bytes that are free in the file system of a folder; `None`: it cannot be asked.
pub fn free_bytes(folder: &Path) -> Option<u64> {
    rustix::fs::statvfs(folder).ok().map(|about| about.f_bavail * about.f_frsize)
}
