//! The room that a configuration names: built-in, generated, or read from a file.

mod files;

pub use files::{RecordedRoom, RoomFiles, name_for_people, sha256};

use super::LABORATORY;
use formats::map_file::{self, MapFileError};
use sim::{Room, RoomError, RoomKind};
use std::io;
use std::path::{Path, PathBuf};

/// Largest file that is read as a scanned room, bytes.
const ROOM_BYTES_MAX: u64 = 256 << 20;
/// Largest image of a map that is read as a room, bytes.
const IMAGE_BYTES_MAX: u64 = 512 << 20;

/// Reason why a room cannot be loaded.
#[derive(Debug, thiserror::Error)]
pub enum RoomLoadError {
    /// The room's file cannot be read.
    #[error(
        "room {path}: {source}; expected `{LABORATORY}`, a generated room ({}, each with an optional :SEED), a map's \
         .yaml, or a .json, .json.gz, .glb, .gltf or .obj file of at most {} MB",
        generated_rooms(),
        ROOM_BYTES_MAX >> 20
    )]
    File {
        /// Path of the room's file.
        path: String,
        /// What the operating system said.
        source: io::Error,
    },
    /// The seed of a generated room is no number.
    #[error("room {kind}:{seed}: the seed is `{seed}`; expected a whole number from 0, as in `{kind}:7`")]
    Seed {
        /// Kind of the generated room.
        kind: String,
        /// Text behind the colon.
        seed: String,
    },
    /// The files of the map cannot be read.
    #[error("room {path}: {source}")]
    Map {
        /// Path of the map's YAML file.
        path: String,
        /// What is wrong, with the file.
        source: MapFileError,
    },
    /// The content of the room's file is refused.
    #[error("room {path}: {source}")]
    Content {
        /// Path of the room's file.
        path: String,
        /// What is wrong with its content.
        source: RoomError,
    },
}

/// Loads the room of this name: `laboratory`, a generated room, or a file. A map_server file (`.yaml`, `.yml`) becomes a room
/// whose frame is the map's.
pub fn load(name: &str) -> Result<Room, RoomLoadError> {
    if name == LABORATORY {
        return Ok(Room::laboratory());
    }
    if let Some((kind, seed)) = Room::parse_generated(name) {
        return Ok(Room::generate(kind, seed));
    }
    if let Some((kind, seed)) = name.split_once(':').filter(|(kind, _)| RoomKind::from_name(kind).is_some()) {
        return Err(RoomLoadError::Seed { kind: kind.into(), seed: seed.into() });
    }
    let path = Path::new(name);
    let file_name = path.file_name().map_or_else(|| name.into(), |name| name.to_string_lossy());
    let room = if is_map(path) {
        let map =
            map_file::read_map(path).map_err(|source| RoomLoadError::Map { path: name.into(), source })?;
        Room::from_map(&file_name, map.view())
    } else {
        let bytes = formats::limited::read(path, ROOM_BYTES_MAX)
            .map_err(|source| RoomLoadError::File { path: name.into(), source })?;
        Room::from_bytes(&file_name, &bytes)
    };
    room.map_err(|source| RoomLoadError::Content { path: name.into(), source })
}

/// Returns the files that [`load`] reads for a room: none for a built-in or generated one.
pub fn files(name: &str) -> Vec<PathBuf> {
    let path = Path::new(name);
    if name == LABORATORY || Room::parse_generated(name).is_some() {
        return Vec::new();
    }
    let of_map = is_map(path).then(|| map_file::read_files(path).ok()).flatten();
    of_map.map_or_else(|| vec![path.into()], Vec::from)
}

/// Whether a file is a map_server file by its name.
fn is_map(path: &Path) -> bool {
    let extension = path.extension().map(|extension| extension.to_ascii_lowercase());
    extension.is_some_and(|extension| extension == "yaml" || extension == "yml")
}

/// Lists the kinds of generated rooms, as a configuration names them.
fn generated_rooms() -> String {
    RoomKind::ALL.map(|kind| format!("`{}`", kind.name())).join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_that_is_no_file_has_no_files() {
        assert_eq!(files(LABORATORY), Vec::<PathBuf>::new());
        assert_eq!(files("office:7"), Vec::<PathBuf>::new());
        assert_eq!(files("hall.obj"), [PathBuf::from("hall.obj")]);
        assert_eq!(files("missing.yaml"), [PathBuf::from("missing.yaml")]);
        assert!(is_map(Path::new("a/B.YAML")) && is_map(Path::new("b.yml")) && !is_map(Path::new("yaml")));
    }
}
