//! Files of one log: a file, the folder of a rosbag2 bag, or the parts into which a recorder split one.

use super::ReplayError;
use crate::command::output;
use formats::bag_folder::{files_of, unlisted};
use msg::{Scan, Stamp};
use recording::RecordingReader;
use recording::bag::{Bag, BagOptions, BagReader, RecordedTimes};
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

/// Longest pause between the scans of two parts of a bag, seconds: a recorder that was started again.
const PAUSE_MAX_S: f64 = 10.0;
/// Longest time that the scans of two parts of a bag overlap, seconds: messages are not written in the order of their times.
const OVERLAP_MAX_S: f64 = 1.0;

/// Says which files of a bag's folder are not read, and returns their paths.
pub fn note_unlisted(folder: &Path, listed: &[PathBuf]) -> Vec<String> {
    let names = if folder.is_dir() { unlisted(folder, listed) } else { Vec::new() };
    if !names.is_empty() {
        output::note(&format!(
            "{}: not read, because they are empty, or neither recording.json nor metadata.yaml lists them (`ros2 bag reindex` writes \
             metadata.yaml anew): {}",
            folder.display(),
            names.join(", "),
        ));
    }
    names.iter().map(|name| folder.join(name).display().to_string()).collect()
}

/// Reads the scans and the odometry of one robot from recordings that are one log: folders, or parts without longer pauses between
/// them. Returns them with the files of the folders that are not read.
pub fn read_bag(paths: &[PathBuf], options: &BagOptions) -> Result<(Bag, Vec<String>), ReplayError> {
    let mut not_read = Vec::new();
    let mut bag = BagReader::new(options.clone());
    let mut scan: Box<Scan> = bytemuck::allocation::zeroed_box();
    let mut parts: Vec<((Stamp, Stamp), &PathBuf)> = Vec::new();
    for path in paths {
        let mut of_scans: Option<(Stamp, Stamp)> = None;
        let files = files_of(path)?;
        not_read.extend(note_unlisted(path, &files));
        // The files of a folder were written in their order; parts that a person names may have any.
        let mut times = RecordedTimes::default();
        for file in files {
            let opened =
                File::open(&file).map_err(|source| ReplayError::Read { path: file.clone(), source })?;
            let ends = bag
                .add(
                    &file.display().to_string(),
                    &mut RecordingReader::new(BufReader::new(opened)),
                    &mut times,
                    &mut scan,
                )
                .map_err(|why| ReplayError::Bag { path: file.clone(), why: why.into() })?;
            of_scans = match (of_scans, ends) {
                (Some((first, last)), Some((next, end))) => Some((first.min(next), last.max(end))),
                (one, other) => one.or(other),
            };
        }
        parts.extend(of_scans.map(|ends| (ends, path)));
    }
    parts.sort();
    for pair in parts.windows(2) {
        let [((_, ended), first), ((begins, _), second)] = pair else { continue };
        let pause_s = *begins - *ended;
        if !(-OVERLAP_MAX_S..=PAUSE_MAX_S).contains(&pause_s) {
            let (first, second) = ((*first).clone(), (*second).clone());
            return Err(ReplayError::NotOneBag { first, second, pause_s });
        }
    }
    let bag = bag.finish().map_err(|why| ReplayError::Bag { path: paths[0].clone(), why })?;
    Ok((bag, not_read))
}
