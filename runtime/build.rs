//! Gives the program a number of its channels' layout: a hash of the sources that define messages, channels, limits and names.

use std::path::{Path, PathBuf};
use std::{fs, io};

/// Files, and folders with files, of the messages' fields, of the channels' settings, and of all else in shared memory.
const SOURCES: [&str; 7] = [
    "../msg/src",
    "src/channel",
    "src/channel.rs",
    "src/shared_memory",
    "src/shared_memory.rs",
    "src/progress.rs",
    "src/processes.rs",
];
/// File whose line on iceoryx2 has the version of the transport.
const MANIFEST: &str = "Cargo.toml";

fn main() -> io::Result<()> {
    let mut files = Vec::new();
    for source in SOURCES {
        println!("cargo::rerun-if-changed={source}");
        collect(Path::new(source), &mut files)?;
    }
    files.sort();
    println!("cargo::rerun-if-changed={MANIFEST}");
    let manifest = fs::read_to_string(MANIFEST)?;
    let mut hash = manifest
        .lines()
        .filter(|line| line.starts_with("iceoryx2"))
        .fold(FNV_OFFSET, |hash, line| fnv1a(hash, line.as_bytes()));
    for file in files {
        hash = fnv1a(hash, &fs::read(file)?);
    }
    println!("cargo::rustc-env=MR_SLAM_LAYOUT={hash:016x}");
    Ok(())
}

/// Adds a file, or all Rust files below a folder: an editor's backups say nothing of the program.
fn collect(path: &Path, files: &mut Vec<PathBuf>) -> io::Result<()> {
    if path.is_dir() {
        fs::read_dir(path)?.try_for_each(|entry| collect(&entry?.path(), files))
    } else {
        files.extend(path.extension().is_some_and(|extension| extension == "rs").then(|| path.into()));
        Ok(())
    }
}

/// Start of the hash of Fowler, Noll and Vo (FNV-1a, 64 bits).
const FNV_OFFSET: u64 = 0xcbf2_9ce4_8422_2325;

/// Adds bytes to the hash.
fn fnv1a(hash: u64, bytes: &[u8]) -> u64 {
    bytes.iter().fold(hash, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3))
}
