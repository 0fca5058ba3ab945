//! Opens files, and refuses what is no regular file: a pipe would keep its reader waiting, and a device is not to be replaced.

use std::fs::{File, Metadata};
use std::io;
use std::path::Path;

/// Opens a regular file to read it.
///
/// # Errors
/// It cannot be opened, or is a folder, device or pipe: opening a pipe would wait until somebody writes to it.
pub fn open(path: &Path) -> io::Result<File> {
    check(&std::fs::metadata(path)?)?;
    File::open(path)
}

/// Checks that this is what the file system says of a regular file.
pub fn check(kind: &Metadata) -> io::Result<()> {
    let wrong =
        || io::Error::new(io::ErrorKind::InvalidInput, "is a folder, device or pipe; expected a file");
    if kind.is_file() { Ok(()) } else { Err(wrong()) }
}
