//! Recognition of the format of a room's file, and its decompression.

use super::{BYTES_MAX, JSON_OBJECTS_MAX, Room, RoomError, gltf, mruk, obj, scene};
use std::borrow::Cow;
use std::io::Read;

impl Room {
    /// Reads a room from the bytes of a file, which may be gzipped. Supported formats are:
    ///
    /// - scene JSON as WebXR's emulators record it (`.json`, y up);
    /// - scene JSON of Meta's Mixed Reality Utility Kit, as `MRUK.SaveSceneToJsonString` writes it (`.json`, y up);
    /// - glTF with embedded buffers (`.glb`, `.gltf`, y up);
    /// - Wavefront OBJ (`.obj`, y or z up). A line `# up y` or `# up z` near the beginning tells the axis. Without
    ///   one, the axis with the larger floor is used.
    ///
    /// The content tells the format; `name` becomes the room's name and tells OBJ by its ending.
    ///
    /// Scanned floors are not flat. The floor's height is estimated, and robots drive on a plane there.
    /// Triangles that lie completely below 3 cm above it belong to the floor and are no obstacles.
    ///
    /// # Errors
    /// The content is unknown or malformed, has numbers that are not finite or too many elements, or has no
    /// floor, no obstacles or no space for a robot.
    pub fn from_bytes(name: &str, bytes: &[u8]) -> Result<Room, RoomError> {
        let bytes = inflate(bytes)?;
        if bytes.len() > BYTES_MAX {
            return Err(RoomError::TooManyBytes { max: BYTES_MAX });
        }
        let bytes = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(&bytes);
        let first = bytes.iter().find(|byte| !byte.is_ascii_whitespace());
        if first == Some(&b'{') {
            check_json_objects(bytes)?;
        }
        let (mesh, stated_floor_m) = if bytes.starts_with(b"glTF") {
            (gltf::read(bytes)?, None)
        } else if first == Some(&b'{') {
            // Every glTF document has an `asset`, every scene of MRUK has `Rooms`, every other scene `spatialEntities`.
            match json_kind(bytes)? {
                JsonKind::Gltf => (gltf::read(bytes)?, None),
                JsonKind::Mruk => mruk::read(bytes)?,
                JsonKind::Scene => scene::read(bytes)?,
            }
        } else if has_ending(name, ".obj") {
            (obj::read(bytes)?, None)
        } else {
            return Err(RoomError::UnknownFormat { name: name.to_owned() });
        };
        Room::from_mesh(name, mesh, stated_floor_m)
    }
}

/// First bytes of a UTF-8 text as some programs write it.
const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

fn has_ending(name: &str, ending: &str) -> bool {
    let name = name.to_ascii_lowercase();
    name.strip_suffix(".gz").unwrap_or(&name).ends_with(ending)
}

/// Format of a JSON document.
enum JsonKind {
    Gltf,
    Mruk,
    Scene,
}

fn json_kind(bytes: &[u8]) -> Result<JsonKind, RoomError> {
    #[derive(serde::Deserialize)]
    struct Fields {
        asset: Option<serde::de::IgnoredAny>,
        #[serde(rename = "Rooms")]
        rooms: Option<serde::de::IgnoredAny>,
    }
    match serde_json::from_slice::<Fields>(bytes) {
        Ok(Fields { asset: Some(_), .. }) => Ok(JsonKind::Gltf),
        Ok(Fields { rooms: Some(_), .. }) => Ok(JsonKind::Mruk),
        // What is wrong in a scene, its reader says.
        Err(why) if why.is_syntax() || why.is_eof() => Err(RoomError::Json(why)),
        Ok(_) | Err(_) => Ok(JsonKind::Scene),
    }
}

/// Refuses documents whose many small objects would take far more memory than their text.
fn check_json_objects(bytes: &[u8]) -> Result<(), RoomError> {
    let count = bytes.iter().filter(|byte| **byte == b'{').count();
    let fits = count <= JSON_OBJECTS_MAX;
    if fits { Ok(()) } else { Err(RoomError::TooMany { what: "JSON objects", count, max: JSON_OBJECTS_MAX }) }
}

/// Decompresses gzip, up to one byte over the limit.
fn inflate(bytes: &[u8]) -> Result<Cow<'_, [u8]>, RoomError> {
    if !bytes.starts_with(&[0x1f, 0x8b]) {
        return Ok(Cow::Borrowed(bytes));
    }
    let mut inflated = Vec::new();
    let mut reader = flate2::read::MultiGzDecoder::new(bytes).take(BYTES_MAX as u64 + 1);
    reader.read_to_end(&mut inflated).map_err(RoomError::Gzip)?;
    Ok(Cow::Owned(inflated))
}
