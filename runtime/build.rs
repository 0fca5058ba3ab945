//! Gives the program a number of its channels' layout: a hash of the sources that define messages and channels.

use std::path::{Path, PathBuf};
use std::{fs, io};

/// Sources of the messages' fields, of the channels' settings, and of the version of iceoryx2.
const SOURCES: [&str; 4] = ["../msg/src", "src/channel", "src/channel.rs", "Cargo.toml"];

fn main() -> io::Result<()> {
    let mut files = Vec::new();
    for source in SOURCES {
        println!("cargo::rerun-if-changed={source}");
        collect(Path::new(source), &mut files)?;
    }
    files.sort();
    let mut hash = FNV_OFFSET;
    for file in files {
        hash = fnv1a(hash, &fs::read(file)?);
    }
    println!("cargo::rustc-env=MR_SLAM_LAYOUT={hash:016x}");
    Ok(())
}

/// Adds a file, or all files below a folder.
fn collect(path: &Path, files: &mut Vec<PathBuf>) -> io::Result<()> {
    if path.is_dir() {
        fs::read_dir(path)?.try_for_each(|entry| collect(&entry?.path(), files))
    } else {
        files.push(path.into());
        Ok(())
    }
}

/// Start of the hash of Fowler, Noll and Vo (FNV-1a, 64 bits).
const FNV_OFFSET: u64 = 0xcbf2_9ce4_8422_2325;

/// Adds bytes to the hash.
fn fnv1a(hash: u64, bytes: &[u8]) -> u64 {
    bytes.iter().fold(hash, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3))
}
