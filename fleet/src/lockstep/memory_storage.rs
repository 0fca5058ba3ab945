//! A run's folder in memory, which a fault can make full.

use super::queues::Network;
use crate::ports::Clock;
use crate::storage::{FileCount, Storage};
use formats::map_file::MapFileError;
use msg::{Grid, GridView};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::rc::Rc;

/// Files by their path.
#[derive(Clone)]
pub struct MemoryStorage {
    files: Rc<RefCell<BTreeMap<PathBuf, Vec<u8>>>>,
    network: Rc<Network>,
}

impl MemoryStorage {
    /// Creates an empty folder; `network` has the faults that make it full.
    pub fn new(network: &Rc<Network>) -> Self {
        Self { files: Rc::default(), network: network.clone() }
    }
}

impl Storage for MemoryStorage {
    fn read(&self, path: &Path, bytes_max: u64) -> io::Result<Vec<u8>> {
        let files = self.files.borrow();
        let bytes = files.get(path).ok_or(ErrorKind::NotFound)?;
        if bytes.len() as u64 > bytes_max {
            return Err(ErrorKind::FileTooLarge.into());
        }
        Ok(bytes.clone())
    }

    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        if self.network.faults().is_disk_full(self.network.clock().now()) {
            return Err(ErrorKind::StorageFull.into());
        }
        self.files.borrow_mut().insert(path.to_owned(), bytes.to_vec());
        Ok(())
    }

    fn replace(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        self.write(path, bytes)
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        self.files.borrow_mut().remove(path);
        Ok(())
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        let mut files = self.files.borrow_mut();
        if files.contains_key(to) {
            return Err(ErrorKind::AlreadyExists.into());
        }
        let bytes = files.remove(from).ok_or(ErrorKind::NotFound)?;
        files.insert(to.to_owned(), bytes);
        Ok(())
    }

    fn append(&self, path: &Path, at: u64, bytes: &[u8]) -> io::Result<()> {
        // A file is emptied in place on a full disk, too.
        let needs_room = !bytes.is_empty();
        if needs_room && self.network.faults().is_disk_full(self.network.clock().now()) {
            return Err(ErrorKind::StorageFull.into());
        }
        let mut files = self.files.borrow_mut();
        let file = files.entry(path.to_owned()).or_default();
        if (file.len() as u64) < at {
            return Err(ErrorKind::UnexpectedEof.into());
        }
        file.truncate(at as usize);
        file.extend_from_slice(bytes);
        Ok(())
    }

    fn write_map(&self, _: &Path, _: GridView<'_>, _: &[&str]) -> Result<(), MapFileError> {
        // Nobody reads pictures in lockstep.
        Ok(())
    }

    fn read_map(&self, path: &Path) -> Result<Grid, MapFileError> {
        formats::map_file::read_map(path)
    }

    fn count_files(&self, folder: &Path, files_max: usize) -> io::Result<FileCount> {
        let files = self.files.borrow();
        let mut count = FileCount::default();
        files.iter().filter(|(path, _)| path.starts_with(folder)).take(files_max).for_each(|(_, bytes)| {
            count.add(bytes.len() as u64);
        });
        Ok(count)
    }
}
