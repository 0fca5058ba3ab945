//! The files of a room, held as they were read: a run keeps a copy of them, and a recording says which they were.

use super::{IMAGE_BYTES_MAX, LABORATORY, ROOM_BYTES_MAX, RoomLoadError, is_map};
use formats::atomic;
use formats::map_file::MapFiles;
use serde::Serialize;
use sha2::{Digest as _, Sha256};
use sim::Room;
use std::ffi::OsString;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

/// Folder with the copy of a room's files, in a run's folder.
const COPY: &str = "room.copy";

/// All files of a room that comes from files.
#[derive(Debug)]
pub struct RoomFiles {
    /// File name of the room, without its folder.
    file_name: OsString,
    content: Content,
}

#[derive(Debug)]
enum Content {
    Map(MapFiles),
    Scan(Vec<u8>),
}

impl RoomFiles {
    /// Reads the files of a room; `None` for one that is built in or generated.
    ///
    /// # Errors
    /// A file cannot be read or is too long, or a map's YAML is malformed. What else is in the files is not looked at.
    pub fn read(name: &str) -> Result<Option<Self>, RoomLoadError> {
        if name == LABORATORY || Room::parse_generated(name).is_some() {
            return Ok(None);
        }
        let path = Path::new(name);
        let content = if is_map(path) {
            let map = MapFiles::read(path, IMAGE_BYTES_MAX);
            Content::Map(map.map_err(|source| RoomLoadError::Map { path: name.into(), source })?)
        } else {
            let bytes = formats::limited::read(path, ROOM_BYTES_MAX);
            Content::Scan(bytes.map_err(|source| RoomLoadError::File { path: name.into(), source })?)
        };
        let file_name = path.file_name().unwrap_or(path.as_os_str()).to_owned();
        Ok(Some(Self { file_name, content }))
    }

    /// Returns the SHA-256 of the room in hexadecimal digits. It does not depend on the names of the files, nor on what a map's YAML
    /// has beside the fields that give the image its meaning.
    pub fn sha256(&self) -> String {
        let mut hash = Sha256::new();
        match &self.content {
            Content::Map(map) => {
                // The fields end with a line of their own.
                hash.update(map.meaning());
                hash.update(map.image());
            }
            Content::Scan(bytes) => hash.update(bytes),
        }
        format!("{:x}", hash.finalize())
    }

    /// Returns the path of the room in the copy that a run's folder has.
    pub fn copy_in(&self, run: &Path) -> PathBuf {
        run.join(COPY).join(&self.file_name)
    }

    /// Writes a copy of the files into a run's folder, see [`RoomFiles::copy_in`].
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn write_copy(&self, run: &Path) -> io::Result<()> {
        let path = self.copy_in(run);
        std::fs::create_dir_all(run.join(COPY))?;
        let write = |path: &Path, bytes: &[u8]| atomic::write(path, |file| file.write_all(bytes));
        match &self.content {
            Content::Scan(bytes) => write(&path, bytes),
            Content::Map(map) => {
                let name = self.file_name.to_str().filter(|name| name.chars().all(is_plain)).unwrap_or("map");
                let image = format!("{name}.image");
                write(&path.with_file_name(&image), map.image())?;
                write(&path, format!("image: \"{image}\"\n{}", map.meaning()).as_bytes())
            }
        }
    }
}

/// Returns the digest of a room's files, see [`RoomFiles::sha256`]; `None` for a room that is built in or generated.
///
/// # Errors
/// As [`RoomFiles::read`].
pub fn sha256(name: &str) -> Result<Option<String>, RoomLoadError> {
    Ok(RoomFiles::read(name)?.map(|files| files.sha256()))
}

/// Whether a room's files are those that a recording, or another run, had.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RecordedRoom {
    /// They are, or the room has no files.
    Same,
    /// They have another content.
    Changed,
    /// They cannot be read.
    Missing,
    /// Nobody knows: the recording does not say which they were.
    NotChecked,
}

impl RecordedRoom {
    /// Compares the files of a room with the digest that was recorded, if there is one.
    pub fn compare(name: &str, recorded_sha256: Option<&str>) -> Self {
        match (sha256(name), recorded_sha256) {
            (Ok(None), _) => Self::Same,
            (_, None) => Self::NotChecked,
            (Ok(Some(here)), Some(recorded)) if here == recorded => Self::Same,
            (Ok(Some(_)), Some(_)) => Self::Changed,
            (Err(_), Some(_)) => Self::Missing,
        }
    }

