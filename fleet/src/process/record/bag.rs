//! The description of a recording's folder, `metadata.yaml`, with which rosbag2 takes its files as one bag.

use formats::atomic;
use formats::bag_folder::{is_whole_mcap, unlisted};
use recording::rosbag2::{Bag, METADATA_FILE};
use std::fs::File;
use std::io::{self, BufReader, Write};
use std::path::{Path, PathBuf};

/// Writes the description of a folder that is a recording's own. Earlier files are those of a recorder that was killed. A file that ends
/// without its index, as where a recorder was killed or the disk was full, is left out: rosbag2 does not read it.
///
/// # Errors
/// The file cannot be written, or an earlier one cannot be read.
pub fn write_description(bag: &Bag, folder: &Path, earlier: &[PathBuf]) -> io::Result<()> {
    let mut all = Bag { files: Vec::new(), topics: bag.topics.clone() };
    for path in earlier.iter().filter(|path| is_whole_mcap(path)) {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        all.read(&name, BufReader::new(File::open(path)?)).map_err(io::Error::other)?;
    }
    all.files.extend(bag.files.iter().filter(|file| is_whole_mcap(&folder.join(&file.name))).cloned());
    let path = folder.join(METADATA_FILE);
    let written = atomic::write(&path, |file| file.write_all(all.description().as_bytes()));
    written.map_err(|why| io::Error::new(why.kind(), format!("cannot write {}: {why}", path.display())))
}

/// Writes the description of the folder of a recording in several files, if it has no other recording and no description. A single file is a
/// bag without one.
///
/// # Errors
/// The file cannot be written.
pub fn describe_parts(bag: &Bag, files: &[PathBuf]) -> io::Result<()> {
    let [first, _, ..] = files else { return Ok(()) };
    let folder = first.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."));
    let is_alone = unlisted(folder, files).is_empty() && !folder.join(METADATA_FILE).exists();
    if is_alone { write_description(bag, folder, &[]) } else { Ok(()) }
}
