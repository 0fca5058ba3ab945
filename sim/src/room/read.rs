//! Which format a room's bytes have, and their decompression.

use super::{BYTES_MAX, Room, RoomError, gltf, obj, scene};
use std::borrow::Cow;
use std::io::Read;

impl Room {
    /// Reads a room: scene JSON as WebXR's emulators record it (y up; `.json`), glTF with its buffers
    /// inside (y up; `.glb`, `.gltf`), or Wavefront OBJ (`.obj`; y or z up: a line `# up y` or `# up z` near its
    /// head says which, else the axis is taken on whose side the larger floor lies); any of
    /// them gzipped. What it is, its content says; `name` helps to tell OBJ and is the room's name.
    ///
    /// Floors of scans are not flat: the floor's height is found, robots drive on a plane there, and
    /// triangles wholly below 3 cm above it are the floor's and not obstacles.
    ///
    /// # Errors
    /// Unknown or malformed content; numbers that are none; too much of anything; no floor, nothing on
    /// it, or no place for a robot.
    pub fn from_bytes(name: &str, bytes: &[u8]) -> Result<Room, RoomError> {
        let bytes = inflate(bytes)?;
        if bytes.len() > BYTES_MAX {
            return Err(RoomError::TooManyBytes { max: BYTES_MAX });
        }
        let first = bytes.iter().find(|byte| !byte.is_ascii_whitespace());
        let (mesh, stated_floor_m) = if bytes.starts_with(b"glTF") {
            (gltf::read(&bytes)?, None)
        } else if first == Some(&b'{') {
            // A glTF document has to have an `asset`, a scene its `spatialEntities`.
            if is_gltf_json(&bytes) { (gltf::read(&bytes)?, None) } else { scene::read(&bytes)? }
        } else if has_ending(name, ".obj") {
            (obj::read(&bytes)?, None)
        } else {
            return Err(RoomError::UnknownFormat { name: name.to_owned() });
        };
        Room::from_mesh(name, mesh, stated_floor_m)
    }
}

fn has_ending(name: &str, ending: &str) -> bool {
    let name = name.to_ascii_lowercase();
    name.strip_suffix(".gz").unwrap_or(&name).ends_with(ending)
}

fn is_gltf_json(bytes: &[u8]) -> bool {
    #[derive(serde::Deserialize)]
    struct Either {
        asset: Option<serde::de::IgnoredAny>,
    }
    serde_json::from_slice::<Either>(bytes).is_ok_and(|either| either.asset.is_some())
}

/// Unpacks gzip, up to one byte over the limit.
fn inflate(bytes: &[u8]) -> Result<Cow<'_, [u8]>, RoomError> {
    if !bytes.starts_with(&[0x1f, 0x8b]) {
        return Ok(Cow::Borrowed(bytes));
    }
    let mut inflated = Vec::new();
    let mut reader = flate2::read::MultiGzDecoder::new(bytes).take(BYTES_MAX as u64 + 1);
    reader
        .read_to_end(&mut inflated)
        .map_err(|error| RoomError::Malformed { format: "gzip", reason: error.to_string() })?;
    Ok(Cow::Owned(inflated))
}