    /// Returns whether the room may be used as the recorded one.
    pub fn is_usable(self) -> bool {
        matches!(self, Self::Same | Self::NotChecked)
    }

    /// Says what is wrong, for people; `None` if nothing is.
    pub fn note(self, name: &str) -> Option<String> {
        let without = "the replay compares nothing with the room, and the robots start where they did";
        match self {
            Self::Same => None,
            Self::Changed => {
                Some(format!("room {name}: the files have changed since the recording; {without}"))
            }
            Self::Missing => {
                Some(format!("room {name}: the files of the recorded run cannot be read; {without}"))
            }
            Self::NotChecked => Some(format!(
                "room {name}: not checked: the recording does not say which files it had, and those of today are used"
            )),
        }
    }
}

/// Whether YAML holds a character within quotes as it is.
fn is_plain(character: char) -> bool {
    !character.is_control() && !matches!(character, '"' | '\\')
}

/// Returns a room's name for people: without the folder, if it is a run's copy of the room.
pub fn name_for_people(room: &str) -> &str {
    let path = Path::new(room);
    let is_copy = path.parent().and_then(Path::file_name).is_some_and(|folder| folder == COPY);
    path.file_name().and_then(|name| name.to_str()).filter(|_| is_copy).unwrap_or(room)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    const YAML: &str = "image: a.pgm\nresolution: 0.05\norigin: [-1.0, 2.5, 0.0]\nnegate: 0\n\
                        occupied_thresh: 0.65\nfree_thresh: 1e-7\n";

    fn digest(path: &Path) -> String {
        RoomFiles::read(&path.display().to_string()).unwrap().unwrap().sha256()
    }

    #[test]
    fn a_copy_is_the_same_room_when_the_files_are_gone() {
        let folder = tempfile::tempdir().unwrap();
        let (yaml, run) = (folder.path().join("build \u{e9}.yaml"), folder.path().join("run"));
        fs::write(&yaml, YAML).unwrap();
        fs::write(folder.path().join("a.pgm"), "P5 1 1 255\n0").unwrap();
        let files = RoomFiles::read(&yaml.display().to_string()).unwrap().unwrap();
        files.write_copy(&run).unwrap();
        fs::remove_file(&yaml).unwrap();
        fs::remove_file(folder.path().join("a.pgm")).unwrap();
        let copy = files.copy_in(&run);
        assert_eq!(digest(&copy), files.sha256());
        assert_eq!(name_for_people(copy.to_str().unwrap()), "build \u{e9}.yaml");
        assert_eq!(formats::map_file::read_map(&copy).unwrap().header.width, 1);
        // A copy may be copied onto itself.
        let again = RoomFiles::read(copy.to_str().unwrap()).unwrap().unwrap();
        again.write_copy(&run).unwrap();
        assert_eq!(digest(&copy), files.sha256());
    }

    #[test]
    fn the_digest_is_of_what_the_room_is() {
        let folder = tempfile::tempdir().unwrap();
        let yaml = folder.path().join("a.yaml");
        let of = |text: &str, image: &str| {
            fs::write(&yaml, text).unwrap();
            fs::write(folder.path().join("a.pgm"), image).unwrap();
            digest(&yaml)
        };
        let here = of(YAML, "P5 1 1 255\n0");
        assert_eq!(of(&format!("# by hand\n{YAML}unreliable: [\"x\"]\n"), "P5 1 1 255\n0"), here);
        assert_ne!(of(YAML, "P5 1 1 255\n1"), here);
        for (from, to) in [("0.05", "0.06"), ("2.5", "2.6"), ("negate: 0", "negate: 1"), ("1e-7", "0.1")] {
            assert_ne!(of(&YAML.replace(from, to), "P5 1 1 255\n0"), here, "{to}");
        }
        let recorded = of(YAML, "P5 1 1 255\n0");
        let compare = |digest| RecordedRoom::compare(&yaml.display().to_string(), digest);
        assert_eq!(compare(Some(&recorded)), RecordedRoom::Same);
        assert_eq!(compare(None), RecordedRoom::NotChecked);
        assert_eq!(compare(Some("other")), RecordedRoom::Changed);
        fs::remove_file(folder.path().join("a.pgm")).unwrap();
        assert_eq!(compare(Some(&recorded)), RecordedRoom::Missing);
        assert_eq!(RecordedRoom::compare(LABORATORY, None), RecordedRoom::Same);
        assert!(
            RoomFiles::read("office:7").unwrap().is_none() && RoomFiles::read(LABORATORY).unwrap().is_none()
        );
        assert_eq!(name_for_people("maps/a.yaml"), "maps/a.yaml");
    }
}
